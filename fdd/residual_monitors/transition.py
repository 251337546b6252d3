"""The run of a chart as a Markov chain on quadrature nodes: the integral equations of Page, solved by Nystrom's method.

A chart whose statistic has one step's density f(y | x) has a mean run length L(x) = 1 + int L(y) f(y | x) dy. On Gauss-
Legendre nodes this is a linear system that converges faster than any power of the number of nodes; what stands here
are its matrices, one function a chart. The unit of every value is the standard deviation of one input value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from scipy.special import gammaln, i0e, ive, ndtr
from scipy.stats import ncx2

from fdd.records import FloatArray

NODES_LEAST = 28
NODES_MOST = 600
"""Bounds of the number of nodes along an axis; between them about ten for each standard deviation of a step."""
PLANE_MOST = (48, 28)
"""Most nodes along and across a shift for the two-dimensional equation of the MEWMA."""
PLAIN_MOST = 1e8
"""Mean run length up to which 1 - P is solved as it stands; it loses a digit with every factor of ten."""
NEVER = 1e100
"""Longest mean run length that is told: that of a CUSUM's other side under a large shift."""
_ROOT_2PI = float(np.sqrt(2 * np.pi))


@dataclass(frozen=True)
class Transition:
    """One step of a chart that has not alarmed.

    Attributes
    ----------
    matrix : shape (m, m), weights from node to node; a row's sum is the probability of no alarm in the step
    row : weights of the first step from a start given as a share of the limit, shape (m,)
    leave : shape (m,), probability of an alarm in the step, to its own relative accuracy; None where it is not known
    """

    matrix: FloatArray
    row: Callable[[float], FloatArray]
    leave: FloatArray | None = None

    def mean(self) -> FloatArray:
        """Mean run length from each node, shape (m,)."""
        m = len(self.matrix)
        if self.leave is None or self.leave.max() > 1.0 / PLAIN_MOST:
            plain = np.asarray(np.linalg.solve(np.eye(m) - self.matrix, np.ones(m)))
            if self.leave is None or (plain.min() > 0 and plain.max() < PLAIN_MOST):
                return plain
        return np.asarray(_mean_without_subtraction(self.matrix.copy(), self.leave.copy()))

    def quasi_stationary(self) -> FloatArray:
        """Where a chart that has run long without alarm stands: weights of the nodes, shape (m,), sum 1."""
        m = len(self.matrix)
        inverse = np.linalg.inv(np.eye(m) - self.matrix.T)
        weights = np.full(m, 1.0 / m)
        for _ in range(500):
            last = weights
            weights = inverse @ weights
            weights /= weights.sum()
            if np.max(np.abs(weights - last)) < 1e-14:
                break
        return np.asarray(weights)


@numba.njit(cache=True)
def _mean_without_subtraction(matrix: FloatArray, leave: FloatArray) -> FloatArray:
    """Solve (1 - P) m = 1 to full relative accuracy however rare an alarm is; both arrays are overwritten.

    Elimination after Grassmann, Taksar and Heyman (1985, Operations Research 33, 1107-1116): a diagonal element of
    1 - P is the sum of what leaves the node, so that nothing is ever subtracted.
    """
    n = len(leave)
    right = np.ones(n)
    pivot = np.empty(n)
    for k in range(n - 1, -1, -1):
        pivot[k] = leave[k]
        for j in range(k):
            pivot[k] += matrix[k, j]
        pivot[k] = max(pivot[k], 1e-300)  # a node that is never left for an alarm, to all that a double can say
        for i in range(k):
            share = matrix[i, k] / pivot[k]
            leave[i] += share * leave[k]
            right[i] += share * right[k]
            for j in range(k):
                matrix[i, j] += share * matrix[k, j]
    mean = np.empty(n)
    for k in range(n):
        total = right[k]
        for j in range(k):
            total += matrix[k, j] * mean[j]
        mean[k] = min(total / pivot[k], NEVER)
    return mean


@lru_cache(maxsize=64)
def _legendre(count: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return np.asarray(nodes), np.asarray(weights)


def gauss(low: float, high: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on an interval."""
    nodes, weights = _legendre(count)
    half = 0.5 * (high - low)
    return low + half * (nodes + 1), half * weights


def count_nodes(length: float) -> int:
    """Nodes for an interval of this many standard deviations of a step; rounded so that few sets are kept."""
    return int(min(NODES_MOST, NODES_LEAST + 8 * np.ceil(0.7 * length)))


def _normal(x: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * x * x) / _ROOT_2PI)


def cusum(h: float, k: float, shift: float) -> Transition:
    """Upper CUSUM: an atom at zero, a density above it (Page 1954; Goel and Wu 1971)."""
    y, w = gauss(0.0, h, count_nodes(h))

    def rows(start: FloatArray) -> FloatArray:
        at_zero = ndtr(k - start - shift)[:, None]
        above = w * _normal(y[None, :] + k - start[:, None] - shift)
        return np.hstack([at_zero, above])

    nodes = np.concatenate([[0.0], y])
    leave = np.asarray(ndtr(nodes - h - k + shift))
    return Transition(rows(nodes), lambda share: rows(np.array([share * h]))[0], leave)


def ewma(limit: float, lam: float, shift: float) -> Transition:
    """Two-sided EWMA with the limit of the settled chart (Crowder 1987); ``limit`` in its standard deviations."""
    c = limit * np.sqrt(lam / (2 - lam))
    y, w = gauss(-c, c, count_nodes(2 * c / lam))

    def rows(start: FloatArray) -> FloatArray:
        return np.asarray(w * _normal((y[None, :] - (1 - lam) * start[:, None]) / lam - shift) / lam)

    kept = (1 - lam) * y
    leave = np.asarray(ndtr((kept - c) / lam + shift) + ndtr((-c - kept) / lam - shift))
    return Transition(rows(y), lambda share: rows(np.array([share * c]))[0], leave)


def ewma_opening(limit: float, lam: float, shift: float) -> tuple[float, FloatArray]:
    """EWMA whose limit follows the exact variance while it settles.

    Returns the sum of the probabilities of surviving 0, 1, ... steps up to where the limit has settled, and the weights
    of the nodes of :func:`ewma` there.
    """
    steps = int(np.ceil(np.log(1e-9) / (2 * np.log1p(-lam)))) if lam < 1 else 1
    settled = limit * np.sqrt(lam / (2 - lam))
    start, weights, total = np.zeros(1), np.ones(1), 1.0
    count = count_nodes(2 * settled / lam)
    for t in range(1, steps + 1):
        c = settled * np.sqrt(1 - (1 - lam) ** (2 * t)) if t < steps else settled
        y, w = gauss(-c, c, count)
        kernel = _normal((y[None, :] - (1 - lam) * start[:, None]) / lam - shift) / lam
        start, weights = y, (weights @ kernel) * w
        total += weights.sum()
    return float(total - weights.sum()), weights


def _chi(a: FloatArray, b: FloatArray, dof: int) -> FloatArray:
    """Density at ``a`` of the length of a normal vector of ``dof`` dimensions whose mean has length ``b``."""
    order = dof / 2 - 1
    a, b = np.broadcast_arrays(a, b)
    product = a * b
    if dof == 1:
        near = np.exp(-0.5 * (a - b) ** 2) * (1 + np.exp(-2 * product)) / _ROOT_2PI
        return np.asarray(near)
    if dof == 2:
        return np.asarray(a * np.exp(-0.5 * (a - b) ** 2) * i0e(product))
    central = np.exp((dof - 1) * np.log(a) - 0.5 * a * a - order * np.log(2.0) - gammaln(dof / 2))
    safe = np.maximum(b, 1e-12)
    if dof == 3:
        moved = a / safe * np.exp(-0.5 * (a - b) ** 2) * -np.expm1(-2 * product) / _ROOT_2PI
    else:
        moved = a * (a / safe) ** order * np.exp(-0.5 * (a - b) ** 2) * ive(order, product)
    return np.where(product > 1e-8, moved, central)


def mewma(limit: float, lam: float, dimension: int) -> Transition:
    """MEWMA while all is well: the radius is a Markov chain (Rigdon 1995); ``limit`` on the squared distance."""
    radius = np.sqrt(limit * lam / (2 - lam))
    y, w = gauss(0.0, radius, count_nodes(radius / lam))

    def rows(start: FloatArray) -> FloatArray:
        return np.asarray(w / lam * _chi(y[None, :] / lam, (1 - lam) / lam * start[:, None], dimension))

    leave = np.asarray(ncx2.sf((radius / lam) ** 2, dimension, ((1 - lam) / lam * y) ** 2))
    return Transition(rows(y), lambda share: rows(np.array([share * radius]))[0], leave)


def mewma_shifted(limit: float, lam: float, dimension: int, shift: float) -> Transition:
    """MEWMA under a shift of this Mahalanobis distance: along the shift, and the radius across it (Rigdon 1995b)."""
    radius = np.sqrt(limit * lam / (2 - lam))
    along = min(PLANE_MOST[0], NODES_LEAST + int(radius / lam))
    across = min(PLANE_MOST[1], NODES_LEAST // 2 + int(radius / lam))
    # The half circle in polar-like coordinates, so that the integrand is smooth up to its rim.
    angle, angle_w = gauss(-np.pi / 2, np.pi / 2, along)
    part, part_w = gauss(0.0, 1.0, across)
    v = np.repeat(radius * np.sin(angle), across)
    rim = np.repeat(radius * np.cos(angle), across)
    r = rim * np.tile(part, along)
    w = np.repeat(angle_w, across) * rim * np.tile(part_w, along) * rim / lam**2

    def rows(v0: FloatArray, r0: FloatArray) -> FloatArray:
        forward = _normal((v[None, :] - (1 - lam) * v0[:, None]) / lam - shift)
        sideways = _chi(r[None, :] / lam, (1 - lam) / lam * r0[:, None], dimension - 1)
        return np.asarray(w * forward * sideways)

    return Transition(rows(v, r), lambda share: rows(np.array([share * radius]), np.zeros(1))[0])
