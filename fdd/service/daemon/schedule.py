"""When jobs are due: by event time, at a time of the day in the site's zone."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Literal
from zoneinfo import ZoneInfo

import structlog

from fdd.config import Site
from fdd.records import NANOSECONDS, JsonObject
from fdd.service.alarms.book import iso
from fdd.service.daemon.parent import PARENT

log = structlog.get_logger()

DAY = 86400.0
# Reports are written early in the first morning after their period.
REPORT_AT = (6, 0)
LEARN_AT = (3, 30)
# What a job may take to stop when the service stops.
STOP_SECONDS = 10.0
# A job that was killed (no memory, a restart) is tried again so often, so long after [ns].
TRIES, AGAIN = 3, 3600 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Schedule:
    """Every so many days, every Monday, or every first of the month, at a local time of the day."""

    name: str
    every: int | Literal["weekly", "monthly"]
    at: tuple[int, int]
    zone: str

    def next(self, after: int) -> int:
        """The first event time [ns] later than ``after`` at which the job is due."""
        zone = ZoneInfo(self.zone)
        local = datetime.fromtimestamp(after / NANOSECONDS, zone)
        day = local.date()
        while True:
            # A time that a change of clocks leaves out is taken as it would have been read before the change.
            due = round(datetime(day.year, day.month, day.day, *self.at, tzinfo=zone).timestamp()) * NANOSECONDS
            fits = isinstance(self.every, int) and day.toordinal() % self.every == 0
            fits |= (self.every == "weekly" and day.weekday() == 0) or (self.every == "monthly" and day.day == 1)
            if fits and due > after:
                return due
            day += timedelta(days=1)

    def day(self, time: int) -> date:
        """The site's date at an event time [ns]."""
        return datetime.fromtimestamp(time / NANOSECONDS, ZoneInfo(self.zone)).date()

    def midnight(self, day: date) -> int:
        """Event time [ns] at which a day of the site begins."""
        begin = datetime(day.year, day.month, day.day, tzinfo=ZoneInfo(self.zone))
        return round(begin.timestamp()) * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Job:
    """A schedule and the arguments of ``fdd`` that do its work; ``{until}`` and ``{since}`` stand for times.

    ``span`` [s] is how far back a job that is due every so many days looks.
    """

    schedule: Schedule
    arguments: tuple[str, ...]
    span: float = 0.0

    def period(self, due: int) -> tuple[int, int]:
        """What it is about, from and until [ns]: the week or month of the calendar that has ended, else the span."""
        last = self.schedule.day(due)
        if self.schedule.every == "weekly":
            last -= timedelta(days=last.weekday())
            first = last - timedelta(days=7)
        elif self.schedule.every == "monthly":
            last = last.replace(day=1)
            first = (last - timedelta(days=1)).replace(day=1)
        else:
            return due - round(self.span * NANOSECONDS), due
        return self.schedule.midnight(first), self.schedule.midnight(last)


def jobs_of(site: Site, site_file: Path) -> list[Job]:
    """The jobs that a site file asks for."""
    found = []
    if site.reidentify is not None:
        r = site.reidentify
        arguments = ["reidentify", str(site_file), "--until", "{until}", "--days", f"{r.window / DAY:g}", "--json"]
        if r.approval:
            arguments.append("--propose")
        schedule = Schedule("reidentify", round(r.every / DAY), r.time_of_day, site.zone)
        found.append(Job(schedule, tuple(arguments), r.window))
    if site.reports is not None:
        name = str(site.folder / site.reports.folder / "report-{day}")
        arguments = ["report", str(site_file), "--out", f"{name}.html", "--from", "{since}", "--until", "{until}"]
        if site.reports.pdf:
            arguments += ["--pdf", f"{name}.pdf"]
        found.append(Job(Schedule("report", site.reports.every, REPORT_AT, site.zone), tuple(arguments)))
    return found


def learning_job(site: Site, site_file: Path) -> Job:
    """The daily job of a site some of whose equipment has no baseline yet."""
    return Job(
        Schedule("learn", 1, LEARN_AT, site.zone), ("learn", str(site_file), "--until", "{until}", "--json"), DAY
    )


@dataclass(slots=True)
class _Running:
    job: Job
    due: int
    process: subprocess.Popen[bytes]
    log: Path


class JobRunner:
    """Starts jobs when they are due, each in a process of its own, one of a kind at a time.

    Parameters
    ----------
    folder : where the jobs' output goes, one file a kind
    """

    def __init__(self, jobs: Sequence[Job], folder: Path) -> None:
        self._jobs, self._folder = list(jobs), folder
        self._next: dict[str, int] = {}
        self._running: dict[str, _Running] = {}
        self._tried: dict[str, int] = {}

    @property
    def state(self) -> JsonObject:
        """When each job is due next, for the checkpoint: one that is running is due again if this process dies."""
        return {**self._next, **{name: r.due for name, r in self._running.items()}}

    def restore(self, state: JsonObject) -> None:
        """Continue with what was due when :attr:`state` was asked for."""
        self._next = {str(k): int(v) for k, v in state.items()}

    def tick(self, time: int) -> list[JsonObject]:
        """Event time has come to ``time``: start what is due; returns documents of the jobs that have ended."""
        ended = self._collect(time)
        for job in self._jobs:
            name = job.schedule.name
            # The first sample ever is no reason for a job: there is no history yet.
            due = self._next.setdefault(name, job.schedule.next(time))
            if time < due:
                continue
            # However long event time leapt, the job is done once.
            self._next[name] = job.schedule.next(time)
            if name in self._running:
                log.warning("job skipped, the one before is still running", job=name)
                continue
            try:
                self._start(job, due)
            except OSError as problem:  # a folder that cannot be made, no memory for a process
                ended.append(_document(name, due, -1, f"could not be started: {problem}"))
        return ended

    def _start(self, job: Job, due: int) -> None:
        since, until = job.period(due)
        table = {"until": iso(until), "since": iso(since), "day": job.schedule.day(due).isoformat()}
        arguments = [a.format(**table) if "{" in a else a for a in job.arguments]
        path = self._folder / f"job-{job.schedule.name}.log"
        for a, b in pairwise(arguments):
            if a in ("--out", "--pdf"):
                Path(b).parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as out:
            environment = {**os.environ, PARENT: str(os.getpid())}
            command = [sys.executable, "-m", "fdd", *arguments]
            process = subprocess.Popen(command, stdout=out, stderr=out, env=environment)
        os.setpriority(os.PRIO_PROCESS, process.pid, 10)  # the samples come first
        log.info("job started", job=job.schedule.name, due=iso(due), pid=process.pid)
        self._running[job.schedule.name] = _Running(job, due, process, path)

    def _collect(self, time: int) -> list[JsonObject]:
        return [self._ended(name, time) for name, r in list(self._running.items()) if r.process.poll() is not None]

    def _ended(self, name: str, time: int | None) -> JsonObject:
        r = self._running.pop(name)
        last = r.log.read_text(errors="replace").strip().splitlines()[-1:]
        code = int(r.process.returncode)
        if code >= 0:
            self._tried.pop(name, None)
        elif time is None:
            self._next[name] = r.due  # stopped with the service: done as soon as it is back
        elif self._tried.setdefault(name, 0) + 1 < TRIES:
            self._tried[name] += 1
            self._next[name] = min(self._next[name], time + AGAIN)
            log.warning("job was killed, trying again", job=name, signal=-code, at=iso(time + AGAIN))
        return _document(name, r.due, code, last[0] if last else "")

    def stop(self) -> list[JsonObject]:
        """Stop what is running; what it had not finished has changed nothing, and is done when the service is back."""
        for r in self._running.values():
            r.process.terminate()
        for r in self._running.values():
            try:
                r.process.wait(STOP_SECONDS)
            except subprocess.TimeoutExpired:
                r.process.kill()
                r.process.wait()
        return [self._ended(name, None) for name in list(self._running)]


def _document(name: str, due: int, code: int, said: str) -> JsonObject:
    """What is kept of a job that has ended."""
    state = "done" if code == 0 else "failed"
    (log.info if code == 0 else log.error)("job ended", job=name, state=state, code=code, said=said[:200])
    key = f"job/{name}/{iso(due)}"
    return {"key": key, "job": name, "due": due, "state": state, "code": code, "said": said[:2000]}
