"""``fdd audit``: was the promise of false alarms kept on a healthy record? Alarms that came, of those promised.

A plain replay cannot tell: an alarm stands until somebody clears it, and hides those that would follow. Here every
alarm is cleared once it is a day old, and counts for the chart that rang first. What was promised is each chart's share
of the budget over the time in which that chart could judge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from fdd.config.schema import SqliteStore
from fdd.diagnosis.judged import is_consequence
from fdd.records import NANOSECONDS, Alarm, Baseline, Batch, IntArray, JsonObject, Rows
from fdd.residual_monitors.budget import YEAR, poisson_interval
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import Command, iso, subject_of
from fdd.service.baselines.fitting import fit_open_site
from fdd.service.daemon.ready import ready_engine
from fdd.service.engine.engine import Engine, Outputs
from fdd.service.site.feed import Feed
from fdd.service.site.naming import speaker_of
from fdd.service.site.site_context import SiteContext, open_site

DAY = 86400 * NANOSECONDS
# Between looks at what is open: an alarm is cleared at the first one at which it is a day old.
LOOK = DAY // 4
# Parts of a record: what the baseline was fitted to (and what is before), what its charts were calibrated on, what they
# watched, and the time since the component has declared its promise void: it accuses nobody, and is promised nothing.
FITTED, PROBATION, WATCHED, VOID = PARTS = ("fitted", "probation", "watched", "void")
PRIMARY = "day"
# Fewer promised alarms than this and the interval of their number is wider than any verdict.
FEW = 1.0


@dataclass(frozen=True, slots=True)
class Place:
    """Where an alarm counts: component, kind of the chart that rang first, part of the record, month (UTC)."""

    component: str
    chart: str
    part: str
    month: str


@dataclass
class Kept:
    """Alarms that came; those ``promised`` over the time judged, and those ``due`` over all the time with data."""

    alarms: int = 0
    promised: float = 0.0
    due: float = 0.0

    def add(self, other: Kept) -> None:
        """Count another place's, too."""
        self.alarms += other.alarms
        self.promised += other.promised
        self.due += other.due

    @property
    def judged(self) -> float:
        """Share of the time in which the charts could judge, each counted by what it may ring."""
        return self.promised / self.due if self.due else 0.0

    def document(self) -> JsonObject:
        """For machines: counts, realised over promised, and its exact 95 % Poisson interval (Garwood 1936)."""
        table: JsonObject = {"alarms": self.alarms, "promised": self.promised, "share_judged": self.judged}
        if self.promised > 0:
            low, high = poisson_interval(self.alarms)
            table |= {
                "ratio": self.alarms / self.promised,
                "low": low / self.promised,
                "high": high / self.promised,
            }
        return table


@dataclass
class Audit:
    """What an audit found: counts by place, and each alarm as it stood when it rang and when it was cleared."""

    site: str
    budget: float
    baselines: Mapping[str, Baseline]
    table: dict[Place, Kept] = field(default_factory=dict)
    alarms: list[JsonObject] = field(default_factory=list)
    consequences: int = 0
    first: int | None = None
    last: int | None = None
    notes: tuple[str, ...] = ()

    def by(self, name: Callable[[Place], str], parts: Iterable[str] = PARTS) -> dict[str, Kept]:
        """Added up by a name, over parts of the record."""
        found: dict[str, Kept] = {}
        for place, kept in self.table.items():
            if place.part in parts:
                found.setdefault(name(place), Kept()).add(kept)
        return found

    def whole(self, parts: Iterable[str] = (WATCHED,)) -> Kept:
        """Everything, over parts of the record."""
        return self.by(lambda _: "all", parts).get("all", Kept())

    def document(self) -> JsonObject:
        """For machines; charts, components and months are those of the part that is watched."""

        def rows(name: Callable[[Place], str], parts: Iterable[str]) -> JsonObject:
            return {key: kept.document() for key, kept in sorted(self.by(name, parts).items())}

        return {
            "site": self.site,
            "from": None if self.first is None else iso(self.first),
            "until": None if self.last is None else iso(self.last),
            "false_alarms_per_year": self.budget,
            "cleared_after_days": 1,
            "confidence": 0.95,
            "all": self.whole().document(),
            "parts": rows(lambda p: p.part, PARTS),
            "charts": rows(lambda p: p.chart, (WATCHED,)),
            "components": rows(lambda p: p.component, (WATCHED,)),
            "months": rows(lambda p: p.month, (WATCHED,)),
            "consequences": self.consequences,
            "alarms": self.alarms,
            "notes": list(self.notes),
        }

    def print(self, console: Console, local: Callable[[int], str]) -> None:
        """For people."""
        span = f"{local(self.first)} to {local(self.last)}" if self.first and self.last else "no time"
        console.print(
            f"{self.site}: {span}, {self.budget:g} false alarms a year promised; every alarm cleared after a day",
            highlight=False,
            soft_wrap=True,
        )
        watched = (WATCHED,)
        for table in (
            _table("part of the record", self.by(lambda p: p.part)),
            _table("chart, while watched", self.by(lambda p: p.chart, watched)),
            _table("component, while watched", self.by(lambda p: p.component, watched)),
        ):
            console.print(table, soft_wrap=True)
        for note in self.notes[:5]:
            console.print(f"  {note}", highlight=False, markup=False)
        console.print(verdict(self.whole()), highlight=False, soft_wrap=True)


def verdict(kept: Kept) -> str:
    """Whether the promise was kept, in a sentence."""
    if kept.promised <= 0:
        return "Nothing was judged after fit and probation: nothing can be said."
    told = kept.document()
    ratio = f"{_plain(told['ratio'])} times (95 %: {_plain(told['low'])} to {_plain(told['high'])})"
    counts = f"{kept.alarms} alarm(s) where {kept.promised:.2g} were promised over the time judged, {ratio}"
    if told["low"] > 1:
        return f"Not kept, if the record is healthy: {counts}."
    if kept.promised < FEW and told["high"] > 2:
        return f"Too little time for a verdict: {counts}."
    return f"Kept: {counts}."


def _table(title: str, rows: Mapping[str, Kept]) -> Table:
    table = Table(title, "alarms", "promised", "of promised", "95 %", "judged", box=None)
    for name, kept in sorted(rows.items()):
        told = kept.document()
        ratio = (
            [_plain(told["ratio"]), f"{_plain(told['low'])} to {_plain(told['high'])}"] if "ratio" in told else ["", ""]
        )
        table.add_row(name, str(kept.alarms), f"{kept.promised:.3g}", *ratio, f"{kept.judged:.0%}" if kept.due else "")
    return table


def _plain(value: float) -> str:
    """Two digits, and never a power of ten."""
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def audit_site(
    site_file: Path,
    data: Path | None,
    *,
    fit_until: str | None = None,
    since: str | None = None,
    until: str | None = None,
    console: Console,
) -> tuple[Audit, SiteContext]:
    """Replay with every alarm cleared after a day and count; nothing in the site's store is changed.

    Parameters
    ----------
    fit_until : fit baselines to what is before this time first, for this audit alone; else those in force are used

    Raises
    ------
    UsageError : no component has a baseline, or none could be fitted
    """
    context = open_site(site_file, data)
    start, end = context.nanoseconds(since), context.nanoseconds(until)
    with TemporaryDirectory() as folder:
        source = context
        if fit_until is not None:
            store = SqliteStore(kind="sqlite", path=Path(folder) / "audit.sqlite")
            source = replace(context, site=context.site.model_copy(update={"store": store}))
            fit_open_site(source, until=fit_until, console=console)
        engine = ready_engine(source)
    counter = Counter(engine)
    feed = Feed(context.site)
    feed.open()
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("auditing", total=None)
        for batch in feed.batches():
            for piece in pieces(batch.between(start, end)):
                counter.take(engine.step(piece))
                at = "" if engine.time is None else f" {context.local(engine.time)}"
                progress.update(task, advance=len(piece), description=f"auditing{at}")
        counter.take(engine.flush())
    feed.close()
    return counter.result([*engine.notes, *feed.notes()]), context


def pieces(batch: Batch) -> Iterator[Batch]:
    """A batch cut where event time enters the next span between two looks."""
    if len(batch) == 0:
        return
    span = np.maximum.accumulate(batch.time // LOOK)
    cuts = [0, *(np.flatnonzero(np.diff(span)) + 1).tolist(), len(batch)]
    for begin, stop in pairwise(cuts):
        yield batch.slice(begin, stop)


class Counter:
    """Counts what an engine says, and clears its alarms once they are a day old."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._promised = engine.promised
        self._speaker = speaker_of(engine.plan)
        self._void: set[str] = set()
        self._told: dict[str, JsonObject] = {}
        self._hidden: set[str] = set()
        # Components whose primary chart has once judged: their probation is over.
        self._ready = {c for c, _ in self._promised if (c, PRIMARY) not in self._promised}
        self.audit = Audit(engine.plan.site, engine.plan.false_alarms_per_year, engine.baselines)

    def take(self, outputs: Outputs) -> None:
        """Count one step's outputs, then look at what is open."""
        self._count_time(outputs)
        for alarm in outputs.alarms:
            self._count(alarm)
        time = self._engine.time
        if time is None:
            return
        self._void = {name for name, told in self._engine.trust.items() if told["state"] == "void"}
        for alarm in self._engine.alarms.open:
            if time - alarm.raised >= DAY and self._engine.alarms.of(subject_of(alarm)) is alarm:
                self._clear(alarm, time)

    def result(self, notes: Iterable[str] = ()) -> Audit:
        """What was counted."""
        hidden = len(self._hidden - set(self._told))
        return replace(self.audit, alarms=list(self._told.values()), consequences=hidden, notes=tuple(notes))

    def _clear(self, alarm: Alarm, time: int) -> None:
        """Clear an alarm and, before it, its consequences: freed by this they would count as alarms of their own."""
        caused = [a for a in self._engine.alarms.open if a.evidence.caused_by == alarm.key]
        for each in (*caused, alarm):
            self._engine.command(Command(each.key, "clear", "audit", time, "a day old"))
            if told := self._told.get(each.key):
                told["cleared_as"] = _named(each)

    def _count(self, alarm: Alarm) -> None:
        if is_consequence(alarm):
            self._hidden.add(alarm.key)
            return
        if alarm.key in self._told:
            return
        chart = self._chart(alarm)
        part = self._part(alarm.component, alarm.raised)
        self._at(Place(alarm.component, chart, part, _month(alarm.raised))).alarms += 1
        told = {
            "key": alarm.key,
            "component": alarm.component,
            "chart": chart,
            "part": part,
            "kind": alarm.evidence.place or str(alarm.evidence.kind),
            "raised": iso(alarm.raised),
            "since": iso(alarm.since),
            "summary": self._speaker.summary(alarm),
            "rang_as": _named(alarm),
        }
        self._told[alarm.key] = told

    def _count_time(self, outputs: Outputs) -> None:
        """Add what each kind of chart was promised over these frames."""
        judged: dict[tuple[str, str], list[float]] = {}
        for rows in outputs.rows:
            self._reach(rows)
            if rows.measurement == "charts":
                for name, phase in _phases(rows):
                    judged.setdefault(_owner(name), []).append(self._sees(name, phase))
        if not outputs.frames or self.audit.last is None:
            return
        years = outputs.frames * self._engine.plan.step / NANOSECONDS / YEAR
        for (component, chart), rate in self._promised.items():
            part = self._part(component, self.audit.last)
            kept = self._at(Place(component, chart, part, _month(self.audit.last)))
            # What has no rows a frame, such as a chiller, judges in its own time and is watched all the time.
            share = float(np.mean(judged.get((component, chart), [1.0])))
            kept.due += rate * years
            kept.promised += rate * years * share

    def _sees(self, chart: str, phase: IntArray) -> float:
        """Share of frames in which a chart could judge; a primary one that still learns rings for gross faults only."""
        component, kind = _owner(chart)
        if kind != PRIMARY:
            return float(np.mean(phase > Phase.NO_DATA))
        judged = float(np.mean(phase > Phase.LEARNING))
        if judged > 0.5:
            self._ready.add(component)
        return judged

    def _reach(self, rows: Rows) -> None:
        first, last = int(rows.time.min()), int(rows.time.max())
        self.audit.first = first if self.audit.first is None else min(first, self.audit.first)
        self.audit.last = last if self.audit.last is None else max(last, self.audit.last)

    def _part(self, component: str, time: int) -> str:
        baseline = self.audit.baselines.get(component) or self.audit.baselines.get(f"{component}:rows")
        if baseline is None:  # equipment that rows watch from its first day
            return WATCHED
        if time <= baseline.end:
            return FITTED
        calibrated = int(baseline.diagnostics.get("probation", {}).get("end", baseline.end))
        if time <= calibrated or component not in self._ready:
            return PROBATION
        return VOID if component in self._void else WATCHED

    def _chart(self, alarm: Alarm) -> str:
        """The kind of the chart that rang first; charts of a day's verdicts are promised as one kind."""
        kind = _owner(alarm.charts[0])[1]
        whole = [k for k in ("chiller", "rows") if (alarm.component, k) in self._promised]
        return kind if (alarm.component, kind) in self._promised or not whole else whole[0]

    def _at(self, place: Place) -> Kept:
        return self.audit.table.setdefault(place, Kept())


def _phases(rows: Rows) -> Iterator[tuple[str, IntArray]]:
    """Each chart's phases in a batch of rows, where it has any."""
    for i, name in enumerate(rows.names):
        phase = rows.fields["phase"][rows.series == i]
        if phase.size:
            yield name, phase


def _owner(chart: str) -> tuple[str, str]:
    """Component and kind in a chart's name, ``COMPONENT/SYMBOL:KIND``."""
    stream, _, kind = chart.rpartition(":")
    return stream.rpartition("/")[0], kind


def _named(alarm: Alarm) -> list[JsonObject]:
    return [{"name": c.name, "likelihood": c.likelihood} for c in alarm.causes[:3]]


def _month(time: int) -> str:
    return iso(time)[:7]
