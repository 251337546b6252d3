"""Exponentially weighted moving average: small lasting shifts, and a picture people read easily."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import CAP, CLIP, Chart, Verdicts, conclude
from fdd.residual_monitors.run_length import limit_for


class Ewma(Chart):
    r"""A smoothed value against the limits of its own standard deviation.

    Much like a CUSUM with a small reference value; slower to turn after having wandered the other way (inertia).

    Equations
        .. math:: s_t = (1 - \lambda) s_{t-1} + \lambda z_t, \quad |s_t| > L \sqrt{\lambda / (2 - \lambda)}

        With ``exact`` the variance of the first values is taken as it is, times 1 - (1 - lambda)^(2t), which finds
        early shifts sooner. The statistic is |s_t| in its standard deviations; the onset is where s last changed sign.

    Parameters
    ----------
    limit : shape (n,), L
    lam : weight of the newest value, (0, 1]; 0.05 to 0.25 is usual
    exact : limits that open with the variance, from the start and after a reset
    learn : see :class:`Chart`

    References
    ----------
    Roberts, S. W. (1959), Technometrics 1, 239-250. Lucas, J. M., Saccucci, M. S. (1990), Technometrics 32, 1-12.
    """

    kind = "ewma"
    _state = ("average", "steps", "age")

    def __init__(self, limit: ArrayLike, *, lam: float = 0.1, exact: bool = False, learn: int = 0) -> None:
        super().__init__(limit, learn=learn)
        if not 0 < lam <= 1:
            raise ValueError(f"ewma chart: lam is {lam}; give a weight above 0 and up to 1")
        self.lam, self.exact = float(lam), bool(exact)
        self.average = np.zeros(self.n)
        self.steps = np.zeros(self.n, dtype=np.int64)
        self.age = np.zeros(self.n, dtype=np.int64)

    @classmethod
    def design(cls, arl: ArrayLike, *, lam: float = 0.1, exact: bool = False, learn: int = 0) -> Ewma:
        """A chart with these mean numbers of updates between false alarms."""
        return cls(limit_for("ewma", arl, lam=lam, exact=exact), lam=lam, exact=exact, learn=learn)

    def _step(self, z: FloatArray) -> Verdicts:
        phase, statistic, direction, age = _ewma(
            z, self.lam, self.exact, self.limit, self.average, self.steps, self.age, self.latched, self.side, self.onset
        )
        return Verdicts(phase, statistic, self.limit, direction, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        self.average[rows] = 0.0
        self.steps[rows] = 0
        self.age[rows] = 0


@numba.njit(cache=True)
def _ewma(
    z: FloatArray,
    lam: float,
    exact: bool,
    limit: FloatArray,
    average: FloatArray,
    steps: IntArray,
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
    settled = np.sqrt(lam / (2 - lam))
    for i in range(n):
        seen = not np.isnan(z[i])
        before = average[i]
        if seen:
            value = (1 - lam) * before + lam * min(max(z[i], -CLIP), CLIP)
            most = CAP * limit[i] * settled
            average[i] = min(max(value, -most), most)
            steps[i] += 1
        age[i] = age[i] + 1 if before * average[i] > 0 else (1 if average[i] != 0 else 0)
        sd = settled
        if exact and steps[i] > 0:
            sd = settled * np.sqrt(1 - (1 - lam) ** (2.0 * steps[i]))
        statistic[i] = abs(average[i]) / sd
        sign = 1 if average[i] > 0 else (-1 if average[i] < 0 else 0)
        phase[i], direction[i], since[i] = conclude(i, seen, statistic[i], sign, age[i], limit[i], latched, side, onset)
    return phase, statistic, direction, since
