"""One finding: an alarm with the evidence behind it, said so that a technician can act on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdd.evidence import parts_of
from fdd.records import Alarm, AlarmState, JsonObject
from fdd.report.evidence import Evidence
from fdd.report.site import ComponentInfo, SiteInfo
from fdd.report.words import (
    DAY,
    STATES,
    chart_words,
    duration,
    in_words,
    inside,
    likely,
    listed,
    local,
    names_in_words,
    quantity,
    sentence,
)
from fdd.store.schema import SEVERITIES

# What an alarm's state says of how urgent it is; the first is looked at first.
URGENCY = (AlarmState.RAISED, AlarmState.ACKNOWLEDGED, AlarmState.RETURNED, AlarmState.SHELVED)

SERVICE = "service"
"""The actor of what the service did by itself."""


@dataclass(frozen=True, slots=True)
class Check:
    """What to do, and what a healthy machine (or this fault) would show."""

    do: str
    expect: str


@dataclass(frozen=True, slots=True)
class Cause:
    """A likely cause with what speaks for and against it."""

    meaning: str
    likelihood: float
    speaks_for: tuple[str, ...]
    speaks_against: tuple[str, ...]
    checks: tuple[Check, ...]


@dataclass(frozen=True, slots=True)
class Reading:
    """What an instrument shows and what a healthy machine would make it show: means over the last day of data, SI."""

    meaning: str
    point: str
    unit: str
    measured: float
    expected: float

    @property
    def words(self) -> tuple[str, str, str]:
        """Measured, expected and their difference, with units."""
        difference = quantity(self.measured - self.expected, self.unit, difference=True, sign=True)
        return quantity(self.measured, self.unit), quantity(self.expected, self.unit), difference


@dataclass(frozen=True, slots=True)
class Signal:
    """A chart that passed its limit."""

    name: str
    words: str
    direction: int
    raised: int
    ratio: float
    """Largest value of the statistic, in multiples of the limit."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A line of the history."""

    time: int
    state: str
    actor: str
    comment: str


@dataclass(frozen=True, slots=True)
class Finding:
    """An alarm in a technician's words; times in ns."""

    key: str
    component: str
    info: ComponentInfo
    state: AlarmState
    severity: str
    since: int
    raised: int
    updated: int
    summary: str
    certainty: tuple[str, ...]
    cost: str
    cost_detail: str
    cost_value: float | None
    causes: tuple[Cause, ...]
    checks: tuple[Check, ...]
    readings: tuple[Reading, ...]
    signals: tuple[Signal, ...]
    history: tuple[Entry, ...]
    caused_by: str = ""
    consequences: tuple[str, ...] = ()
    evidence: Evidence = field(default_factory=Evidence)
    kind: str = "plant"

    @property
    def seen(self) -> tuple[str, ...]:
        """What speaks for the likeliest cause, each once."""
        return tuple(dict.fromkeys(self.causes[0].speaks_for)) if self.causes else ()

    @property
    def state_words(self) -> str:
        """The state as people say it."""
        return STATES[self.state]

    @property
    def anchor(self) -> str:
        """Name of its place in the document."""
        return "finding-" + "".join(c if c.isascii() and c.isalnum() else "-" for c in self.key)


def alarm_of(document: JsonObject) -> Alarm:
    """The alarm of a store's document."""
    lists = {name: tuple(document.get(name) or ()) for name in ("charts", "causes", "checks", "history")}
    return Alarm(**{**document, **lists, "state": AlarmState(document["state"])})


def of_model(alarm: Alarm) -> bool:
    """Whether an alarm speaks of the model of a component, and accuses no equipment."""
    return alarm.evidence.get("kind") == "model"


def order(alarm: Alarm) -> tuple[int, int, float, int]:
    """Sorts the most urgent first: by state, severity, cost, then age."""
    severity = SEVERITIES.index(alarm.severity) if alarm.severity in SEVERITIES else 2
    state = URGENCY.index(alarm.state) if alarm.state in URGENCY else len(URGENCY)
    return state, -severity, -(_cost(alarm.evidence)[0] or 0.0), alarm.since


def finding(alarm: Alarm, site: SiteInfo, evidence: Evidence, suppressed: Sequence[Alarm], end: int) -> Finding:
    """Put an alarm and its rows into words.

    Parameters
    ----------
    alarm : as the store keeps it
    site : names, units and zone
    evidence : rows of the alarm's component, from before the onset to ``end``
    suppressed : alarms that may be consequences of this one
    end : end of the report's period [ns]
    """
    info = site.component(alarm.component)
    signals = _signals(alarm, info, evidence)
    causes = tuple(_cause(c, alarm.component, info) for c in alarm.causes)
    cost, cost_words, cost_detail = _cost(alarm.evidence, site)
    return Finding(
        key=alarm.key,
        component=alarm.component,
        info=info,
        state=alarm.state,
        severity=alarm.severity,
        since=alarm.since,
        raised=alarm.raised,
        updated=alarm.updated,
        summary=_summary(alarm, info),
        certainty=_certainty(alarm, causes, signals, evidence, site, end),
        cost=cost_words,
        cost_detail=cost_detail,
        cost_value=cost,
        causes=causes,
        checks=tuple(check(c) for c in alarm.checks),
        readings=_readings(info, evidence, end),
        signals=signals,
        history=tuple(_entry(e, alarm.component, info, site) for e in alarm.history),
        caused_by=str(alarm.evidence.get("caused_by", "")),
        consequences=tuple(
            site.component(a.component).title for a in suppressed if a.evidence.get("caused_by") == alarm.key
        ),
        evidence=evidence,
        kind="model" if of_model(alarm) else "plant",
    )


def _summary(alarm: Alarm, info: ComponentInfo) -> str:
    """What departs and to which side, and the likeliest cause; the service's own sentence where charts give no side."""
    sides: dict[int, list[str]] = {1: [], -1: []}
    for name, numbers in alarm.evidence.get("charts", {}).items():
        meaning = info.meaning(str(numbers.get("symbol") or parts_of(name)[0]))
        sides.get(int(numbers.get("direction", 0)), []).append(meaning)
    if of_model(alarm):
        return "Its model no longer describes it: what is said of its faults may be wrong until it has a new baseline."
    parts = [f"{listed(what)} higher" for what in [sides[1]] if what]
    parts += [f"{listed(what)} lower" for what in [sides[-1]] if what]
    if parts and not info.daily:
        likely = f" Most likely {inside(str(alarm.causes[0]['meaning']))}" if _has_meaning(alarm) else ""
        return sentence(f"{', and '.join(parts)} than its healthy model expects.{likely}")
    text = alarm.summary.removeprefix(f"{alarm.component}: ")
    return sentence(in_words(text, alarm.component, info)) or "It no longer behaves as its healthy model expects."


def _has_meaning(alarm: Alarm) -> bool:
    return bool(alarm.causes and alarm.causes[0].get("meaning"))


def check(item: str | Mapping[str, Any]) -> Check:
    """A check from its text, ``what to do: what to expect``, or from a mapping with ``do`` and ``expect``."""
    if isinstance(item, Mapping):
        return Check(sentence(str(item.get("do", ""))), sentence(str(item.get("expect", ""))))
    do, _, expect = item.partition(": ")
    return Check(sentence(do), sentence(expect))


def _cause(cause: JsonObject, component: str, info: ComponentInfo) -> Cause:
    return Cause(
        meaning=sentence(in_words(str(cause.get("meaning") or cause.get("name", "")), component, info)),
        likelihood=float(cause.get("likelihood", float("nan"))),
        speaks_for=tuple(sentence(in_words(str(t), component, info)) for t in cause.get("for", ())),
        speaks_against=tuple(sentence(in_words(str(t), component, info)) for t in cause.get("against", ())),
        checks=tuple(check(c) for c in cause.get("checks", ())),
    )


def _signals(alarm: Alarm, info: ComponentInfo, evidence: Evidence) -> tuple[Signal, ...]:
    charts = alarm.evidence.get("charts", {})
    found = []
    for name in dict.fromkeys([*alarm.charts, *charts]):
        numbers = charts.get(name, {})
        symbol, kind = parts_of(name)
        symbol = str(numbers.get("symbol") or symbol)
        limit = float(numbers.get("limit") or np.nan)
        ratio = float(numbers.get("statistic") or np.nan) / limit
        trace = evidence.charts.get(name)
        if trace is not None:
            after = trace.between(int(numbers.get("raised", alarm.raised)), int(trace.time[-1]) + 1)
            seen = after.statistic / after.limit
            ratio = float(np.nanmax([ratio, *seen[np.isfinite(seen)]])) if len(seen) else ratio
        direction = int(numbers.get("direction", 0))
        raised = int(numbers.get("raised", alarm.raised))
        found.append(Signal(name, sentence(chart_words(symbol, kind, info)), direction, raised, ratio))
    return tuple(found)


def _certainty(
    alarm: Alarm, causes: Sequence[Cause], signals: Sequence[Signal], evidence: Evidence, site: SiteInfo, end: int
) -> tuple[str, ...]:
    """How sure the fault is, how sure its cause is, and how large the departure is."""
    ratios = [s.ratio for s in signals if np.isfinite(s.ratio)]
    budget = f"{site.false_alarms_per_year:g} false alarm{'s' * (site.false_alarms_per_year != 1)} a year"
    lines = []
    if signals:
        watched = max(len(evidence.charts), len(signals))
        strongest = f"; the strongest went to {max(ratios):.1f} times its limit" if ratios else ""
        lines.append(
            f"{len(signals)} of {watched} charts on this equipment passed {'its' if len(signals) == 1 else 'their'} "
            f"limit{strongest}. Limits allow {budget} for the whole plant."
        )
    lines += _departures(alarm, site.component(alarm.component), evidence, end)
    lines += _changes(alarm, site.component(alarm.component))
    if causes and np.isfinite(causes[0].likelihood):
        p = causes[0].likelihood
        word = "probable" if p >= 0.6 else "the likeliest, not certain" if p >= 0.35 else "one of several that fit"
        lines.append(f"The first cause is {word}: {likely(p)} among the faults known for this equipment.")
    return tuple(lines)


def _departures(alarm: Alarm, info: ComponentInfo, evidence: Evidence, end: int) -> list[str]:
    """Mean of measured minus expected since the onset, for the outputs whose charts passed their limits."""
    lines = []
    for name in alarm.evidence.get("charts", {}):
        symbol = str(alarm.evidence["charts"][name].get("symbol") or parts_of(name)[0])
        trace, output = evidence.outputs.get(symbol), info.outputs.get(symbol)
        if trace is None or output is None:
            continue
        until = end if alarm.state not in (AlarmState.RETURNED, AlarmState.CLEARED) else alarm.updated
        part = trace.between(alarm.since, until)
        residual = (part.measured - part.predicted)[np.isfinite(part.measured - part.predicted)]
        if len(residual) < 2:
            continue
        mean, sd = float(residual.mean()), float(np.nanmean(part.sd))
        side = "above" if mean > 0 else "below"
        lines.append(
            f"Since the onset the {output.meaning} has been {quantity(abs(mean), output.unit, difference=True)} {side} "
            f"what was expected (one reading: ± {quantity(1.96 * sd, output.unit, difference=True)})."
        )
    return list(dict.fromkeys(lines))


def _changes(alarm: Alarm, info: ComponentInfo) -> list[str]:
    """How far parameters have moved, where their charts could tell (``change``, ``standard_error``, ``scale``)."""
    lines = []
    for name, numbers in alarm.evidence.get("charts", {}).items():
        symbol = str(numbers.get("symbol") or parts_of(name)[0])
        change, error = numbers.get("change"), numbers.get("standard_error")
        if symbol not in info.parameters or change is None or error is None:
            continue
        described, side = info.parameters[symbol], "above" if change > 0 else "below"
        if numbers.get("scale") == "relative":
            size, spread = (f"{100 * x:.2g} %" for x in (abs(change), 1.96 * error))
        else:
            size, spread = (quantity(x, described.unit, difference=True) for x in (abs(change), 1.96 * error))
        lines.append(
            f"The {described.meaning} was {size} {side} its baseline (give or take {spread}) at the alarm, if it alone "
            "has changed."
        )
    return lines


def _readings(info: ComponentInfo, evidence: Evidence, end: int) -> tuple[Reading, ...]:
    found = []
    for symbol, output in info.outputs.items():
        trace = evidence.outputs.get(symbol)
        if trace is None or not len(trace.time):
            continue
        last = trace.between(min(int(trace.time[-1]) + 1, end) - DAY, end)
        both = np.isfinite(last.measured) & np.isfinite(last.predicted)
        if both.any():
            measured, expected = float(last.measured[both].mean()), float(last.predicted[both].mean())
            found.append(Reading(output.meaning, output.point, output.unit, measured, expected))
    return tuple(found)


def _cost(evidence: JsonObject, site: SiteInfo | None = None) -> tuple[float | None, str, str]:
    """Value, words and detail of the cost a day from the alarm's evidence.

    ``cost_per_day`` is a number or {value, lower, upper, basis, currency}; without it ``power_W`` is told.
    """
    cost = evidence.get("cost_per_day")
    table: Mapping[str, Any] = cost if isinstance(cost, Mapping) else {"value": cost}
    value = table.get("value")
    if value is not None and np.isfinite(float(value)):
        currency = str(table.get("currency") or (site.currency if site else "EUR"))
        detail = []
        if table.get("lower") is not None and table.get("upper") is not None:
            detail.append(f"between {float(table['lower']):.2f} and {float(table['upper']):.2f}")
        if table.get("basis"):
            detail.append(str(table["basis"]))
        if float(value) < 0:
            detail.insert(0, f"{-float(value):.2f} {currency} a day less than when healthy")
            return float(value), "No extra cost", "; ".join(detail)
        return float(value), f"{float(value):.2f} {currency} a day", "; ".join(detail)
    if isinstance(cost, Mapping):
        return None, *_unpriced(cost)
    power = evidence.get("power_W")
    if power is not None:
        return None, f"{quantity(float(power), 'W')} of extra power", "no price is known"
    return None, "", ""


def _unpriced(cost: Mapping[str, Any]) -> tuple[str, str]:
    """Words and detail of a cost without a price: energy, lost comfort, or why nothing can be said."""
    detail = "; ".join(str(cost[k]) for k in ("why", "basis") if cost.get(k))
    energy = cost.get("kWh_per_day")
    if cost.get("kind") == "comfort" and energy is not None:
        return f"Comfort: {float(energy):.1f} kWh a day of heat missing", detail
    if energy is not None and float(energy) < 0:
        return "No extra cost", f"{-float(energy):.1f} kWh a day less than when healthy; {detail}"
    return (f"{float(energy):.1f} kWh a day" if energy is not None else "Not in money"), detail


def _entry(entry: JsonObject, component: str, info: ComponentInfo, site: SiteInfo) -> Entry:
    state = str(entry.get("state", ""))
    actor = str(entry.get("actor", ""))
    comment = str(entry.get("comment", ""))
    if actor != SERVICE:  # what people write stands as they wrote it
        return Entry(int(entry["time"]), state, actor, comment)
    # Points first: what a symbol means may hold a word that is also a point's name.
    said = sentence(in_words(names_in_words(comment, site), component, info))
    return Entry(int(entry["time"]), state, "the service", said)


def timing(f: Finding, site: SiteInfo, end: int) -> dict[str, str]:
    """Onset, alarm and age of a finding in local time."""
    closed = f.updated if f.state in (AlarmState.RETURNED, AlarmState.CLEARED) else end
    return {
        "since": local(f.since, site.tz),
        "raised": local(f.raised, site.tz),
        "delay": duration(max(0, f.raised - f.since)),
        "age": duration(max(0, closed - f.since)),
    }
