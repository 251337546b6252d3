"""Cumulated periodogram over a window: colour at any frequency, such as a hunting loop or a daily rhythm."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import lambertw
from scipy.stats import kstwo

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.autocorrelation import share_of_windows
from fdd.residual_monitors.window import WindowChart

BEND = 30.0
"""What log x is bent by; see :meth:`Periodogram.straightened`."""


class Periodogram(WindowChart):
    r"""Kolmogorov-Smirnov test on the cumulated periodogram of windows side by side.

    Power that gathers at low frequencies (drift, a forgotten slow state) or at a line (hunting) bends the straight line
    that white innovations give. Short memory: ``autocorrelation``.

    Equations
        .. math:: C_k = \sum_{j \le k} I_j / \sum_{j \le q} I_j, \quad D = \max_k |C_k - k / q|

        over the q = (N - 1) // 2 ordinates; for white normal values the C are ordered uniforms, so that the limit is
        exact. Direction +1: too much at low frequencies.

    Parameters
    ----------
    limit : shape (n,), on D
    window : values of a window N
    block : values seen that make one of them, summed over the root of their number

    References
    ----------
    Bartlett, M. S. (1955), An Introduction to Stochastic Processes. Durbin, J. (1969), Biometrika 56, 1-15.
    """

    kind = "periodogram"

    def __init__(self, limit: ArrayLike, *, window: int = 288, block: int = 1) -> None:
        super().__init__(limit, window=window, block=block)

    @classmethod
    def design(cls, arl: ArrayLike, *, window: int = 288) -> Periodogram:
        """A chart with these mean numbers of values between false alarms."""
        return cls(kstwo.isf(share_of_windows(arl, window), (window - 1) // 2 - 1), window=window)

    def straightened(self, statistic: ArrayLike) -> FloatArray:
        """D on a scale on which that of white windows is nearly normal, out to the rarest.

        log x + x^2 / 30 with x = D sqrt(q - 1): log D alone has too light a tail, since P(D > d) falls as exp(-2 x^2)
        (Smirnov). Limits at Student's quantiles of 27 white windows are passed 1.09, 1.00 and 0.85 times as often as
        they say, at 1e-2, 1.4e-3 and 5e-5.
        """
        x2 = np.square(statistic) * self._ordinates
        return np.asarray(0.5 * np.log(x2) + x2 / BEND)

    def bent(self, value: ArrayLike) -> FloatArray:
        """D of values of :meth:`straightened`; beyond 1 where D cannot be so large."""
        x2 = 0.5 * BEND * lambertw(2 / BEND * np.exp(2 * np.minimum(value, 30.0))).real
        return np.asarray(np.sqrt(x2 / self._ordinates))

    @property
    def _ordinates(self) -> int:
        return (self.window - 1) // 2 - 1

    def _test(self, values: FloatArray, streams: IntArray) -> tuple[FloatArray, FloatArray]:
        q = (self.window - 1) // 2
        # One row at a time: a transform of many rows may round otherwise than one of one.
        spectrum = np.array([np.fft.rfft(row - row.mean()) for row in values])[:, 1 : q + 1]
        power = np.cumsum(spectrum.real**2 + spectrum.imag**2, axis=1)
        total = power[:, -1:]
        # A window that does not vary has no power: it is held to be white, and left to other charts.
        share = np.divide(power[:, :-1], total, out=np.tile(np.arange(1, q) / q, (len(power), 1)), where=total > 1e-20)
        rank = np.arange(1, q)
        low = np.max(share - (rank - 1) / (q - 1), axis=1)
        high = np.max(rank / (q - 1) - share, axis=1)
        return np.maximum(low, high), np.where(low >= high, 1.0, -1.0)
