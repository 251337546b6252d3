"""``fdd score``: the engine over data whose faults are known, and how well its alarms agree with them."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from fdd.diagnosis.score import Group, Label, Rate, Score, Share, Standing, score, standing
from fdd.evidence import AlarmKind
from fdd.records import NANOSECONDS, JsonObject
from fdd.report.figures_page import Part, Picture, drawn, write_page
from fdd.residual_monitors.design import duration
from fdd.service.alarms.book import iso
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import SiteContext
from fdd.service.verbs.replay import HOUR, ReplayResult, replay_site

COLUMNS = ("component", "fault", "start", "end", "severity")
OUTCOMES = {"found": "#0072b2", "missed": "#b3400a", "masked": "#9aa4ac"}
FALSE = "#e69f00"
BARS = (
    "upper bar: faulty (blue found, red missed, grey masked by an earlier alarm)\n"
    "lower bar: alarmed (green in a case, orange false)"
)


@dataclass(frozen=True)
class Scored:
    """A score and what it was computed from."""

    context: SiteContext
    score: Score
    alarms: list[Standing]
    watched: list[str]
    first: int
    last: int
    notes: tuple[str, ...]

    def document(self) -> JsonObject:
        """For machines; intervals are of 95 %."""
        s = self.score
        return {
            "site": self.context.site.name,
            "from": iso(self.first),
            "until": iso(self.last),
            "watched": self.watched,
            "days": {
                "true_positive": s.days.true_positive,
                "false_negative": s.days.false_negative,
                "false_positive": s.days.false_positive,
                "true_negative": s.days.true_negative,
                "rates": {name.replace(" ", "_"): _share(r) for name, r in s.days.rates.items()},
            },
            "cases": {
                **_group(s.overall),
                "by_severity": [
                    {"fault": fault, "severity": severity, **_group(g)}
                    for (fault, severity), g in s.by_severity().items()
                ],
                "each": [
                    {
                        "component": c.label.component,
                        "fault": c.label.fault,
                        "severity": c.label.severity,
                        "start": iso(c.label.start),
                        "end": iso(c.label.end),
                        "outcome": c.outcome,
                        "delay_seconds": c.delay,
                        "diagnosis": c.diagnosis,
                        "named": c.named,
                    }
                    for c in s.cases
                ],
            },
            "false_alarms": {
                **_rate(s.false_alarms),
                "promised_per_year": self.context.site.false_alarms_per_year,
                "each": [{"component": a.component, "raised": iso(a.start)} for a in s.false],
            },
            "notes": list(self.notes),
        }

    def print(self, console: Console) -> None:
        """For people."""
        console.print(
            f"{self.context.site.name}: {self.context.local(self.first)} to {self.context.local(self.last)}, "
            f"{len(self.score.cases)} case(s), {len(self.watched)} component(s) watched",
            highlight=False,
        )
        for part in _parts(self):
            if part.rows:
                table = Table(*part.head, title=part.title, title_justify="left", box=None)
                for row in part.rows:
                    table.add_row(*row)
                console.print(table)
        for note in self.notes:
            console.print(f"  {note}", highlight=False, markup=False)

    def write(self, path: Path) -> Path:
        """The page with plots."""
        period = f"{self.context.local(self.first)} to {self.context.local(self.last)}"
        parts = [*_parts(self), Part("Labels and alarms", figures=[_timeline(self)])]
        return write_page(
            path, f"{self.context.site.name}: score", f"Alarms against known faults · {period}", self.notes, parts
        )


def score_site(site_file: Path, data: Path, labels_file: Path, *, settle: float = 0.0, console: Console) -> Scored:
    """Replay the data and compare the alarms with the labels; ``settle`` [s], see :func:`fdd.diagnosis.score.score`.

    Raises
    ------
    UsageError : labels that cannot be read, or no component has a baseline
    """
    result = replay_site(site_file, data, since=None, until=None, verdicts=None, console=console)
    if result.first is None or result.last is None:
        raise UsageError(f"{data}: it gave no frames; check it with fdd check SITE DATA")
    labels = read_labels(labels_file, result.context)
    alarms = standing([a for a in result.changes if a.evidence.kind is AlarmKind.PLANT], result.last)
    days = list(_days(result.context, result.first, result.last))
    unwatched = sorted({x.component for x in labels} - set(result.watched))
    notes = [f"{name} has labels and no baseline: its cases count as missed" for name in unwatched]
    found = score(labels, alarms, result.watched, days, round(settle * NANOSECONDS), _seen(result))
    return Scored(result.context, found, alarms, result.watched, result.first, result.last, tuple(notes))


def _seen(result: ReplayResult) -> Callable[[str, int, int], bool]:
    """Whether any output of a component, or any input where it has none, held a value in [start, end)."""
    plan = result.context.plan
    columns: dict[str, tuple[str, ...]] = {c.name: c.outputs for c in plan.components}
    columns |= {c.name: tuple(c.inputs.values()) for c in plan.chillers}
    columns = {e.name: tuple(e.inputs.values()) for e in plan.equipment} | columns
    hours = {
        name: np.array(sorted(set().union(*(result.hours.get(c, set()) for c in own))), dtype=np.int64)
        for name, own in columns.items()
    }

    def seen(component: str, start: int, end: int) -> bool:
        own = hours[component]
        return bool(np.searchsorted(own, start // HOUR) < np.searchsorted(own, -(-end // HOUR)))

    return seen


def read_labels(path: Path, context: SiteContext) -> list[Label]:
    """Labels from a CSV file with the columns of :data:`COLUMNS`; times without a zone are the site's own.

    Raises
    ------
    UsageError : no such file, a column is missing, or a row that cannot be understood; the text names its line
    """
    if not path.is_file():
        raise UsageError(f"labels file {path} is not there; give a CSV with the columns {', '.join(COLUMNS)}")
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        missing = [c for c in COLUMNS if c not in (reader.fieldnames or ())]
        if missing:
            raise UsageError(f"{path}: no column {', '.join(missing)}; the header must be {','.join(COLUMNS)}")
        return [_label(row, f"{path} line {reader.line_num}", context) for row in reader]


def _label(row: dict[str, str], where: str, context: SiteContext) -> Label:
    component, names = row["component"].strip(), list(context.site.equipment)
    if component not in names:
        raise UsageError(f"{where}: the site has no component {component!r}; it has {', '.join(names)}")
    try:
        severity = float(row["severity"]) if (row["severity"] or "").strip() else None
    except ValueError:
        raise UsageError(f"{where}: severity {row['severity']!r} is no number; leave it empty if unknown") from None
    if not (row["start"] and row["end"]):
        raise UsageError(f"{where}: start or end is empty; write both as 2026-03-01T12:00")
    start, end = context.nanoseconds(row["start"]), context.nanoseconds(row["end"])
    if start is None or end is None or end <= start:
        raise UsageError(f"{where}: end {row['end']} is not after start {row['start']}")
    return Label(component, row["fault"].strip(), start, end, severity)


def _days(context: SiteContext, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Days of the site's zone that the data touch; the first and the last may be cut short."""
    zone = ZoneInfo(context.site.zone)
    start = pd.Timestamp(first, unit="ns", tz="UTC").tz_convert(zone).normalize()
    while int(start.value) < last:
        end = (start + pd.DateOffset(days=1)).normalize()
        yield max(first, int(start.value)), min(last, int(end.value))
        start = end


def _share(s: Share) -> JsonObject:
    low, high = s.interval
    return {"count": s.count, "of": s.of, "share": s.value, "low": low, "high": high}


def _rate(r: Rate) -> JsonObject:
    low, high = r.interval
    return {"count": r.count, "years": r.years, "per_year": r.value, "low": low, "high": high}


def _group(g: Group) -> JsonObject:
    return {
        "found": _share(g.found),
        "correct_diagnosis": _share(g.correct),
        "masked": g.masked,
        "median_delay_seconds": g.delay,
    }


def _percent(s: Share) -> str:
    if s.value is None:
        return "nothing to count"
    low, high = s.interval
    return f"{s.value:.0%} ({low:.0%} to {high:.0%}), {s.count} of {s.of}"


def _parts(scored: Scored) -> list[Part]:
    s = scored.score
    low, high = s.false_alarms.interval
    per_year = "no healthy time" if s.false_alarms.value is None else f"{s.false_alarms.value:.2f}"
    promise = f"promised are {scored.context.site.false_alarms_per_year:g}"
    false = [
        str(s.false_alarms.count),
        f"{s.false_alarms.years:.2f}",
        per_year,
        f"{low:.2f} to {high or 0:.2f}",
        promise,
    ]
    groups = [
        [fault, "" if severity is None else f"{severity:g}", _percent(g.found), _percent(g.correct), _delay(g.delay)]
        for (fault, severity), g in s.by_severity().items()
    ]
    cases = [
        [c.label.component, c.label.fault, "" if c.label.severity is None else f"{c.label.severity:g}",
         scored.context.local(c.label.start), c.outcome, _delay(c.delay), c.diagnosis or "", c.named or ""]
        for c in s.cases
    ]  # fmt: skip
    return [
        Part(
            "Component-days",
            ("what", "share (95 % interval)"),
            [[name, _percent(share)] for name, share in s.days.rates.items()],
            note="Every day of every component is one sample (Frank et al. 2019).",
        ),
        Part(
            "False alarms",
            ("alarms outside every label", "healthy plant-years", "a year", "95 % interval", "of these"),
            [false],
        ),
        Part(
            "Cases by severity",
            ("fault", "severity", "found", "rightly named of those found", "median delay"),
            groups,
            [_severity(scored)] if any(k[1] is not None for k in s.by_severity()) else [],
        ),
        Part(
            "Each case",
            ("component", "fault", "severity", "start", "outcome", "delay", "diagnosis", "named"),
            cases,
        ),
    ]


def _delay(seconds: float | None) -> str:
    return "" if seconds is None else duration(seconds)


def _severity(scored: Scored) -> Picture:
    """Share found and delay against severity, a line a fault."""
    table: dict[str, list[tuple[float, Group]]] = {}
    for (fault, severity), g in scored.score.by_severity().items():
        if severity is not None:
            table.setdefault(fault, []).append((severity, g))

    longest = max((g.delay or 0.0 for rows in table.values() for _, g in rows), default=0.0)
    unit, size = next(
        (u, s) for u, s in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)) if longest > 2 * s or u == "min"
    )

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for fault, rows in table.items():
            seen = [(x, g.found) for x, g in rows if g.found.value is not None]
            x, y = [x for x, _ in seen], [f.value or 0.0 for _, f in seen]
            limits = [f.interval for _, f in seen]
            bars = [[v - low for v, (low, _) in zip(y, limits, strict=True)],
                    [high - v for v, (_, high) in zip(y, limits, strict=True)]]  # fmt: skip
            left.errorbar(x, y, yerr=bars, marker="o", ms=3, capsize=2, label=fault)
            late = [(x, g.delay / size) for x, g in rows if g.delay is not None]
            right.plot([x for x, _ in late], [d for _, d in late], marker="o", ms=3, label=fault)
        left.set(xlabel="severity", ylabel="share found (95 % interval)", ylim=(-0.03, 1.03))
        right.set(xlabel="severity", ylabel=f"median delay [{unit}]", ylim=(0, None))
        sizes = sorted({x for rows in table.values() for x, _ in rows})
        for axes in (left, right):
            axes.set_xlim(0.0, 1.1 * sizes[-1])
            axes.set_xticks(sizes, [f"{x:g}" for x in sizes])
        left.legend()

    return drawn(draw, "Share of cases found, and median delay, against the severity of the fault")


def _timeline(scored: Scored) -> Picture:
    """When each component was faulty, and when it was alarmed."""
    names = scored.watched

    def days(time: int) -> float:
        return (time - scored.first) / NANOSECONDS / 86400

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for row, name in enumerate(names):
            for case in scored.score.cases:
                if case.label.component == name:
                    span = (days(case.label.start), days(case.label.end) - days(case.label.start))
                    axes.broken_barh([span], (row + 0.05, 0.38), color=OUTCOMES[case.outcome])
            for alarm in scored.alarms:
                if alarm.component == name:
                    span = (days(alarm.start), max(days(alarm.end) - days(alarm.start), 0.05))
                    axes.broken_barh(
                        [span], (row - 0.43, 0.38), color=FALSE if alarm in scored.score.false else "#1d6b4f"
                    )
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(-0.55, len(names) - 0.45)
        axes.set_xlim(0, days(scored.last))
        axes.set_xlabel(f"days since {scored.context.local(scored.first)}")
        axes.set_title(BARS, fontsize=8)

    return drawn(draw, "When each component was faulty, and when it was alarmed", (7.2, 1.2 + 0.4 * len(names)))
