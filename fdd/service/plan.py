"""What the engine watches: a site file, resolved to columns of a frame.

Everything that can be wrong in a site is found here, before the first sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fdd.chiller_eiv.config import ChillerConfig
from fdd.config import Equipment, Site, component_model
from fdd.config.chiller import chiller_config, chillers_share, is_chiller
from fdd.expressions import Expression
from fdd.models.declare import ComponentModel, Parameter
from fdd.records import NANOSECONDS, FloatArray


@dataclass(frozen=True, slots=True)
class Derived:
    """A point computed from others: ``compute`` takes columns by name, each (m,), and returns (m,)."""

    name: str
    compute: Callable[[Mapping[str, FloatArray]], FloatArray]


@dataclass(frozen=True, slots=True)
class Component:
    """One piece of equipment under a filter.

    ``inputs`` and ``outputs`` are point names in the order of the model; ``when`` names the column of its gate, which
    is 1 while the machine may be judged; ``start_up`` is how long its charts rest after a start [ns]. ``upstream`` has
    components whose alarm explains this one's; ``charts`` the kinds that watch it (empty: all), ``exclude`` the outputs
    and parameters that get none.
    """

    name: str
    model: ComponentModel
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    when: str | None = None
    start_up: int = 0
    weight: float = 1.0
    upstream: frozenset[str] = frozenset()
    charts: frozenset[str] = frozenset()
    exclude: frozenset[str] = frozenset()

    def carries(self, kind: str, symbol: str) -> bool:
        """Whether a chart of this kind watches this output or parameter."""
        return (not self.charts or kind in self.charts) and symbol not in self.exclude


@dataclass(frozen=True, slots=True)
class Chiller:
    """One chiller: ``inputs`` maps its quantities to columns; ``when`` and ``upstream`` as a component's."""

    name: str
    config: ChillerConfig
    inputs: Mapping[str, str]
    when: str | None = None
    upstream: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Plan:
    """All the engine needs to know; times in ns.

    ``false_alarms_per_year`` is what the components may give, ``budget`` what they and the chillers may give together.
    """

    site: str
    step: int
    lateness: int
    max_gap: int
    max_jump: int
    hold: int
    false_alarms_per_year: float
    points: tuple[str, ...]
    derived: tuple[Derived, ...]
    components: tuple[Component, ...]
    chillers: tuple[Chiller, ...] = ()
    tariffs: Mapping[str, float | str | None] = field(default_factory=dict)
    learning: int = 28 * 86400 * NANOSECONDS
    slack: float = 0.0
    budget: float | None = None

    @property
    def promised(self) -> float:
        """False alarms a year of the whole plant."""
        return self.false_alarms_per_year if self.budget is None else self.budget

    @property
    def watched(self) -> tuple[Component | Chiller, ...]:
        """Everything that can have a baseline: components, then chillers."""
        return (*self.components, *self.chillers)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of a frame's columns: the measured points, then the derived ones."""
        return (*self.points, *(d.name for d in self.derived))

    def derive(self, values: FloatArray) -> FloatArray:
        """Columns (m, n_columns) from the measured points' values (m, n_points)."""
        table = {name: values[:, i] for i, name in enumerate(self.points)}
        for derived in self.derived:
            table[derived.name] = np.broadcast_to(derived.compute(table), len(values))
        return np.column_stack([table[name] for name in self.columns])


def plan_of(site: Site) -> Plan:
    """Resolve a checked site; gates become derived columns of 1 and 0."""
    derived = [Derived(name, expression) for name, expression in site.derived.items()]
    components, chillers = [], []
    for name, equipment in site.equipment.items():
        gate = site.gate(name)
        when = None
        if gate is not None:
            when = f"{name}/when"
            derived.append(Derived(when, _as_number(gate)))
        if is_chiller(equipment):
            config, upstream = chiller_config(site, name), frozenset(equipment.upstream)
            chillers.append(Chiller(name, config, dict(equipment.inputs), when, upstream))
            continue
        model = _bounded(component_model(equipment), equipment)
        components.append(
            Component(
                name=name,
                model=model,
                inputs=tuple(equipment.inputs[q.symbol] for q in model.inputs),
                outputs=tuple(equipment.outputs[q.symbol] for q in model.outputs),
                when=when,
                start_up=_nanoseconds(equipment.start_up),
                weight=equipment.weight,
                upstream=frozenset(equipment.upstream),
                charts=frozenset(equipment.charts.kinds),
                exclude=frozenset(equipment.charts.exclude),
            )
        )
    return Plan(
        site=site.name,
        step=_nanoseconds(site.step),
        lateness=_nanoseconds(site.lateness),
        max_gap=_nanoseconds(site.max_gap),
        learning=_nanoseconds(site.learning),
        slack=site.reidentify.slack if site.reidentify else 0.0,
        max_jump=_nanoseconds(site.max_jump),
        hold=_nanoseconds(site.hold),
        false_alarms_per_year=site.false_alarms_per_year * (1 - chillers_share(site)),
        budget=site.false_alarms_per_year,
        points=tuple(site.measured),
        derived=tuple(derived),
        components=tuple(components),
        chillers=tuple(chillers),
        tariffs=site.tariffs.model_dump(),
    )


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


def _as_number(gate: Expression) -> Callable[[Mapping[str, FloatArray]], FloatArray]:
    return lambda columns: gate.gate(columns).astype(np.float64)


def _bounded(model: ComponentModel, equipment: Equipment) -> ComponentModel:
    """The model with the site's starting values and bounds in place of its own."""

    def given(p: Parameter) -> Parameter:
        spec = equipment.parameters.get(p.symbol)
        if spec is None:
            return p
        lower = p.lower if spec.lower is None else spec.lower
        upper = p.upper if spec.upper is None else spec.upper
        typical = min(max(p.typical, lower), upper) if spec.initial is None else spec.initial
        return replace(p, typical=typical, lower=lower, upper=upper)

    return replace(model, parameters=tuple(given(p) for p in model.parameters))
