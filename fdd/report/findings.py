"""One finding: an alarm with the evidence behind it, said so that a technician can act on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fdd import evidence as told
from fdd.evidence import AlarmKind, Cost, Message
from fdd.records import Alarm, AlarmState
from fdd.report.evidence import Evidence
from fdd.report.site import ComponentInfo, SiteInfo
from fdd.report.telling import Speaker
from fdd.report.words import (
    DAY,
    STATES,
    duration,
    inside,
    likely,
    local,
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


def of_model(alarm: Alarm) -> bool:
    """Whether an alarm speaks of the model of a component, and accuses no equipment."""
    return alarm.evidence.kind is AlarmKind.MODEL


def order(alarm: Alarm) -> tuple[int, int, float, int]:
    """Sorts the most urgent first: by state, severity, cost, then age."""
    severity = SEVERITIES.index(alarm.severity) if alarm.severity in SEVERITIES else 2
    state = URGENCY.index(alarm.state) if alarm.state in URGENCY else len(URGENCY)
    return state, -severity, -((alarm.evidence.cost.value if alarm.evidence.cost else None) or 0.0), alarm.since


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
    speaker = Speaker(site, keys=False)
    signals = _signals(alarm, speaker, evidence)
    causes = tuple(_cause(c, alarm.component, speaker) for c in alarm.causes)
    cost, cost_words, cost_detail = _cost(alarm, speaker)
    return Finding(
        key=alarm.key,
        component=alarm.component,
        info=info,
        state=alarm.state,
        severity=alarm.severity,
        since=alarm.since,
        raised=alarm.raised,
        updated=alarm.updated,
        summary=_summary(alarm, speaker),
        certainty=_certainty(alarm, causes, signals, evidence, site, end),
        cost=cost_words,
        cost_detail=cost_detail,
        cost_value=cost,
        causes=causes,
        checks=tuple(check(c, alarm.component, speaker) for c in alarm.checks),
        readings=_readings(info, evidence, end),
        signals=signals,
        history=tuple(_entry(e, alarm.component, speaker) for e in alarm.history),
        caused_by=alarm.evidence.caused_by,
        consequences=tuple(site.component(a.component).title for a in suppressed if a.evidence.caused_by == alarm.key),
        evidence=evidence,
        kind="model" if of_model(alarm) else "plant",
    )


def _summary(alarm: Alarm, speaker: Speaker) -> str:
    """What departs and to which side, and the likeliest cause; the line of lists where charts give no side."""
    if of_model(alarm):
        return speaker.language.words("model")
    sides = speaker.sides(list(alarm.evidence.charts.values()), speaker.site.component(alarm.component))
    if sides and alarm.evidence.kind is AlarmKind.PLANT:
        cause = inside(speaker.say(alarm.causes[0].meaning, alarm.component)) if alarm.causes else ""
        return sentence(speaker.language.words("departs_likely" if cause else "departs", sides=sides, cause=cause))
    return sentence(speaker.line(alarm))


def check(item: Message, component: str, speaker: Speaker) -> Check:
    """A check: what to do, and what to expect; texts of before are ``what to do: what to expect``."""
    if item.code == "check":
        return Check(sentence(speaker.say(item["do"], component)), sentence(speaker.say(item["expect"], component)))
    do, _, expect = speaker.say(item, component).partition(": ")
    return Check(sentence(do), sentence(expect))


def _cause(cause: told.Cause, component: str, speaker: Speaker) -> Cause:
    def said(items: Sequence[Message]) -> tuple[str, ...]:
        return tuple(sentence(speaker.say(m, component)) for m in items)

    return Cause(
        meaning=sentence(speaker.say(cause.meaning, component)),
        likelihood=float("nan") if cause.likelihood is None else cause.likelihood,
        speaks_for=said(cause.speaks_for),
        speaks_against=said(cause.speaks_against),
        checks=tuple(check(c, component, speaker) for c in cause.checks),
    )


def _signals(alarm: Alarm, speaker: Speaker, evidence: Evidence) -> tuple[Signal, ...]:
    found = []
    for name, chart in alarm.evidence.charts.items():
        ratio = chart.statistic / chart.limit if chart.limit else np.nan
        trace = evidence.charts.get(name)
        if trace is not None:
            after = trace.between(chart.raised, int(trace.time[-1]) + 1)
            seen = after.statistic / after.limit
            ratio = float(np.nanmax([ratio, *seen[np.isfinite(seen)]])) if len(seen) else ratio
        found.append(Signal(name, sentence(speaker.chart(name)), chart.direction, chart.raised, ratio))
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
    for chart in alarm.evidence.charts.values():
        trace, output = evidence.outputs.get(chart.symbol), info.outputs.get(chart.symbol)
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
    for chart in alarm.evidence.charts.values():
        change, error = chart.change, chart.standard_error
        if chart.symbol not in info.parameters or change is None or error is None:
            continue
        described, side = info.parameters[chart.symbol], "above" if change > 0 else "below"
        if chart.scale == "relative":
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


def _cost(alarm: Alarm, speaker: Speaker) -> tuple[float | None, str, str]:
    """Value, words and detail of the cost a day."""
    cost = alarm.evidence.cost
    if cost is None:
        return None, "", ""
    said = [speaker.say(m, alarm.component) for m in (cost.why, cost.basis) if m is not None]
    if cost.value is None:
        return None, *_unpriced(cost, "; ".join(said))
    detail = said[-1:] if cost.basis is not None else []
    if cost.lower is not None and cost.upper is not None:
        detail.insert(0, f"between {cost.lower:.2f} and {cost.upper:.2f}")
    if cost.value < 0:
        detail.insert(0, f"{-cost.value:.2f} {cost.currency} a day less than when healthy")
        return cost.value, "No extra cost", "; ".join(detail)
    return cost.value, f"{cost.value:.2f} {cost.currency} a day", "; ".join(detail)


def _unpriced(cost: Cost, detail: str) -> tuple[str, str]:
    """Words and detail of a cost without a price: energy, lost comfort, or why nothing can be said."""
    energy = cost.energy
    if cost.kind == "comfort" and energy is not None:
        return f"Comfort: {energy:.1f} kWh a day of heat missing", detail
    if energy is not None and energy < 0:
        return "No extra cost", f"{-energy:.1f} kWh a day less than when healthy; {detail}"
    return (f"{energy:.1f} kWh a day" if energy is not None else "Not in money"), detail


def _entry(entry: told.Entry, component: str, speaker: Speaker) -> Entry:
    """What the service did comes in words; what people wrote stands as they wrote it."""
    actor = speaker.language.words("service") if entry.actor == SERVICE else entry.actor
    said = entry.comment if entry.reason is None else sentence(speaker.say(entry.reason, component))
    return Entry(entry.time, entry.state, actor, said)


def timing(f: Finding, site: SiteInfo, end: int) -> dict[str, str]:
    """Onset, alarm and age of a finding in local time."""
    closed = f.updated if f.state in (AlarmState.RETURNED, AlarmState.CLEARED) else end
    return {
        "since": local(f.since, site.tz),
        "raised": local(f.raised, site.tz),
        "delay": duration(max(0, f.raised - f.since)),
        "age": duration(max(0, closed - f.since)),
    }
