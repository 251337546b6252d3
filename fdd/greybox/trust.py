"""Fisher-scoring trust region with bounds: few evaluations, each of value, gradient and information in one pass."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
RIDGE = 1e-3  # log-likelihood per squared unit of a parameter
Objective = Callable[[FloatArray], tuple[float, FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class Optimum:
    """Where a search ended; ``reason`` says why it stopped."""

    theta: FloatArray
    value: float
    gradient: FloatArray
    information: FloatArray
    evaluations: int
    converged: bool
    reason: str


def minimise(
    objective: Objective,
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    *,
    scale: FloatArray | None = None,
    radius: float = 1.0,
    tolerance: float = 1e-7,
    most: int = 200,
    curvature: FloatArray | None = None,
) -> Optimum:
    """Minimise within bounds; ``scale`` (k,) is a natural unit of each parameter, ``radius`` counts in it.

    The quadratic model is the Fisher information: positive semidefinite everywhere, which the observed curvature is
    not. Where a model does not fit the data the two differ; what the Fisher information lacks is learned from the
    gradients of the steps taken (Dennis, Gay and Welsch 1981) and added whenever the last step says that it helps. A
    ``curvature`` (k, k) replaces both at the start of the search. The search stops when the model promises, and the
    last step gave, less than ``tolerance`` (in units of the log-likelihood).
    """
    unit = np.ones_like(start) if scale is None else scale
    x = np.clip(start, lower, upper)
    f, g, B = objective(x)
    count = 1
    if not math.isfinite(f):
        return Optimum(x, f, g, B, count, False, "the likelihood is not finite at the start")
    last, reason = math.inf, "the most evaluations were used"
    lacking = np.zeros_like(B) if curvature is None else curvature - B
    corrected = curvature is not None
    while count < most:
        model = _definite((B + lacking if corrected else B) * np.outer(unit, unit))
        step, promised = _bounded_step(g * unit, model, radius, (lower - x) / unit, (upper - x) / unit)
        if promised < tolerance and last < tolerance * 10:
            return Optimum(x, f, g, B, count, True, "converged")
        if promised < 1e-13 * max(1.0, abs(f)):
            return Optimum(x, f, g, B, count, True, "converged")
        new = np.clip(x + step * unit, lower, upper)
        fn, gn, Bn = objective(new)
        count += 1
        gained = f - fn if math.isfinite(fn) else -math.inf
        length = float(np.linalg.norm(step))
        ratio = gained / promised
        if ratio < 0.1 or not math.isfinite(ratio):
            radius = min(radius, length) * (0.25 if math.isfinite(ratio) else 0.1)
        elif ratio > 0.7 and length > 0.9 * radius:
            radius = min(radius * 2.5, 10.0)
        if math.isfinite(fn):
            moved = new - x
            corrected = _better(g, B, lacking, moved, gained)
            lacking = _learned(lacking, moved, gn - g, Bn)
        if gained > 0 and ratio > 1e-4:
            x, f, g, B, last = new, fn, gn, Bn, gained
        elif radius < 1e-9 or (promised < 1e-6 and abs(gained) < 1e-9 * max(1.0, abs(f))):
            return Optimum(x, f, g, B, count, promised < 1e-3, "no step improves the likelihood any more")
    return Optimum(x, f, g, B, count, False, reason)


def _better(g: FloatArray, B: FloatArray, lacking: FloatArray, step: FloatArray, gained: float) -> bool:
    """Whether the model with what Fisher's information lacks foretold the last step better than that alone."""
    plain = -float(g @ step + 0.5 * step @ B @ step)
    return abs(plain - 0.5 * float(step @ lacking @ step) - gained) < abs(plain - gained)


def _learned(lacking: FloatArray, step: FloatArray, change: FloatArray, B: FloatArray) -> FloatArray:
    """The symmetric rank-two update that makes B + lacking send the step to the change of the gradient.

    Sized down first where the old part claims more curvature along the step than was seen.
    """
    seen = change - B @ step
    curvature = float(step @ change)
    if not curvature > 1e-12 * float(step @ step):
        return lacking
    claimed = float(step @ lacking @ step)
    size = min(1.0, abs(float(step @ seen)) / abs(claimed)) if claimed else 1.0
    rest = seen - size * (lacking @ step)
    outer = np.outer(rest, change)
    return np.asarray(
        size * lacking + (outer + outer.T) / curvature - float(step @ rest) / curvature**2 * np.outer(change, change)
    )


def _definite(B: FloatArray) -> FloatArray:
    """Symmetric; directions of negative curvature get the size of it with a positive sign.

    A direction the data say nothing about keeps a little stiffness, or a search strays along it to where it is lost.
    """
    values, vectors = np.linalg.eigh(0.5 * (B + B.T))
    return np.asarray((vectors * (np.abs(values) + RIDGE)) @ vectors.T)


def _bounded_step(
    g: FloatArray, B: FloatArray, radius: float, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, float]:
    """Minimiser of the model in the ball, parameters that meet a bound held there one after the other."""
    step = np.zeros_like(g)
    held = ((low >= 0) & (g > 0)) | ((high <= 0) & (g < 0))
    for _ in range(len(g) + 1):
        free = ~held
        if not free.any():
            break
        room = math.sqrt(max(radius**2 - float(step[held] @ step[held]), (0.1 * radius) ** 2))
        slope = g[free] + B[np.ix_(free, held)] @ step[held]
        step[free] = _ball_step(slope, B[np.ix_(free, free)], room)
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step = np.where(out, np.clip(step, low, high), step)
        held |= out
    promised = -float(g @ step + 0.5 * step @ B @ step)
    return step, promised


def _ball_step(g: FloatArray, B: FloatArray, radius: float) -> FloatArray:
    """Exact trust-region step by eigenvalues (Conn, Gould and Toint 2000, chapter 7) for positive semidefinite B."""
    values, vectors = np.linalg.eigh(B)
    a = vectors.T @ g
    values = np.maximum(values, 1e-14 * max(values[-1], 1e-300))

    def length(mu: float) -> float:
        return float(np.linalg.norm(a / (values + mu)))

    if length(0.0) <= radius:
        return np.asarray(-vectors @ (a / values))
    low, high = 0.0, float(np.linalg.norm(g)) / radius
    for _ in range(100):
        mu = 0.5 * (low + high) if low > 0 else high * 0.5 ** (1 + _)
        if length(mu) > radius:
            low = mu
        else:
            high = mu
        if low > 0 and high / low < 1.0001:
            break
    return np.asarray(-vectors @ (a / (values + high)))
