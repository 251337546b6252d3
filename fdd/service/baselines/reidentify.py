"""``fdd reidentify``: baselines that follow the plant as it ages and the seasons turn, and never a fault."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from fdd.diagnosis.gates import Outcome, Policy
from fdd.records import Baseline, JsonObject
from fdd.service.alarms.book import iso
from fdd.service.baselines.candidate import Candidate, consider
from fdd.service.baselines.history import History, stored_history
from fdd.service.baselines.pool import Failure, side_by_side
from fdd.service.baselines.versions import accept, chain, in_force, propose, versions
from fdd.service.baselines.window import DAY, avoided, without
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Component
from fdd.service.site.site_context import SiteContext, open_site
from fdd.store.store import Store

SPAN_DAYS = 28.0


@dataclass(frozen=True, slots=True)
class Task:
    """One component's work as plain data, for a process of its own."""

    site_file: Path
    component: str
    history: History
    chain: tuple[Baseline, ...]
    policy: Policy
    suspected: bool


@dataclass
class Outcomes:
    """What a job did: a candidate a component, and the versions that were accepted or proposed."""

    context: SiteContext
    candidates: list[Candidate] = field(default_factory=list)
    kept: dict[str, int] = field(default_factory=dict)
    proposed: bool = False
    seconds: float = 0.0

    def document(self) -> JsonObject:
        """For machines, and for the store."""
        return {
            "seconds": round(self.seconds, 3),
            "accepted": {} if self.proposed else dict(self.kept),
            "proposed": dict(self.kept) if self.proposed else {},
            "suspected": [c.component for c in self.candidates if c.outcome is Outcome.SUSPECTED],
            "components": [
                {
                    "component": c.component,
                    "outcome": str(c.outcome),
                    "reason": c.reason,
                    "version": self.kept.get(c.component),
                    "window": None if c.window is None else [iso(c.window.start), iso(c.window.end), c.window.reason],
                    "gates": [
                        {
                            "name": g.name,
                            "passed": g.passed,
                            "statistic": float(g.statistic),
                            "limit": float(g.limit),
                            "remark": g.remark,
                        }
                        for g in c.gates
                    ],
                    "seconds": round(c.seconds, 3),
                }
                for c in self.candidates
            ],
        }

    def print(self, console: Console) -> None:
        """For people."""
        table = Table("component", "window", "gates", "outcome", "why", box=None)
        for c in self.candidates:
            span = "" if c.window is None else f"{self.context.local(c.window.start)[:10]}, {c.window.reason}"
            gates = " ".join(g.name if g.passed else f"[red]{g.name.upper()}[/red]" for g in c.gates)
            version = self.kept.get(c.component)
            outcome = str(c.outcome)
            if version is not None:
                outcome = f"proposed as version {version}" if self.proposed else f"version {version} in force"
            table.add_row(c.component, span, gates, outcome, c.reason)
        console.print(table, soft_wrap=True)


def run_task(task: Task) -> Candidate:
    """Fit and judge one component; touches no store."""
    began = clock.monotonic()
    context = open_site(task.site_file)
    component = next(c for c in context.plan.components if c.name == task.component)
    plan = replace(context.plan, points=task.history.columns, derived=(), components=(component,), chillers=())
    found = consider(plan, component, task.history, task.chain, task.policy, suspected=task.suspected)
    return replace(found, seconds=clock.monotonic() - began)


def reidentify_site(
    site_file: Path,
    *,
    only: Sequence[str] | None = None,
    until: str | None = None,
    days: float = SPAN_DAYS,
    propose_only: bool = False,
    policy: Policy | None = None,
    workers: int | None = None,
    console: Console,
) -> Outcomes:
    """Fit every component that has a baseline anew from the store, and put in force what passes all gates.

    Parameters
    ----------
    until : end of the history; by default the last sample in the store
    days : how far back the history reaches
    propose_only : keep what passes for a person to approve

    Raises
    ------
    UsageError : no such equipment, no baseline, or no data
    """
    began = clock.monotonic()
    context = open_site(site_file)
    outcomes = Outcomes(context, proposed=propose_only)
    reader = context.store(read_only=True)
    try:
        tasks = _tasks(context, reader, site_file, only, until, days, policy or Policy())
    finally:
        reader.close()
    store = context.store()
    try:
        with Progress(console=console, transient=True) as progress:
            bar = progress.add_task("re-identifying", total=len(tasks))

            def done(i: int, found: Candidate | Failure) -> None:
                name = tasks[i].component
                if isinstance(found, Failure):
                    found = Candidate(name, Outcome.REFUSED, f"failed: {found.reason}")
                outcomes.candidates.append(found)
                _keep(store, found, outcomes)
                progress.update(bar, advance=1, description=f"re-identified {name}")

            side_by_side(run_task, tasks, done, workers)
        order = {t.component: i for i, t in enumerate(tasks)}
        outcomes.candidates.sort(key=lambda c: order[c.component])
        outcomes.seconds = clock.monotonic() - began
        key = f"reidentify/{iso(clock.time_ns())}"
        store.put("run", key, {"key": key, "job": "reidentify", **outcomes.document()})
    finally:
        store.close()
    return outcomes


def _tasks(
    context: SiteContext,
    store: Store,
    site_file: Path,
    only: Sequence[str] | None,
    until: str | None,
    days: float,
    policy: Policy,
) -> list[Task]:
    plan = context.plan
    names = [c.name for c in plan.components]
    for name in only or ():
        if name not in names:
            raise UsageError(f"no equipment is named {name!r}; there are {', '.join(names)}")
    current = in_force(store, [n for n in names if not only or n in only])
    if not current:
        raise UsageError(f"{context.site.name}: no component has a baseline; fit them first: fdd fit SITE DATA")
    end = context.nanoseconds(until) or _last(store, plan.points) + 1
    history = stored_history(plan, store, end - round(days * DAY), end)
    alarms, states = store.list("alarm"), store.items("state")
    tasks = []
    for component in plan.components:
        if component.name in current:
            healthy = without(_columns(component, history), avoided(alarms, component))
            kept = versions(store, component.name)
            line = tuple(chain(kept, current[component.name]))
            suspected = bool(states.get(_suspect(component.name), {}).get("suspected"))
            tasks.append(Task(site_file, component.name, healthy, line, policy, suspected))
    return tasks


def _last(store: Store, points: Sequence[str]) -> int:
    """Event time of the newest run document's frame, or of the newest sample."""
    run = store.get("run", "daemon")
    if run and run.get("time"):
        return int(run["time"])
    table = store.read("samples", list(points))
    if not len(table):
        raise UsageError("the store has no samples yet; run the daemon (or `fdd run --until-end`) first")
    return int(table["time"].max())


def _columns(component: Component, history: History) -> History:
    """Only what one component reads, each column once."""
    gate = (component.when,) if component.when else ()
    names = tuple(dict.fromkeys((*component.inputs, *component.outputs, *gate)))
    return History(names, history.time, history.of(names))


def _keep(store: Store, found: Candidate, outcomes: Outcomes) -> None:
    """Put in force (or propose) what passed, and remember or release a suspicion."""
    if found.outcome is Outcome.ACCEPTED and found.baseline is not None:
        kept = propose(store, found.baseline) if outcomes.proposed else accept(store, found.baseline)
        outcomes.kept[found.component] = kept.version
    judged = {g.name: g.passed for g in found.gates}
    if found.outcome is Outcome.SUSPECTED or judged.get("no fault", False):
        suspected = found.outcome is Outcome.SUSPECTED
        store.put("state", _suspect(found.component), {"suspected": suspected, "reason": found.reason})


def release(store: Store, component: str) -> None:
    """A person has answered: nothing is suspected any more."""
    store.put("state", _suspect(component), {"suspected": False, "reason": "answered by a person"})


def _suspect(component: str) -> str:
    return f"suspect/{component}"
