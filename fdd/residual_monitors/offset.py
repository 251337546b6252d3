r"""The constant error of a baseline, learned from scores direction by direction until it is known well enough.

The baseline's error d is normal with covariance P. A block of scores is ``s = I d + e``, e with covariance
:math:`\sigma^2 I`. With :math:`I = L L^T` and :math:`L^T P L = Q \Lambda Q^T`, the numbers
:math:`Q^T L^+ (s - I d)` are independent with variances :math:`\sigma^2 + \lambda_i`. Directions with
:math:`\lambda_i > \sigma^2 / m` are known worse than from m such blocks and go on being learned (Kalman's update); the
others stand still, so that no later change of the plant is learned as normal. What is charted are departures from what
was foreseen (recursive residuals: Brown, Durbin and Evans 1975, J. R. Statist. Soc. B 37, 149-192): they have the
spread they are said to have while the error is large, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.records import FloatArray
from fdd.residual_monitors.information import NULL


@dataclass(frozen=True, slots=True)
class Residual:
    """A block's departure from what was foreseen; arrays (r, p).

    ``score`` has the known offset taken out. ``learned`` and ``standing`` are the variances of the score's mean, in
    units of its information, that the error gives it in directions that are learned and in those that stand still.
    """

    score: FloatArray
    learned: FloatArray
    standing: FloatArray


def residual(
    score: FloatArray,
    information: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    noise: FloatArray,
    enough: FloatArray,
) -> tuple[Residual, FloatArray, FloatArray]:
    """Departures of blocks from what was foreseen, and the error's mean and covariance after them.

    Parameters
    ----------
    score, information : shapes (r, p) and (r, p, p), sums over blocks
    mean, covariance : of the baseline's error, the same shapes
    noise : shape (r,), standard deviation of the standardised scores, 1 for white innovations
    enough : shape (r,), blocks m; 0: nothing is learned
    """
    departure = score - np.einsum("rij,rj->ri", information, mean)
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    seen = diagonal > 0
    scale = np.sqrt(np.where(seen, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / scale[:, :, None] / scale[:, None, :])
    told = values > NULL * information.shape[1]
    root = np.sqrt(np.where(told, values, 0.0))
    L = scale[:, :, None] * vectors * root[:, None, :]
    white = np.einsum("rij,ri->rj", vectors, departure / scale) / np.where(told, root, 1.0) * told
    lam, Q = np.linalg.eigh(L.transpose(0, 2, 1) @ covariance @ L)
    lam = np.maximum(lam, 0.0)
    variance = np.square(noise)[:, None]
    learns = lam * enough[:, None] > variance
    G = L @ Q
    share = np.square(G) / np.where(seen, diagonal, 1.0)[:, :, None]
    gain = covariance @ G * np.where(learns, 1.0 / (variance + lam), 0.0)[:, None, :]
    found = Residual(
        departure,
        np.einsum("rji,ri->rj", share, np.where(learns, lam, 0.0)),
        np.einsum("rji,ri->rj", share, np.where(learns, 0.0, lam)),
    )
    moved = mean + np.einsum("rij,rj->ri", gain, np.einsum("rij,ri->rj", Q, white))
    left = covariance - gain @ (covariance @ G).transpose(0, 2, 1)
    left = 0.5 * (left + left.transpose(0, 2, 1))
    quiet: NDArray[np.bool_] = ~learns.any(axis=1)
    return found, np.where(quiet[:, None], mean, moved), np.where(quiet[:, None, None], covariance, left)
