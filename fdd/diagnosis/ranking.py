"""Ranks what may be wrong: each fault that the model declares, by how well its signature agrees with the evidence.

A fault's signature says which parameters it moves, or which outputs it makes the filter mispredict, and to which side.
The evidence says which charts rang, and to which side. Agreement speaks for a cause, a wrong sign or silence against.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from fdd.diagnosis.advice import checks_of
from fdd.diagnosis.departure import Departure
from fdd.diagnosis.measured import measured_causes, seen_at
from fdd.evidence import Cause, ChartEvidence, Message
from fdd.models.declare import ComponentModel, Fault
from fdd.records import Alarm

# Each sign that agrees multiplies a cause's odds by this, each that does not divides them.
WEIGHT = 3.0
# Sign of a signature that may go either way, such as that of a stuck sensor.
EITHER = 0
# A parameter with less than this share of the strongest one's evidence may only be its shadow.
SHADOW = 0.5
# Relative change of a parameter from which an alarm is of medium and of high severity.
MEDIUM, HIGH = 0.1, 0.25
# A change of fewer standard errors than this is not sure enough for its own severity: it counts one class lower.
SURE = 3.0


@dataclass(frozen=True, slots=True)
class Finding:
    """Causes in order of likelihood, and checks in order; severity."""

    causes: tuple[Cause, ...]
    checks: tuple[Message, ...]
    severity: str = "medium"


@dataclass(frozen=True, slots=True)
class _Signs:
    """Which way the charts that rang point: outputs that are mispredicted, parameters that have moved."""

    outputs: Mapping[str, int]
    parameters: Mapping[str, int]


def diagnose(model: ComponentModel, alarm: Alarm, departure: Departure | None = None) -> Finding:
    """Likely causes of an alarm, ranked, with what speaks for and against each.

    Parameters
    ----------
    model : the component's declaration; its fault table gives the hypotheses
    alarm : with the charts that rang
    departure : how parameters and innovations have moved since the onset; where the model has measured signatures,
        causes are ranked by its likelihood under each, otherwise by the signs of the charts that rang
    """
    charts = list(alarm.evidence.charts.values())
    signs = _signs(model, charts)
    causes = measured_causes(model, departure) if departure is not None else ()
    causes = causes or _declared_causes(model, signs)
    checks = tuple(dict.fromkeys(check for cause in causes[:3] for check in cause.checks))
    return Finding(causes, checks, severity(charts))


def _declared_causes(model: ComponentModel, signs: _Signs) -> tuple[Cause, ...]:
    outputs = {q.symbol for q in model.outputs}
    judged = [_judge(fault, signs, outputs) for fault in model.faults]
    total = sum(odds for odds, _ in judged) or 1.0
    ranked = sorted(judged, key=lambda j: -j[0])
    return tuple(replace(c, likelihood=round(odds / total, 3)) for odds, c in ranked)


def severity(charts: Sequence[ChartEvidence]) -> str:
    """``low``, ``medium`` or ``high``: by the largest relative change of a parameter, and how sure it is.

    Medium from 10 %, high from 25 %; a change of fewer than three standard errors counts one class lower. Innovation
    charts give no size: an alarm that rests on them alone is medium.
    """
    sized = [c for c in charts if c.scale == "relative" and (c.standard_error or 0.0) > 0]
    if not sized:
        return "medium"
    largest = max(sized, key=lambda c: abs(c.change or 0.0))
    size = abs(largest.change or 0.0)
    grade = int(size >= MEDIUM) + int(size >= HIGH)
    if largest.strength < SURE:
        grade = max(0, grade - 1)
    return ("low", "medium", "high")[grade]


def _signs(model: ComponentModel, charts: Sequence[ChartEvidence]) -> _Signs:
    names = {q.symbol for q in model.outputs}
    outputs = {c.symbol: c.direction for c in charts if c.symbol in names}
    moved = {c.symbol: (c.direction, c.strength) for c in charts if c.symbol not in names}
    strongest = max((strength for _, strength in moved.values()), default=0.0)
    kept = {symbol: sign for symbol, (sign, strength) in moved.items() if strength >= SHADOW * strongest}
    return _Signs(outputs, kept)


def _judge(fault: Fault, signs: _Signs, outputs: Collection[str]) -> tuple[float, Cause]:
    """Weigh one hypothesis: its odds, and what speaks for and against it."""
    agree, against = [], []
    odds = 1.0
    for target, expected in fault.shows.items():
        symbol = target.removeprefix("innovation:")
        seen = (signs.outputs if target.startswith("innovation:") else signs.parameters).get(symbol)
        if seen is None:
            continue
        word = seen_at("output" if symbol in outputs else "parameter", symbol, seen)
        if expected in (seen, EITHER):
            odds *= WEIGHT
            agree.append(word)
        else:
            odds /= WEIGHT
            against.append(word)
    for symbol in _unexplained(fault, signs):
        odds /= WEIGHT
        against.append(Message.of("unexplained_symbol", symbol=symbol))
    return odds, Cause(
        name=fault.name,
        meaning=Message.declared(fault.meaning),
        speaks_for=tuple(agree),
        speaks_against=tuple(against),
        checks=checks_of(fault.name, fault.checks),
    )


def _unexplained(fault: Fault, signs: _Signs) -> list[str]:
    """What rang and is not the fault's; parameters are correlated, so one that is explained excuses the others."""
    outputs = {t.removeprefix("innovation:") for t in fault.shows if t.startswith("innovation:")}
    left = sorted(set(signs.outputs) - outputs)
    moved = set(signs.parameters)
    return left if moved & set(fault.shows) else left + sorted(moved)
