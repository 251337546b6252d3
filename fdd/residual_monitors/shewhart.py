"""Shewhart chart with run rules: large shifts at once, and patterns a technician can see with the naked eye."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import CLIP, Chart, Verdicts, conclude
from fdd.residual_monitors.run_rules import LONGEST, rule_limits


class Shewhart(Chart):
    """One value beyond a limit, or runs of values beyond lower ones.

    The rules are the Western Electric ones (1 value; 2 of 3; 4 of 5; 8 in a row, all on one side) with limits moved out
    until all together keep the promised rate: at their textbook limits they give a false alarm every 92 values. Small
    shifts: ``cusum``.

    Parameters
    ----------
    limit : shape (n,), limit for a single value [standard deviations]
    ratios : shape (4,) or (n, 4), limits of the rules over ``limit``; the first is 1, a rule of ratio infinity is off.
        :meth:`design` chooses them so that each rule alone gives about the same share of false alarms.

    Notes
    -----
    The statistic is the largest of the four rules' values over its ratio. A rule looks at values seen, across gaps.

    References
    ----------
    Champ, C. W., Woodall, W. H. (1987), Technometrics 29, 393-399. Western Electric (1956), Statistical Quality Control
    Handbook.
    """

    kind = "shewhart"
    _state = ("recent", "filled", "age")

    def __init__(self, limit: ArrayLike, *, ratios: ArrayLike = (1.0, 2 / 3, 1 / 3, np.inf), learn: int = 0) -> None:
        super().__init__(limit, learn=learn)
        grid = np.array(ratios, dtype=np.float64)
        if grid.shape not in ((4,), (self.n, 4)) or not np.all(grid > 0) or not np.all(grid[..., 0] == 1):
            raise ValueError(f"shewhart chart: ratios must be 4 positive numbers a stream, the first 1; got {ratios!r}")
        self.ratios = np.ascontiguousarray(np.broadcast_to(grid, (self.n, 4)))
        self.recent = np.zeros((self.n, LONGEST))
        self.filled = np.zeros(self.n, dtype=np.int64)
        self.age = np.zeros(self.n, dtype=np.int64)

    @classmethod
    def design(cls, arl: ArrayLike, *, rules: tuple[bool, bool, bool, bool] = (True,) * 4, learn: int = 0) -> Shewhart:
        """A chart with these mean numbers of updates between false alarms, of all rules together."""
        wanted = np.array(arl, dtype=np.float64, ndmin=1)
        unique, back = np.unique(wanted, return_inverse=True)
        limits = np.array([rule_limits(float(a), rules) for a in unique])[back]
        return cls(limits[:, 0], ratios=limits / limits[:, :1], learn=learn)

    def _step(self, z: FloatArray) -> Verdicts:
        phase, statistic, direction, age = _shewhart(
            z, self.limit, self.ratios, self.recent, self.filled, self.age, self.latched, self.side, self.onset
        )
        return Verdicts(phase, statistic, self.limit, direction, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        self.recent[rows] = 0.0
        self.filled[rows] = 0
        self.age[rows] = 0


@numba.njit(cache=True)
def _second(a: float, b: float, c: float, d: float, e: float) -> float:
    """Second smallest of five."""
    first, second = min(a, b), max(a, b)
    for x in (c, d, e):
        second = min(second, max(first, x))
        first = min(first, x)
    return second


@numba.njit(cache=True)
def _strength(x: FloatArray, ratios: FloatArray) -> float:
    """Largest of the rules' values on the upper side, each over its ratio; ``x`` newest first."""
    two = max(min(x[0], x[1]), min(max(x[0], x[1]), x[2]))
    four = _second(x[0], x[1], x[2], x[3], x[4])
    run = x[0]
    for m in range(1, LONGEST):
        run = min(run, x[m])
    return float(max(max(x[0], two / ratios[1]), max(four / ratios[2], run / ratios[3])))


@numba.njit(cache=True)
def _shewhart(
    z: FloatArray,
    limit: FloatArray,
    ratios: FloatArray,
    recent: FloatArray,
    filled: IntArray,
    age: IntArray,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.int8], IntArray]:
    n = z.shape[0]
    phase = np.empty(n, dtype=np.uint8)
    statistic = np.empty(n)
    direction = np.empty(n, dtype=np.int8)
    since = np.empty(n, dtype=np.int64)
    x = np.empty(LONGEST)
    for i in range(n):
        seen = not np.isnan(z[i])
        before = recent[i, 0]
        if seen:
            for m in range(LONGEST - 1, 0, -1):
                recent[i, m] = recent[i, m - 1]
            recent[i, 0] = min(max(z[i], -CLIP), CLIP)
            filled[i] = min(filled[i] + 1, LONGEST)
        # Values not yet seen are zeros: they lie inside every rule's limit.
        for m in range(LONGEST):
            x[m] = recent[i, m]
        up = _strength(x, ratios[i])
        for m in range(LONGEST):
            x[m] = -recent[i, m]
        down = _strength(x, ratios[i])
        statistic[i] = max(up, down, 0.0)
        sign = 0 if filled[i] == 0 else (1 if up >= down else -1)
        if not seen:
            age[i] = age[i] + 1 if age[i] > 0 else 0
        else:
            age[i] = age[i] + 1 if before * recent[i, 0] > 0 else 1
        phase[i], direction[i], since[i] = conclude(i, seen, statistic[i], sign, age[i], limit[i], latched, side, onset)
    return phase, statistic, direction, since
