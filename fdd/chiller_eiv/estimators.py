"""Estimators of the Gordon-Ng parameters: one family, beta_k = (M_xx - k S_xx)^-1 (M_xy - k S_xy).

| estimator | k |
|---|---|
| ``ols`` | 0 |
| ``cls`` | 1 (Andersen and Reddy 2000, Eq. 11) |
| ``tls`` | lambda_min |
| ``capped`` | min(lambda_min, 1) - 1/(n - p), after Fuller 1987, Sec. 2.5 |

``lambda_min`` is the smallest root of det(M - lambda S) = 0. Plain CLS breaks down where the load range is narrow
(M_xx - S_xx stops being positive definite); TLS is best while the model is exact and biased at every n when it is not.
The capped estimator is always positive definite, and is the default.

Everything here takes any leading shape: one machine, its weeks, its leave-one-day-out sums, ten thousand machines.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from fdd.chiller_eiv.forms import Form
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.moments import Moments, Terms
from fdd.records import FloatArray

Estimator = Literal["ols", "cls", "tls", "capped"]
ESTIMATORS: tuple[Estimator, ...] = ("ols", "cls", "tls", "capped")

# The number the eigenvalues of a correlation-scaled moment matrix are known to, relative to the largest.
_ROUNDING = 1e-15


def _scale(M: FloatArray) -> FloatArray:
    """Square roots of the diagonal, 1 where it is zero: makes condition numbers independent of units."""
    d = np.sqrt(np.abs(np.diagonal(M, axis1=-2, axis2=-1)))
    return np.asarray(np.where(d > 0, d, 1.0))


def lambda_min(moments: Moments) -> FloatArray:
    """Smallest root of |M - lambda S|: (true / assumed error variance) where the model is exact.

    Returns
    -------
    Shape of the moments' leading axes; infinite where no error is assumed, zero where M is singular
    """
    d = _scale(moments.M)
    outer = d[..., :, None] * d[..., None, :]
    w, V = np.linalg.eigh(moments.M / outer)
    w = np.maximum(w, _ROUNDING * w[..., -1:])
    root = V / np.sqrt(w)[..., None, :]
    largest = np.linalg.eigvalsh(np.swapaxes(root, -1, -2) @ (moments.S / outer) @ root)[..., -1]
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(largest > 0, 1.0 / np.where(largest > 0, largest, 1.0), np.inf))


def choose_k(moments: Moments, estimator: Estimator) -> FloatArray:
    """The share of the error moments an estimator takes off, see the module's table."""
    shape = moments.M.shape[:-2]
    if estimator == "ols":
        return np.zeros(shape)
    if estimator == "cls":
        return np.ones(shape)
    root = lambda_min(moments)
    if estimator == "tls":
        return np.where(np.isfinite(root), root, 0.0)
    parameters = moments.M.shape[-1] - 1
    freedom = np.maximum(np.asarray(moments.n, dtype=float) - parameters, 1.0)
    return np.asarray(np.minimum(root, 1.0) - 1.0 / freedom)


def solve(moments: Moments, k: FloatArray | float) -> FloatArray:
    """Estimates for given k, shape (..., p); NaN where there are not more points than parameters."""
    A, b = normal_equations(moments, k)
    d = _scale(A)
    A = A / (d[..., :, None] * d[..., None, :])
    enough = np.asarray(moments.n) > A.shape[-1]
    A = np.where(enough[..., None, None], A, np.eye(A.shape[-1]))
    try:
        beta = np.linalg.solve(A, (b / d)[..., None])[..., 0] / d
    except np.linalg.LinAlgError as e:
        raise ChillerError(
            "the regression terms are exactly proportional to one another: the load and the temperatures never change; "
            "give more varied data or hold a parameter"
        ) from e
    return np.asarray(np.where(enough[..., None], beta, np.nan))


def normal_equations(moments: Moments, k: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """A = M_xx - k S_xx (..., p, p) and b = M_xy - k S_xy (..., p)."""
    D = moments.M - np.asarray(k)[..., None, None] * moments.S
    return D[..., 1:, 1:], D[..., 1:, 0]


def positive_definite(moments: Moments, k: FloatArray | float) -> NDArray[np.bool_]:
    """Whether M_xx - k S_xx is positive definite; where not, the estimate means nothing."""
    A, _ = normal_equations(moments, k)
    d = _scale(moments.M)[..., 1:]
    return np.asarray(np.linalg.eigvalsh(A / (d[..., :, None] * d[..., None, :]))[..., 0] > 0)


def estimate(moments: Moments, estimator: Estimator = "capped") -> FloatArray:
    """Parameters by one of the estimators, shape (..., p)."""
    return solve(moments, choose_k(moments, estimator))


def hold(form: Form, held: Mapping[str, FloatArray | float]) -> tuple[FloatArray, tuple[str, ...]]:
    """The linear map of the terms that holds parameters at given values, and the names left.

    ``moments.map(T)`` then is a regression of Y - sum held X_held on the remaining terms, with the errors of the held
    terms moved to the left-hand side where they belong. Values may have a leading shape (one a machine).
    """
    free = [p for p in form.parameters if p not in held]
    if not free:
        raise ChillerError("every parameter is held; leave at least one free")
    values = {form.position(p) + 1: np.asarray(v, dtype=float) for p, v in held.items()}
    lead = np.broadcast_shapes(*(v.shape for v in values.values()))
    T = np.zeros((*lead, len(free) + 1, len(form.parameters) + 1))
    T[..., 0, 0] = 1.0
    for column, v in values.items():
        T[..., 0, column] = -v
    for row, p in enumerate(free, start=1):
        T[..., row, form.position(p) + 1] = 1.0
    return T, tuple(free)


def map_terms(terms: Terms, T: FloatArray) -> Terms:
    """Terms T z with their covariances."""
    return Terms(terms.z @ T.T, T @ terms.C @ T.T)


def combine_with_prior(
    beta: FloatArray,
    covariance: FloatArray,
    *,
    mean: FloatArray,
    precision: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Join one machine's estimate with Gaussian prior knowledge and bounds.

    The posterior of a normal estimate and a normal prior, then its mode within the bounds. A parameter that ends on a
    bound is treated as known there: the others' covariance is conditional on it, its own is zero.

    Parameters
    ----------
    beta, covariance : shape (p,), (p, p), the estimate from data
    mean, precision : shape (p,), (p, p); a zero precision is no prior
    lower, upper : shape (p,), infinite where free
    """
    d = np.sqrt(np.diagonal(covariance))
    if not (np.isfinite(d).all() and (d > 0).all()):
        raise ChillerError("priors need the estimate's covariance; give at least two days of data")
    information = np.linalg.pinv(covariance / np.outer(d, d), hermitian=True, rcond=1e-12) / np.outer(d, d)
    A = information + precision
    b = information @ beta + precision @ mean
    L = np.linalg.cholesky(A * np.outer(d, d) + 1e-14 * np.eye(len(d)))
    fit = lsq_linear(L.T, np.linalg.solve(L, b * d), bounds=(lower / d, upper / d), method="bvls", tol=1e-12)
    value = np.asarray(fit.x * d)
    free = fit.active_mask == 0
    out = np.zeros_like(covariance)
    if free.any():
        inside = np.ix_(free, free)
        out[inside] = np.linalg.inv(A[inside])
    return value, out


def fit_orthogonal(terms: Terms, start: FloatArray) -> tuple[FloatArray, float]:
    """Orthogonal distance regression by Sampson's distance: minimise sum (a' z)^2 / (a' C a), a = (1, -beta).

    Best while the model is exact, biased at every n when it is not; reported beside the default as a check.

    Returns
    -------
    Estimates (p,) and the minimum, which is chi-squared with n - p degrees of freedom where the errors are right
    """
    scale = np.where(start == 0, 1.0, np.abs(start))

    def residuals(scaled: FloatArray) -> FloatArray:
        a = np.concatenate([[1.0], -scaled * scale])
        variance = np.einsum("i,nij,j->n", a, terms.C, a)
        return np.asarray(terms.z @ a / np.sqrt(variance))

    if not np.all(np.diagonal(terms.C, axis1=1, axis2=2)[:, 0] > 0):
        raise ChillerError("orthogonal regression needs sensor errors above zero; declare them in the site file")
    fit = least_squares(residuals, start / scale, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.asarray(fit.x * scale), float(2 * fit.cost)
