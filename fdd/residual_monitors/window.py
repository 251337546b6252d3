"""Charts that test a window of values when it is full: the shared part."""

from __future__ import annotations

from abc import abstractmethod

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import ALARM, CAP, CLIP, LEARNING, NO_DATA, QUIET, Chart, Verdicts

FILLING = ("values", "part", "inside", "filled", "elapsed")
"""State of the window that is being filled: the same in all charts that are fed and reset alike."""


class WindowChart(Chart):
    """Windows side by side, tested one by one; the statistic is held until the next is full.

    A window takes ``window`` values, closing up gaps: white noise with holes closed up is white noise. A value is the
    sum of ``block`` of those seen over the root of their number, white with unit variance as they are, so that a window
    of a day takes little memory at one value a second. The phase is learning until the first window is full. The onset
    is the beginning of the window that alarmed.
    """

    _state = (*FILLING, "held", "pointed", "tested")

    def __init__(self, limit: ArrayLike, *, window: int, block: int = 1) -> None:
        super().__init__(limit)
        if window < 32:
            raise ValueError(f"{self.kind} chart: window is {window}; give at least 32 values")
        if block < 1:
            raise ValueError(f"{self.kind} chart: block is {block}; give at least 1 value")
        self.window, self.block = int(window), int(block)
        self.values = np.zeros((self.n, self.window))
        self.part = np.zeros(self.n)
        self.inside = np.zeros(self.n, dtype=np.int64)
        self.filled = np.zeros(self.n, dtype=np.int64)
        self.elapsed = np.zeros(self.n, dtype=np.int64)
        self.held = np.zeros(self.n)
        self.pointed = np.zeros(self.n, dtype=np.int8)
        self.tested = np.zeros(self.n, dtype=np.int8)

    @abstractmethod
    def _test(self, values: FloatArray, streams: IntArray) -> tuple[FloatArray, FloatArray]:
        """Statistic and its direction for full windows of these streams, (rows, window) -> (rows,), (rows,)."""

    def statistics(self, values: ArrayLike, stream: int = 0) -> FloatArray:
        """Statistic of full windows of one stream without charting them, (rows, window) -> (rows,)."""
        rows = np.ascontiguousarray(values, dtype=np.float64)
        return self._test(rows, np.full(len(rows), stream, dtype=np.int64))[0]

    def _step(self, z: FloatArray) -> Verdicts:
        full = np.flatnonzero(_fill(z, self.block, self.values, self.part, self.inside, self.filled, self.elapsed))
        length = self.elapsed[full]
        if full.size:
            statistic, direction = self._test(self.values[full], full)
            self.held[full] = np.minimum(statistic, CAP * self.limit[full])
            self.pointed[full] = np.sign(direction)
            self.tested[full] = 1
            self.filled[full] = 0
            self.elapsed[full] = 0
        self.onset[self.latched == 1] += 1
        new = full[(self.held[full] > self.limit[full]) & (self.latched[full] == 0)]
        if new.size:
            self.latched[new], self.side[new] = 1, self.pointed[new]
            self.onset[new] = length[np.searchsorted(full, new)]
        alarm = self.latched == 1
        phase = np.where(self.tested == 1, QUIET, LEARNING)
        phase = np.where(alarm, ALARM, np.where(np.isnan(z), NO_DATA, phase)).astype(np.uint8)
        pointed: NDArray[np.int8] = np.where(alarm, self.side, self.pointed).astype(np.int8)
        age: IntArray = self.onset.copy()
        return Verdicts(phase, self.held.copy(), self.limit, pointed, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        for name in self._state:
            getattr(self, name)[rows] = 0


def blocks(values: ArrayLike, block: int) -> FloatArray:
    """What the charts make of the values seen: sums of whole blocks over the root of their length."""
    seen = np.asarray(values, dtype=np.float64)
    whole = seen[: len(seen) // block * block].reshape(-1, block)
    return np.asarray(whole.sum(axis=1) / np.sqrt(block))


@numba.njit(cache=True)
def _fill(
    z: FloatArray,
    block: int,
    values: FloatArray,
    part: FloatArray,
    inside: IntArray,
    filled: IntArray,
    elapsed: IntArray,
) -> NDArray[np.bool_]:
    n, window = values.shape
    full = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        if filled[i] > 0 or inside[i] > 0:
            elapsed[i] += 1
        if np.isnan(z[i]):
            continue
        if filled[i] == 0 and inside[i] == 0:
            elapsed[i] = 1
        part[i] += min(max(z[i], -CLIP), CLIP)
        inside[i] += 1
        if inside[i] == block:
            values[i, filled[i]] = part[i] / np.sqrt(block)
            part[i], inside[i] = 0.0, 0
            filled[i] += 1
            full[i] = filled[i] == window
    return full
