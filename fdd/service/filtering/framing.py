"""Samples of any rate and order become frames: one row of point values for each step of event time.

Frame *k* holds, for every point, the last good value with event time in ``((k - 1) step, k step]``. It closes when a
sample shows that event time has passed ``k step + lateness``. What is dropped, and why, is counted; the outcome
depends on the order of the samples alone, never on how they were cut into batches.

==================  ==========================================================================
count               what happened to the sample
==================  ==========================================================================
accepted            it is in a frame
late                its frame had already closed (time ran backwards, or it came too late)
duplicate           it is not newer than what its open frame already holds for the point
no_value            NaN or bad quality: it moved time forward, nothing else
unknown_point       the site does not know the point
clock_jump          more than ``max_jump`` ahead of all others, and not confirmed by the others
==================  ==========================================================================

A leap of more than ``max_jump`` is believed when most of the points that were heard before it leap together, or when
nobody contradicts for :data:`STEPS_ALONE` steps. One point, or one message, never moves the plant's time alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fdd.records import Batch, FloatArray, IntArray, JsonObject, Quality

COUNTS = ("accepted", "late", "duplicate", "no_value", "unknown_point", "clock_jump")
NEVER = np.iinfo(np.int64).min
BoolArray = NDArray[np.bool_]
# A clock that has really jumped says so again and again; a corrupt time stamp does not.
CONFIRMATIONS = 5
STEPS_ALONE = 12


@dataclass(frozen=True, slots=True)
class Frames:
    """Closed frames: ``time`` shape (m,) [ns], ``values`` shape (m, n_points) in SI, NaN where nothing was seen."""

    time: IntArray
    values: FloatArray

    def __len__(self) -> int:
        return len(self.time)


@dataclass
class Framer:
    """Cuts the stream of samples into frames of ``step`` nanoseconds."""

    points: tuple[str, ...]
    step: int
    lateness: int
    max_jump: int
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))

    def __post_init__(self) -> None:
        self._index = {name: i for i, name in enumerate(self.points)}
        self._watermark: int | None = None
        self._closed: int = NEVER
        self._ahead: int = 0
        # Of every point: when it was last heard, and whether it has leapt since anybody contradicted; the first leap.
        self._heard: IntArray = np.full(len(self.points), NEVER, dtype=np.int64)
        self._leapt: BoolArray = np.zeros(len(self.points), dtype=np.bool_)
        self._first_ahead: int = 0
        self._forget()

    def _forget(self) -> None:
        self._ticks: IntArray = np.empty(0, dtype=np.int64)
        self._values: FloatArray = np.empty((0, len(self.points)))
        self._times: IntArray = np.empty((0, len(self.points)), dtype=np.int64)

    def add(self, batch: Batch) -> Frames:
        """Take a batch in; return the frames that it closed."""
        if len(batch) == 0:
            return self._empty()
        point = self._known(batch)
        keep = self._believable(batch.time, point)
        time = batch.time[keep]
        point, value, quality = point[keep], batch.value[keep], batch.quality[keep]
        if len(time) == 0:
            return self._empty()
        tick = -(-time // self.step)
        late = self._late(time, tick)
        good = (quality != Quality.BAD) & np.isfinite(value)
        known = point >= 0
        self.counts["unknown_point"] += int((~known).sum())
        self.counts["late"] += int((known & late).sum())
        self.counts["no_value"] += int((known & ~late & ~good).sum())
        use = known & ~late & good
        self._fill(tick[use], point[use], time[use], value[use])
        self._advance(int(time.max()))
        return self._close(self._last_complete())

    def flush(self) -> Frames:
        """Close every open frame: the stream has ended."""
        return self._close(int(self._ticks[-1]) if len(self._ticks) else NEVER)

    def _known(self, batch: Batch) -> IntArray:
        table = np.array([self._index.get(name, -1) for name in batch.names], dtype=np.int64)
        return table[batch.point] if len(table) else np.full(len(batch), -1, dtype=np.int64)

    def _believable(self, time: IntArray, point: IntArray) -> BoolArray:
        """Mask of samples that are not a lone leap into the future."""
        before = time[0] if self._watermark is None else self._watermark
        running = np.maximum.accumulate(np.concatenate([[before], time]))[:-1]
        keep = np.ones(len(time), dtype=bool)
        if self._ahead == 0 and not (time > running + self.max_jump).any():
            self._hear(time, point)
            return keep
        watermark = int(before)
        for i, (t, p) in enumerate(zip(time.tolist(), point.tolist(), strict=True)):
            if t <= watermark + self.max_jump:
                self._ahead = 0
                watermark = max(watermark, t)
            elif self._confirmed(t, p, watermark):
                self._ahead = 0
                watermark = t
            else:
                keep[i] = False
                self.counts["clock_jump"] += 1
                continue
            self._hear(time[i : i + 1], point[i : i + 1])
        return keep

    def _hear(self, time: IntArray, point: IntArray) -> None:
        known = point >= 0
        np.maximum.at(self._heard, point[known], time[known])

    def _confirmed(self, time: int, point: int, watermark: int) -> bool:
        """Whether a leap to ``time`` is one of the whole plant, this sample included."""
        if point < 0:
            return False
        if self._ahead == 0:
            self._leapt[:] = False
            self._first_ahead = time
        self._ahead += 1
        self._leapt[point] = True
        alive = self._heard > watermark - self.max_jump
        most = 2 * int((self._leapt & alive).sum()) > int(alive.sum())
        return self._ahead >= CONFIRMATIONS and (most or abs(time - self._first_ahead) >= STEPS_ALONE * self.step)

    def turn_back(self, time: int) -> None:
        """Go on from an earlier time [ns]: what was seen after it is forgotten, and may come again."""
        self._watermark, self._ahead = time, 0
        self._closed = min(self._closed, (time - self.lateness - 1) // self.step)
        self._heard = np.minimum(self._heard, time)
        self._forget()

    def _late(self, time: IntArray, tick: IntArray) -> BoolArray:
        first = time[0] if self._watermark is None else self._watermark
        before = np.maximum.accumulate(np.concatenate([[first], time]))[:-1]
        closed = np.maximum((before - self.lateness - 1) // self.step, self._closed)
        if self._watermark is None:
            closed[:1] = NEVER
        late: BoolArray = tick <= closed
        return late

    def _fill(self, tick: IntArray, point: IntArray, time: IntArray, value: FloatArray) -> None:
        """Put each slot's newest value in; a sample that is not newer than its slot is a duplicate."""
        self._make_room(tick)
        row = np.searchsorted(self._ticks, tick)
        order = np.lexsort((np.arange(len(tick)), point, row))
        row, point, time, value = row[order], point[order], time[order], value[order]
        slot = row * len(self.points) + point
        # One running maximum serves all slots, because a later slot's keys are larger than any of an earlier one.
        rank = np.cumsum(np.diff(slot, prepend=slot[:1]) > 0)
        key = rank * (self.step + 1) + (time - (self._ticks[row] - 1) * self.step)
        before = np.maximum.accumulate(np.concatenate([[-1], key]))[:-1]
        stale = (key <= before) | (time <= self._times[row, point])
        self.counts["duplicate"] += int(stale.sum())
        self.counts["accepted"] += int((~stale).sum())
        row, point, time, value = row[~stale], point[~stale], time[~stale], value[~stale]
        self._values[row, point] = value  # in order of arrival within a slot: the last, which is the newest, stays
        self._times[row, point] = time

    def _make_room(self, tick: IntArray) -> None:
        ticks = np.union1d(self._ticks, tick)
        if len(ticks) == len(self._ticks):
            return
        values = np.full((len(ticks), len(self.points)), np.nan)
        times = np.full((len(ticks), len(self.points)), NEVER, dtype=np.int64)
        old = np.searchsorted(ticks, self._ticks)
        values[old], times[old] = self._values, self._times
        self._ticks, self._values, self._times = ticks, values, times

    def _advance(self, time: int) -> None:
        self._watermark = time if self._watermark is None else max(self._watermark, time)

    def _last_complete(self) -> int:
        return self._closed if self._watermark is None else (self._watermark - self.lateness - 1) // self.step

    def _close(self, upto: int) -> Frames:
        self._closed = max(self._closed, upto)
        n = int(np.searchsorted(self._ticks, upto, side="right"))
        closed = Frames(self._ticks[:n] * self.step, self._values[:n])
        self._ticks, self._values, self._times = self._ticks[n:], self._values[n:], self._times[n:]
        return closed

    def _empty(self) -> Frames:
        return Frames(np.empty(0, dtype=np.int64), np.empty((0, len(self.points))))

    def export_state(self) -> JsonObject:
        """Open frames, watermark and counts as plain data."""
        return {
            "points": list(self.points),
            "watermark": self._watermark,
            "closed": int(self._closed),
            "ahead": self._ahead,
            "heard": self._heard.copy(),
            "leapt": self._leapt.copy(),
            "first_ahead": self._first_ahead,
            "counts": dict(self.counts),
            "ticks": self._ticks.copy(),
            "values": self._values.copy(),
            "times": self._times.copy(),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood; points new since then start empty."""
        self._watermark = state["watermark"]
        self._closed = int(state["closed"])
        self._ahead = int(state["ahead"])
        self.counts.update(state["counts"])
        self._forget()
        self._make_room(np.asarray(state["ticks"], dtype=np.int64))
        old = np.array([self._index.get(name, -1) for name in state["points"]], dtype=np.int64)
        kept = old >= 0
        self._values[:, old[kept]] = np.asarray(state["values"])[:, kept]
        self._times[:, old[kept]] = np.asarray(state["times"])[:, kept]
        self._first_ahead = int(state.get("first_ahead", 0))
        if "heard" in state:
            self._heard[old[kept]] = np.asarray(state["heard"], dtype=np.int64)[kept]
            self._leapt[old[kept]] = np.asarray(state["leapt"], dtype=np.bool_)[kept]
