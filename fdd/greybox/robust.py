"""The robust likelihood: what a measurement beyond ``huber`` standard deviations may do to states and estimates.

A filter cannot be made robust by its likelihood alone, because an outlier it has taken in spoils the samples after it:
beyond the bound c an innovation e moves state and covariance as if its variance were e^2 / c^2, so that it counts as
one of c standard deviations with a larger error (Huber 1964; Masreliez and Martin 1977 for filters).

Its loss rho is quadratic up to c. Huber's linear growth beyond would bound what an outlier does to means but not what
it does to variances, z rho'(z) = c |z|, and here the gains hang on the variances. Beyond c it is therefore

    z rho'(z) = k + (c^2 - k) c^2 / z^2,        k = TAIL

which falls from c^2 to a remainder k. The remainder must not vanish: with k less than the expectation of z rho'(z) a
variance going to zero, for which every sample is an outlier, would be the most likely. The loss is divided by that
expectation for a standard normal z, so that variances of normal data are estimated without bias (Huber 1981, ch. 5).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
TAIL = 1.5


def expectation(bound: float) -> float:
    """Expectation of z rho'(z) of a standard normal z; one without bound."""
    if not math.isfinite(bound):
        return 1.0
    square, tail = bound**2, min(TAIL, bound**2)
    beyond = math.erfc(bound / math.sqrt(2))
    density = math.exp(-0.5 * square) / math.sqrt(2 * math.pi)
    inverse = 2 * density / bound - beyond  # of 1 / z^2 beyond the bound
    return 1 - beyond - 2 * bound * density + tail * beyond + (square - tail) * square * inverse


def loss(z2: FloatArray, bound: float) -> FloatArray:
    """2 rho of squared standardised innovations, over its expectation."""
    square, tail = bound**2, min(TAIL, bound**2)
    far = z2 > square
    out = z2.copy()
    out[far] = square + tail * np.log(z2[far] / square) + (square - tail) * (1 - square / z2[far])
    return out / expectation(bound)
