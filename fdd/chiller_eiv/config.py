"""What the service and the study must know about one chiller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, Literal

from fdd.chiller_eiv.drift import DriftOptions
from fdd.chiller_eiv.errors import RAW_UNITS, Instrumentation, SensorError
from fdd.chiller_eiv.fit import FitOptions, Prior
from fdd.chiller_eiv.forms import (
    DIVISION_FREE,
    VARIABLE_FLOW,
    VARIABLE_SPEED,
    Form,
    variable_flow_and_speed_by_load,
    variable_speed_by_load,
)
from fdd.chiller_eiv.gate import GateLimits
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.steady_state import SteadyLimits, propose_limits
from fdd.records import FloatArray, IntArray


@dataclass(frozen=True)
class ChillerConfig:
    """One chiller's declaration.

    Attributes
    ----------
    name : as in the site file
    rated_load : rated capacity [W]
    instruments : what is measured and how well
    speed : compressor speed: ``fixed``, ``measured`` (quantity ``speed``), or ``by load`` where the drive's speed is
        unknown
    condenser_flow : ``fixed``, or ``measured`` where it varies (quantity ``flow_cd``)
    leak : heat leak where it is known from elsewhere [W]
    priors : Gaussian knowledge or bounds by parameter
    steady, gate, drift : limits and options of the stages
    steady_given : the fields of ``steady`` that were given; the others follow from the data
    residual_false_alarms : a year, for the chart of the steady states [1/a]
    baseline_days : length of the healthy period the baseline is learned from [d]
    price, currency : of electricity [currency/kWh]
    """

    name: str
    rated_load: float
    instruments: Instrumentation
    speed: Literal["fixed", "measured", "by load"] = "fixed"
    condenser_flow: Literal["fixed", "measured"] = "fixed"
    leak: float | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    steady: SteadyLimits = field(default_factory=SteadyLimits)
    gate: GateLimits = field(default_factory=GateLimits)
    drift: DriftOptions = field(default_factory=DriftOptions)
    steady_given: frozenset[str] = frozenset()
    residual_false_alarms: float = 0.25
    baseline_days: float = 84.0
    price: float = float("nan")
    currency: str = ""

    def __post_init__(self) -> None:
        """Refuse what cannot work together."""
        if not self.rated_load > 0:
            raise ChillerError(f"chiller {self.name!r}: rated_load must be positive; got {self.rated_load!r} W")
        for key, known in (("speed", ("fixed", "measured", "by load")), ("condenser_flow", ("fixed", "measured"))):
            if getattr(self, key) not in known:
                given = getattr(self, key)
                raise ChillerError(f"chiller {self.name!r}: {key} must be one of {', '.join(known)}; got {given!r}")
        if self.speed == "measured" and self.condenser_flow == "measured":
            raise ChillerError(
                f"chiller {self.name!r}: measured speed together with measured condenser flow is not supported; "
                "set speed to 'by load'"
            )
        if self.condenser_flow == "measured" and not self.instruments.nominal_flow_cd:
            raise ChillerError(f"chiller {self.name!r}: variable condenser flow needs nominal_flow_cd [kg/s]")

    def form(self) -> Form:
        """The regression form whose parameters are estimated."""
        if self.condenser_flow == "measured":
            return variable_flow_and_speed_by_load(self.rated_load) if self.speed == "by load" else VARIABLE_FLOW
        if self.speed == "measured":
            return VARIABLE_SPEED
        return variable_speed_by_load(self.rated_load) if self.speed == "by load" else DIVISION_FREE

    def steady_for(self, time: IntArray, raw: Mapping[str, FloatArray]) -> SteadyLimits:
        """Steady-state limits that fit these data, where the declaration leaves them open."""
        return propose_limits(
            time,
            raw,
            self.instruments,
            rated_load=self.rated_load,
            limits=self.steady,
            given=self.steady_given,
        )

    def fit_options(self) -> FitOptions:
        """How parameters are fitted."""
        return FitOptions(form=self.form(), priors=self.priors)

    def quantities(self) -> tuple[str, ...]:
        """Raw quantities this chiller must deliver, names of ``errors.RAW_UNITS``."""
        need = list(self.instruments.needed())
        if self.condenser_flow == "measured":
            need.append("flow_cd")
        if self.speed == "measured":
            need.append("speed")
        return tuple(k for k in RAW_UNITS if k in need)


_INSTRUMENT_KEYS = tuple(f.name for f in fields(Instrumentation) if f.name != "errors")


def config_of_table(name: str, table: Mapping[str, Any]) -> ChillerConfig:
    """A chiller's declaration from a plain table, as a site file has it; SI units.

    Parameters
    ----------
    name : of the chiller
    table : ``rated_load``; ``errors``: quantity to ``{random, relative, slow}``; the other fields of
        :class:`errors.Instrumentation` and of :class:`ChillerConfig` by name; ``steady``, ``gate``, ``drift`` and
        ``priors`` as tables of their fields

    Raises
    ------
    ChillerError : an unknown or missing key, with the nearest known one
    """
    own = {f.name for f in fields(ChillerConfig)} - {"name", "instruments", "steady_given"}
    _refuse_unknown(f"chiller {name!r}", table, {*own, *_INSTRUMENT_KEYS, "errors"})
    for key in ("rated_load", "errors"):
        if key not in table:
            raise ChillerError(f"chiller {name!r} lacks {key!r}; give it in SI units")
    errors = {k: _table(SensorError, f"chiller {name!r}, errors of {k}", v) for k, v in table["errors"].items()}
    instruments = Instrumentation(errors, **{k: table[k] for k in _INSTRUMENT_KEYS if k in table})
    values: dict[str, Any] = {k: table[k] for k in own if k in table}
    for key, kind in (("steady", SteadyLimits), ("gate", GateLimits), ("drift", DriftOptions)):
        if key in values:
            if key == "steady":
                values["steady_given"] = frozenset(values[key])
            values[key] = _table(kind, f"chiller {name!r}, {key}", values[key])
    if "priors" in values:
        values["priors"] = {k: _table(Prior, f"chiller {name!r}, prior of {k}", v) for k, v in values["priors"].items()}
    return ChillerConfig(name=name, instruments=instruments, **values)


def _table(kind: type[Any], where: str, values: Mapping[str, Any]) -> Any:
    _refuse_unknown(where, values, {f.name for f in fields(kind)})
    return kind(**values)


def _refuse_unknown(where: str, table: Mapping[str, Any], known: set[str]) -> None:
    for key in table:
        if key not in known:
            near = get_close_matches(key, sorted(known), 1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(sorted(known))}"
            raise ChillerError(f"{where}: unknown key {key!r}; {hint}")
