"""Multivariate EWMA: a small shift spread over several outputs of one component."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import CAP, CLIP, Chart, Feed, Verdicts, conclude
from fdd.residual_monitors.run_length import limit_for


class Mewma(Chart):
    r"""Squared length of a smoothed vector of standardised innovations.

    For a component with several outputs, when a fault moves them together. One output: ``ewma``. The values must be
    uncorrelated within a vector, as those of sequential measurement updates are.

    Equations
        .. math:: s_t = (1 - \lambda) s_{t-1} + \lambda z_t, \quad T^2_t = \frac{2 - \lambda}{\lambda} s_t^T s_t > H

        A missing element holds its own smoothed value. The onset is where T^2 was last at or below its mean, the
        dimension.

    Parameters
    ----------
    limit : shape (n,), H on the squared distance
    dimension : outputs a stream
    lam : weight of the newest value, (0, 1]

    References
    ----------
    Lowry, C. A., Woodall, W. H., Champ, C. W., Rigdon, S. E. (1992), Technometrics 34, 46-53.
    """

    kind = "mewma"
    feed = Feed.VECTORS
    _state = ("average", "age")

    def __init__(self, limit: ArrayLike, *, dimension: int = 2, lam: float = 0.1) -> None:
        super().__init__(limit)
        if dimension < 1 or not 0 < lam <= 1:
            raise ValueError(f"mewma chart: dimension {dimension} must be 1 or more and lam {lam} in (0, 1]")
        self.dimension, self.lam = int(dimension), float(lam)
        self.average = np.zeros((self.n, self.dimension))
        self.age = np.zeros(self.n, dtype=np.int64)

    @classmethod
    def design(cls, arl: ArrayLike, *, dimension: int = 2, lam: float = 0.1) -> Mewma:
        """A chart with these mean numbers of updates between false alarms."""
        return cls(limit_for("mewma", arl, lam=lam, dimension=dimension), dimension=dimension, lam=lam)

    @property
    def _shape(self) -> tuple[int, ...]:
        return (self.n, self.dimension)

    def _step(self, z: FloatArray) -> Verdicts:
        phase, statistic, direction, age = _mewma(
            z, self.lam, self.limit, self.average, self.age, self.latched, self.side, self.onset
        )
        return Verdicts(phase, statistic, self.limit, direction, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        self.average[rows] = 0.0
        self.age[rows] = 0


@numba.njit(cache=True)
def _mewma(
    z: FloatArray,
    lam: float,
    limit: FloatArray,
    average: FloatArray,
    age: IntArray,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.int8], IntArray]:
    n, dimension = z.shape
    phase = np.empty(n, dtype=np.uint8)
    statistic = np.empty(n)
    direction = np.empty(n, dtype=np.int8)
    since = np.empty(n, dtype=np.int64)
    for i in range(n):
        seen = False
        square = 0.0
        for j in range(dimension):
            if not np.isnan(z[i, j]):
                seen = True
                average[i, j] = (1 - lam) * average[i, j] + lam * min(max(z[i, j], -CLIP), CLIP)
            square += average[i, j] * average[i, j]
        statistic[i] = (2 - lam) / lam * square
        if statistic[i] > CAP * limit[i]:
            shrink = np.sqrt(CAP * limit[i] / statistic[i])
            for j in range(dimension):
                average[i, j] *= shrink
            statistic[i] = CAP * limit[i]
        age[i] = age[i] + 1 if statistic[i] > dimension else 0
        phase[i], direction[i], since[i] = conclude(i, seen, statistic[i], 0, age[i], limit[i], latched, side, onset)
    return phase, statistic, direction, since
