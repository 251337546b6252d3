"""Pre-whitening and robust scale: what to do with innovations that are not quite white, nor quite of variance one.

A model is never perfect. What colour its innovations keep on healthy data is taken out by an autoregression fitted
there, once, and frozen: charts are designed for white input, and for AR(1) with rho 0.5 a limit for 465 gives 52.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray, JsonObject
from fdd.residual_monitors.chart import StateError

MAD_TO_SD = 1.482602218505602
SHORTEST = 50
"""Fewest baseline values a stream needs to be whitened; with less it is only passed on."""


def robust_scale(values: ArrayLike, axis: int = 0) -> FloatArray:
    """Standard deviation from the median absolute deviation, ignoring NaN; 37 % efficient, and unmoved by outliers."""
    x = np.asarray(values, dtype=np.float64)
    middle = np.nanmedian(x, axis=axis, keepdims=True)
    return np.asarray(MAD_TO_SD * np.nanmedian(np.abs(x - middle), axis=axis))


class Whitener:
    r"""Autoregression of each stream, run online: standardised innovations in, whiter ones out.

    Equations
        .. math:: e_t = (x_t - \mu - \sum_j \phi_j (x_{t-j} - \mu)) / \sigma

        A value follows only ``order`` values seen in a row; until then the output is NaN (nothing seen).

    Parameters
    ----------
    coefficients : shape (n, p), phi
    mean, scale : shape (n,), mu and sigma; :meth:`fit` keeps mu at 0 unless told, so that a bias of the model stays
        visible to the charts
    """

    schema = 1

    def __init__(self, coefficients: ArrayLike, mean: ArrayLike, scale: ArrayLike) -> None:
        self.coefficients = np.array(coefficients, dtype=np.float64, ndmin=2, order="C")
        self.n, self.order = self.coefficients.shape
        self.mean = np.array(np.broadcast_to(mean, (self.n,)), dtype=np.float64)
        self.scale = np.array(np.broadcast_to(scale, (self.n,)), dtype=np.float64)
        if not np.all(np.isfinite(self.coefficients)) or not np.all(self.scale > 0):
            raise ValueError("whitener: coefficients must be finite and scales positive; refit on a longer baseline")
        self.recent = np.zeros((self.n, max(1, self.order)))
        self.run = np.zeros(self.n, dtype=np.int64)

    @classmethod
    def fit(cls, values: ArrayLike, order: int = 2, *, centre: bool = False, floor: float = 0.0) -> Whitener:
        """Fit each stream on healthy data.

        Parameters
        ----------
        values : shape (time, n), NaN where nothing was seen
        order : p; 0 fits the scale alone
        centre : also take out the mean
        floor : least scale [standard deviations of the input]; a signal stuck on the baseline must not blow up others
        """
        x = np.array(values, dtype=np.float64, ndmin=2)
        mean = np.nanmean(x, axis=0) if centre else np.zeros(x.shape[1])
        centred = x - mean
        phi = np.array([_autoregression(column, order) for column in centred.T]).reshape(x.shape[1], order)
        out = cls(phi, mean, np.ones(x.shape[1]))
        left = np.array([out.update(row) for row in x])
        scale = np.maximum(robust_scale(left), floor)
        short = np.isfinite(left).sum(axis=0) < SHORTEST
        return cls(phi, mean, np.where(short | ~(scale > 0), 1.0, scale))

    def update(self, z: ArrayLike) -> FloatArray:
        """Whitened values of this step, shape (n,)."""
        values = np.ascontiguousarray(z, dtype=np.float64)
        if values.shape != (self.n,):
            raise ValueError(f"whitener of {self.n} streams: update got shape {values.shape}")
        return _whiten(values, self.coefficients, self.mean, self.scale, self.recent, self.run)

    def reset(self, which: NDArray[np.bool_] | None = None) -> None:
        """Forget recent values (after a change of mode); coefficients stay."""
        rows = slice(None) if which is None else which
        self.recent[rows] = 0.0
        self.run[rows] = 0

    def export_state(self) -> JsonObject:
        """Recent values; coefficients belong to the baseline."""
        return {"schema": self.schema, "recent": self.recent.copy(), "run": self.run.copy()}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` was called."""
        recent = np.array(state.get("recent", ()), dtype=np.float64)
        run = np.array(state.get("run", ()), dtype=np.int64)
        if state.get("schema") != self.schema or recent.shape != self.recent.shape or run.shape != self.run.shape:
            raise StateError(
                f"whitener: saved state has schema {state.get('schema')!r} and shape {recent.shape}, this one needs "
                f"{self.schema} and {self.recent.shape}; start it anew (it takes {self.order} values)"
            )
        self.recent, self.run = np.ascontiguousarray(recent), run


def _autoregression(x: FloatArray, order: int) -> FloatArray:
    """Least squares on runs of seen values, outliers held at 4 robust standard deviations; zero for short data."""
    if order == 0 or np.isfinite(x).sum() < SHORTEST:
        return np.zeros(order)
    most = 4 * float(robust_scale(x))
    if not most > 0:
        return np.zeros(order)
    held = np.clip(x, -most, most)
    columns = np.stack([held[order - j : len(held) - j] for j in range(order + 1)], axis=1)
    columns = columns[np.isfinite(columns).all(axis=1)]
    if len(columns) < SHORTEST:
        return np.zeros(order)
    phi = np.linalg.lstsq(columns[:, 1:], columns[:, 0], rcond=None)[0]
    roots = np.roots(np.concatenate([[1.0], -phi]))
    reach = float(np.max(np.abs(roots))) if roots.size else 0.0
    # An estimate on or beyond the unit circle says that the mean wanders; hold it just inside.
    shrink = min(1.0, 0.98 / reach) if reach > 0 else 1.0
    return np.asarray(phi * shrink ** np.arange(1, order + 1))


@numba.njit(cache=True)
def _whiten(
    z: FloatArray, phi: FloatArray, mean: FloatArray, scale: FloatArray, recent: FloatArray, run: IntArray
) -> FloatArray:
    n, order = phi.shape
    out = np.full(n, np.nan)
    for i in range(n):
        if not np.isfinite(z[i]):
            run[i] = 0
            continue
        value = z[i] - mean[i]
        if run[i] >= order:
            left = value
            for j in range(order):
                left -= phi[i, j] * recent[i, j]
            out[i] = left / scale[i]
        for j in range(order - 1, 0, -1):
            recent[i, j] = recent[i, j - 1]
        if order > 0:
            recent[i, 0] = value
        run[i] += 1
    return out
