"""A site folder for the drifting room: site file, store with its samples, a first baseline; and its daemon."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.drifting_room import DAY, POINTS, START, Course, simulate
from fdd.records import NANOSECONDS, Baseline, Rows
from fdd.service.baselines.identify import identify
from fdd.service.baselines.versions import accept
from fdd.service.site.site_context import SiteContext, open_site

DAY_NS = DAY * NANOSECONDS
SITE = """
name: room
step: 15 min
lateness: 0 s
max_gap: 4 h
store: {kind: sqlite, path: fdd.sqlite}
points:
  outside: {unit: degC}
  sun: {unit: W/m2}
  heat: {unit: W}
  T: {unit: degC}
equipment:
  room:
    model: zone
    options: {nodes: Ti}
    inputs: {T_out: outside, I_solar: sun, P_heat: heat}
    outputs: {T_room: T}
"""


def make_site(folder: Path, course: Course, seed: int, *, learning_days: int = 21, extra: str = "") -> SiteContext:
    """The whole course is in the store; the baseline is fitted to its first days."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "site.yaml").write_text(SITE + extra)
    context = open_site(folder / "site.yaml")
    history = simulate(course, seed)
    store = context.store()
    n, p = history.values.shape
    store.write(
        Rows(
            "samples",
            POINTS,
            np.tile(np.arange(p, dtype=np.int32), n),
            np.repeat(history.time, p),
            {"value": history.values.ravel()},
        )
    )
    accept(store, first_baseline(context, course, seed, learning_days))
    store.close()
    return context


def first_baseline(context: SiteContext, course: Course, seed: int, days: int) -> Baseline:
    """Fitted to the first days of a course."""
    history = simulate(course, seed).between(None, START + days * DAY_NS)
    return identify(context.plan, context.plan.components[0], history)[0]


@contextmanager
def daemon(site_file: Path, log: Path, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """``fdd run`` on a site file as a process of its own; killed in the end if it still runs."""
    command = [sys.executable, "-m", "fdd", "run", str(site_file)]
    with log.open("wb") as out:
        process = subprocess.Popen(command, stderr=out, stdout=out, env={**os.environ, **environment})
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def until(said: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait for what a daemon is to do."""
    end = time.monotonic() + seconds
    while not said():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)
