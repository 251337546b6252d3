"""Past data in the engine's own frames: what fitting and reports look at."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fdd.records import Batch, FloatArray, IntArray
from fdd.service.filtering.framing import Framer
from fdd.service.site.plan import Component, Plan
from fdd.store.store import Store


@dataclass(frozen=True, slots=True)
class History:
    """Frames of a span: ``time`` (m,) [ns], ``values`` (m, n_columns) in SI, columns as in the plan."""

    columns: tuple[str, ...]
    time: IntArray
    values: FloatArray

    def __len__(self) -> int:
        return len(self.time)

    def between(self, start: int | None, end: int | None) -> History:
        """The frames in [start, end)."""
        keep = np.ones(len(self), dtype=np.bool_)
        if start is not None:
            keep &= self.time >= start
        if end is not None:
            keep &= self.time < end
        return History(self.columns, self.time[keep], self.values[keep])

    def of(self, names: tuple[str, ...]) -> FloatArray:
        """Columns by name, shape (m, len(names))."""
        return self.values[:, [self.columns.index(n) for n in names]]


def read_history(plan: Plan, batches: Iterable[Batch]) -> tuple[History, dict[str, int]]:
    """Frame a whole source as the engine would; also the counts of what became of its samples."""
    framer = Framer(plan.points, plan.step, plan.lateness, plan.max_jump)
    closed = [framer.add(b) for b in batches]
    closed.append(framer.flush())
    time = np.concatenate([f.time for f in closed])
    values = plan.derive(np.concatenate([f.values for f in closed]))
    return History(plan.columns, time, values), framer.counts


def stored_history(plan: Plan, store: Store, start: int | None = None, end: int | None = None) -> History:
    """Frames that the daemon kept in the store."""
    table = store.read("samples", list(plan.points), start, end)
    wide = table.pivot(index="time", columns="series", values="value").reindex(columns=list(plan.points))
    return History(plan.columns, wide.index.to_numpy(dtype=np.int64), plan.derive(wide.to_numpy(dtype=np.float64)))


@dataclass(frozen=True, slots=True)
class Run:
    """Consecutive frames in which a component could be judged: ``time`` (m,) [ns], ``u`` (m, n_u), ``y`` (m, n_y)."""

    time: IntArray
    u: FloatArray
    y: FloatArray


def runs(plan: Plan, component: Component, history: History, shortest: int = 12) -> list[Run]:
    """Cut a history into runs without gaps, with the gate on; lost inputs are bridged, single ones or within ``hold``.

    The engine can but hold them, or leave the step out, knowing nothing of what comes; here both ends are known. Beyond
    ``hold`` a bridge is a guess all the same: outputs beside it and of the step over it count as missing, as the engine
    does not judge them. A flow that jumps there would be taken for noise.
    """
    inputs = history.of(component.inputs)
    u = bridged(history.time, inputs, max(plan.hold, plan.step))
    seen = np.isfinite(held(history.time, inputs, plan.hold)).all(axis=1, keepdims=True)
    seen = seen & np.roll(seen, 1, axis=0)
    y = np.where(seen, history.of(component.outputs), np.nan)
    off = np.zeros(len(history), dtype=np.bool_)
    if component.when:
        off = ~(history.of((component.when,))[:, 0] > 0.5)
    at = np.flatnonzero(np.isfinite(u).all(axis=1) & ~off)
    if len(at) == 0:
        return []
    # A machine that was off, or silence, breaks a run; a few frames without inputs only lengthen a step.
    breaks = np.flatnonzero((np.diff(np.cumsum(off)[at]) > 0) | (np.diff(history.time[at]) > plan.max_gap)) + 1
    found = []
    for part in np.split(at, breaks):
        complete = np.isfinite(y[part]).all(axis=1)
        part = part[int(np.argmax(complete)) :] if complete.any() else part[:0]
        if len(part) >= shortest:
            found.append(Run(history.time[part], u[part], y[part]))
    return found


def held(time: IntArray, values: FloatArray, hold: int) -> FloatArray:
    """Fill each column's gaps with its last value, for as long as ``hold`` [ns]."""
    rows = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(values), rows, -1), axis=0)
    filled = np.where(last >= 0, np.take_along_axis(values, np.maximum(last, 0), axis=0), np.nan)
    age = time[:, None] - time[np.maximum(last, 0)]
    return np.where(age <= hold, filled, np.nan)


def bridged(time: IntArray, values: FloatArray, hold: int) -> FloatArray:
    """Fill gaps that :func:`held` fills, by straight lines where the next value is known."""
    filled = held(time, values, hold)
    for column, full in zip(values.T, filled.T, strict=True):
        seen = np.isfinite(column)
        lost = ~seen & np.isfinite(full)
        if seen.any() and lost.any():
            full[lost] = np.interp(time[lost] - time[0], time[seen] - time[0], column[seen])
    return filled
