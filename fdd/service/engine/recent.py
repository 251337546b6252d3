"""What the last days said of every component, kept for diagnosis: sums by the quarter of a day, and hourly means.

Charts answer whether something has changed. To tell what, the engine remembers for ten days the sums of scores and
informations, the sums of the innovations and their largest single jump. For what a fault costs it remembers the hourly
means of the last day.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.diagnosis.departure import Departure, Operation
from fdd.records import NANOSECONDS, FloatArray, IntArray, JsonObject
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.baseline_uncertainty import baseline_covariance, spread_of

BLOCK = 6 * 3600 * NANOSECONDS
BLOCKS = 40
HOUR = 3600 * NANOSECONDS
HOURS = 24
# The first sample this far off is a jump: it is kept as such, and says nothing of a parameter.
JUMP = 8.0
# What is further off than this is a broken signal.
LARGEST = 100.0
NEVER = -1
SUMS = ("score", "information", "sum", "count", "peak")


class RecentGroup:
    """The remembered sums of one filter group; every array is (n, BLOCKS, ...)."""

    def __init__(self, group: FilterGroup) -> None:
        self.group = group
        self._physical = group.physical
        n, p, y = len(group.components), len(self._physical), len(group.model.outputs)
        self._block = np.full(BLOCKS, NEVER, dtype=np.int64)
        self._score = np.zeros((n, BLOCKS, p))
        self._information = np.zeros((n, BLOCKS, p, p))
        self._sum = np.zeros((n, BLOCKS, y))
        self._count = np.zeros((n, BLOCKS, y))
        self._peak = np.zeros((n, BLOCKS, y))
        self._far = np.zeros(n, dtype=np.bool_)

    def update(self, time: int, step: GroupStep) -> None:
        """Take one frame."""
        slot = self._slot(time)
        z = np.clip(np.nan_to_num(step.standardised), -LARGEST, LARGEST)
        seen = np.isfinite(step.standardised)
        size = np.abs(z).max(axis=1, initial=0.0)
        jumped = (size > JUMP) & ~self._far
        self._far = np.where(seen.any(axis=1), size > JUMP, self._far)
        calm = step.charted & ~jumped & (size < LARGEST)
        self._sum[:, slot] += np.where(jumped[:, None], 0.0, z)
        self._count[:, slot] += seen & ~jumped[:, None]
        self._peak[:, slot] = np.where(np.abs(z) > np.abs(self._peak[:, slot]), z, self._peak[:, slot])
        score = step.score[:, self._physical]
        information = step.information[:, self._physical[:, None], self._physical]
        calm &= np.isfinite(score).all(axis=1) & np.isfinite(information).all(axis=(1, 2))
        self._score[calm, slot] += score[calm]
        self._information[calm, slot] += information[calm]

    def _slot(self, time: int) -> int:
        block = time // BLOCK
        slot = int(block % BLOCKS)
        if self._block[slot] != block:
            self._block[slot] = block
            for sums in self._sums():
                sums[:, slot] = 0.0
        return slot

    def _sums(self) -> Sequence[FloatArray]:
        return [getattr(self, f"_{name}") for name in SUMS]

    def forget(self, rows: Sequence[int]) -> None:
        """What these components did so far is not their present."""
        for sums in self._sums():
            sums[list(rows)] = 0.0

    def departure(self, row: int, since: int, now: int) -> Departure:
        """What has been seen of a component since an onset."""
        first, last = since // BLOCK, now // BLOCK
        # The block of the onset is half healthy, and a jump in it disturbs every parameter.
        settled = first + 1 if last > first + 2 else first
        recent = (self._block >= settled) & (self._block <= last)
        near = (self._block >= first - 1) & (self._block <= first + 4) & (self._block <= last)
        baseline, parameters = self.group.baselines[row], self.group.model.parameters
        symbols = [parameters[i].symbol for i in self._physical]
        peaks = np.where(near[:, None], self._peak[row], 0.0)
        largest = np.abs(peaks).argmax(axis=0)
        return Departure(
            symbols=tuple(symbols),
            values=np.array([baseline.parameters[s] for s in symbols]),
            score=self._score[row, recent].sum(axis=0),
            information=self._information[row, recent].sum(axis=0),
            spread=spread_of(baseline, symbols),
            baseline=baseline_covariance(self.group, baseline),
            outputs=tuple(q.symbol for q in self.group.model.outputs),
            innovation=self._sum[row, recent].sum(axis=0),
            count=self._count[row, recent].sum(axis=0),
            jump=np.take_along_axis(peaks, largest[None, :], axis=0)[0],
        )

    def export_state(self) -> JsonObject:
        """Plain data."""
        sums = {k: a.copy() for k, a in zip(SUMS, self._sums(), strict=True)}
        return {"block": self._block.copy(), "far": self._far.copy(), **sums}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._block = np.array(state["block"], dtype=np.int64)
        self._far = np.array(state["far"], dtype=np.bool_)
        for name, sums in zip(SUMS, self._sums(), strict=True):
            sums[...] = np.asarray(state[name])


class Hours:
    """Hourly means of a frame's columns over the last day."""

    def __init__(self, columns: int) -> None:
        self._hour = np.full(HOURS, NEVER, dtype=np.int64)
        self._sum = np.zeros((HOURS, columns))
        self._count = np.zeros((HOURS, columns))

    def update(self, time: int, values: FloatArray) -> None:
        """Take one frame, shape (columns,)."""
        hour = time // HOUR
        slot = int(hour % HOURS)
        if self._hour[slot] != hour:
            self._hour[slot] = hour
            self._sum[slot], self._count[slot] = 0.0, 0.0
        good = np.isfinite(values)
        self._sum[slot, good] += values[good]
        self._count[slot, good] += 1.0

    def means(self, now: int, columns: IntArray) -> FloatArray:
        """Rows of the hours of the last day in which every one of these columns was seen, (hours, n)."""
        kept = (self._hour > now // HOUR - HOURS) & (self._hour <= now // HOUR)
        count = self._count[np.ix_(kept, columns)]
        full = (count > 0).all(axis=1)
        return np.asarray(self._sum[np.ix_(kept, columns)][full] / count[full])

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {"hour": self._hour.copy(), "sum": self._sum.copy(), "count": self._count.copy()}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._hour = np.array(state["hour"], dtype=np.int64)
        self._sum, self._count = np.array(state["sum"]), np.array(state["count"])


class Recent:
    """All that is remembered of a site's components."""

    def __init__(self, groups: Sequence[FilterGroup], columns: Sequence[str]) -> None:
        self._groups = [RecentGroup(g) for g in groups]
        self._hours = Hours(len(columns))
        self._column = {name: i for i, name in enumerate(columns)}
        self._at = {c.name: (g, i) for g in self._groups for i, c in enumerate(g.group.components)}

    def update(self, time: int, values: FloatArray, steps: Sequence[GroupStep]) -> None:
        """Take one frame."""
        self._hours.update(time, values)
        for group, step in zip(self._groups, steps, strict=True):
            group.update(time, step)

    def departure(self, component: str, since: int, now: int) -> Departure:
        """What has been seen of a component since an onset [ns]."""
        group, row = self._at[component]
        return group.departure(row, since, now)

    def operation(self, component: str, now: int) -> Operation:
        """How a component was run over the last day."""
        group, row = self._at[component]
        c, model = group.group.components[row], group.group.model
        symbols = (*(q.symbol for q in model.inputs), *(q.symbol for q in model.outputs))
        rows = self._hours.means(now, np.array([self._column[p] for p in (*c.inputs, *c.outputs)], dtype=np.int64))
        return Operation({s: rows[:, j] for j, s in enumerate(symbols)})

    def forget(self, component: str) -> None:
        """An operator has cleared the component's alarm, or its baseline is another."""
        if component in self._at:
            group, row = self._at[component]
            group.forget([row])

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {"groups": [g.export_state() for g in self._groups], "hours": self._hours.export_state()}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        for group, saved in zip(self._groups, state["groups"], strict=True):
            group.restore_state(saved)
        self._hours.restore_state(state["hours"])
