"""``fdd demo``: a simulated plant with a fault, streamed over Zenoh into the daemon; the alarm and the report.

Nothing is staged: baselines are fitted to the first weeks of noisy measurements, the daemon is a process of its own
that knows only the site file, and the samples reach it over the network.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time as clock
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from fdd.evidence import AlarmKind, kind_of
from fdd.plant.faults import DAY, PlantFault, Shape
from fdd.plant.scenario import Scenario, pieces, points
from fdd.plant.site import demo_site
from fdd.records import NANOSECONDS, AlarmState, Batch, JsonObject
from fdd.report.content import Report, gather
from fdd.report.plots import plots
from fdd.report.render import write_gathered
from fdd.service.alarms.book import iso
from fdd.service.baselines.history import read_history
from fdd.service.baselines.identify import identify
from fdd.service.baselines.probation import on_probation
from fdd.service.baselines.versions import accept
from fdd.service.site.errors import UsageError
from fdd.service.site.naming import site_info
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.operate import stored_alarms
from ingest.zenoh.options import ZenohOptions
from ingest.zenoh.publisher import ZenohPublisher

FIT_WEEKS = 3
# Weeks that the fit has not seen, for the charts to learn what is normal.
PROBATION_WEEKS = 2
LEARNING_WEEKS = FIT_WEEKS + PROBATION_WEEKS
ROWS_PER_MESSAGE = 12
TOPIC = "fdd/demo/samples"

# Fault of the demo: where it is, which component must be alarmed, how bad it becomes and over how many days.
FAULTS: dict[str, tuple[str, str, float, float]] = {
    "fouling": ("hx", "hx", 0.3, 7.0),
    "air": ("radiator-south", "radiator-south", 0.3, 3.0),
    "bias": ("hx.T_hot_out", "hx", 1.0, 0.0),
}


@dataclass
class DemoResult:
    """What was planted and what was found."""

    seed: int
    fault: str
    component: str | None
    onset: int | None
    alarms: list[JsonObject] = field(default_factory=list)
    samples: int = 0
    seconds: float = 0.0
    total_seconds: float = 0.0
    report: Path | None = None
    context: SiteContext | None = None

    @property
    def _raised(self) -> list[JsonObject]:
        """What accuses the plant: a model that no longer holds does not."""
        standing = [a for a in self.alarms if a["state"] != AlarmState.SUPPRESSED]
        return [a for a in standing if kind_of(a["evidence"])[0] is AlarmKind.PLANT]

    @property
    def hits(self) -> list[JsonObject]:
        """Alarms on the right component after the onset."""
        return [a for a in self._raised if a["component"] == self.component and a["raised"] >= (self.onset or 0)]

    @property
    def false_alarms(self) -> int:
        """Alarms that the fault does not explain."""
        return len(self._raised) - len(self.hits)

    def document(self) -> JsonObject:
        """For machines."""
        first = min((a["raised"] for a in self.hits), default=None)
        delay = None if first is None or self.onset is None else (first - self.onset) / NANOSECONDS
        return {
            "seed": self.seed,
            "fault": self.fault,
            "faulty_component": self.component,
            "onset": None if self.onset is None else iso(self.onset),
            "first_alarm": None if first is None else iso(first),
            "delay_days": None if delay is None else round(delay / DAY, 3),
            "components_alarmed": sorted({a["component"] for a in self._raised}),
            "false_alarms": self.false_alarms,
            "samples": self.samples,
            "samples_per_second": round(self.samples / self.seconds) if self.seconds else 0,
            "seconds": round(self.total_seconds, 1),
            "report": str(self.report),
        }

    def story(self) -> str:
        """For people."""
        assert self.context is not None
        lines = []
        if self.onset is None:
            lines.append("No fault was planted.")
        else:
            lines.append(f"Planted:  {self.fault} on {self.component}, from {self.context.local(self.onset)}")
        for a in self.alarms:
            lines.append(f"Alarm:    {a['raised_local']}  {a['summary']} ({a['state']})")
        if not self.alarms:
            lines.append("Alarms:   none")
        if self.hits and self.onset is not None:
            delay = (self.hits[0]["raised"] - self.onset) / NANOSECONDS / DAY
            lines.append(f"Found:    on the right component after {delay:.1f} days, while it was still growing")
        lines.append(f"False:    {self.false_alarms} alarm(s) that the fault does not explain")
        rate = self.samples / max(self.seconds, 1e-9)
        lines.append(f"Samples:  {self.samples} at {rate:,.0f} samples/s; {self.total_seconds:.0f} s in all")
        lines.append(f"Report:   {self.report}")
        return "\n".join(lines)


@dataclass(frozen=True)
class Prepared:
    """A demonstration site with baselines, and the samples that its daemon has not seen."""

    context: SiteContext
    site_file: Path
    scenario: Scenario
    endpoint: str
    batches: list[Batch]

    @property
    def samples(self) -> int:
        """Samples to be streamed."""
        return sum(len(b) for b in self.batches)


def scenario_of(fault: str, seed: int, weeks: int) -> tuple[Scenario, PlantFault | None]:
    """Weeks of learning, then weeks of watching with the fault's onset in the second one.

    Raises
    ------
    UsageError : no such fault
    """
    days = 7.0 * (LEARNING_WEEKS + weeks)
    if fault == "none":
        return Scenario(days=days, seed=seed), None
    if fault not in FAULTS:
        raise UsageError(f"no fault is called {fault!r}; there are {', '.join(FAULTS)} and none")
    target, _, severity, ramp = FAULTS[fault]
    at = 7.0 * LEARNING_WEEKS + np.random.default_rng(seed).uniform(4.0, 10.0)
    shape: Shape = "ramp" if ramp else "step"
    planted = PlantFault(fault, target, round(at * DAY / 300) * 300.0, severity, shape, (ramp or 1.0) * DAY)
    return Scenario(days=days, seed=seed, faults=(planted,)), planted


def prepare(
    scenario: Scenario,
    folder: Path,
    progress: Progress | None = None,
    *,
    learning_days: float = FIT_WEEKS * 7,
    probation_days: float = PROBATION_WEEKS * 7,
    store: JsonObject | None = None,
) -> Prepared:
    """Simulate, write the site file, fit baselines to the first days, and put them on probation on those after."""
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    source = {"kind": "zenoh", "key": TOPIC, "connect": [endpoint]}
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("demo*.sqlite*"):
        old.unlink()
    site_file = demo_site(folder, sources=[source], scenario=scenario, store=store)
    context = open_site(site_file)
    batches = list(_simulated(scenario, progress))
    fitted = scenario.first + round(learning_days * DAY * NANOSECONDS)
    end = fitted + round(probation_days * DAY * NANOSECONDS)
    learning = [b for b in batches if b.time[0] < end]
    history, _ = read_history(context.plan, learning)
    task = progress.add_task("fitting baselines", total=len(context.plan.components)) if progress else None
    kept = context.store()
    for component in context.plan.components:
        if progress and task is not None:
            progress.update(task, description=f"fitting {component.name}")
        baseline, _ = identify(context.plan, component, history.between(None, fitted))
        if probation_days:
            baseline = on_probation(context.plan, component, baseline, history, fitted)
        accept(kept, baseline)
        if progress and task is not None:
            progress.advance(task)
    kept.close()
    return Prepared(context, site_file, scenario, endpoint, batches[len(learning) :])


def _simulated(scenario: Scenario, progress: Progress | None) -> Iterator[Batch]:
    """The scenario as batches of an hour."""
    names = tuple(points())
    task = progress.add_task("simulating the plant", total=scenario.samples) if progress else None
    for piece in pieces(scenario):
        for start in range(0, len(piece.time), ROWS_PER_MESSAGE):
            rows = slice(start, start + ROWS_PER_MESSAGE)
            yield Batch.of_table(names, piece.time[rows], piece.values[rows])
        if progress and task is not None:
            progress.update(task, completed=piece.first + len(piece.time))


def publish(prepared: Prepared, progress: Progress | None = None) -> ZenohPublisher:
    """Stream every batch; the publisher stays open, so that a daemon that comes late gets what it missed."""
    options = ZenohOptions(listen=(prepared.endpoint,))
    publisher = ZenohPublisher(options, TOPIC, cache=len(prepared.batches) + 10)
    task = progress.add_task("streaming over Zenoh", total=prepared.samples) if progress else None
    for batch in prepared.batches:
        publisher.publish(batch)
        if progress and task is not None:
            progress.advance(task, len(batch))
    publisher.end()
    return publisher


def start_daemon(prepared: Prepared) -> subprocess.Popen[bytes]:
    """The daemon as a process of its own, its log beside the site file."""
    log = (prepared.site_file.parent / "daemon.log").open("ab")
    command = [sys.executable, "-m", "fdd", "run", str(prepared.site_file), "--until-end"]
    return subprocess.Popen(command, stdout=log, stderr=log)


def store_table(kind: str) -> JsonObject | None:
    """The store of the demonstration's site file: SQLite beside it, or the server that the environment names.

    Raises
    ------
    UsageError : no such store, or the environment does not name the server
    """
    if kind == "sqlite":
        return None
    if kind != "influx":
        raise UsageError(f"no store is called {kind!r}; there are sqlite and influx")
    named = {key: os.environ.get(f"FDD_INFLUX_{key.upper()}", "") for key in ("url", "org", "bucket", "token")}
    missing = [f"FDD_INFLUX_{key.upper()}" for key, value in named.items() if not value]
    if missing:
        raise UsageError(f"--store influx: set {', '.join(missing)}; the bucket keeps data for ever (--raw-days 0)")
    return {"kind": "influx", **{k: named[k] for k in ("url", "org", "bucket")}, "token_env": "FDD_INFLUX_TOKEN"}


def run_demo(
    *, fault: str, seed: int, weeks: int, folder: Path, console: Console, store_kind: str = "sqlite"
) -> DemoResult:
    """The whole demonstration.

    Raises
    ------
    UsageError : no such fault or store, or the daemon failed
    """
    scenario, planted = scenario_of(fault, seed, weeks)
    began = clock.monotonic()
    columns = (TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        prepared = prepare(scenario, folder, progress, store=store_table(store_kind))
        streaming = clock.monotonic()
        daemon = start_daemon(prepared)
        with publish(prepared, progress):
            _wait(daemon, prepared, progress)
        streamed = clock.monotonic() - streaming
    onset = None if planted is None else scenario.first + round(planted.onset * NANOSECONDS)
    result = DemoResult(
        seed=seed,
        fault=fault,
        component=None if planted is None else FAULTS[fault][1],
        onset=onset,
        alarms=stored_alarms(prepared.context),
        samples=prepared.samples,
        seconds=streamed,
        context=prepared.context,
    )
    store = prepared.context.store(read_only=True)
    end = scenario.first + round(scenario.days * DAY * NANOSECONDS)
    start = end - round(weeks * 7 * DAY * NANOSECONDS)
    info = site_info(prepared.context.plan, prepared.context.site)
    report = gather(store, info, start, end)
    store.close()
    result.report = write_gathered(report, folder / "report.html")
    _draw_alarm(report, folder / "alarm.svg")
    result.total_seconds = clock.monotonic() - began
    return result


def _draw_alarm(report: Report, path: Path) -> None:
    """The first finding's first plot as a file of its own: what was measured, and what the model expected."""
    if report.findings and report.start is not None and report.end is not None:
        first, *_ = plots(report.findings[0], report.site, report.start, report.end)
        path.write_bytes(b64decode(first.source.partition(",")[2]))


def _wait(daemon: subprocess.Popen[bytes], prepared: Prepared, progress: Progress) -> None:
    task = progress.add_task("daemon finishing", total=None)
    code = daemon.wait(timeout=600)
    progress.update(task, total=1, completed=1)
    if code != 0:
        log = prepared.site_file.parent / "daemon.log"
        last = log.read_text(errors="replace").strip().splitlines()[-3:]
        raise UsageError(f"the daemon ended with code {code}; the end of {log} says: {' | '.join(last)}")


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port: int = s.getsockname()[1]
        return port
