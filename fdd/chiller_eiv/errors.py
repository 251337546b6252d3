"""From measured quantities to regressors (T_cdi, T_chi, Q, E, ...) and the covariance of their random errors.

Where the load is computed from flow and temperatures, Q = c m (T_chi - T_cho), its error is correlated with T_chi's;
where an auxiliary is taken off the meter, E carries both errors. Each derived quantity therefore keeps its gradient
with respect to the raw readings, and the covariance of a point is G diag(variances) G'.

The errors here are *random* ones. No regression corrects a sensor's bias.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fdd.chiller_eiv.model import WATER_HEAT_CAPACITY, ZERO_CELSIUS, ChillerError
from fdd.records import FloatArray, IntArray

RAW_UNITS: Mapping[str, str] = {
    "T_cdi": "degC",
    "T_cdo": "degC",
    "T_chi": "degC",
    "T_cho": "degC",
    "flow_ch": "kg/s",
    "flow_cd": "kg/s",
    "load": "W",
    "power": "W",
    "auxiliary": "W",
    "speed": "1",
    "T_sat_cd": "degC",
    "T_sat_ev": "degC",
    "T_liquid": "degC",
    "T_discharge": "degC",
    "T_oil": "degC",
    "subcooling": "K",
    "superheat": "K",
    "drive_ch": "any",
    "drive_cd": "any",
    "others": "1",
}
"""What a chiller may have measured: condenser and chilled water entering (i) and leaving (o), their mass flows, a heat
meter's load, electrical power, auxiliaries on the same meter, relative compressor speed, saturation temperatures of
condenser and evaporator, liquid line, discharge and oil temperature, or subcooling and discharge superheat as such;
what drives the chilled and the condenser water pump (speed, power or command, in any unit), and how many other machines
run on the same water."""


@dataclass(frozen=True, slots=True)
class SensorError:
    """One-sigma random error of a sensor.

    Attributes
    ----------
    random : of one sample, independent from sample to sample; averaging N samples divides its variance by N
    relative : the same, as a share of the reading [1]
    slow : what does not average out within a window but differs from window to window (installation, resolution)
    scale : what never averages out, as a share of the reading [1]: a meter's calibration
    """

    random: float = 0.0
    relative: float = 0.0
    slow: float = 0.0
    scale: float = 0.0

    def __post_init__(self) -> None:
        """Refuse negative standard deviations."""
        for name in ("random", "relative", "slow", "scale"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ChillerError(f"sensor error {name} must be zero or positive; got {value!r}: give one sigma")

    def variance(self, reading: FloatArray, samples: IntArray | int) -> FloatArray:
        """Variance of the mean of ``samples`` readings, shape of ``reading``."""
        one = self.random**2 + (self.relative * reading) ** 2
        return np.asarray(one / np.maximum(samples, 1) + self.slow**2)

    def sd(self, reading: float) -> float:
        """Standard deviation of one sample."""
        return float(np.hypot(self.random, self.relative * reading))


@dataclass(frozen=True)
class Instrumentation:
    """What is measured on a chiller and how well.

    Attributes
    ----------
    errors : sensor error by raw quantity, in the units of ``RAW_UNITS``
    load_from : ``flow`` for c m (T_chi - T_cho), ``meter`` for a heat meter's reading
    chilled_water : which chilled-water temperature the model works with. ``entering`` is the model's own; it is
        taken from its sensor, or from T_cho + Q/(c m) where only the leaving one is measured. ``leaving`` uses T_cho as
        it is: the parameters then mean something a little different and compare only with others fitted so
    auxiliary : constant power of auxiliaries on the compressor's meter [W], beside a measured ``auxiliary``
    heat_capacity : of the chilled water [J/(kg K)]; brine differs
    nominal_flow_cd : condenser flow that relative flow V = 1 stands for [kg/s]; needed by the variable-flow form
    """

    errors: Mapping[str, SensorError]
    load_from: Literal["flow", "meter"] = "flow"
    chilled_water: Literal["entering", "leaving"] = "entering"
    auxiliary: float = 0.0
    heat_capacity: float = WATER_HEAT_CAPACITY
    nominal_flow_cd: float | None = None

    def __post_init__(self) -> None:
        """Refuse unknown quantities and choices."""
        for name in self.errors:
            if name not in RAW_UNITS:
                raise ChillerError(f"unknown chiller quantity {name!r}; known: {', '.join(RAW_UNITS)}")
        if self.load_from not in ("flow", "meter"):
            raise ChillerError(f"load_from must be 'flow' or 'meter'; got {self.load_from!r}")
        if self.chilled_water not in ("entering", "leaving"):
            raise ChillerError(f"chilled_water must be 'entering' or 'leaving'; got {self.chilled_water!r}")

    def needed(self) -> tuple[str, ...]:
        """Raw quantities without which no point can be made."""
        chilled = ("T_cho",) if self.chilled_water == "leaving" else ("T_chi",)
        if self.load_from == "flow":
            return ("T_cdi", "T_chi", "T_cho", "flow_ch", "power")
        if self.chilled_water == "entering" and "T_chi" not in self.errors:
            return ("T_cdi", "T_cho", "flow_ch", "load", "power")
        return ("T_cdi", *chilled, "load", "power")

    def scales(self) -> dict[str, float]:
        """Declared scale errors of load and power, ``Q`` and ``E`` [1]."""
        meters = ("load",) if self.load_from == "meter" else ("flow_ch",)
        table = {"Q": meters, "E": ("power",)}
        return {
            k: float(np.hypot.reduce([self.errors[m].scale for m in v if m in self.errors] + [0.0]))
            for k, v in table.items()
        }

    def sd_of(self, name: str, reading: float) -> float:
        """One-sample standard deviation of a raw quantity, zero where none is declared."""
        error = self.errors.get(name)
        return 0.0 if error is None else error.sd(reading)


class _Derived:
    """A quantity with its value (n,) and its gradient with respect to the raw readings (n, r)."""

    def __init__(self, value: FloatArray, gradient: FloatArray) -> None:
        self.value = value
        self.gradient = gradient

    def __add__(self, other: _Derived) -> _Derived:
        return _Derived(self.value + other.value, self.gradient + other.gradient)

    def __sub__(self, other: _Derived) -> _Derived:
        return _Derived(self.value - other.value, self.gradient - other.gradient)

    def __mul__(self, other: _Derived) -> _Derived:
        gradient = self.gradient * other.value[:, None] + other.gradient * self.value[:, None]
        return _Derived(self.value * other.value, gradient)

    def __truediv__(self, other: _Derived) -> _Derived:
        ratio = self.value / other.value
        return _Derived(ratio, (self.gradient - ratio[:, None] * other.gradient) / other.value[:, None])

    def scaled(self, factor: float) -> _Derived:
        return _Derived(self.value * factor, self.gradient * factor)


def regressors(
    raw: Mapping[str, FloatArray], samples: IntArray | int, instruments: Instrumentation, measured: tuple[str, ...]
) -> tuple[FloatArray, FloatArray]:
    """Measurements of the model and their error covariance, from averaged raw readings.

    Parameters
    ----------
    raw : averaged readings, shape (n,) each, units of ``RAW_UNITS``
    samples : how many readings each average holds, shape (n,) or one number
    instruments : what is measured and how well
    measured : of the regression form, for example ``("T_cdi", "T_chi", "Q", "E")``

    Returns
    -------
    x (n, m) in [K, K, W, W, 1] and covariance (n, m, m)

    Raises
    ------
    ChillerError : a needed quantity is missing
    """
    names = [k for k in RAW_UNITS if k in raw]
    missing = [k for k in instruments.needed() if k not in names]
    if missing:
        raise ChillerError(
            f"the chiller's points lack {', '.join(missing)}; the load comes from {instruments.load_from} and the "
            f"chilled water is taken {instruments.chilled_water}: map the points, or change load_from or chilled_water"
        )
    count = np.asarray(samples)
    unit = np.eye(len(names))
    have = {
        k: _Derived(np.asarray(raw[k], float), np.broadcast_to(unit[i], (len(raw[k]), len(names))))
        for i, k in enumerate(names)
    }
    variance = np.stack(
        [instruments.errors.get(k, SensorError()).variance(have[k].value, count) + 0 * have[k].value for k in names],
        axis=1,
    )
    columns = _columns(have, instruments, measured)
    G = np.stack([c.gradient for c in columns], axis=1)
    x = np.stack([c.value for c in columns], axis=1)
    return x, np.einsum("nir,nr,njr->nij", G, variance, G)


def _columns(have: Mapping[str, _Derived], instruments: Instrumentation, measured: tuple[str, ...]) -> list[_Derived]:
    c = instruments.heat_capacity
    if instruments.load_from == "meter":
        load = have["load"]
    else:
        load = (have["flow_ch"] * (have["T_chi"] - have["T_cho"])).scaled(c)
    if instruments.chilled_water == "leaving":
        chilled = have["T_cho"]
    elif "T_chi" in have:
        chilled = have["T_chi"]
    else:
        chilled = have["T_cho"] + (load / have["flow_ch"]).scaled(1 / c)
    electric = have["power"]
    if "auxiliary" in have:
        electric = electric - have["auxiliary"]
    electric = _Derived(electric.value - instruments.auxiliary, electric.gradient)
    table = {"T_cdi": _kelvin(have["T_cdi"]), "T_chi": _kelvin(chilled), "Q": load, "E": electric}
    if "V" in measured:
        if "flow_cd" not in have or not instruments.nominal_flow_cd:
            raise ChillerError("the variable-flow form needs flow_cd measured and nominal_flow_cd [kg/s] declared")
        table["V"] = have["flow_cd"].scaled(1 / instruments.nominal_flow_cd)
    if "w" in measured:
        if "speed" not in have:
            raise ChillerError("the variable-speed form needs the speed measured; or use variable_speed_by_load")
        table["w"] = have["speed"]
    return [table[k] for k in measured]


def _kelvin(t: _Derived) -> _Derived:
    return _Derived(t.value + ZERO_CELSIUS, t.gradient)


def heat_balance(raw: Mapping[str, FloatArray], load: FloatArray, electric: FloatArray, c: float) -> FloatArray:
    """Error of Q_cd = Q + E, shape (n,): (c m_cd (T_cdo - T_cdi) - Q - E) / (Q + E); NaN where not measured."""
    if not {"flow_cd", "T_cdo", "T_cdi"} <= raw.keys():
        return np.full(len(load), np.nan)
    rejected = c * raw["flow_cd"] * (raw["T_cdo"] - raw["T_cdi"])
    total = load + electric
    return np.asarray(np.where(total > 0, (rejected - total) / np.where(total > 0, total, 1.0), np.nan))
