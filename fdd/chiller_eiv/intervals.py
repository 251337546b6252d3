"""Standard errors and confidence intervals: sandwich for fixed k, delete-group jackknife for the capped estimator.

Field points are not independent (RP-1139 reports 300 of them to be worth about 20), so groups are whole days. A
percentile bootstrap under-covers at n = 30 and is not offered.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from fdd.chiller_eiv.estimators import Estimator, choose_k, normal_equations, solve
from fdd.chiller_eiv.moments import Moments, Terms
from fdd.records import FloatArray, IntArray


def sandwich(terms: Terms, beta: FloatArray, k: float) -> FloatArray:
    """Covariance of an estimate of one machine with fixed k, points independent, shape (p, p).

    A^-1 (sum g g') A^-1 n / (n - p), with g = x e - k (C_xy - C_xx beta) of each point.
    """
    z, C = terms.z, terms.C
    n, p = len(z), z.shape[1] - 1
    e = z[:, 0] - z[:, 1:] @ beta
    g = z[:, 1:] * e[:, None] - k * (C[:, 1:, 0] - C[:, 1:, 1:] @ beta)
    A = z[:, 1:].T @ z[:, 1:] - k * C[:, 1:, 1:].sum(0)
    return np.asarray(_bread(A, g.T @ g) * n / max(n - p, 1))


def cluster_sandwich(groups: Moments, beta: FloatArray, k: FloatArray) -> FloatArray:
    """Covariance with points of one group allowed to depend on one another, shape (..., p, p).

    Parameters
    ----------
    groups : moments with the groups on the last leading axis, shape (..., G)
    beta : shape (..., p)
    k : shape (...)
    """
    A, b = normal_equations(groups, np.asarray(k)[..., None])
    g = b - (A @ beta[..., None, :, None])[..., 0]
    filled = np.maximum((groups.n > 0).sum(-1), 2)
    return np.asarray(_bread(A.sum(-3), np.swapaxes(g, -1, -2) @ g) * (filled / (filled - 1.0))[..., None, None])


def _bread(A: FloatArray, middle: FloatArray) -> FloatArray:
    d = np.sqrt(np.abs(np.diagonal(A, axis1=-2, axis2=-1)))
    d = np.where(d > 0, d, 1.0)
    outer = d[..., :, None] * d[..., None, :]
    inverse = np.linalg.pinv(A / outer, hermitian=True, rcond=1e-15)
    return np.asarray(inverse @ (middle / outer) @ inverse / outer)


def jackknife(groups: Moments, estimator: Estimator = "capped") -> FloatArray:
    """Covariance by leaving out one group at a time, shape (..., p, p); NaN with fewer than two groups filled.

    (G - 1)/G sum (beta_(g) - mean)(beta_(g) - mean)' over the filled groups; k is chosen anew each time.
    """
    leave = groups.without_each()
    beta = solve(leave, choose_k(leave, estimator))
    filled = (groups.n > 0)[..., None]
    G = filled.sum(-2)[..., 0].astype(float)
    mean = np.where(filled, beta, 0.0).sum(-2) / np.maximum(G, 1)[..., None]
    d = np.where(filled, beta - mean[..., None, :], 0.0)
    cov = np.swapaxes(d, -1, -2) @ d * ((G - 1) / np.maximum(G, 1))[..., None, None]
    return np.asarray(np.where((G >= 2)[..., None, None], cov, np.nan))


def standard_errors(covariance: FloatArray) -> FloatArray:
    """Square roots of the diagonal, shape (..., p)."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0)))


def half_width(se: FloatArray, freedom: FloatArray | float, level: float = 0.95) -> FloatArray:
    """Half the width of a two-sided interval with Student's t of ``freedom`` degrees."""
    return np.asarray(se * student.ppf(0.5 + level / 2, np.maximum(freedom, 1.0)))


def groups_of(n: int, groups: int) -> IntArray:
    """Split n points in order into ``groups`` equal groups where there are no days to go by, shape (n,) of indices."""
    return np.asarray(np.minimum(np.arange(n, dtype=np.int64) * groups // max(n, 1), groups - 1))
