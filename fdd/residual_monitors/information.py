"""Parameter changes from sums of scores: what moved, by how much, how sure, and what the data cannot show.

With s the sum of scores at the baseline and I that of informations, s is normal with mean I d and covariance I when the
parameters have moved by d (asymptotic local approach: Benveniste, Basseville and Moustakides 1987, IEEE Transactions
on Automatic Control 32, 583-592).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.records import FloatArray

NULL = 1e-9
"""Eigenvalues of the scaled information below this share of its trace count as zero: a direction without data."""
LOADED = 1e-3
"""A parameter with more than this squared share in such directions cannot be estimated apart from others."""


@dataclass(frozen=True, slots=True)
class Change:
    """Estimated changes of the parameters on their estimation scale, each array (..., n_p).

    Attributes
    ----------
    joint, joint_error : change when all may have moved, I^-1 s, and its standard error; NaN and inf where the data
        cannot tell a parameter from others
    single, single_error : change when only this one moved, s_j / I_jj; NaN and inf where not visible at all
    gain : twice the log-likelihood gained by moving this one alone, s_j^2 / I_jj; the largest names the parameter
    isolated : projected score, joint / joint_error without the baseline's error: standard normal while this one
        stands still, whatever the others do
    visible : whether the data speak of the parameter at all
    """

    joint: FloatArray
    joint_error: FloatArray
    single: FloatArray
    single_error: FloatArray
    gain: FloatArray
    isolated: FloatArray
    visible: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def inverse(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pseudo-inverse of informations (..., n_p, n_p), and the share of each parameter in directions without data."""
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    seen = diagonal > 0
    scale = np.where(seen, 1.0 / np.sqrt(np.where(seen, diagonal, 1.0)), 0.0)
    scaled = information * scale[..., :, None] * scale[..., None, :]
    values, vectors = np.linalg.eigh(scaled)
    null = values <= NULL * information.shape[-1]
    weights = np.where(null, 0.0, 1.0 / np.where(null, 1.0, values))
    back = np.einsum("...ik,...k,...jk->...ij", vectors, weights, vectors)
    share = np.einsum("...ik,...k->...i", vectors**2, null.astype(np.float64))
    return back * scale[..., :, None] * scale[..., None, :], np.where(seen, share, 1.0)


def change(
    score: FloatArray, information: FloatArray, covariance: FloatArray | None = None, spread: FloatArray | float = 1.0
) -> Change:
    """Estimate the change behind sums of scores and informations.

    Parameters
    ----------
    score, information : shape (..., n_p) and (..., n_p, n_p), sums over the time since the change
    covariance : shape (..., n_p, n_p), covariance of the baseline's own parameters; widens the errors
    spread : standard deviation of the standardised score on healthy data, 1 for white innovations; widens the errors
    """
    inv, lost = inverse(information)
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    visible = diagonal > 0
    safe = np.where(visible, diagonal, 1.0)
    told = visible & (lost < LOADED)
    own = np.zeros(()) if covariance is None else np.diagonal(covariance, axis1=-2, axis2=-1)
    variance = np.where(told, np.diagonal(inv, axis1=-2, axis2=-1), 1.0) * np.square(spread)
    joint = np.einsum("...ij,...j->...i", inv, score)
    return Change(
        joint=np.where(told, joint, np.nan),
        joint_error=np.where(told, np.sqrt(variance + own), np.inf),
        single=np.where(visible, score / safe, np.nan),
        single_error=np.where(visible, np.sqrt(np.square(spread) / safe + own), np.inf),
        gain=np.where(visible, score**2 / safe, 0.0) / np.square(spread),
        isolated=np.where(told, joint / np.sqrt(variance), np.nan),
        visible=visible,
    )
