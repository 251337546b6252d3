"""Reference values for a baseline that is itself uncertain: the promised rate on average over the baseline's error.

An error of the baseline shifts the mean of what a CUSUM is fed, for good. With the shift normal with variance v, so
much is added to the reference value that the false-alarm rate averaged over the shift is that of a chart without one.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fdd.records import FloatArray

STEP, LAST = 0.02, 3.0  # grid of the shift's standard deviation; beyond the last the result grows in proportion
_SD = np.arange(0.0, LAST + STEP / 2, STEP)
_X = np.linspace(-6.0, 6.0, 121)
_WEIGHTS = np.exp(-0.5 * _X * _X) / np.exp(-0.5 * _X * _X).sum()


def siegmund_rate(drift: FloatArray, limit: FloatArray | float) -> FloatArray:
    """False alarms an update of a one-sided CUSUM on values with mean ``-drift`` against its reference value.

    Siegmund, D. (1985), Sequential Analysis, eq. 2.56: the limit moved out by 1.166 for the overshoot.
    """
    b = np.asarray(limit) + 1.166
    y = 2.0 * drift * b
    small = np.abs(y) < 1e-3
    safe = np.where(small, 1.0, np.clip(y, -700.0, 700.0))
    length = np.where(small, 0.5 + y / 6.0, (np.expm1(safe) - safe) / (safe * safe)) * 2.0 * b * b
    return np.asarray(1.0 / np.maximum(length, 1.0))


def widened(limit: ArrayLike, k: ArrayLike, variance: ArrayLike) -> FloatArray:
    """Limits of CUSUMs whose values have a scale that is itself uncertain.

    Rates fall as exp(-2 k h / v) with the values' variance v (Siegmund 1985, eq. 2.56). A relative error of v that is
    normal with this ``variance`` s^2 multiplies their mean by exp(2 (k h s)^2), which k h^2 s^2 more of a limit undoes
    (4 to 7 % too much at s = 0.06, 11 to 19 % at 0.1).
    Arguments are scalars or of one shape (n,).
    """
    h = np.asarray(limit, dtype=np.float64)
    return np.asarray(h * (1.0 + np.asarray(k) * h * np.asarray(variance)))


class Uncertainty:
    """What to add to the reference values of CUSUMs, by their limits.

    Parameters
    ----------
    limit : shape (n,), decision intervals
    k : shape (n,) or scalar, reference values while the baseline is known
    """

    def __init__(self, limit: ArrayLike, k: ArrayLike) -> None:
        h = np.array(limit, dtype=np.float64, ndmin=1)
        pairs = np.stack([h, np.broadcast_to(np.asarray(k, dtype=np.float64), h.shape)], axis=1)
        unique, back = np.unique(pairs, axis=0, return_inverse=True)
        rows = [_extra(float(a), float(b)) for a, b in unique]
        self._table = np.round(np.reshape(rows, (len(unique), _SD.size)), 6)
        self._row = back.reshape(-1)

    def extra(self, variance: FloatArray, which: ArrayLike | None = None) -> FloatArray:
        """Additions to k, the shape of ``variance`` (n,) of the shifts [squared standard deviations of a value].

        ``which`` : streams that the variances belong to; all by default.
        """
        sd = np.sqrt(np.maximum(variance, 0.0))
        rows = self._row if which is None else self._row[np.asarray(which)]
        at = np.minimum(sd, LAST) / STEP
        low = np.minimum(at.astype(np.int64), self._table.shape[1] - 2)
        left, right = self._table[rows, low], self._table[rows, low + 1]
        return np.asarray((left + (right - left) * (at - low)) * np.maximum(1.0, sd / LAST))


@lru_cache(maxsize=1024)
def _extra(limit: float, k: float) -> FloatArray:
    """By bisection: the mean over the shift of the two sides' rates equals the rate without a shift."""
    wanted = float(siegmund_rate(np.array(k), limit))
    low, high = np.zeros_like(_SD), 7.0 * _SD
    for _ in range(50):
        middle = 0.5 * (low + high)
        rate = siegmund_rate(k + middle[:, None] - _SD[:, None] * _X, limit) @ _WEIGHTS
        low, high = np.where(rate > wanted, middle, low), np.where(rate > wanted, high, middle)
    return np.asarray(high)
