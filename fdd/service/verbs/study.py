"""``fdd study``: check, fit, replay and report over one history, and what came of every piece of equipment."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import Progress

from fdd.evidence import AlarmKind, kind_of
from fdd.records import NANOSECONDS, JsonObject
from fdd.service.alarms.book import iso
from fdd.service.alarms.handles import handles
from fdd.service.baselines.fitting import Fitted, fit_history, read_span, watched_of
from fdd.service.baselines.history import History
from fdd.service.baselines.versions import in_force
from fdd.service.daemon.lock import StateLock
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.check import check_all
from fdd.service.verbs.operate import stored_alarms
from fdd.service.verbs.quality import RecordQuality
from fdd.service.verbs.replay import ReplayResult, refuse_to_forget, replay_site
from fdd.service.verbs.reporting import report_site

LONGEST_BASELINE = 28 * 86400 * NANOSECONDS
Outcome = Literal["alarm", "quiet", "not judged"]


@dataclass(frozen=True)
class Verdict:
    """What came of one piece of equipment, in words; ``handles`` are those of its alarms."""

    equipment: str
    outcome: Outcome
    words: str
    handles: tuple[str, ...] = ()


@dataclass
class Study:
    """What a study found."""

    context: SiteContext
    split: int
    verdicts: list[Verdict] = field(default_factory=list)
    replay: ReplayResult | None = None
    reports: list[Path] = field(default_factory=list)
    faults: tuple[str, ...] = ()

    def document(self) -> JsonObject:
        """For machines."""
        return {
            "site": self.context.site.name,
            "learned_until": iso(self.split),
            "data": list(self.faults),
            "verdicts": [
                {"equipment": v.equipment, "outcome": v.outcome, "words": v.words, "alarms": list(v.handles)}
                for v in self.verdicts
            ],
            "replay": None if self.replay is None else self.replay.document(),
            "reports": [str(p) for p in self.reports],
        }

    def print(self, console: Console) -> None:
        """For people."""
        for words in self.faults:
            console.print(f"data: {words}", highlight=False, markup=False, soft_wrap=True)
        for v in self.verdicts:
            console.print(f"{v.equipment}: {v.outcome}", highlight=False, markup=False, soft_wrap=True)
            for line in v.words.splitlines():
                console.print(f"  {line}", highlight=False, markup=False, soft_wrap=True)
        for path in self.reports[:1]:
            console.print(f"report: {path}", highlight=False, markup=False, soft_wrap=True)
        if any(v.handles for v in self.verdicts):
            console.print(
                "next: fdd explain SITE ALARM; fdd alarms ack|clear SITE ALARM", highlight=False, markup=False
            )


def study_site(
    site_file: Path,
    data: Path | None,
    *,
    until: str | None,
    out: Path,
    pdf: Path | None = None,
    starts: int = 3,
    anyway: bool = False,
    console: Console,
) -> Study:
    """Learn from the first part of a history, watch the rest, and keep and report what came of it.

    Parameters
    ----------
    until : end of the healthy part that baselines are fitted to; by default half of the history, 28 days at most
    out, pdf : where the report goes

    Raises
    ------
    UsageError : the daemon of the site runs, nothing can be read, or nothing is left after ``until``
    MostlyLostError : most of the data cannot be used, and not ``anyway``
    """
    context = open_site(site_file, data)
    quality = None if anyway else _quality(site_file, data)
    if quality is not None and quality.mostly_lost:
        raise MostlyLostError(
            f"{quality.used:.0%} of the samples and {quality.span_used:.0%} of the span can be used: "
            f"{'; '.join(f.words for f in quality.faults[:3])}. See fdd check; to go on all the same: --anyway"
        )
    _refuse_early(context)
    chosen = watched_of(context)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("reading", total=len(chosen))
        history = read_span(context, None, None)
        split = _split(context, history, until)

        def tell(name: str, done: int) -> None:
            progress.update(task, description=f"fitting {name}", completed=done)

        learned = history.between(None, split)
        fitted, failures = fit_history(context, chosen, learned, starts=starts, tell=tell)
    study = Study(context, split, faults=() if quality is None else tuple(f.words for f in quality.faults))
    refused = [f for f in fitted if isinstance(f, Fitted) and f.against]
    reasons = failures | {f.baseline.component: "; ".join(f.against) for f in refused}
    if _can_watch(context):
        study.replay = replay_site(
            site_file, data, since=iso(split), until=None, verdicts=None, console=console, store=True
        )
    # Where nothing can be watched, the report says why.
    end = int(history.time[-1]) + 1
    study.reports = report_site(site_file, out, pdf=pdf, since=iso(split), until=iso(end))
    study.verdicts = _verdicts(context, study.replay, reasons)
    return study


def _refuse_early(context: SiteContext) -> None:
    """Before hours are spent: a daemon may write to this store, or have left its state there."""
    StateLock(context.checkpoint_path).close()
    store = context.store()
    try:
        refuse_to_forget(context, store)
    finally:
        store.close()


class MostlyLostError(UsageError):
    """Less than half of a record can be used; the text says what is lost."""


def _quality(site_file: Path, data: Path | None) -> RecordQuality | None:
    """What is wrong with the data; None for live sources, whose data come as they come.

    Raises
    ------
    UsageError : not a frame holds a value
    """
    checked = check_all(site_file, data)
    if checked.errors:
        raise UsageError("\n  ".join(str(e) for e in checked.errors))
    return checked.quality


def _split(context: SiteContext, history: History, until: str | None) -> int:
    """Where learning ends and watching begins [ns].

    Raises
    ------
    UsageError : nothing is left on one of the sides
    """
    first, last = int(history.time[0]), int(history.time[-1])
    split = context.nanoseconds(until)
    if split is None:
        split = first + min(LONGEST_BASELINE, (last - first) // 2)
    if not first < split <= last:
        raise UsageError(
            f"--until {until} leaves nothing to {'learn from' if split <= first else 'watch'}: the data reach from "
            f"{context.local(first)} to {context.local(last)}"
        )
    return split


def _can_watch(context: SiteContext) -> bool:
    """Whether anything has a baseline, or needs none."""
    store = context.store(read_only=True)
    try:
        return bool(context.plan.equipment or in_force(store, context.plan.baseline_names))
    finally:
        store.close()


def _verdicts(context: SiteContext, replay: ReplayResult | None, reasons: dict[str, str]) -> list[Verdict]:
    """Of every piece of equipment: the alarms that came, that none did, or why it was not judged."""
    watched = set(replay.watched) if replay else set()
    alarms = stored_alarms(context) if replay else []
    came = [a for a in alarms if replay and a["key"] in replay.alarms]
    names = handles(alarms)
    found = []
    for name in dict.fromkeys(c.name for c in watched_of(context)):
        if name not in watched:
            why = reasons.get(name, "it has no baseline")
            found.append(Verdict(name, "not judged", f"because {why}"))
            continue
        own = [a for a in came if a["component"] == name]
        note = [f"the baseline was refused: {reasons[name]}; an earlier one is in force"] if name in reasons else []
        if not own:
            found.append(Verdict(name, "quiet", "\n".join([_days(replay), *note])))
            continue
        words = [_told(a, names[a["key"]]) for a in own]
        found.append(Verdict(name, "alarm", "\n".join([*words, *note]), tuple(names[a["key"]] for a in own)))
    return found


def _told(alarm: JsonObject, handle: str) -> str:
    of_model = "the model, not the equipment: " if kind_of(alarm["evidence"])[0] is AlarmKind.MODEL else ""
    return f"{handle} ({alarm['state']}, {alarm['raised_local']}): {of_model}{alarm['summary']}"


def _days(replay: ReplayResult | None) -> str:
    if replay is None or replay.first is None or replay.last is None:
        return "no frame was watched"
    days = (replay.last - replay.first) / NANOSECONDS / 86400
    return f"no alarm in {days:.3g} days watched"
