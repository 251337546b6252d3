"""How likely a component's departure is under each hypothesis.

The evidence is one vector x: the standardised score of every physical parameter, z_j = s_j / sqrt(I_jj), the sum of
every output's standardised innovations over sqrt(n), and every output's largest jump at the onset. Under a fault whose
signature is (m, b, c) and whose extent is a,

.. math:: E x = a (D I m, \\sqrt{n} b, c), \\quad D = diag(I_{jj}^{-1/2})

with the covariance of healthy data, D I D with the spread of the baseline's scores and with what its own error adds,
and the scatter of the signature, which grows with a. The likelihood is the Gaussian density, averaged over extents that
are equally likely on a log scale. *Model* stands for what no signature explains: the same vector, pointing anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.departure import Departure
from fdd.diagnosis.hypotheses import PRIOR, Hypothesis
from fdd.records import FloatArray

EXTENTS = np.geomspace(0.03, 10.0, 25)
"""Extents of a fault, in multiples of the size that its signature was measured with."""
SCATTER, FLOOR = 0.25, 0.08
"""A signature holds for another plant to this share of each element, and of the whole vector's length."""
JUMP_SD = 3.5
"""The largest of some hundred healthy innovations, as a standard deviation."""
ANYWHERE = np.geomspace(2.0, 60.0, 6)
"""Lengths an unexplained vector may have [standard deviations an element]."""
TINY = 1e-6


@dataclass(frozen=True, slots=True)
class Judged:
    """A hypothesis against the evidence: log-likelihood, the extent that fits best, and what it then expects.

    ``expected`` and ``sd`` are those of the evidence vector at that extent, (n,).
    """

    hypothesis: Hypothesis
    log_likelihood: float
    extent: float
    expected: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class Vector:
    """The evidence as one vector, and its covariance on healthy data."""

    x: FloatArray
    covariance: FloatArray
    gain: FloatArray
    """D I, (n_p, n_p): from a shift of the parameters to their standardised scores"""
    weight: FloatArray
    """sqrt(n) of each output, (n_y,)"""

    @classmethod
    def of(cls, d: Departure) -> Vector:
        """From a departure; a parameter that the data do not speak of has no weight."""
        diagonal = np.diagonal(d.information)
        scale = np.where(diagonal > 0, 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
        gain = scale[:, None] * d.information
        healthy = gain * scale[None, :] * np.outer(d.spread, d.spread) + gain @ d.baseline @ gain.T
        n_p, n_y = len(d.symbols), len(d.outputs)
        covariance = np.zeros((n_p + 2 * n_y, n_p + 2 * n_y))
        covariance[:n_p, :n_p] = healthy + np.diag(np.where(diagonal > 0, TINY, 1.0))
        covariance[n_p : n_p + n_y, n_p : n_p + n_y] = np.eye(n_y)
        covariance[n_p + n_y :, n_p + n_y :] = JUMP_SD**2 * np.eye(n_y)
        weight = np.sqrt(np.maximum(d.count, 0.0))
        sums = np.where(weight > 0, d.innovation / np.maximum(weight, 1.0), 0.0)
        return cls(np.concatenate([d.score * scale, sums, d.jump]), covariance, gain, weight)

    def expected(self, h: Hypothesis, extent: float) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance under a hypothesis."""
        n_p = len(h.shift)
        mean = extent * np.concatenate([self.gain @ h.shift, self.weight * h.mean, h.jump])
        shift = np.square(extent * h.shift_sd) + np.square(SCATTER * extent * h.shift)
        scatter = np.zeros_like(self.covariance)
        scatter[:n_p, :n_p] = (self.gain * shift) @ self.gain.T
        rest = extent * np.concatenate([self.weight * h.mean_sd, h.jump_sd])
        scatter[n_p:, n_p:] = np.diag(np.square(rest) + np.square(SCATTER * mean[n_p:]))
        for part in (slice(0, n_p), slice(n_p, n_p + len(h.mean)), slice(n_p + len(h.mean), None)):
            length = float(np.sqrt(np.sum(np.square(mean[part]))))
            scatter[part, part] += np.square(FLOOR * length) * np.eye(len(mean[part]))
        return mean, self.covariance + scatter


def log_density(x: FloatArray, covariance: FloatArray) -> float:
    """Of a normal vector around zero.

    Parameters whose scores differ by many orders of magnitude leave a covariance that is positive definite on paper and
    not in doubles: it is taken as a correlation, and directions below rounding are held at rounding.
    """
    sd = np.sqrt(np.diagonal(covariance))
    correlation, z = covariance / np.outer(sd, sd), x / sd
    try:
        root = np.linalg.cholesky(correlation)
        white, half = np.linalg.solve(root, z), float(np.log(np.diagonal(root)).sum())
    except np.linalg.LinAlgError:
        variance, axes = np.linalg.eigh((correlation + correlation.T) / 2)
        variance = np.maximum(variance, len(x) * np.finfo(np.float64).eps * variance[-1])
        white, half = (axes.T @ z) / np.sqrt(variance), float(np.log(variance).sum() / 2)
    return float(-0.5 * white @ white - half - np.log(sd).sum())


def judge(h: Hypothesis, vector: Vector) -> Judged:
    """A hypothesis' likelihood, averaged over extents; both sides unless it knows only one."""
    extents = EXTENTS if h.signed else np.concatenate([EXTENTS, -EXTENTS])
    logs = np.empty(len(extents))
    for i, a in enumerate(extents.tolist()):
        mean, covariance = vector.expected(h, a)
        logs[i] = log_density(vector.x - mean, covariance)
    best = int(logs.argmax())
    mean, covariance = vector.expected(h, float(extents[best]))
    average = float(np.logaddexp.reduce(logs) - np.log(len(extents)))
    return Judged(h, average, float(extents[best]), mean, np.sqrt(np.diagonal(covariance)))


def unexplained(vector: Vector) -> float:
    """Log-likelihood of a departure that points anywhere."""
    eye = np.eye(len(vector.x))
    logs = [log_density(vector.x, vector.covariance + s**2 * eye) for s in ANYWHERE.tolist()]
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def shares(judged: Sequence[Judged], vector: Vector) -> tuple[FloatArray, float]:
    """Posterior share of every hypothesis, and that of *model*; they add up to one."""
    logs = np.array(
        [j.log_likelihood + np.log(j.hypothesis.prior) for j in judged] + [unexplained(vector) + np.log(PRIOR["model"])]
    )
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    return weights[:-1], float(weights[-1])
