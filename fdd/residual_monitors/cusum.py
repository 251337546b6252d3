"""Two-sided tabular CUSUM: the quickest chart for a lasting shift of about twice the reference value."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import CAP, CLIP, Chart, Verdicts, conclude, per_stream
from fdd.residual_monitors.run_length import limit_for


class Cusum(Chart):
    r"""Cumulated sums of what exceeds the reference value, one for each direction.

    Tuned to a shift of 2 ``k`` standard deviations. Small and slow shifts: a smaller ``k``, or sums of a
    day (``daily``); of a physical parameter: ``score``.

    Equations
        .. math:: C^+_t = \max(0, C^+_{t-1} + z_t - k), \quad C^-_t = \max(0, C^-_{t-1} - z_t - k)

        Alarm when either exceeds h; both start from ``head_start`` h (Lucas and Crosier 1982).

    Parameters
    ----------
    limit : shape (n,), decision interval h [standard deviations]; 10.4 is one false alarm a year at 5 min and k = 0.5
    k : scalar or shape (n,), reference value [standard deviations]
    head_start : share of the limit the sums start from, at the beginning and after a reset; 0 for none, 0.5 is usual
    learn : see :class:`Chart`

    Raises
    ------
    ValueError
        Where ``k`` is negative or ``head_start`` outside [0, 1).

    References
    ----------
    Page, E. S. (1954), Biometrika 41, 100-115. Lucas, J. M., Crosier, R. B. (1982), Technometrics 24, 199-205.
    """

    kind = "cusum"
    _state = ("upper", "lower", "upper_age", "lower_age")

    def __init__(self, limit: ArrayLike, *, k: ArrayLike = 0.5, head_start: float = 0.0, learn: int = 0) -> None:
        super().__init__(limit, learn=learn)
        self.k = per_stream(k, self.n, "k")
        if not np.all(self.k >= 0):
            raise ValueError(
                f"cusum chart: reference value k is {np.min(self.k)}; give zero or more standard deviations"
            )
        if not 0 <= head_start < 1:
            raise ValueError(f"cusum chart: head_start is {head_start}; give a share of the limit in [0, 1)")
        self.head_start = float(head_start)
        self._forgiven = np.zeros(self.n)
        self.upper = self.limit * self.head_start
        self.lower = self.limit * self.head_start
        self.upper_age = np.zeros(self.n, dtype=np.int64)
        self.lower_age = np.zeros(self.n, dtype=np.int64)

    @classmethod
    def design(
        cls, arl: ArrayLike, *, k: float = 0.5, head_start: float = 0.0, shift_sd: float = 0.0, learn: int = 0
    ) -> Cusum:
        """A chart with these mean run lengths in control; ``shift_sd`` widens for a fitted baseline."""
        limit = limit_for("cusum", arl, k=k, head_start=head_start, shift_sd=shift_sd)
        return cls(limit, k=k, head_start=head_start, learn=learn)

    def allow_bias(self, shift: ArrayLike) -> None:
        """Forgive these shifts from now on, shape (n,) [standard deviations]: so much is added to k.

        For shifts of the mean that an imperfect baseline explains, where their size changes from update to update.
        """
        self._forgiven = np.array(np.broadcast_to(np.asarray(shift, dtype=np.float64), (self.n,)))

    def _step(self, z: FloatArray) -> Verdicts:
        phase, statistic, direction, age = _cusum(
            z, self.k + self._forgiven, self.limit, self.upper, self.lower, self.upper_age, self.lower_age,
            self.latched, self.side, self.onset,
        )  # fmt: skip
        return Verdicts(phase, statistic, self.limit, direction, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        self.upper[rows] = self.limit[rows] * self.head_start
        self.lower[rows] = self.limit[rows] * self.head_start
        self.upper_age[rows] = 0
        self.lower_age[rows] = 0


@numba.njit(cache=True)
def _cusum(
    z: FloatArray,
    k: FloatArray,
    limit: FloatArray,
    upper: FloatArray,
    lower: FloatArray,
    upper_age: IntArray,
    lower_age: IntArray,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.int8], IntArray]:
    n = z.shape[0]
    phase = np.empty(n, dtype=np.uint8)
    statistic = np.empty(n)
    direction = np.empty(n, dtype=np.int8)
    age = np.empty(n, dtype=np.int64)
    for i in range(n):
        seen = not np.isnan(z[i])
        if seen:
            value = min(max(z[i], -CLIP), CLIP)
            upper[i] = min(max(0.0, upper[i] + value - k[i]), CAP * limit[i])
            lower[i] = min(max(0.0, lower[i] - value - k[i]), CAP * limit[i])
        # Time passes in a gap too: ages count updates, so that the onset is a time.
        upper_age[i] = upper_age[i] + 1 if upper[i] > 0 else 0
        lower_age[i] = lower_age[i] + 1 if lower[i] > 0 else 0
        statistic[i] = max(upper[i], lower[i])
        sign = 0
        since = 0
        if upper[i] >= lower[i] and upper[i] > 0:
            sign, since = 1, upper_age[i]
        elif lower[i] > 0:
            sign, since = -1, lower_age[i]
        phase[i], direction[i], age[i] = conclude(i, seen, statistic[i], sign, since, limit[i], latched, side, onset)
    return phase, statistic, direction, age
