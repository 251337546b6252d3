"""What must be ruled out before "fouling" is said, and the words for what was found.

A water flow that reads 5 % low looks exactly like an 11 % rise of the heat-exchanger resistance, so the heat balance
Q_cd = Q + E is looked at first. The steady states' vectors (``vector.py``), where more is measured, tell the sides
apart and see small faults that power cannot: laboratory faults of 10 to 14 % severity move it by 1 % or less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fdd.chiller_eiv.drift import Isolation
from fdd.chiller_eiv.vector import FEATURES, VectorBaseline
from fdd.chiller_eiv.watch import VectorFinding
from fdd.records import FloatArray

BALANCE_TOLERANCE = 0.02
"""Change of the heat balance's error that is worth a look at the meters [1]."""


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


@dataclass(frozen=True)
class Finding:
    """What a technician is told.

    Attributes
    ----------
    sentence : the finding in one sentence
    cause : name of the most likely cause or group of causes; ``not known`` where the evidence names none
    probability : of it among the explanations compared; None where none were
    checks : what to check, first what decides most
    ranked : single causes with their probabilities, where they were compared
    """

    sentence: str
    cause: str
    probability: float | None
    checks: tuple[str, ...]
    ranked: tuple[tuple[str, float], ...] = ()


NOT_KNOWN = "not known"

RESISTANCE_CHECKS = (
    "flow meter",
    "condenser water flow and strainer",
    "chilled-water flow",
    "condenser tubes (fouling)",
    "non-condensable gas",
    "evaporator tubes",
    "refrigerant charge",
)
LOSS_CHECKS = (
    "power meter and auxiliaries on it",
    "refrigerant charge and non-condensables",
    "compressor, oil, bypass valve",
)
SENSOR_CHECKS = ("flow meter", "chilled-water temperature sensors")
LESS = {
    "R": "heat exchangers cleaner, more water through them, or a meter that reads otherwise than before",
    "dS": "less loss than when it was learned: a repair, less on the meter, or a meter that reads otherwise",
}
"""What a parameter that went down may mean; no fault makes a machine better."""


def diagnose(isolation: Isolation, since: str, sensors: SensorCheck) -> Finding:
    """Words for a drift of the parameters: which, how much, and what to rule out first.

    Parameters
    ----------
    isolation : of the parameter charts
    since : the onset, as text
    sensors : heat balance since then
    """
    amount = f"{drift_words(isolation)} since {since}"
    if sensors.suspicious:
        return Finding(f"{amount}, as it seems, but {sensors.note}", "sensor", isolation.probability, SENSOR_CHECKS)
    if isolation.change < 0:
        cause = "better than when it was learned"
        text = f"{amount}; {LESS.get(isolation.parameter, 'no fault does this')}; {sensors.note}"
        return Finding(text, cause, isolation.probability, ("power meter and auxiliaries on it", *SENSOR_CHECKS))
    if isolation.parameter == "R":
        first = "check flow meter first" if not sensors.checked else sensors.note
        return Finding(f"{amount}, {first}", isolation.name, isolation.probability, RESISTANCE_CHECKS)
    return Finding(f"{amount}; {sensors.note}", isolation.name, isolation.probability, LOSS_CHECKS)


def drift_words(isolation: Isolation) -> str:
    """Which parameter, in which direction and by how much."""
    low, high = sorted((abs(isolation.low), abs(isolation.high)))
    digits = 0 if high - low > 0.02 else 1
    direction = "up" if isolation.change > 0 else "down"
    span = f"{100 * low:.{digits}f} to {100 * high:.{digits}f} %"
    return f"{isolation.name} {direction} {100 * abs(isolation.change):.{digits}f} % ({span})"


SENSOR_NAMES: Mapping[str, str] = {
    "T_cdi": "condenser water entering",
    "T_cdo": "condenser water leaving",
    "T_chi": "chilled water entering",
    "T_cho": "chilled water leaving",
    "flow_ch": "chilled-water flow",
    "flow_cd": "condenser water flow",
    "load": "cooling load",
    "power": "electrical power",
    "T_sat_cd": "condensing temperature",
    "T_sat_ev": "evaporating temperature",
    "T_liquid": "liquid line temperature",
    "T_discharge": "discharge temperature",
    "T_oil": "oil temperature",
    "subcooling": "subcooling",
    "superheat": "discharge superheat",
}


def describe(finding: VectorFinding, baseline: VectorBaseline, since: str) -> Finding:
    """Words for a change of the steady states: what changed, by how much, and what explains it.

    Parameters
    ----------
    finding : of the chart of steady states
    since : the onset, as text
    """
    changes = ", ".join(_changed(finding, baseline)) or "many readings changed a little"
    named = finding.named
    probability = named.probability
    if not named.cause:
        text = f"{changes} since {since}; none of the known causes explains it"
        return Finding(text, NOT_KNOWN, None, SENSOR_CHECKS, named.ranked)
    checks = tuple(dict.fromkeys(c for name, p in named.ranked if p >= LEAST_TOLD for c in checks_of(name)))
    told = f"{_cause_words(finding)} ({100 * probability:.0f} %)"
    return Finding(f"{told}: {changes} since {since}", named.cause, probability, checks, named.ranked)


LEAST_TOLD = 0.05
"""Probability from which a single cause and its checks are told."""


def _changed(finding: VectorFinding, baseline: VectorBaseline) -> list[str]:
    """The features that changed beyond doubt, the clearest first, at most four."""
    z = finding.change / finding.sd
    words: list[str] = []
    for i in np.argsort(-np.abs(z)):  # NaN, of a feature that is gone, comes last
        name = baseline.layout.features[i]
        if not abs(z[i]) >= 2 or len(words) == 4:
            break
        direction = "up" if z[i] > 0 else "down"
        if FEATURES[name][0] == "share":
            amount = f"{100 * abs(np.expm1(finding.change[i])):.1f} %"
        else:
            amount = f"{abs(finding.change[i]):.2g} K"
        words.append(f"{name} {direction} {amount}")
    return words


def _cause_words(finding: VectorFinding) -> str:
    named = finding.named
    if named.cause.endswith(" sensor"):
        quantity = named.cause.removesuffix(" sensor")
        return f"sensor of {SENSOR_NAMES[quantity]} reads wrongly{finding.bias}"
    singles = [name for name, p in named.ranked if p >= LEAST_TOLD and name != "none of these"]
    if named.cause in singles:
        return named.cause
    spoken = [f"sensor of {SENSOR_NAMES[n.removesuffix(' sensor')]}" if n.endswith(" sensor") else n for n in singles]
    return f"{named.cause}: {' or '.join(spoken)}" if spoken else named.cause


def checks_of(cause: str) -> tuple[str, ...]:
    """What decides whether a cause is there."""
    if cause.endswith(" sensor"):
        quantity = cause.removesuffix(" sensor")
        if quantity in ("flow_ch", "flow_cd", "load"):
            return ("flow meter",)
        if quantity == "power":
            return ("power meter and auxiliaries on it",)
        return ("water temperature sensors",) if quantity in WATERS else ("refrigerant temperature sensors",)
    return CAUSE_CHECKS.get(cause, ())


WATERS = ("T_cdi", "T_cdo", "T_chi", "T_cho")
CAUSE_CHECKS: Mapping[str, tuple[str, ...]] = {
    "non-condensable gas": ("non-condensable gas",),
    "condenser fouling": ("condenser tubes (fouling)",),
    "evaporator fouling": ("evaporator tubes",),
    "low condenser flow": ("condenser water flow and strainer", "flow meter"),
    "high condenser flow": ("condenser water flow and strainer", "flow meter"),
    "low chilled-water flow": ("chilled-water flow", "flow meter"),
    "high chilled-water flow": ("chilled-water flow", "flow meter"),
    "low charge": ("refrigerant charge",),
    "high charge": ("refrigerant charge",),
    "oil excess": ("oil level",),
    "compressor efficiency loss": ("compressor, oil, bypass valve",),
    "purged condenser": ("maintenance log",),
    "cleaner condenser": ("maintenance log",),
    "cleaner evaporator": ("maintenance log",),
    "better compressor": ("maintenance log", "power meter and auxiliaries on it"),
}
