"""How equipment is declared to be watched from its first day: roles, rows of physical expectations, a steady form.

A *row* says what physics expects of a stretch of a day in one operating state: a residual that is zero (or, for an
inequality, at most zero) but for the errors of sensors and of the few numbers that a name plate leaves open. These
errors are the row's terms: each an unknown of mean zero with a standard deviation and the factor it enters with,

.. math:: r_t = \\sum_k h_{kt} b_k + e, \\quad b_k \\sim N(0, sd_k^2)

so that the engine (:mod:`fdd.diagnosis.evidence`) has a predictive distribution without any training. A *steady form*
gives the readings of settled operation from a few parameters; its faults are transformations of an input, a parameter
or a reading (:mod:`fdd.diagnosis.bank`). Tolerances follow ASHRAE Guideline 36-2021, 5.16.14, taken as two standard
deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fdd.models.declare import ModelError, Quantity
from fdd.records import FloatArray

BoolArray = NDArray[np.bool_]
Scale = Literal["identity", "log", "logit"]
Terms = Mapping[str, FloatArray | float]
Residual = tuple[FloatArray, Terms]


@dataclass(frozen=True, slots=True)
class Role(Quantity):
    """A measured quantity of equipment.

    Attributes
    ----------
    sd : standard deviation of what its reading may be off for good [unit]
    required : without it the equipment is not watched
    names : classes of Brick and tags of Project Haystack that mean the same
    driver : it comes from outside, and what was learned holds in the range that was seen of it
    """

    sd: float = 0.0
    required: bool = False
    names: tuple[str, ...] = ()
    driver: bool = False


@dataclass(frozen=True)
class Day:
    """A stretch of records of one piece of equipment, at most a day.

    Attributes
    ----------
    time : event time [s], (n,), increasing
    values : role to readings in SI, each (n,), NaN where missing; a role that is not mapped is absent
    step : length of a frame [s]
    """

    time: FloatArray
    values: Mapping[str, FloatArray]
    step: float

    def __getitem__(self, role: str) -> FloatArray:
        """A role's readings."""
        return self.values[role]

    def __contains__(self, role: object) -> bool:
        return role in self.values

    def get(self, role: str, default: float) -> FloatArray:
        """A role's readings, or a constant where it is not mapped."""
        return self.values.get(role, np.full(len(self.time), default))

    def held(self, mask: BoolArray, seconds: float) -> BoolArray:
        """Where a condition has held for so long without a break; (n,)."""
        return np.asarray(mask & (self.time - self.begin(mask) >= seconds - self.step / 2))

    def begin(self, mask: BoolArray) -> FloatArray:
        """When the present stretch of a condition began [s]; the first sample of the record counts as a beginning."""
        gap = np.concatenate([[False], np.diff(self.time) > 2.5 * self.step])
        fresh = mask & ~(np.concatenate([[False], mask[:-1]]) & ~gap)
        at = np.maximum.accumulate(np.where(fresh, np.arange(len(mask)), 0))
        return np.asarray(self.time[at])

    def since(self, mask: BoolArray, value: FloatArray, which: Literal["first", "highest", "lowest"]) -> FloatArray:
        """Of a quantity since the present stretch of a condition began, (n,): last value before, or extremes so far.

        A stretch that the record begins with has its own first value in place of the last before.
        """
        out = np.full(len(mask), np.nan)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
        for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            part = value[a:b]
            if which == "first":
                good = value[max(a - 1, 0) : b]
                good = good[np.isfinite(good)]
                out[a:b] = good[0] if len(good) else np.nan
            elif which == "highest":
                out[a:b] = np.fmax.accumulate(part)
            else:
                out[a:b] = np.fmin.accumulate(part)
        return out


@dataclass(frozen=True, slots=True)
class Term:
    """An unknown of a row besides its sensors: standard deviation in the unit it enters with."""

    symbol: str
    sd: float
    meaning: str


@dataclass(frozen=True, slots=True)
class Row:
    """One physical expectation.

    Attributes
    ----------
    name : of the row, a noun phrase
    needs : roles without which it is not evaluated
    residual : what is expected to vanish, (n,), NaN where the row does not apply, and the factor of every term by
        symbol (roles stand for the errors of their sensors)
    high, low : what a residual above, or below, says in words; empty where that side is no evidence
    high_causes, low_causes : faults that explain it
    terms : unknowns besides the sensors
    sd : of what is left from one stretch to the next [unit of the residual]
    span : length of the stretches that means are taken over [s]
    unit : of the residual
    inequality : only what exceeds zero is judged, and learned
    source : author, year, equation or section
    """

    name: str
    needs: tuple[str, ...]
    residual: Callable[[Day], Residual]
    source: str
    high: str = ""
    low: str = ""
    high_causes: tuple[str, ...] = ()
    low_causes: tuple[str, ...] = ()
    terms: tuple[Term, ...] = ()
    sd: float = 0.3
    unit: str = "K"
    inequality: bool = False
    span: float = 3600.0


@dataclass(frozen=True, slots=True)
class Prior:
    """A parameter of a steady form: its prior on the scale, with ``sd`` on that scale (a share for ``log``)."""

    symbol: str
    unit: str
    meaning: str
    mean: float
    sd: float
    scale: Scale = "identity"


Values = dict[str, FloatArray]
"""Parameters by symbol, each (k, 1), or readings by role, each (n,) or (k, n)."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A fault as a transformation of inputs, parameters or readings, with at most one unknown size.

    Attributes
    ----------
    fault : the name it is told by
    change : from (readings, parameters, size) to readings and parameters under the fault; arrays broadcast
    low, high : range of the size; ``scale`` says where it is uniform (identity) or log-uniform (log)
    unit : of the size
    starts : where the search begins
    needs : readings that it changes; left out where they are missing
    """

    fault: str
    change: Callable[[Values, Values, FloatArray], tuple[Values, Values]]
    low: float = 0.0
    high: float = 1.0
    scale: Literal["identity", "log"] = "identity"
    unit: str = "1"
    starts: tuple[float, ...] = (0.5,)
    needs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SteadyForm:
    """Readings of settled operation.

    Attributes
    ----------
    settled : where a day may be used, (n,)
    needs : roles it cannot do without
    predict : (readings, parameters) to what each output reads, (k, n); outputs that are not mapped are left out
    priors : of the parameters
    outputs : output role to the standard deviation of what is left of a block of half an hour
    alternatives : the faults
    """

    settled: Callable[[Day], BoolArray]
    needs: tuple[str, ...]
    predict: Callable[[Values, Values], Values]
    priors: tuple[Prior, ...]
    outputs: Mapping[str, float]
    alternatives: tuple[Alternative, ...]


@dataclass(frozen=True, slots=True)
class EquipmentFault:
    """A fault in words: what it means, where it sits (faults of one place are one finding), what to check first.

    ``odds`` are those before any evidence, against the other faults.
    """

    name: str
    place: str
    meaning: str
    checks: tuple[str, ...]
    odds: float = 1.0


@dataclass(frozen=True)
class EquipmentModel:
    """A kind of equipment, declared once: what is measured, what physics expects, and what may be wrong."""

    name: str
    title: str
    roles: tuple[Role, ...]
    rows: tuple[Row, ...]
    faults: tuple[EquipmentFault, ...]
    form: SteadyForm | None = None
    options: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a row that needs a role, or a cause, that is not declared."""
        roles, faults = set(self.by_symbol), {f.name for f in self.faults}
        for row in self.rows:
            for symbol in row.needs:
                if symbol not in roles:
                    raise ModelError(f"{self.name}: row {row.name!r} needs {symbol!r}, which is no role; declare it")
            for cause in (*row.high_causes, *row.low_causes):
                if cause not in faults:
                    raise ModelError(f"{self.name}: row {row.name!r} names {cause!r}, which is no fault; declare it")
        for a in self.form.alternatives if self.form else ():
            if a.fault not in faults:
                raise ModelError(f"{self.name}: an alternative is of {a.fault!r}, which is no fault; declare it")

    @cached_property
    def by_symbol(self) -> Mapping[str, Role]:
        """Roles by symbol."""
        return {r.symbol: r for r in self.roles}

    @cached_property
    def drivers(self) -> tuple[str, ...]:
        """Roles that come from outside, such as the weather."""
        return tuple(r.symbol for r in self.roles if r.driver)

    @cached_property
    def required(self) -> tuple[Role, ...]:
        """Roles without which the equipment is not watched."""
        return tuple(r for r in self.roles if r.required)

    def symbol_of(self, name: str) -> str | None:
        """The role a site's word means: its symbol, or a name of Brick or Haystack; None where there is none."""
        if name in self.by_symbol:
            return name
        plain = name.replace("-", " ").replace("_", " ").lower()
        found = [r.symbol for r in self.roles if plain in (n.replace("_", " ").lower() for n in r.names)]
        return found[0] if found else None
