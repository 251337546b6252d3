"""Dispersion over a window: do the innovations still vary as much as the filter says they do?"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.autocorrelation import share_of_windows
from fdd.residual_monitors.chart import per_stream
from fdd.residual_monitors.window import WindowChart


class Dispersion(WindowChart):
    r"""Chi-square test on the variance of windows side by side, two-sided.

    Noise that has grown or gone over a day, however it is spread within it. The mean is taken
    out, so that a plain shift is left to ``cusum``.

    Equations
        .. math:: x = \frac{(V / (N - 1))^{1/3} - 1 + 2 / (9 (N - 1))}{\sqrt{2 / (9 (N - 1))}}, \quad
                  V = \sum_t (z_t - \bar z)^2 \sim \chi^2_{N - 1}

        standard normal to a part in a thousand of its tail (Wilson and Hilferty). The statistic is the distance of x
        from ``centre``. Direction +1: too large.

    Parameters
    ----------
    limit : shape (n,), on the distance
    window : values of a window N
    block : values seen that make one of them, summed over the root of their number
    centre : scalar or shape (n,), x of a healthy stream; 0 where the filter's variance is right

    References
    ----------
    Wilson, E. B., Hilferty, M. M. (1931), Proc. Natl. Acad. Sci. 17, 684-688.
    """

    kind = "dispersion"

    def __init__(self, limit: ArrayLike, *, window: int = 288, centre: ArrayLike = 0.0, block: int = 1) -> None:
        super().__init__(limit, window=window, block=block)
        self.centre = per_stream(centre, self.n, "centre")

    @classmethod
    def design(cls, arl: ArrayLike, *, window: int = 288) -> Dispersion:
        """A chart with these mean numbers of values between false alarms."""
        return cls(-ndtri(share_of_windows(arl, window) / 2), window=window)

    def scores(self, values: FloatArray) -> FloatArray:
        """x of each full window, (rows, window) -> (rows,)."""
        dof = self.window - 1
        ratio = values.var(axis=1) * self.window / dof
        return np.asarray((np.cbrt(ratio) - 1 + 2 / (9 * dof)) / np.sqrt(2 / (9 * dof)))

    def _test(self, values: FloatArray, streams: IntArray) -> tuple[FloatArray, FloatArray]:
        away = self.scores(values) - self.centre[streams]
        return np.abs(away), np.sign(away)
