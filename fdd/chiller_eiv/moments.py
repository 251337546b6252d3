"""Moments of the regression terms and of their errors: M = sum z z' and S = sum C, for one machine or for thousands.

Every estimator of :mod:`fdd.chiller_eiv.estimators` needs nothing but these sums; leaving a day out is subtracting its
sums, holding a parameter is a linear map of them. Four ways to get the error moments S:

``exact``        z_k less 1/2 tr(H_k S); C = J S J' - [1/2 tr(H_k S H_l S)]; unbiased for quadratic terms
``propagation``  C = J S J' (paper, Sec. 5.1, with the right signs)
``calculus``     C = E[z z'] - z z' to second order = J S J' + z b' + b z', b_k = 1/2 tr(H_k S) (Sec. 5.2)
``simulation``   the same difference of moments by antithetic random draws about the measured point (Sec. 5.3)

S_xx and S_xy always come from the same method, and are sums over the samples because M is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fdd.chiller_eiv.forms import Form, derivatives
from fdd.chiller_eiv.model import ChillerError
from fdd.records import FloatArray, IntArray

Method = Literal["exact", "propagation", "calculus", "simulation"]
_CODE = {"propagation": 0, "calculus": 1, "exact": 2}


@dataclass(frozen=True, slots=True)
class Terms:
    """The regression terms of every point and the covariance of their errors.

    Attributes
    ----------
    z : shape (n, q), terms, the left-hand side first
    C : shape (n, q, q), error covariance
    """

    z: FloatArray
    C: FloatArray

    def __len__(self) -> int:
        return len(self.z)


@dataclass(frozen=True, slots=True)
class Moments:
    """Sums over points; any leading shape (machines, groups).

    Attributes
    ----------
    M : shape (..., q, q), sum of z z'
    S : shape (..., q, q), sum of C
    n : shape (...), number of points
    """

    M: FloatArray
    S: FloatArray
    n: IntArray

    def map(self, T: FloatArray) -> Moments:
        """Moments of the terms T z, with T of shape (..., q', q)."""
        Tt = np.swapaxes(T, -1, -2)
        return Moments(T @ self.M @ Tt, T @ self.S @ Tt, self.n)

    def total(self) -> Moments:
        """Sum over the last leading axis (the groups)."""
        return Moments(self.M.sum(-3), self.S.sum(-3), self.n.sum(-1))

    def without_each(self) -> Moments:
        """For groups on the last leading axis, the sums without each group in turn."""
        return Moments(
            self.M.sum(-3, keepdims=True) - self.M,
            self.S.sum(-3, keepdims=True) - self.S,
            self.n.sum(-1, keepdims=True) - self.n,
        )

    def scaled(self, factor: FloatArray | float) -> Moments:
        """The same data with every assumed error variance times ``factor``."""
        return Moments(self.M, self.S * np.asarray(factor)[..., None, None], self.n)


@njit(cache=True)
def _point_covariance(
    J: FloatArray, H: FloatArray, S: FloatArray, quadratic: bool, b: FloatArray, C: FloatArray
) -> None:
    """Write b_k = 1/2 tr(H_k S) and C = J S J' (less 1/2 tr(H_k S H_l S) where ``quadratic``)."""
    q, m = J.shape
    HS = np.zeros((q, m, m))
    JS = np.zeros((q, m))
    for k in range(q):
        b[k] = 0.0
        for a in range(m):
            for d in range(m):
                JS[k, a] += J[k, d] * S[d, a]
                b[k] += 0.5 * H[k, a, d] * S[d, a]
                for f in range(m):
                    HS[k, a, d] += H[k, a, f] * S[f, d]
    for k in range(q):
        for j in range(k + 1):
            t = 0.0
            h = 0.0
            for a in range(m):
                t += JS[k, a] * J[j, a]
                for d in range(m):
                    h += HS[k, a, d] * HS[j, d, a]
            C[k, j] = t - 0.5 * h if quadratic else t
            C[j, k] = C[k, j]


@njit(cache=True)
def _terms(
    coefficients: FloatArray, exponents: NDArray[np.int64], x: FloatArray, cov: FloatArray, code: int
) -> tuple[FloatArray, FloatArray]:
    n, m = x.shape
    q = len(coefficients)
    z = np.empty((n, q))
    C = np.empty((n, q, q))
    J = np.empty((q, m))
    H = np.empty((q, m, m))
    b = np.empty(q)
    for i in range(n):
        derivatives(coefficients, exponents, x[i], z[i], J, H)
        _point_covariance(J, H, cov[i], code == 2, b, C[i])
        if code == 1:
            for k in range(q):
                for j in range(q):
                    C[i, k, j] += z[i, k] * b[j] + b[k] * z[i, j]
        elif code == 2:
            z[i] -= b
    return z, C


def regression_terms(
    form: Form, x: FloatArray, cov: FloatArray, method: Method = "exact", draws: int | None = None, seed: int = 0
) -> Terms:
    """Terms and error covariances of every point.

    Parameters
    ----------
    form : how the model is written
    x : shape (n, m), measurements in the form's order [K, W, 1]
    cov : shape (n, m, m) or (m, m), covariance of their random errors
    method : see the module's text
    draws, seed : for ``simulation`` only; 100 to 2000 draws, fewer for more points, where not given

    Raises
    ------
    ChillerError : on a wrong shape or a value that is not finite
    """
    form.check(x)
    m = len(form.measured)
    cov = np.asarray(cov, dtype=float)
    if cov.shape not in ((m, m), (len(x), m, m)):
        raise ChillerError(f"the error covariance must have shape ({m}, {m}) or ({len(x)}, {m}, {m}); got {cov.shape}")
    if not (np.isfinite(x).all() and np.isfinite(cov).all()):
        raise ChillerError("a measurement or its error covariance is not finite; drop incomplete points first")
    cov = np.ascontiguousarray(np.broadcast_to(cov, (len(x), m, m)))
    x = np.ascontiguousarray(x, dtype=float)
    if method == "simulation":
        return _simulated(form, x, cov, draws or min(2000, max(100, 10**6 // max(len(x), 1))), seed)
    z, C = _terms(form.coefficients, form.exponents, x, cov, _CODE[method])
    return Terms(z, C)


def _simulated(form: Form, x: FloatArray, cov: FloatArray, draws: int, seed: int) -> Terms:
    """Error moments by random draws; each draw is used with both signs, which removes the odd moments' noise."""
    rng = np.random.default_rng(seed)
    z = form.evaluate(x)[0]
    root = np.linalg.cholesky(cov + 1e-300 * np.eye(cov.shape[-1]))
    C = np.zeros((len(x), z.shape[1], z.shape[1]))
    for _ in range(draws):
        e = np.einsum("nij,nj->ni", root, rng.standard_normal(x.shape))
        for sign in (1.0, -1.0):
            d = form.evaluate(x + sign * e)[0] - z
            zd = np.einsum("ni,nj->nij", z, d)
            C += np.einsum("ni,nj->nij", d, d) + zd + zd.transpose(0, 2, 1)
    return Terms(z, C / (2 * draws))


@njit(cache=True)
def _accumulate(z: FloatArray, C: FloatArray, group: IntArray, groups: int) -> tuple[FloatArray, FloatArray, IntArray]:
    q = z.shape[1]
    M = np.zeros((groups, q, q))
    S = np.zeros((groups, q, q))
    n = np.zeros(groups, dtype=np.int64)
    for i in range(len(z)):
        g = group[i]
        n[g] += 1
        for a in range(q):
            for b in range(q):
                M[g, a, b] += z[i, a] * z[i, b]
                S[g, a, b] += C[i, a, b]
    return M, S, n


def sum_moments(terms: Terms, group: IntArray | None = None, groups: int | None = None) -> Moments:
    """Moments by group.

    Parameters
    ----------
    terms : of n points
    group : shape (n,), group of each point, 0 to groups - 1; all in one group where not given
    groups : number of groups; the largest index plus one where not given

    Returns
    -------
    Moments with leading shape (groups,), or without it where ``group`` is not given
    """
    if group is None:
        M, S, n = _accumulate(terms.z, terms.C, np.zeros(len(terms), dtype=np.int64), 1)
        return Moments(M[0], S[0], n[0])
    count = groups if groups is not None else (int(group.max()) + 1 if len(group) else 0)
    return Moments(*_accumulate(terms.z, terms.C, group.astype(np.int64), count))
