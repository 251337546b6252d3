"""What a fitted model says: predictions and their covariance at any horizon, simulations, sampled paths, smoothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace as Space
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fdd.greybox.kernels import Kernel
from fdd.greybox.likelihood import Data, Likelihood, unpack
from fdd.models.declare import ComponentModel

FloatArray = NDArray[np.float64]


def simulate(likelihood: Likelihood, values: FloatArray) -> FloatArray:
    """Outputs (N, n_y) from the start value and the inputs alone: nothing measured after the first sample is used."""
    y = likelihood.records[0].y.copy()
    y[1:] = np.nan
    return likelihood.of(dataclasses.replace(likelihood.records[0], y=y)).paths(values)[0].predicted


def predict(likelihood: Likelihood, values: FloatArray, k: int) -> FloatArray:
    """Outputs (N, n_y) predicted ``k`` samples ahead: row i uses measurements up to row i - k, inputs up to row i.

    The first k rows are NaN.
    """
    d = likelihood.records[0]
    if not 1 <= k < len(d):
        raise ValueError(f"cannot predict {k} samples ahead in a record of {len(d)}; give 1 <= k < {len(d)}")
    path = likelihood.paths(values)[0]
    if k == 1:
        out = path.predicted.copy()
        out[0] = np.nan
        return out
    kern = likelihood.kernel(0, tangents=False)
    c, w, n = kern.constants(), kern.workspace(), kern.layout.n
    rows, columns = np.triu_indices(n)
    out, shown, nothing = np.full_like(d.y, np.nan), np.empty(4 * d.y.shape[1]), np.full(d.y.shape[1], np.nan)
    with np.errstate(all="ignore"):
        kern.module.prepare(values, c)
        for i in range(len(d) - k):
            w[:n] = path.xf[i]
            w[n : kern.layout.nz] = path.Pf[i][rows, columns]
            for s in range(i, i + k):
                kern.module.predict(w, c, d.dt[s], d.u[s], d.u[s + 1], 0)
            kern.module.update(w, c, d.u[i + k], nothing, shown)
            out[i + k] = shown[: d.y.shape[1]]
    return out


@dataclass(frozen=True, slots=True)
class Forecast:
    """Distributions of states and outputs 1 to k samples after each of m rows, normal and given all before.

    ``x`` (m, k, n), ``P`` (m, k, n, n); ``y`` and ``variance`` (m, k, n_y), the measurement error in it.
    """

    rows: NDArray[np.int64]
    x: FloatArray
    P: FloatArray
    y: FloatArray
    variance: FloatArray

    def interval(self, probability: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Limits of the outputs, (m, k, n_y) each."""
        half = float(stats.norm.isf((1.0 - probability) / 2.0)) * np.sqrt(self.variance)
        return self.y - half, self.y + half


def forecast(likelihood: Likelihood, values: FloatArray, rows: Sequence[int], steps: int) -> Forecast:
    """Forecasts ``steps`` samples ahead from filtered states at ``rows`` of the first record, inputs as recorded.

    Raises
    ------
    ValueError : a row from which the record does not reach so far
    """
    d = likelihood.records[0]
    at = np.asarray(rows, dtype=np.int64)
    if steps < 1 or not ((at >= 0) & (at + steps < len(d))).all():
        raise ValueError(
            f"{d.name}: forecasts of {steps} samples need rows from 0 to {len(d) - steps - 1} (and at least one step)"
        )
    path, kern = likelihood.paths(values)[0], likelihood.kernel(0, tangents=False)
    n, q = kern.layout.n, d.y.shape[1]
    x, P = np.empty((len(at), steps, n)), np.empty((len(at), steps, kern.layout.nz - n))
    shown = np.empty((len(at), steps, 4 * q))
    c, w, nothing = kern.constants(), kern.workspace(), np.full(q, np.nan)
    upper = np.triu_indices(n)
    with np.errstate(all="ignore"):
        kern.module.prepare(values, c)
        for j, i in enumerate(at.tolist()):
            w[:n], w[n : kern.layout.nz] = path.xf[i], path.Pf[i][upper]
            for k in range(steps):
                kern.module.predict(w, c, d.dt[i + k], d.u[i + k], d.u[i + k + 1], 0)
                kern.module.update(w, c, d.u[i + k + 1], nothing, shown[j, k])
                x[j, k], P[j, k] = w[:n], w[n : kern.layout.nz]
    whole = unpack(P.reshape(-1, P.shape[2]), n).reshape(len(at), steps, n, n)
    return Forecast(at, x, whole, shown[..., :q], shown[..., q : 2 * q])


def sample(
    likelihood: Likelihood, values: FloatArray, row: int, steps: int, count: int, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """``count`` paths of states (count, steps, n) and outputs (count, steps, n_y) from the filtered state at a row.

    Each begins at a state drawn from the filter's distribution; every step is drawn from the normal distribution that
    the model's prediction has from a known state, which is exact where the drift is linear.
    """
    d, random = likelihood.records[0], np.random.default_rng(seed)
    path, kern = likelihood.paths(values)[0], likelihood.kernel(0, tangents=False)
    n, q = kern.layout.n, d.y.shape[1]
    states, outputs, shown = np.empty((count, steps, n)), np.empty((count, steps, q)), np.empty(4 * q)
    c, w, nothing = kern.constants(), kern.workspace(), np.full(q, np.nan)
    with np.errstate(all="ignore"):
        kern.module.prepare(values, c)
        for j in range(count):
            x = _drawn(path.xf[row], path.Pf[row], random)
            for k in range(steps):
                w[:n], w[n : kern.layout.nz] = x, 0.0
                kern.module.predict(w, c, d.dt[row + k], d.u[row + k], d.u[row + k + 1], 0)
                x = _drawn(w[:n].copy(), unpack(w[None, n : kern.layout.nz], n)[0], random)
                w[:n], w[n : kern.layout.nz] = x, 0.0
                kern.module.update(w, c, d.u[row + k + 1], nothing, shown)
                states[j, k] = x
                outputs[j, k] = shown[:q] + np.sqrt(shown[q : 2 * q]) * random.normal(size=q)
    return states, outputs


def _drawn(mean: FloatArray, P: FloatArray, random: np.random.Generator) -> FloatArray:
    lam, V = np.linalg.eigh(P)
    return np.asarray(mean + V @ (np.sqrt(np.maximum(lam, 0.0)) * random.normal(size=len(mean))))


def smooth(likelihood: Likelihood, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smoothed states (N, n) and covariances (N, n, n): every state given the whole record.

    Rauch, Tung and Striebel (1965) on the filter's moments; the transition matrix of each step is that of the tangent
    of the prediction, found by central differences of the kernel itself.
    """
    d, path = likelihood.records[0], likelihood.paths(values)[0]
    kern = likelihood.kernel(0, tangents=False)
    xs, Ps = path.xf.copy(), path.Pf.copy()
    for i in range(len(d) - 2, -1, -1):
        F = _transition(kern, values, d, i, path.xf[i], path.Pf[i])
        G = np.linalg.lstsq(path.P[i + 1].T, F @ path.Pf[i].T, rcond=None)[0].T
        xs[i] = path.xf[i] + G @ (xs[i + 1] - path.x[i + 1])
        Ps[i] = path.Pf[i] + G @ (Ps[i + 1] - path.P[i + 1]) @ G.T
    return xs, Ps


def _transition(kern: Kernel, values: FloatArray, d: Data, i: int, x: FloatArray, P: FloatArray) -> FloatArray:
    c, n = kern.constants(), kern.layout.n
    rows, columns = np.triu_indices(n)
    kern.module.prepare(values, c)
    out = np.empty((n, n))
    h = 1e-5 * np.maximum(1.0, np.abs(x))
    for j in range(n):
        ends = []
        for sign in (1, -1):
            w = kern.workspace()
            w[:n], w[n : kern.layout.nz] = x, P[rows, columns]
            w[j] += sign * h[j]
            kern.module.predict(w, c, d.dt[i], d.u[i], d.u[i + 1], 0)
            ends.append(w[:n].copy())
        out[:, j] = (ends[0] - ends[1]) / (2 * h[j])
    return out


def realise(model: ComponentModel, values: FloatArray, data: Data, seed: int, substeps: int = 20) -> Data:
    """The record with outputs drawn from the model itself (process and measurement noise), at its own times and inputs.

    Euler-Maruyama with ``substeps`` steps a sample, parameters (n_p,) natural; for Monte Carlo tests of fits and for
    the design of experiments.
    """
    random, names = np.random.default_rng(seed), model.symbols
    p = Space(**dict(zip(names["parameters"], values, strict=True)))

    def of(table: str, row: FloatArray) -> Space:
        return Space(**dict(zip(names[table], row, strict=True)))

    def rows(table: str, result: Mapping[str, Any]) -> FloatArray:
        return np.array([float(result[s]) for s in names[table]])

    u = of("inputs", data.u[0])
    x = rows("states", model.start(of("outputs", data.y[0]), u, p)) if data.x0 is None else data.x0.copy()
    P0 = np.diag([s.initial_sd**2 for s in model.states]) if data.P0 is None else data.P0
    x = x + random.multivariate_normal(np.zeros(len(x)), P0)
    y = np.empty_like(data.y)
    for k in range(len(data)):
        u, at = of("inputs", data.u[k]), of("states", x)
        r = rows("outputs", model.noise(at, u, p))
        y[k] = rows("outputs", model.observe(at, u, p)) + r * random.normal(size=len(r))
        dt = data.dt[k] / substeps if k < len(data) - 1 else 0.0
        for _ in range(substeps if dt else 0):
            at = of("states", x)
            g = rows("states", model.diffusion(at, u, p))
            x = x + rows("states", model.drift(at, u, p)) * dt + g * np.sqrt(dt) * random.normal(size=len(x))
    y[~np.isfinite(data.y)] = np.nan
    return dataclasses.replace(data, y=y)
