"""A chart on the day's sum of bounded innovations, for models that are a little wrong: held-out days say how much."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from fdd.records import FloatArray, IntArray, JsonObject
from fdd.residual_monitors.chart import CAP, LEARNING, QUIET, Chart, Verdicts, conclude

BOUND = 3.0
"""An innovation counts as at most so many standard deviations: opened windows and lost samples are no faults."""
BOUNDED = 0.99748
"""Standard deviation of a standard normal bounded so."""
DAY_BOUND = 2.0
"""A day counts as at most so many of its own standard deviations: no single day rings."""
GROSS, GROSS_BOUND = 3.0, 8.0
"""Reference value and bound of a day while the chart is on probation or outside the range it has seen."""
DEGREES = 7.0
"""Days that the prior of the scale, 1, is worth."""
WEEKS = 4.0
"""Weeks that the prior of the ratio of weekly to daily scale, 1, is worth."""
WEEK = 7
WANDER = 0.5
"""Variance of the mean from week to week beyond what conditions explain, in that of a day."""
MEMORY = 56
"""Days over which scales are learned."""
ENOUGH = 56.0
"""A day like at least so many that were seen teaches nothing more."""
RANGE = 1.0
"""A day is judged while what it adds to the variance by being unlike those seen is less than a day's own."""
READY = 7
"""Days of probation after which a chart judges; the fewer days, the wider its predictions are."""
HOLD = 0.5
"""A stream with a statistic above this share of its limit learns nothing."""
LATTICE = 40
"""Steps a standard deviation in which run lengths are computed."""
KNOWLEDGE = ("coefficients", "covariance", "squares", "degrees", "weekly", "weeks", "days")
"""What was learned of a stream, apart from what its chart is doing at present."""


class Daily(Chart):
    r"""Two-sided CUSUM on recursive residuals of the day's sum of bounded values.

    The day's mean of a model that is a little wrong moves with weather and load, and its sums vary more than those of
    white noise. Both are learned from days that the fit has not seen, by regression on the day's conditions: a day is
    judged by its departure from what days like it have shown, in units of the standard deviation of that prediction,
    which grows where conditions leave the range seen. For models that are true, ``score`` and ``cusum`` are quicker.

    Equations
        .. math:: x = \sum \min(\max(z, -3), 3) / \sqrt n, \quad
                  w = \frac{x - \phi^T b}{s \sqrt{1 + v + \phi^T P \phi}}, \quad \phi = (1, c_1, ..., c_q)

        with b and P by recursive least squares from a unit prior, s^2 the larger of 1 and the mean square of past
        residuals times the ratio of weekly to daily variance, and v = 0.5 for a mean that wanders. w is bounded at 2
        and charted as by :class:`fdd.residual_monitors.cusum.Cusum`; limits are those for bounded values.

        A day teaches while the chart is on probation; later only where it is unlike those seen, by
        :math:`\phi^T P \phi > (q + 1) / 56`, so that a fault in known conditions is never learned. A chart in alarm or
        near it learns nothing. In the first 7 days, and where :math:`\phi^T P \phi > 1`, only gross departures ring.

    Parameters
    ----------
    limit : shape (n,), decision interval [standard deviations of a day]
    block : values seen that make a day
    k : reference value of the CUSUM
    conditions : number q of conditions that come with each value
    probation : days over which the chart learns first; 0: values are white, nothing is ever learned

    References
    ----------
    Brown, R. L., Durbin, J., Evans, J. M. (1975), J. R. Statist. Soc. B 37, 149-192 (recursive residuals).
    """

    kind = "daily"
    _state = (
        "total", "count", "elapsed", "condition", "upper", "lower", "upper_age", "lower_age", "leverage", "week",
        "in_week", "closed", "judged", *KNOWLEDGE,
    )  # fmt: skip

    def __init__(
        self, limit: ArrayLike, *, block: int = 288, k: float = 0.5, conditions: int = 0, probation: int = 0
    ) -> None:
        super().__init__(limit)
        if block < 1 or conditions < 0 or probation < 0:
            raise ValueError(
                f"daily chart: block {block}, conditions {conditions}, probation {probation}; give a block of at least "
                "one value and no negative numbers"
            )
        self.block, self.k, self.conditions, self.probation = int(block), float(k), int(conditions), int(probation)
        n, p = self.n, 1 + self.conditions
        self.centre, self.width = np.zeros((n, p - 1)), np.zeros((n, p - 1))
        self.total, self.condition = np.zeros(n), np.zeros((n, p - 1))
        self.count, self.elapsed = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self.upper, self.lower = np.zeros(n), np.zeros(n)
        self.upper_age, self.lower_age = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self.leverage, self.week = np.zeros(n), np.zeros(n)
        self.in_week = np.zeros(n, dtype=np.int64)
        self.closed, self.judged = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self.coefficients, self.covariance = np.zeros((n, p)), np.tile(np.eye(p), (n, 1, 1))
        self.squares, self.degrees = np.full(n, DEGREES), np.full(n, DEGREES)
        self.weekly, self.weeks = np.full(n, WEEKS), np.full(n, WEEKS)
        self.days = np.zeros(n, dtype=np.int64)

    @classmethod
    def design(
        cls, arl: ArrayLike, *, block: int = 288, k: float = 0.5, conditions: int = 0, probation: int = 0
    ) -> Daily:
        """Charts with these mean numbers of *values* between false alarms."""
        days = np.array(arl, dtype=np.float64, ndmin=1) / block
        return cls(bounded_limit(days, k), block=block, k=k, conditions=conditions, probation=probation)

    def presume(self, rows: NDArray[np.bool_], centre: FloatArray, width: FloatArray, *, anew: bool = True) -> None:
        """Centre and width of each condition, (n, q); of a width of zero nothing is learned.

        What was learned is forgotten; unless ``anew``, scales and the days of probation stay.
        """
        self.centre[rows], self.width[rows] = centre[rows], width[rows]
        fresh = Daily(self.limit, block=self.block, conditions=self.conditions, probation=self.probation)
        learned = KNOWLEDGE if anew else ("coefficients", "covariance")
        for name in (*learned, "week", "in_week", "leverage", "closed", "judged"):
            getattr(self, name)[rows] = getattr(fresh, name)[rows]

    def knowledge(self, stream: int) -> JsonObject:
        """What held-out days have taught of a stream, plain data."""
        return {name: getattr(self, name)[stream].tolist() for name in KNOWLEDGE}

    def recall(self, stream: int, knowledge: JsonObject) -> None:
        """Take up what :meth:`knowledge` gave, of as many conditions."""
        for name in KNOWLEDGE:
            getattr(self, name)[stream] = knowledge[name]

    @property
    def scale(self) -> FloatArray:
        """Standard deviation of a day in conditions seen, (n,), in that of white noise."""
        return np.array([scale_of(self.knowledge(i)) if self.probation else 1.0 for i in range(self.n)])

    @property
    def ready(self) -> NDArray[np.bool_]:
        """Streams that judge: enough of their probation is over, (n,)."""
        return np.asarray(self.days >= min(READY, self.probation))

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Streams whose last day was within the range that they have seen, (n,)."""
        return np.asarray(self.leverage <= RANGE)

    def update_days(self, z: ArrayLike, conditions: FloatArray, held: NDArray[np.bool_]) -> Verdicts:
        """Take one value a stream with its conditions (n, q); streams that are ``held`` (n,) learn nothing."""
        values = np.ascontiguousarray(z, dtype=np.float64)
        c = np.ascontiguousarray(conditions, dtype=np.float64)
        if values.shape != (self.n,) or c.shape != self.condition.shape:
            raise ValueError(
                f"daily chart of {self.n} streams and {self.conditions} conditions: got values {values.shape} and "
                f"conditions {c.shape}"
            )
        seen = _accumulate(values, c, self.total, self.count, self.elapsed, self.condition)
        for i in np.flatnonzero(self.count >= self.block).tolist():
            self._close(i, bool(held[i]))
        short = self.days < min(READY, self.probation)
        phase, statistic, direction, age = _tell(
            seen, short | (self.leverage > RANGE), self.limit, self.upper, self.lower, self.upper_age, self.lower_age,
            self.latched, self.side, self.onset,
        )  # fmt: skip
        return Verdicts(phase, statistic, self.limit, direction, age)

    def _close(self, i: int, held: bool) -> None:
        """A day of one stream is full: judge it, perhaps learn from it, and begin the next."""
        x = self.total[i] / (np.sqrt(self.count[i]) * BOUNDED)
        away = self.condition[i] / self.count[i] - self.centre[i]
        known = self.width[i] > 0
        phi = np.append(1.0, np.where(known, away / np.where(known, self.width[i], 1.0), 0.0))
        gain = self.covariance[i] @ phi
        unlike = float(phi @ gain) if self.probation else 0.0
        error = x - float(phi @ self.coefficients[i])
        ratio = max(1.0, self.weekly[i] / self.weeks[i])
        scale = float(np.sqrt(max(1.0, self.squares[i] / self.degrees[i] * ratio)))
        watched = self.days[i] >= min(READY, self.probation) and unlike <= RANGE
        self.leverage[i] = unlike
        self.closed[i] += 1
        self.judged[i] += watched
        self._sum(i, error / (scale * np.sqrt(1.0 + unlike + (WANDER if self.probation else 0.0))), watched)
        calm = not held and self.latched[i] == 0 and max(self.upper[i], self.lower[i]) < HOLD * self.limit[i]
        if calm and (self.days[i] < self.probation or (self.probation and unlike > len(phi) / ENOUGH)):
            most = BOUND * scale * np.sqrt(1.0 + unlike)
            self._learn(i, min(max(error, -most), most), gain, unlike)
        self.total[i], self.count[i], self.elapsed[i], self.condition[i] = 0.0, 0, 0, 0.0

    def _sum(self, i: int, w: float, watched: bool) -> None:
        """Add a standardised day to the stream's sums; where it is not judged only what is gross counts."""
        bound, k = (DAY_BOUND, self.k) if watched else (GROSS_BOUND, GROSS)
        value, most = min(max(w, -bound), bound), CAP * self.limit[i]
        # A sum that leaves zero began with the day, not at its end.
        began = self.elapsed[i] - 1
        self.upper_age[i] = began if self.upper[i] == 0 else self.upper_age[i]
        self.lower_age[i] = began if self.lower[i] == 0 else self.lower_age[i]
        self.upper[i] = min(max(0.0, self.upper[i] + value - k), most)
        self.lower[i] = min(max(0.0, self.lower[i] - value - k), most)

    def _learn(self, i: int, error: float, gain: FloatArray, unlike: float) -> None:
        """Recursive least squares on the day's conditions, and the scales of days and weeks."""
        self.coefficients[i] += gain * (error / (1.0 + unlike))
        self.covariance[i] -= np.outer(gain, gain) / (1.0 + unlike)
        self.days[i] += 1
        if self.degrees[i] >= DEGREES + MEMORY:
            return
        residual = error / np.sqrt(1.0 + unlike)
        self.squares[i] += residual * residual
        self.degrees[i] += 1
        self.week[i] += residual / np.sqrt(self.squares[i] / self.degrees[i])
        self.in_week[i] += 1
        if self.in_week[i] == WEEK:
            self.weekly[i] += self.week[i] ** 2 / WEEK
            self.weeks[i] += 1
            self.week[i], self.in_week[i] = 0.0, 0

    def _step(self, z: FloatArray) -> Verdicts:
        if self.conditions:
            raise TypeError("a daily chart with conditions is fed by update_days")
        return self.update_days(z, self.condition, np.zeros(self.n, dtype=np.bool_))

    def reset(self, which: ArrayLike | None = None, *, relearn: bool = False) -> None:
        """Clear alarms and start again; what was learned of health stays, unless it is to be learned again."""
        super().reset(which, relearn=relearn)
        rows = np.ones(self.n, dtype=np.bool_) if which is None else np.asarray(which, dtype=np.bool_)
        if relearn:
            self.presume(rows, self.centre.copy(), self.width.copy())

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        for name in ("total", "count", "elapsed", "condition", "upper", "lower", "upper_age", "lower_age"):
            getattr(self, name)[rows] = 0


@numba.njit(cache=True)
def _accumulate(
    z: FloatArray,
    conditions: FloatArray,
    total: FloatArray,
    count: IntArray,
    elapsed: IntArray,
    condition: FloatArray,
) -> NDArray[np.bool_]:
    """Add values to their days; say which streams saw something."""
    n, q = condition.shape
    seen = np.empty(n, dtype=np.bool_)
    for i in range(n):
        good = not np.isnan(z[i])
        for j in range(q):
            good = good and np.isfinite(conditions[i, j])
        seen[i] = good
        elapsed[i] += 1
        if good:
            total[i] += min(max(z[i], -BOUND), BOUND)
            count[i] += 1
            for j in range(q):
                condition[i, j] += conditions[i, j]
    return seen


@numba.njit(cache=True)
def _tell(
    seen: NDArray[np.bool_],
    learning: NDArray[np.bool_],
    limit: FloatArray,
    upper: FloatArray,
    lower: FloatArray,
    upper_age: IntArray,
    lower_age: IntArray,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.int8], IntArray]:
    """The verdict of every stream."""
    n = limit.shape[0]
    phase = np.empty(n, dtype=np.uint8)
    statistic = np.empty(n)
    direction = np.empty(n, dtype=np.int8)
    age = np.empty(n, dtype=np.int64)
    for i in range(n):
        upper_age[i] = upper_age[i] + 1 if upper[i] > 0 else 0
        lower_age[i] = lower_age[i] + 1 if lower[i] > 0 else 0
        statistic[i] = max(upper[i], lower[i])
        sign, since = 0, 0
        if upper[i] >= lower[i] and upper[i] > 0:
            sign, since = 1, upper_age[i]
        elif lower[i] > 0:
            sign, since = -1, lower_age[i]
        phase[i], direction[i], age[i] = conclude(i, seen[i], statistic[i], sign, since, limit[i], latched, side, onset)
        if phase[i] == QUIET and learning[i]:
            phase[i] = LEARNING
    return phase, statistic, direction, age


def scale_of(knowledge: JsonObject) -> float:
    """Standard deviation of a day in conditions seen, in that of white noise, from :meth:`Daily.knowledge`."""
    ratio = max(1.0, knowledge["weekly"] / knowledge["weeks"])
    return float(np.sqrt(max(1.0, knowledge["squares"] / knowledge["degrees"] * ratio) * (1.0 + WANDER)))


def bounded_limit(arl: ArrayLike, k: float, bound: float = DAY_BOUND) -> FloatArray:
    """Limits of two-sided CUSUMs on standard normal values that are bounded, for mean run lengths of the same shape.

    Raises
    ------
    ValueError
        For a mean run length below 2 updates or beyond 1e9.
    """
    wanted = np.asarray(arl, dtype=np.float64)
    if np.any(wanted < 2) or np.any(wanted > 1e9):
        raise ValueError(f"a chart of days cannot have mean run lengths of {wanted.min():g} to {wanted.max():g} days")
    limits, lengths = _lengths(float(k), float(bound))
    return np.asarray(np.round(np.interp(np.log(wanted), lengths, limits), 6))


def bounded_power(limit: float, k: float, shift: float, updates: int, bound: float = DAY_BOUND) -> float:
    """Chance that a CUSUM on bounded values that are shifted for good rings within so many updates."""
    chain = _chain(limit, k, bound, shift)
    here = np.zeros(len(chain))
    here[0] = 1.0
    for _ in range(updates):
        here = here @ chain
    return float(1.0 - here.sum())


@lru_cache
def _lengths(k: float, bound: float) -> tuple[FloatArray, FloatArray]:
    """Limits, and the logarithms of the mean run lengths they give; two sides are half as long as one."""
    limits = np.concatenate([np.arange(0.5, 8.0, 0.25), np.arange(8.0, 22.0, 1.0)])
    lengths = np.empty_like(limits)
    for j, limit in enumerate(limits):
        chain = _chain(float(limit), k, bound, 0.0)
        lengths[j] = 0.5 * np.linalg.solve(np.eye(len(chain)) - chain, np.ones(len(chain)))[0]
    return limits, np.round(np.log(lengths), 9)


def _chain(limit: float, k: float, bound: float, shift: float) -> FloatArray:
    """Steps of one side on a lattice (Brook and Evans 1972, Biometrika 59, 539-549), (m, m)."""
    states = np.arange(round(limit * LATTICE) + 1)
    # By how much a value moves the sum, in steps; all that is further out than the bound comes there.
    least, most = round((-bound - k) * LATTICE), round((bound - k) * LATTICE)
    steps = np.arange(least, most + 1)
    edges = (steps[:-1] + 0.5) / LATTICE + k - shift
    below = np.concatenate([[0.0], ndtr(edges), [1.0]])
    chance = np.diff(below)
    chain: NDArray[Any] = np.zeros((len(states), len(states)))
    for i in states:
        to = np.maximum(i + steps, 0)
        kept = to < len(states)
        np.add.at(chain[i], to[kept], chance[kept])
    return chain
