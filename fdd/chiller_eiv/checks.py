"""What must be ruled out before "fouling" is said, and what extra sensors add.

A water flow that reads 5 % low looks exactly like an 11 % rise of the heat-exchanger resistance, so the heat balance
Q_cd = Q + E is looked at first. Condenser and evaporator approach and subcooling, where refrigerant temperatures are
measured, tell the sides apart and see small faults that the power residual cannot (laboratory faults of 10 to 14 %
severity move it by 1 % or less).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fdd.chiller_eiv.drift import Isolation
from fdd.chiller_eiv.model import ChillerError
from fdd.records import FloatArray

BALANCE_TOLERANCE = 0.02
"""Change of the heat balance's error that is worth a look at the meters [1]."""

SERIES: Mapping[str, tuple[str, str, str]] = {
    "condenser approach": ("T_sat_cd", "T_cdo", "condenser"),
    "evaporator approach": ("T_cho", "T_sat_ev", "evaporator"),
    "subcooling": ("T_sat_cd", "T_liquid", "refrigerant charge"),
}
"""Series by name: the warmer and the colder quantity, and the side it speaks of."""


@dataclass(frozen=True, slots=True)
class SensorCheck:
    """Whether the heat balance moved since the baseline.

    Attributes
    ----------
    checked : False where it is not measured
    change, se : change of its mean error and the standard error of that [1]
    suspicious : whether a sensor must be checked first
    note : in words
    """

    checked: bool
    change: float
    se: float
    suspicious: bool
    note: str


def check_balance(before: FloatArray, now: FloatArray) -> SensorCheck:
    """Compare the heat balance's error of recent points with the baseline's.

    Parameters
    ----------
    before, now : relative errors of Q_cd = Q + E, shape (n,), (m,); NaN where not measured
    """
    a, b = before[np.isfinite(before)], now[np.isfinite(now)]
    if len(a) < 10 or len(b) < 5:
        note = "the heat balance is not measured (condenser flow and leaving temperature): check the flow meter by hand"
        return SensorCheck(False, np.nan, np.nan, False, note)
    change = float(np.median(b) - np.median(a))
    se = float(1.25 * np.hypot(a.std(ddof=1) / np.sqrt(len(a)), b.std(ddof=1) / np.sqrt(len(b))))
    suspicious = abs(change) > max(BALANCE_TOLERANCE, 3 * se)
    if suspicious:
        less = "evaporator flow or temperature difference reads low, or condenser flow reads high"
        more = "evaporator flow or temperature difference reads high, or condenser flow reads low"
        note = (
            f"the heat balance moved by {100 * change:+.1f} %: {less if change > 0 else more}; check the meters first"
        )
    else:
        note = f"the heat balance holds (moved by {100 * change:+.1f} %)"
    return SensorCheck(True, change, se, suspicious, note)


@dataclass(frozen=True, slots=True)
class ApproachModel:
    """A temperature difference and how it goes with load while healthy: intercept [K] and slope [K/W]."""

    series: str
    intercept: float
    slope: float

    def residual(self, raw: Mapping[str, FloatArray], load: FloatArray) -> FloatArray:
        """Measured less expected difference [K], shape (n,)."""
        return approach(self.series, raw) - self.intercept - self.slope * load


def approach(series: str, raw: Mapping[str, FloatArray]) -> FloatArray:
    """One of ``SERIES`` [K], shape (n,)."""
    warm, cold, _ = SERIES[series]
    return np.asarray(raw[warm] - raw[cold])


def available_series(raw: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Names of the series whose quantities are measured."""
    return tuple(
        k for k, (w, c, _) in SERIES.items() if w in raw and c in raw and np.isfinite(raw[w] - raw[c]).sum() >= 10
    )


def fit_approach(series: str, raw: Mapping[str, FloatArray], load: FloatArray) -> ApproachModel:
    """Line through a baseline's points by robust least squares.

    Raises
    ------
    ChillerError : fewer than ten points
    """
    value = approach(series, raw)
    keep = np.isfinite(value) & np.isfinite(load)
    if keep.sum() < 10:
        raise ChillerError(f"{series}: {int(keep.sum())} points are too few for a baseline; 10 are needed")
    v, q = value[keep], load[keep]
    A = np.column_stack([np.ones(len(q)), q / q.mean()])
    w = np.ones(len(q))
    b: FloatArray = np.zeros(2)
    for _ in range(20):
        b = np.asarray(np.linalg.lstsq(A * w[:, None], v * w, rcond=None)[0], dtype=np.float64)
        r = v - A @ b
        w = 1 / np.maximum(1.0, np.abs(r) / (2 * max(1.4826 * float(np.median(np.abs(r))), 1e-6)))
    return ApproachModel(series, float(b[0]), float(b[1] / q.mean()))


@dataclass(frozen=True)
class Finding:
    """What a technician is told.

    Attributes
    ----------
    sentence : the finding in one sentence
    cause : name of the most likely cause
    probability : of it among the explanations compared; None where none were
    checks : what to check, first one first
    """

    sentence: str
    cause: str
    probability: float | None
    checks: tuple[str, ...]


def diagnose(
    isolation: Isolation, since: str, sensors: SensorCheck, sides: Mapping[str, float] | None = None
) -> Finding:
    """Words for a drift: which parameter, how much, which side, and what to rule out first.

    Parameters
    ----------
    isolation : of the parameter charts
    since : the onset, as text
    sensors : heat balance since then
    sides : alarmed approach series and their change [K], if any
    """
    sides = sides or {}
    direction = "up" if isolation.change > 0 else "down"
    low, high = sorted((abs(isolation.low), abs(isolation.high)))
    digits = 0 if high - low > 0.02 else 1
    span = f"{100 * low:.{digits}f} to {100 * high:.{digits}f} %"
    amount = f"{direction} {100 * abs(isolation.change):.{digits}f} % ({span}) since {since}"
    if sensors.suspicious:
        text = f"{isolation.name} seems {amount}, but {sensors.note}"
        return Finding(text, "sensor", isolation.probability, ("flow meter", "chilled-water temperature sensors"))
    if isolation.parameter == "R":
        side = _side(sides)
        first = "check flow meter first" if not sensors.checked else sensors.note
        checks = ("flow meter", *_fouling_checks(side))
        return Finding(f"{isolation.name} {amount}, {side}, {first}", isolation.name, isolation.probability, checks)
    checks = (
        "power meter and auxiliaries on it",
        "refrigerant charge and non-condensables",
        "compressor, oil, bypass valve",
    )
    return Finding(f"{isolation.name} {amount}; {sensors.note}", isolation.name, isolation.probability, checks)


@dataclass(frozen=True, slots=True)
class DailyChange:
    """A daily series in alarm: its change (share of power, or K) and since when, as text."""

    series: str
    change: float
    since: str


def diagnose_daily(changes: tuple[DailyChange, ...], power: str, sensors: SensorCheck) -> Finding:
    """Words for daily charts in alarm where no parameter says more.

    Parameters
    ----------
    changes : the alarmed series, at least one
    power : name of the power residual's series
    sensors : heat balance since then
    """
    sides = {c.series: c.change for c in changes if c.series != power}
    words = []
    for c in changes:
        if c.series == power:
            more = "more" if c.change > 0 else "less"
            words.append(
                f"takes {abs(100 * c.change):.1f} % {more} power at given load and temperatures since {c.since}"
            )
        else:
            words.append(f"{c.series} {'up' if c.change > 0 else 'down'} {abs(c.change):.2f} K since {c.since}")
    text = f"{', '.join(words)}; {sensors.note}"
    if sensors.suspicious:
        return Finding(text, "sensor", None, ("flow meter", "chilled-water temperature sensors"))
    cause = "power" if any(c.series == power for c in changes) else _side(sides).split(" ")[0] + " side"
    if any(c.series == "subcooling" for c in changes):
        return Finding(text, "refrigerant charge", None, ("refrigerant charge", *_fouling_checks(_side(sides))))
    checks = ("power meter and auxiliaries on it", "flow meter", *_fouling_checks(_side(sides)))
    return Finding(text, cause, None, checks)


def _side(sides: Mapping[str, float]) -> str:
    warm, cold = sides.get("condenser approach", 0.0) > 0, sides.get("evaporator approach", 0.0) > 0
    if warm and not cold:
        return "condenser side likely"
    if cold and not warm:
        return "evaporator side likely"
    return "both sides" if warm and cold else "side unknown without refrigerant temperatures"


def _fouling_checks(side: str) -> tuple[str, ...]:
    condenser = ("condenser water flow and strainer", "condenser tubes (fouling)", "non-condensable gas")
    evaporator = ("chilled-water flow", "evaporator tubes", "refrigerant charge")
    if side.startswith("condenser"):
        return condenser
    return evaporator if side.startswith("evaporator") else (*condenser, *evaporator)
