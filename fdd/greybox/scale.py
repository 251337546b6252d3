"""The scale that estimation works on: logarithms of what is positive, logits of what is bounded, and priors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.models.declare import ComponentModel, Parameter

FloatArray = NDArray[np.float64]
LOGIT_EDGE = 14.0  # a logit is cut where its parameter is within 1e-6 of a bound


class ParameterError(ValueError):
    """A start, fixed value or prior that cannot be used; the text names parameter, value, limit and remedy."""


@dataclass(frozen=True, slots=True)
class Prior:
    """Normal knowledge about a parameter before the data, natural scale and unit: mean and standard deviation.

    With ``log`` the logarithm is normal: ``mean`` is the median, natural, and ``sd`` the standard deviation of the
    logarithm, 0.3 for "within 30 % or so".
    """

    mean: float
    sd: float
    log: bool = False

    def __post_init__(self) -> None:
        if not (self.sd > 0 and math.isfinite(self.mean)):
            raise ParameterError(f"a prior needs a finite mean and a positive sd, not {self.mean}, {self.sd}")
        if self.log and not self.mean > 0:
            raise ParameterError(f"a log-normal prior needs a positive median, not {self.mean}; leave log out")

    def penalty(self, value: float, slope: float) -> tuple[float, float, float]:
        """Negative log density at a natural value; its slope and (positive) curvature where d value / d scale is given.

        The density is that of the scale the prior is normal on.
        """
        z = (math.log(value / self.mean) if self.log else value - self.mean) / self.sd
        rate = slope / (value if self.log else 1.0) / self.sd
        return 0.5 * z * z + math.log(self.sd * math.sqrt(2 * math.pi)), z * rate, rate * rate

    def words(self) -> str:
        """What is taken to be known."""
        return f"{self.mean:g} times or over e^{self.sd:g}" if self.log else f"{self.mean:g} +- {self.sd:g}"


def to_scale(q: Parameter, value: float) -> float:
    """Natural value to the scale estimation works on."""
    if q.transform == "log":
        return math.log(value)
    if q.transform == "logit":
        share = (value - q.lower) / (q.upper - q.lower)
        edge = 0.5 * (1 - math.tanh(LOGIT_EDGE / 2))
        share = min(max(share, edge), 1 - edge)
        return math.log(share / (1 - share))
    return value


def from_scale(q: Parameter, theta: float) -> float:
    """Back to the natural value; a bound comes back as itself, which exp(log bound) is not."""
    if q.transform == "log":
        value = math.exp(theta)
        for bound in (q.lower, q.upper):
            if abs(value - bound) <= 1e-12 * bound:
                return bound
        return value
    if q.transform == "logit":
        share = 0.5 * (1 + math.tanh(theta / 2))
        return min(max(q.lower + (q.upper - q.lower) * share, q.lower), q.upper)
    return theta


def chain(model: ComponentModel, values: FloatArray) -> FloatArray:
    """d natural / d scale for each parameter; ``values`` (..., n_p) natural."""
    out = np.ones_like(values)
    for k, q in enumerate(model.parameters):
        v = values[..., k]
        if q.transform == "log":
            out[..., k] = v
        elif q.transform == "logit":
            out[..., k] = (v - q.lower) * (q.upper - v) / (q.upper - q.lower)
    return out


def scale_bounds(q: Parameter) -> tuple[float, float]:
    """Bounds on the transform scale."""
    if q.transform == "logit":
        return -LOGIT_EDGE, LOGIT_EDGE
    return to_scale(q, q.lower), to_scale(q, q.upper)


def scale_unit(q: Parameter) -> float:
    """What counts as one step of a parameter: a factor e on a log scale, its typical size otherwise."""
    if q.transform != "identity" or q.kind == "noise":
        return 1.0
    return max(abs(q.typical) * 0.3, min(1.0, (q.upper - q.lower) * 0.1))
