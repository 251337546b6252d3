"""``fdd replay``: the engine over history, exactly as the daemon would have run it."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np
from rich.console import Console
from rich.progress import Progress

from fdd.records import NANOSECONDS, Alarm, AlarmState, JsonObject, Rows
from fdd.report.telling import Speaker
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import iso
from fdd.service.alarms.handles import handles
from fdd.service.daemon.checkpoint import Checkpoint, files_of
from fdd.service.daemon.daemon import Daemon
from fdd.service.daemon.lock import StateLock
from fdd.service.daemon.ready import ready_engine
from fdd.service.engine.engine import Engine, Outputs
from fdd.service.site.errors import UsageError
from fdd.service.site.feed import Feed
from fdd.service.site.naming import speaker_of
from fdd.service.site.site_context import SiteContext, open_site
from fdd.store.store import Store

HOUR = 3600 * NANOSECONDS


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
    hours: dict[str, set[int]] = field(default_factory=dict)
    """Hours since 1970 in which each column of the plan held a value."""
    speaker: Speaker = field(default_factory=Speaker)
    trust: JsonObject = field(default_factory=dict)

    def document(self) -> JsonObject:
        """For machines."""
        return {
            "site": self.context.site.name,
            "watched": self.watched,
            "alarms": [self.speaker.told(a) for a in self.alarms.values()],
            "frames": self.frames,
            "samples": self.samples,
            "from": None if self.first is None else iso(self.first),
            "until": None if self.last is None else iso(self.last),
            "samples_per_second": round(self.samples / self.seconds) if self.seconds else 0,
            "counts": self.counts,
            "notes": self.notes,
            "trust": self.trust,
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
        for line in trust_told(self.trust):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        if not self.alarms:
            console.print("No alarms.")
            return
        names = handles([a.document() for a in self.alarms.values()])
        for a in self.alarms.values():
            raised = self.context.local(a.raised)
            line = f"{raised}  {self.speaker.summary(a)}  [{a.state}]"
            console.print(line, highlight=False, markup=False, soft_wrap=True)
            told = f"  {names[a.key]}, since {self.context.local(a.since)}; key {a.key}"
            console.print(told, highlight=False, markup=False, soft_wrap=True)


def replay_site(
    site_file: Path,
    data: Path | None,
    *,
    since: str | None,
    until: str | None,
    verdicts: Path | None,
    console: Console,
    store: bool = False,
) -> ReplayResult:
    """Run the engine over the site's sources or a data file.

    With ``store`` all that it gives is kept in the site's store, and its state beside it, as the daemon would have: it
    stands in for what an earlier run has left of the same time. Without, nothing in the store is changed.

    Raises
    ------
    UsageError : no component has a baseline; or the site's daemon runs, whose store is not to be written to
    """
    context = open_site(site_file, data)
    engine = ready_engine(context)
    start, end = context.nanoseconds(since), context.nanoseconds(until)
    result = ReplayResult(context, [c.name for c in engine.watched], speaker=speaker_of(engine.plan, context.site))
    feed = Feed(context.site)
    feed.open()
    began = clock.monotonic()
    lines = verdicts.open("w", encoding="utf-8") if verdicts else None
    kept = Kept(context, engine) if store else None
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("replaying", total=None)
        for batch in feed.batches():
            inside = batch
            if start is not None or end is not None:
                inside = batch.between(start, end)
            result.samples += len(inside)
            _take(result, engine.step(inside), lines, kept)
            progress.update(task, completed=result.samples, description=f"replaying {_where(context, engine)}")
        _take(result, engine.flush(), lines, kept)
    if kept:
        kept.close(result)
    if lines:
        lines.close()
    result.seconds = clock.monotonic() - began
    result.counts = engine.counts | feed.counters()
    result.trust = engine.trust
    result.notes = [*engine.notes, *feed.notes()]
    feed.close()
    return result


def trust_told(trust: JsonObject) -> list[str]:
    """How far each component can be believed, a line each."""
    words = {
        "calibrating": "calibrating, only gross faults ring",
        "watching": "watching",
        "outside": "yesterday was unlike all days seen: not judged",
        "void": "its promise is void",
    }
    return [
        f"{name}: {words[t['state']]}; {t['judged']} of {t['days']} days judged"
        + (f" ({t['reason']})" if t["reason"] else "")
        for name, t in trust.items()
    ]


def _where(context: SiteContext, engine: Engine) -> str:
    return context.local(engine.time) if engine.time is not None else ""


class Kept:
    """The store and the state of a replay that is kept, in the place of a daemon that would have run over the data."""

    def __init__(self, context: SiteContext, engine: Engine) -> None:
        self._lock = StateLock(context.checkpoint_path)
        self._store = context.store()
        try:
            refuse_to_forget(context, self._store)
        except UsageError:
            self._store.close()
            self._lock.close()
            raise
        for file in files_of(context.checkpoint_path):
            file.unlink(missing_ok=True)
        self._checkpoint = Checkpoint(context.checkpoint_path)
        speaker = speaker_of(engine.plan, context.site)
        self._daemon = Daemon(engine, self._store, self._checkpoint, speaker=speaker)
        self._daemon.batch = True
        self._before = {a["key"]: a for a in self._store.list("alarm") if a["state"] != AlarmState.CLEARED}

    def keep(self, outputs: Outputs, samples: int) -> None:
        """What a step gave."""
        self._daemon.samples = samples
        self._daemon.keep(outputs)

    def close(self, result: ReplayResult) -> None:
        """Close earlier alarms of the same time that did not come again, and save the state."""
        for key, alarm in self._before.items():
            if key not in result.alarms and result.first is not None and int(alarm["raised"]) >= result.first:
                now = int(result.last or alarm["updated"])
                said = {"time": now, "state": AlarmState.CLEARED, "actor": "replay", "comment": "did not come again"}
                history = [*alarm["history"], said]
                self._store.put(
                    "alarm", key, {**alarm, "state": AlarmState.CLEARED, "updated": now, "history": history}
                )
        self._daemon.save()
        self._daemon.end()
        self._checkpoint.close()
        self._store.close()
        self._lock.close()


def refuse_to_forget(context: SiteContext, store: Store) -> None:
    """Refuse to replace what a daemon on live sources has come to.

    Raises
    ------
    UsageError : the state beside the store is a daemon's, and not an earlier study's
    """
    run = store.get("run", "daemon")
    if context.checkpoint_path.exists() and run is not None and not run.get("batch"):
        raise UsageError(
            f"{context.checkpoint_path} is the state of this site's daemon, which a study would replace; give the "
            "study a site file with a store of its own, or remove that file if the daemon is to start afresh"
        )


def _take(result: ReplayResult, outputs: Outputs, lines: TextIO | None, kept: Kept | None = None) -> None:
    if kept is not None:
        kept.keep(outputs, result.samples)
    result.frames += outputs.frames
    for alarm in outputs.alarms:
        result.alarms[alarm.key] = alarm
        result.changes.append(alarm)
    for rows in outputs.rows:
        if rows.measurement == "samples":
            _remember(result.hours, rows)
        first, last = int(rows.time.min()), int(rows.time.max())
        result.first = first if result.first is None else min(first, result.first)
        result.last = last if result.last is None else max(last, result.last)
    if lines is not None:
        for line in verdict_lines(outputs):
            lines.write(line + "\n")


def _remember(hours: dict[str, set[int]], rows: Rows) -> None:
    hour = rows.time // HOUR
    for series in np.unique(rows.series):
        hours.setdefault(rows.names[series], set()).update(np.unique(hour[rows.series == series]).tolist())


def verdict_lines(outputs: Outputs) -> Iterator[str]:
    """Every verdict as a line of JSON: each chart at each frame, and each alarm that changed."""
    for rows in outputs.rows:
        if rows.measurement == "charts":
            yield from _chart_lines(rows)
    for alarm in outputs.alarms:
        yield json.dumps({"alarm": alarm.document()})


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
