"""A site folder for the drifting room: site file, store with its samples, and a first baseline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.drifting_room import DAY, POINTS, START, Course, simulate
from fdd.records import NANOSECONDS, Baseline, Rows
from fdd.service.baselines import accept
from fdd.service.identify import identify
from fdd.service.opened import Opened, open_site

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
    outputs: {T_in: T}
"""


def make_site(folder: Path, course: Course, seed: int, *, learning_days: int = 21, extra: str = "") -> Opened:
    """The whole course is in the store; the baseline is fitted to its first days."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "site.yaml").write_text(SITE + extra)
    opened = open_site(folder / "site.yaml")
    history = simulate(course, seed)
    store = opened.store()
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
    accept(store, first_baseline(opened, course, seed, learning_days))
    store.close()
    return opened


def first_baseline(opened: Opened, course: Course, seed: int, days: int) -> Baseline:
    """Fitted to the first days of a course."""
    history = simulate(course, seed).between(None, START + days * DAY_NS)
    return identify(opened.plan, opened.plan.components[0], history)[0]
