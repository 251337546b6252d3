"""``fdd replay``: the engine over history, exactly as the daemon would have run it."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from rich.console import Console
from rich.progress import Progress

from fdd.records import Alarm, JsonObject, Rows
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import alarm_to_document, iso
from fdd.service.daemon.ready import ready_engine
from fdd.service.engine.engine import Engine, Outputs
from fdd.service.site.feed import Feed
from fdd.service.site.site_context import SiteContext, open_site


@dataclass
class ReplayResult:
    """What a replay found."""

    context: SiteContext
    watched: list[str]
    alarms: dict[str, Alarm] = field(default_factory=dict)
    changes: list[Alarm] = field(default_factory=list)
    frames: int = 0
    samples: int = 0
    first: int | None = None
    last: int | None = None
    seconds: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def document(self) -> JsonObject:
        """For machines."""
        return {
            "site": self.context.site.name,
            "watched": self.watched,
            "alarms": [alarm_to_document(a) for a in self.alarms.values()],
            "frames": self.frames,
            "samples": self.samples,
            "from": None if self.first is None else iso(self.first),
            "until": None if self.last is None else iso(self.last),
            "samples_per_second": round(self.samples / self.seconds) if self.seconds else 0,
            "counts": self.counts,
            "notes": self.notes,
        }

    def print(self, console: Console) -> None:
        """For people."""
        span = (
            f"{self.context.local(self.first)} to {self.context.local(self.last)}"
            if self.first and self.last
            else "no time"
        )
        console.print(
            f"{self.context.site.name}: {self.samples} samples, {self.frames} frames, {span}, "
            f"{self.samples / max(self.seconds, 1e-9):,.0f} samples/s",
            highlight=False,
            soft_wrap=True,
        )
        lost = {k: n for k, n in self.counts.items() if n and k != "accepted"}
        if lost:
            console.print("rejected or odd: " + ", ".join(f"{k} {n}" for k, n in lost.items()), highlight=False)
        for note in self.notes[:5]:
            console.print(f"  {note}", highlight=False, markup=False)
        if not self.alarms:
            console.print("No alarms.")
            return
        for a in self.alarms.values():
            raised = self.context.local(a.raised)
            console.print(f"{raised}  {a.summary}  [{a.state}]", highlight=False, markup=False, soft_wrap=True)
            console.print(f"  {a.key}, since {self.context.local(a.since)}", highlight=False, markup=False)


def replay_site(
    site_file: Path,
    data: Path | None,
    *,
    since: str | None,
    until: str | None,
    verdicts: Path | None,
    console: Console,
) -> ReplayResult:
    """Run the engine over the site's sources or a data file; nothing in the store is changed.

    Raises
    ------
    UsageError : no component has a baseline
    """
    context = open_site(site_file, data)
    engine = ready_engine(context)
    start, end = context.nanoseconds(since), context.nanoseconds(until)
    result = ReplayResult(context, [c.name for c in engine.watched])
    feed = Feed(context.site)
    feed.open()
    began = clock.monotonic()
    lines = verdicts.open("w", encoding="utf-8") if verdicts else None
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("replaying", total=None)
        for batch in feed.batches():
            inside = batch
            if start is not None or end is not None:
                inside = batch.between(start, end)
            result.samples += len(inside)
            _take(result, engine.step(inside), lines)
            progress.update(task, completed=result.samples, description=f"replaying {_where(context, engine)}")
        _take(result, engine.flush(), lines)
    if lines:
        lines.close()
    result.seconds = clock.monotonic() - began
    result.counts = engine.counts | feed.counters()
    result.notes = [*engine.notes, *feed.notes()]
    feed.close()
    return result


def _where(context: SiteContext, engine: Engine) -> str:
    return context.local(engine.time) if engine.time is not None else ""


def _take(result: ReplayResult, outputs: Outputs, lines: TextIO | None) -> None:
    result.frames += outputs.frames
    for alarm in outputs.alarms:
        result.alarms[alarm.key] = alarm
        result.changes.append(alarm)
    for rows in outputs.rows:
        first, last = int(rows.time.min()), int(rows.time.max())
        result.first = first if result.first is None else min(first, result.first)
        result.last = last if result.last is None else max(last, result.last)
    if lines is not None:
        for line in verdict_lines(outputs):
            lines.write(line + "\n")


def verdict_lines(outputs: Outputs) -> Iterator[str]:
    """Every verdict as a line of JSON: each chart at each frame, and each alarm that changed."""
    for rows in outputs.rows:
        if rows.measurement == "charts":
            yield from _chart_lines(rows)
    for alarm in outputs.alarms:
        yield json.dumps({"alarm": alarm_to_document(alarm)})


def _chart_lines(rows: Rows) -> Iterator[str]:
    columns = zip(
        rows.time.tolist(),
        rows.series.tolist(),
        rows.fields["phase"].tolist(),
        rows.fields["statistic"].tolist(),
        rows.fields["limit"].tolist(),
        strict=True,
    )
    for time, series, phase, statistic, limit in columns:
        yield json.dumps(
            {
                "time": iso(time),
                "chart": rows.names[series],
                "phase": Phase(phase).name.lower(),
                "statistic": statistic,
                "limit": limit,
            }
        )
