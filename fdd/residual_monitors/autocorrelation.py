"""Autocorrelation over a window: are the innovations still white, that is, does the model still hold?"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.window import WindowChart


class Autocorrelation(WindowChart):
    r"""Portmanteau test on windows side by side: the model's health, apart from the plant's.

    Alarms when the innovations have gained a memory (dynamics changed, a loop hunts, a filter mistuned); their mean and
    spread are taken out, so that a plain shift is left to ``cusum``. Slow oscillations of any period: ``periodogram``.

    Equations
        .. math:: Q = \sum_{j=1}^{m} (N - j - 1/2) (\operatorname{artanh} \kappa_j - \mu_j)^2 \sim \chi^2_m

        with kappa the partial autocorrelations by Burg's recursion, whose means under whiteness are mu = -1/N at odd
        and -2/N at even lags. Ljung and Box's statistic of the plain autocorrelations has three times too many values
        beyond its 1e-3 limit at N = 96 and twice at N = 288, and budgets live in that tail; this one holds to 1e-4.
        The direction is the sign of kappa_1.

    Parameters
    ----------
    limit : shape (n,), on Q
    window : values of a window N
    block : values seen that make one of them, summed over the root of their number
    lags : m

    References
    ----------
    Ljung, G. M., Box, G. E. P. (1978), Biometrika 65, 297-303. Monti, A. C. (1994), Biometrika 81, 776-780 (partial
    autocorrelations). Burg, J. P. (1975), Maximum Entropy Spectral Analysis.
    """

    kind = "autocorrelation"

    def __init__(self, limit: ArrayLike, *, window: int = 288, lags: int = 12, block: int = 1) -> None:
        super().__init__(limit, window=window, block=block)
        if not 1 <= lags <= window // 8:
            raise ValueError(f"autocorrelation chart: {lags} lags in a window of {window}; give 1 to {window // 8}")
        self.lags = int(lags)

    @classmethod
    def design(cls, arl: ArrayLike, *, window: int = 288, lags: int = 12) -> Autocorrelation:
        """A chart with these mean numbers of values between false alarms."""
        return cls(chi2.isf(share_of_windows(arl, window), lags), window=window, lags=lags)

    def _test(self, values: FloatArray, streams: IntArray) -> tuple[FloatArray, FloatArray]:
        return _portmanteau(values, self.lags)


def share_of_windows(arl: ArrayLike, window: int) -> FloatArray:
    """Probability of a false alarm in a window that gives this mean number of values between them."""
    wanted = np.array(arl, dtype=np.float64, ndmin=1) / window
    if not np.all(wanted >= 2):
        raise ValueError(
            f"a mean of {np.min(wanted) * window:g} values between false alarms is less than two windows of {window}; "
            "shorten the window or lower the budget"
        )
    return np.asarray(1.0 / wanted)


@numba.njit(cache=True)
def _portmanteau(values: FloatArray, lags: int) -> tuple[FloatArray, FloatArray]:
    """Q and kappa_1 of each row; zero for a row that does not vary."""
    rows, count = values.shape
    q, first = np.zeros(rows), np.zeros(rows)
    forward, backward = np.empty(count), np.empty(count)
    for i in range(rows):
        mean = 0.0
        for t in range(count):
            mean += values[i, t]
        mean /= count
        for t in range(count):
            forward[t] = values[i, t] - mean
            backward[t] = forward[t]
        for j in range(1, lags + 1):
            product, power = 0.0, 0.0
            for t in range(j, count):
                product += forward[t] * backward[t - 1]
                power += forward[t] * forward[t] + backward[t - 1] * backward[t - 1]
            if power <= 1e-20 * count:
                break
            kappa = min(max(2 * product / power, -1 + 1e-9), 1 - 1e-9)
            for t in range(count - 1, j - 1, -1):
                ahead = forward[t]
                forward[t] = ahead - kappa * backward[t - 1]
                backward[t] = backward[t - 1] - kappa * ahead
            if j == 1:
                first[i] = kappa
            away = np.arctanh(kappa) + (1.0 if j % 2 == 1 else 2.0) / count
            q[i] += (count - j - 0.5) * away * away
    return q, first
