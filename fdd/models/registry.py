"""The component models by name, so that a site file or a stored baseline can ask for one."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any

from fdd.models.air_handler import air_handler
from fdd.models.building import building
from fdd.models.declare import ComponentModel, ModelError
from fdd.models.heat_exchanger import heat_exchanger
from fdd.models.pipe_hydraulic import pipe_hydraulic
from fdd.models.pipe_thermal import pipe_thermal
from fdd.models.pump import pump
from fdd.models.radiator import radiator
from fdd.models.restrict import restrict
from fdd.models.thermostatic_valve import thermostatic_valve
from fdd.models.valve import control_valve, relief_valve
from fdd.models.zone import zone

Factory = Callable[..., ComponentModel]

MODELS: dict[str, Factory] = {}

# Any model can be narrowed by these, whatever its own options are (see fdd.models.restrict).
COMMON_OPTIONS = ("fixed", "tied")


def register(name: str, factory: Factory) -> None:
    """Make a factory known under a name.

    Raises
    ------
    ModelError : the name is taken
    """
    if name in MODELS:
        raise ModelError(f"model {name!r} is already registered by {MODELS[name].__module__}; choose another name")
    MODELS[name] = factory


def get_model(name: str, **options: Any) -> ComponentModel:
    """The model called ``name``, made with its options; ``fixed`` and ``tied`` narrow any model.

    Raises
    ------
    ModelError : unknown name or option (with the nearest known one), or an option's value that the model refuses

    Examples
    --------
    >>> [s.symbol for s in get_model("heat_exchanger", compartments=1).states]
    ['T_hot_1', 'T_cold_1']
    """
    if name not in MODELS:
        raise ModelError(f"unknown model {name!r}{_suggest(name, MODELS)}; known: {', '.join(sorted(MODELS))}")
    factory = MODELS[name]
    known = (*inspect.signature(factory).parameters, *COMMON_OPTIONS)
    for option in options:
        if option not in known:
            raise ModelError(
                f"model {name!r} has no option {option!r}{_suggest(option, known)}; its options: {', '.join(known)}"
            )
    own = {k: v for k, v in options.items() if k not in COMMON_OPTIONS}
    return restrict(factory(**own), fixed=options.get("fixed") or {}, tied=options.get("tied") or {})


def _suggest(word: str, known: Mapping[str, Any] | tuple[str, ...]) -> str:
    close = get_close_matches(word, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


for _factory in (
    radiator,
    heat_exchanger,
    building,
    zone,
    air_handler,
    pipe_hydraulic,
    pipe_thermal,
    thermostatic_valve,
    pump,
    control_valve,
    relief_valve,
):
    register(_factory.__name__, _factory)
