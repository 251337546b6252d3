"""Other filters for the same model: unscented and iterated extended, and the extended one in plain matrices.

They run the model's own Python functions in NumPy, independent of tracer and kernels: hundreds of times slower, with
derivatives by differences. Use them to see whether linearisation matters for a model, at its estimates (``filtered``)
or in its estimates (``estimated``), and as an oracle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace as Space
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fdd.greybox.identifiability import identified
from fdd.greybox.likelihood import Data
from fdd.greybox.results import FitResult
from fdd.greybox.scale import chain, from_scale, scale_bounds, scale_unit, to_scale
from fdd.greybox.trust import minimise
from fdd.models.declare import ComponentModel

FloatArray = NDArray[np.float64]
Kind = Literal["extended", "iterated", "unscented"]
Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Filtered:
    """Negative log-likelihood, innovations (N, n_y) and their covariances (N, n_y, n_y), filtered states (N, n)."""

    value: float
    innovation: FloatArray
    covariance: FloatArray
    state: FloatArray


def filtered(
    model: ComponentModel, data: Data, values: FloatArray, kind: Kind, *, substeps: int = 10, iterations: int = 8
) -> Filtered:
    """Filter a record at natural parameters (n_p,).

    ``unscented``: sigma points of Julier and Uhlmann (1997) with kappa = 3 - n; the moment equations of Sarkka (2007)
    for the prediction. ``iterated``: Gauss-Newton on the update (Bell and Cathey 1993). ``extended``:
    linearised about the estimate.
    """
    f = _Functions(model, data, values)
    n, q = len(model.states), len(model.outputs)
    x, P = f.start()
    innovation, covariance = np.full((len(data), q), np.nan), np.full((len(data), q, q), np.nan)
    states, total = np.empty((len(data), n)), 0.0
    for k in range(len(data)):
        if k:
            x, P = _predict(f, k - 1, x, P, kind, substeps)
        seen = np.isfinite(data.y[k])
        if seen.any():
            h, R = f.observe(k, seen), np.diag(f.noise(k)[seen] ** 2)
            y = data.y[k][seen]
            e, S, x, P = _update(h, R, y, x, P, kind, iterations)
            total += 0.5 * (float(e @ np.linalg.solve(S, e)) + np.linalg.slogdet(S)[1] + len(e) * math.log(2 * math.pi))
            innovation[k, seen] = e
            covariance[k][np.ix_(seen, seen)] = S
        states[k] = x
    return Filtered(float(total), innovation, covariance, states)


@dataclass(frozen=True, slots=True)
class Estimated:
    """Estimates by another filter: values and standard errors (Fisher) by symbol, log-likelihood, and how it ended."""

    kind: Kind
    params: dict[str, float]
    bse: dict[str, float]
    llf: float
    converged: bool
    reason: str


def estimated(
    model: ComponentModel, data: Data, kind: Kind, *, start: FitResult, substeps: int = 4, iterations: int = 8
) -> Estimated:
    """Maximum likelihood by another filter, from the estimates of the extended one; what was fixed there stays so.

    The same trust region as :func:`fdd.greybox.fit.fit`, on central differences of innovations and their covariances:
    2 k + 1 filter runs an evaluation for k free parameters.
    """
    rows = [(i, q) for i, q in enumerate(model.parameters) if q.symbol in start.free]
    bounds = np.array([scale_bounds(q) for _, q in rows])

    def natural(theta: FloatArray) -> FloatArray:
        values = start.values.copy()
        for (i, q), t in zip(rows, theta, strict=True):
            values[i] = from_scale(q, float(t))
        return values

    def run(theta: FloatArray) -> Filtered:
        return filtered(model, data, natural(theta), kind, substeps=substeps, iterations=iterations)

    def objective(theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        steps = 1e-4 * np.eye(len(theta))
        try:
            ends = [(run(theta + h), run(theta - h)) for h in steps]
            value = run(theta)
        except np.linalg.LinAlgError:
            return math.inf, np.zeros(len(theta)), np.eye(len(theta))
        gradient = np.array([(a.value - b.value) / 2e-4 for a, b in ends])
        de = np.array([(a.innovation - b.innovation) / 2e-4 for a, b in ends])
        dS = np.array([(a.covariance - b.covariance) / 2e-4 for a, b in ends])
        return value.value, gradient, _fisher(value.covariance, de, dS)

    theta = np.array([to_scale(q, start.params[q.symbol]) for _, q in rows])
    units = np.array([scale_unit(q) for _, q in rows])
    found = minimise(objective, theta, bounds[:, 0], bounds[:, 1], scale=units, radius=0.3, tolerance=1e-5, most=40)
    names = [q.symbol for _, q in rows]
    on_bound = (found.theta <= bounds[:, 0]) | (found.theta >= bounds[:, 1])
    values = natural(found.theta)
    free = [i for i, _ in rows]
    told = identified(found.information, None, on_bound, [q for _, q in rows], values[free])
    errors = np.sqrt(np.diag(told.covariance)) * chain(model, values)[free]
    bse = {n: math.inf if n in told.untold or b else float(e) for n, e, b in zip(names, errors, on_bound, strict=True)}
    params = {q.symbol: float(v) for q, v in zip(model.parameters, values, strict=True)}
    return Estimated(kind, params, bse, -found.value, found.converged, found.reason)


def _fisher(S: FloatArray, de: FloatArray, dS: FloatArray) -> FloatArray:
    """Sum of de' S^-1 de + tr(S^-1 dS S^-1 dS) / 2 over the samples; de (k, N, q), S (N, q, q), dS (k, N, q, q)."""
    k = len(de)
    out = np.zeros((k, k))
    for t in range(len(S)):
        seen = np.flatnonzero(np.isfinite(np.diag(S[t])))
        if not len(seen):
            continue
        inverse = np.linalg.inv(S[t][np.ix_(seen, seen)])
        e, D = de[:, t, seen], inverse @ dS[:, t][:, seen][:, :, seen]
        out += e @ inverse @ e.T + 0.5 * np.einsum("iab,jba->ij", D, D)
    return out


class _Functions:
    """A model's equations as functions of arrays, at one record's inputs."""

    def __init__(self, model: ComponentModel, data: Data, values: FloatArray) -> None:
        self.model, self.data = model, data
        self.names = model.symbols
        self.p = Space(**dict(zip(self.names["parameters"], (float(v) for v in values), strict=True)))

    def u(self, k: int, fraction: float = 0.0) -> Space:
        row = self.data.u[k]
        if self.data.hold == "first" and fraction:
            row = row + fraction * (self.data.u[k + 1] - row)
        return Space(**dict(zip(self.names["inputs"], (float(v) for v in row), strict=True)))

    def x(self, x: FloatArray) -> Space:
        return Space(**dict(zip(self.names["states"], (float(v) for v in x), strict=True)))

    def drift(self, x: FloatArray, u: Space) -> FloatArray:
        out = self.model.drift(self.x(x), u, self.p)
        return np.array([float(out[s]) for s in self.names["states"]])

    def variance(self, x: FloatArray, u: Space) -> FloatArray:
        out = self.model.diffusion(self.x(x), u, self.p)
        return np.diag([float(out[s]) ** 2 for s in self.names["states"]])

    def observe(self, k: int, seen: NDArray[np.bool_]) -> Function:
        u = self.u(k)

        def h(x: FloatArray) -> FloatArray:
            out = self.model.observe(self.x(x), u, self.p)
            return np.array([float(out[s]) for s in self.names["outputs"]])[seen]

        return h

    def noise(self, k: int) -> FloatArray:
        out = self.model.noise(self.x(np.zeros(len(self.model.states))), self.u(k), self.p)
        return np.array([float(out[s]) for s in self.names["outputs"]])

    def start(self) -> tuple[FloatArray, FloatArray]:
        d = self.data
        y = Space(**dict(zip(self.names["outputs"], (float(v) for v in d.y[0]), strict=True)))
        out = self.model.start(y, self.u(0), self.p)
        x = np.array([float(out[s]) for s in self.names["states"]]) if d.x0 is None else d.x0
        return x, np.diag([s.initial_sd**2 for s in self.model.states]) if d.P0 is None else d.P0


def jacobian(f: Function, x: FloatArray) -> FloatArray:
    """Central differences."""
    h = 1e-6 * np.maximum(1.0, np.abs(x))
    return np.column_stack([(f(x + h[i] * e) - f(x - h[i] * e)) / (2 * h[i]) for i, e in enumerate(np.eye(len(x)))])


def sigma_points(x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """2 n + 1 points (., n) and their weights, exact to the third moment of a normal distribution (kappa = 3 - n)."""
    n = len(x)
    root = np.linalg.cholesky(P + 1e-14 * np.trace(P) * np.eye(n)) * math.sqrt(3.0)
    weights = np.full(2 * n + 1, 1 / 6)
    weights[0] = (3.0 - n) / 3.0
    return np.vstack([x, x + root.T, x - root.T]), weights


def _predict(
    f: _Functions, k: int, x: FloatArray, P: FloatArray, kind: Kind, substeps: int
) -> tuple[FloatArray, FloatArray]:
    h = f.data.dt[k] / substeps

    def slopes(x: FloatArray, P: FloatArray, fraction: float) -> tuple[FloatArray, FloatArray]:
        u = f.u(k, fraction)
        Q = f.variance(x, u)
        if kind != "unscented":
            A = jacobian(lambda z: f.drift(z, u), x)
            return f.drift(x, u), A @ P + P @ A.T + Q
        points, weights = sigma_points(x, P)
        rates = np.array([f.drift(z, u) for z in points])
        cross = (weights[:, None] * (points - x)).T @ rates
        return weights @ rates, cross + cross.T + Q

    for s in range(substeps):
        at = [(s + c) / substeps for c in (0.0, 0.5, 0.5, 1.0)]
        a, A = slopes(x, P, at[0])
        b, B = slopes(x + h / 2 * a, P + h / 2 * A, at[1])
        c, C = slopes(x + h / 2 * b, P + h / 2 * B, at[2])
        d, D = slopes(x + h * c, P + h * C, at[3])
        x, P = x + h / 6 * (a + 2 * b + 2 * c + d), P + h / 6 * (A + 2 * B + 2 * C + D)
    return x, P


def _update(
    h: Function, R: FloatArray, y: FloatArray, x: FloatArray, P: FloatArray, kind: Kind, iterations: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    if kind == "unscented":
        points, weights = sigma_points(x, P)
        seen = np.array([h(z) for z in points])
        mean = weights @ seen
        S = (weights[:, None] * (seen - mean)).T @ (seen - mean) + R
        K = np.linalg.solve(S, (weights[:, None] * (seen - mean)).T @ (points - x)).T
        e = y - mean
        return e, S, x + K @ e, P - K @ S @ K.T
    H = jacobian(h, x)
    e, S = y - h(x), H @ P @ H.T + R
    z, C = x, S
    for _ in range(iterations if kind == "iterated" else 1):
        H = jacobian(h, z)
        C = H @ P @ H.T + R
        K = np.linalg.solve(C, H @ P).T
        z = x + K @ (y - h(z) - H @ (x - z))
    return e, S, z, P - K @ C @ K.T
