"""Normalised innovation squared: innovations larger, or smaller, than the filter says they should be."""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtr, chdtrc, ndtri

from fdd.records import FloatArray
from fdd.residual_monitors.chart import Feed, Verdicts
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.run_length import limit_for

_OCTAVES = (-14, 6)
_PER_OCTAVE = 64
MOST = 8.0
"""Normal scores are held within this many standard deviations."""


class Nis(Cusum):
    r"""Two-sided CUSUM on the normal score of a vector's squared length.

    Watches the spread of the innovations instead of their mean: a noisier sensor, a hunting valve, a filter whose noise
    parameters no longer hold (up), a frozen signal (down). Shifts of the mean: ``cusum`` or ``mewma``.

    Equations
        .. math:: d_t = z_t^T z_t \sim \chi^2_m, \quad x_t = \Phi^{-1}(F_{\chi^2_m}(d_t))

        with m the number of elements seen; x is exactly standard normal, so that the limits of the CUSUM hold for any
        m, also one that changes. Direction +1: too large.

    Parameters
    ----------
    limit, k, head_start : see :class:`Cusum`
    dimension : outputs a stream

    References
    ----------
    Bar-Shalom, Y., Li, X. R., Kirubarajan, T. (2001), Estimation with Applications to Tracking and Navigation, 5.4.
    """

    kind = "nis"
    feed = Feed.VECTORS

    def __init__(self, limit: ArrayLike, *, dimension: int = 2, k: ArrayLike = 0.5, head_start: float = 0.0) -> None:
        super().__init__(limit, k=k, head_start=head_start)
        if not 1 <= dimension <= 64:
            raise ValueError(f"nis chart: dimension is {dimension}; give 1 to 64 outputs")
        self.dimension = int(dimension)
        self._table = normal_scores(self.dimension)

    @classmethod
    def design(  # type: ignore[override]  # a sibling's options
        cls, arl: ArrayLike, *, dimension: int = 2, k: float = 0.5, head_start: float = 0.0
    ) -> Nis:
        """A chart with these mean numbers of updates between false alarms."""
        limit = limit_for("cusum", arl, k=k, head_start=head_start)
        return cls(limit, dimension=dimension, k=k, head_start=head_start)

    @property
    def _shape(self) -> tuple[int, ...]:
        return (self.n, self.dimension)

    def _step(self, z: FloatArray) -> Verdicts:
        return super()._step(_scores(z, self._table))


@lru_cache(maxsize=64)
def normal_scores(dimension: int) -> FloatArray:
    """Normal score of a squared length at equal steps of its logarithm, (dimension, steps); row m - 1 for m seen."""
    low, high = _OCTAVES
    d = 2.0 ** np.linspace(low, high, (high - low) * _PER_OCTAVE + 1)
    dof = np.arange(1, dimension + 1)[:, None]
    below, above = chdtr(dof, d), chdtrc(dof, d)
    scores = np.where(below < 0.5, ndtri(below), -ndtri(above))
    return np.ascontiguousarray(np.clip(scores, -MOST, MOST))


@numba.njit(cache=True)
def _scores(z: FloatArray, table: FloatArray) -> FloatArray:
    n, dimension = z.shape
    last = table.shape[1] - 1
    out = np.full(n, np.nan)
    for i in range(n):
        square, seen = 0.0, 0
        for j in range(dimension):
            if not np.isnan(z[i, j]):
                square += z[i, j] * z[i, j]
                seen += 1
        if seen == 0:
            continue
        at = (np.log2(max(square, 1e-300)) - _OCTAVES[0]) * _PER_OCTAVE
        at = min(max(at, 0.0), float(last))
        left = min(int(at), last - 1)
        out[i] = table[seen - 1, left] + (at - left) * (table[seen - 1, left + 1] - table[seen - 1, left])
    return out
