"""How a component is declared: tables of quantities with units, and equations as plain Python functions.

The equations are written once with ``+ - * / **`` and the functions of :mod:`fdd.models.functions`; they run unchanged
on floats (debugging), on the tracer of :mod:`fdd.greybox.trace` (kernels with exact derivatives) and on SymPy (LaTeX
for documentation). They receive their arguments by name, never by position::

    def drift(x, u, p):
        return {"T_air": (x.T_wall - x.T_air) / (p.R_aw * p.C_air) + u.Phi / p.C_air}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Namespace = Any  # attribute access by symbol; floats, traced expressions or SymPy symbols
Equations = Callable[[Namespace, Namespace, Namespace], Mapping[str, Any]]

Transform = Literal["log", "identity", "logit"]


class ModelError(ValueError):
    """A declaration that cannot become a filter; the text names the symbol, the equation and the remedy."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A symbol with its unit and meaning."""

    symbol: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class State(Quantity):
    """A state and the standard deviation of its value at the start of filtering [its unit]."""

    initial_sd: float


@dataclass(frozen=True, slots=True)
class Parameter(Quantity):
    """A parameter with its typical value and bounds, all in ``unit``.

    ``transform`` is the scale estimation works on: ``log`` for what must stay positive, ``logit`` for what must stay
    inside its bounds, ``identity`` for the rest. ``kind`` says what it describes; only ``physical`` ones show faults.
    """

    typical: float
    lower: float
    upper: float
    source: str
    transform: Transform = "log"
    kind: Literal["physical", "noise", "initial"] = "physical"


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault the component can show, and through what.

    ``shows`` maps a parameter to the sign of its change (+1, -1, or 0 for either), or ``"innovation:OUTPUT"`` to the
    sign of the mean.
    """

    name: str
    meaning: str
    shows: Mapping[str, int]
    checks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Plausible:
    """What equipment of the kind is known to be like, from data sheets: a number of the parameters within a factor.

    ``of`` takes parameters by symbol; ``typical`` in ``unit``; ``remedy`` is what to look at where it is beyond.
    """

    meaning: str
    of: Callable[[Mapping[str, float]], float]
    unit: str
    typical: float
    factor: float
    remedy: str


@dataclass(frozen=True)
class ComponentModel:
    """A component declared once.

    Attributes
    ----------
    name, version, title : identity; the version changes when an equation changes
    states, inputs, outputs, parameters : tables; order is the order of every array
    drift : dx/dt per second, a mapping from state symbol to expression
    diffusion : standard deviation of each state's Wiener increment, per square root of a second
    observe : each output's expected value
    noise : standard deviation of each output's measurement error
    start : the state at the first sample from its measurements ``y``, inputs ``u`` and parameters ``p``
    options : how this variant was made, kept with every baseline
    valid : input or output symbol to the range the equations hold in
    plausible : what estimates must be like to be put in force
    """

    name: str
    version: str
    title: str
    states: tuple[State, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    parameters: tuple[Parameter, ...]
    drift: Equations
    diffusion: Equations
    observe: Equations
    noise: Equations
    start: Equations
    options: Mapping[str, Any] = field(default_factory=dict)
    valid: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    references: tuple[str, ...] = ()
    plausible: tuple[Plausible, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a symbol declared twice and a bound that excludes the typical value."""
        seen: dict[str, str] = {}
        for table in ("states", "inputs", "parameters"):
            for q in getattr(self, table):
                if q.symbol in seen:
                    raise ModelError(
                        f"{self.name}: symbol {q.symbol!r} stands in {seen[q.symbol]} and in {table}; rename one"
                    )
                seen[q.symbol] = table
        for p in self.parameters:
            if not p.lower <= p.typical <= p.upper:
                raise ModelError(
                    f"{self.name}: parameter {p.symbol} has typical value {p.typical} {p.unit} "
                    f"outside [{p.lower}, {p.upper}]"
                )
            if p.transform == "log" and p.lower <= 0:
                raise ModelError(
                    f"{self.name}: parameter {p.symbol} is estimated on a log scale but its lower bound is {p.lower}; "
                    "give a positive bound or transform='identity'"
                )

    @property
    def symbols(self) -> Mapping[str, tuple[str, ...]]:
        """Symbols by table, in order."""
        return {t: tuple(q.symbol for q in getattr(self, t)) for t in ("states", "inputs", "outputs", "parameters")}
