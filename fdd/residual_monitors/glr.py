"""Generalised likelihood ratio: a jump of unknown size at an unknown time, and when it came."""

from __future__ import annotations

from itertools import pairwise

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import CAP, CLIP, Chart, Verdicts, conclude
from fdd.residual_monitors.scan import scan_limit

WINDOWS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)


class Glr(Chart):
    r"""Largest standardised sum over the last 1, 2, 3 ... values.

    Good at every size of jump, best at none; dates the jump. A shift of known size: ``cusum``; slow drifts outlast its
    longest window: ``ewma`` or a ``cusum`` with small k.

    Equations
        .. math:: g_t = \max_{w} \left| \sum_{i=t-w+1}^{t} z_i \right| / \sqrt{w}

        twice the log-likelihood ratio of a jump w values ago is g squared. Windows grow by steps of about a third,
        which loses less than a tenth of g.

    Parameters
    ----------
    limit : shape (n,), on g
    windows : lengths looked at, rising
    learn : see :class:`Chart`

    References
    ----------
    Willsky, A. S., Jones, H. L. (1976), IEEE Trans. Autom. Control 21, 108-112. Siegmund, D., Venkatraman, E. S.
    (1995), Annals of Statistics 23, 255-271.
    """

    kind = "glr"
    _state = ("sums", "ticks", "filled", "tick", "held", "direction", "back")

    def __init__(self, limit: ArrayLike, *, windows: tuple[int, ...] = WINDOWS, learn: int = 0) -> None:
        super().__init__(limit, learn=learn)
        if not windows or windows[0] < 1 or any(b <= a for a, b in pairwise(windows)):
            raise ValueError(f"glr chart: windows {windows} must be rising and at least 1")
        self.windows = np.array(windows, dtype=np.int64)
        self._roots = 1.0 / np.sqrt(self.windows)
        # Sums of all values so far at the last times, newest at filled mod length; differences are window sums.
        self.sums = np.zeros((self.n, windows[-1] + 1))
        self.ticks = np.zeros((self.n, windows[-1] + 1), dtype=np.int64)
        self.filled = np.zeros(self.n, dtype=np.int64)
        self.tick = np.zeros(self.n, dtype=np.int64)
        self.held = np.zeros(self.n)
        self.direction = np.zeros(self.n, dtype=np.int8)
        self.back = np.zeros(self.n, dtype=np.int64)

    @classmethod
    def design(cls, arl: ArrayLike, *, windows: tuple[int, ...] = WINDOWS, learn: int = 0) -> Glr:
        """A chart with these mean numbers of updates between false alarms."""
        wanted = np.array(arl, dtype=np.float64, ndmin=1)
        unique, back = np.unique(wanted, return_inverse=True)
        return cls(np.array([scan_limit(float(a), windows) for a in unique])[back], windows=windows, learn=learn)

    def _step(self, z: FloatArray) -> Verdicts:
        phase, direction, age = _glr(
            z, self.windows, self._roots, self.limit, self.sums, self.ticks, self.filled, self.tick, self.held,
            self.direction, self.back, self.latched, self.side, self.onset,
        )  # fmt: skip
        return Verdicts(phase, self.held.copy(), self.limit, direction, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        for name in self._state:
            getattr(self, name)[rows] = 0


@numba.njit(cache=True)
def _glr(
    z: FloatArray,
    windows: IntArray,
    roots: FloatArray,
    limit: FloatArray,
    sums: FloatArray,
    ticks: IntArray,
    filled: IntArray,
    tick: IntArray,
    held: FloatArray,
    pointed: NDArray[np.int8],
    back: IntArray,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], NDArray[np.int8], IntArray]:
    n, length = sums.shape
    phase = np.empty(n, dtype=np.uint8)
    direction = np.empty(n, dtype=np.int8)
    age = np.empty(n, dtype=np.int64)
    for i in range(n):
        seen = not np.isnan(z[i])
        tick[i] += 1
        if seen:
            now = filled[i] % length
            new = sums[i, now] + min(max(z[i], -CLIP), CLIP)
            ticks[i, now] = tick[i] - 1  # a window that opens here begins with this update
            filled[i] += 1
            now = filled[i] % length
            sums[i, now] = new
            held[i] = 0.0
            best, best_at = 0.0, now
            for m in range(windows.shape[0]):
                w = windows[m]
                if w > filled[i]:
                    break
                at = now - w if now >= w else now - w + length
                strength = (new - sums[i, at]) * roots[m]
                if abs(strength) > abs(best):
                    best, best_at = strength, at
            held[i] = min(abs(best), CAP * limit[i])
            pointed[i] = 1 if best > 0 else (-1 if best < 0 else 0)
            back[i] = ticks[i, best_at]
        since = tick[i] - back[i] if filled[i] > 0 else 0
        phase[i], direction[i], age[i] = conclude(i, seen, held[i], pointed[i], since, limit[i], latched, side, onset)
    return phase, direction, age
