"""Frozen signals: readings that stay the same for longer than they ever do while the sensor lives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaln

from fdd.records import FloatArray, IntArray, JsonObject
from fdd.residual_monitors.chart import CAP, Chart, Feed, Verdicts, conclude

TAIL = 20
"""Longest runs of the baseline from which the chance that a run goes on is estimated."""
LONGEST = 2.0
"""A limit is never below this multiple of the longest run that the baseline has."""
LEAST = 6
"""Fewest unchanged readings that are an alarm: a gateway may repeat a value a few times when it is busy."""
HUGE = 1e300


@dataclass(frozen=True, slots=True)
class FlatRuns:
    """How long a signal's readings stay the same on its baseline; a run's length counts the unchanged readings.

    Attributes
    ----------
    readings : seen in all
    runs : stretches of equal readings, of length 0 where the next one differs at once
    longest : of the runs
    tail, exceed, excess : runs of ``tail`` and more, how many there are, and by how many readings in all
    low, high : ends of the range that the readings had; a signal rests there (off, closed, night) without being frozen
    """

    readings: int
    runs: int
    longest: int
    tail: int
    exceed: int
    excess: int
    low: float
    high: float

    def document(self) -> JsonObject:
        """As plain data."""
        return asdict(self)

    def limit(self, arl: float) -> float:
        """Unchanged readings that come less often than once in ``arl`` readings; above all that the baseline has."""
        return max(self.by_chance(arl), LONGEST * self.longest, LEAST) - 0.5

    def by_chance(self, arl: float) -> int:
        """Unchanged readings that come by chance once in ``arl`` readings.

        Beyond its tail a run goes on with the same chance each time. What the baseline says of that chance is a beta
        distribution (Jeffreys' prior); the rate is averaged over it, so that few runs make the limit wide. A gateway
        that seldom repeats a value for long is not in the tail of a short baseline: for that the longest run counts.
        """
        wanted = float(np.log(self.readings / (self.exceed * arl)))
        high = 1
        while _log_survival(self.excess, self.exceed, high) > wanted:
            high *= 2
        low = high // 2
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if _log_survival(self.excess, self.exceed, middle) > wanted else (low, middle)
        return self.tail + high

    def rate(self, limit: float) -> float:
        """Runs that pass such a limit by chance, a reading; for limits from the tail on the inverse of by_chance."""
        more = int(np.ceil(limit)) - self.tail
        return self.exceed / self.readings * float(np.exp(_log_survival(self.excess, self.exceed, max(more, 0))))


def _log_survival(excess: int, exceed: int, more: int) -> float:
    """Log of the chance that a run that has passed the tail goes on ``more`` times again, over the baseline's error."""
    return float(betaln(excess + 0.5 + more, exceed + 0.5) - betaln(excess + 0.5, exceed + 0.5))


def flat_runs(readings: ArrayLike) -> FlatRuns | None:
    """What a healthy signal's own runs are; None where it has no two readings or never changes.

    Parameters
    ----------
    readings : shape (n,), in order, NaN where there was none; runs at the ends of the range are left out
    """
    x = np.asarray(readings, dtype=np.float64)
    x = x[np.isfinite(x)]
    if len(x) < 2 or np.all(x == x[0]):
        return None
    low, high = float(x.min()), float(x.max())
    starts = np.flatnonzero(np.concatenate([[True], x[1:] != x[:-1]]))
    lengths = np.diff(np.concatenate([starts, [len(x)]])) - 1
    inside = (x[starts] != low) & (x[starts] != high)
    kept = lengths[inside] if inside.any() else lengths
    tail = int(np.sort(kept)[::-1][min(TAIL, len(kept)) - 1])
    beyond = kept[kept >= tail] - tail
    seen = int((kept + 1).sum())
    return FlatRuns(seen, len(kept), int(kept.max()), tail, len(beyond), int(beyond.sum()), low, high)


class Flatline(Chart):
    r"""Counts unchanged readings: a sensor that is frozen, a gateway that repeats, a point that nobody updates.

    A frozen reading may lie well inside what the model expects for days, so that ``cusum`` sees it late. Readings are
    compared as they come, not standardised.

    Equations
        .. math:: n_t = n_{t-1} + 1 \text{ if } x_t = x_{t-1}, \text{ else } 0

        Alarm when n exceeds its limit. Where a reading stays with probability p, independently, the mean number of
        readings to a run of m is (1 - p^m) / ((1 - p) p^m) (Feller 1968, XIII.7). A reading at an end of the signal's
        range (``low``, ``high``) rests there: it is not counted, and says nothing.

    Parameters
    ----------
    limit : shape (n,), unchanged readings
    low, high : scalar or shape (n,), ends of the range; None: it has none

    References
    ----------
    Feller, W. (1968), An Introduction to Probability Theory and Its Applications, volume 1, third edition.
    """

    kind = "flatline"
    feed = Feed.READINGS
    _state = ("count", "age", "last", "begun")

    def __init__(self, limit: ArrayLike, *, low: ArrayLike | None = None, high: ArrayLike | None = None) -> None:
        super().__init__(limit)
        self.low = _ends(low, self.n, -np.inf)
        self.high = _ends(high, self.n, np.inf)
        self.count = np.zeros(self.n, dtype=np.int64)
        self.age = np.zeros(self.n, dtype=np.int64)
        self.last = np.zeros(self.n)
        self.begun = np.zeros(self.n, dtype=np.int8)

    @classmethod
    def design(cls, arl: ArrayLike, *, repeat: ArrayLike = 0.5) -> Flatline:
        """Charts with these mean numbers of readings between false alarms, at least.

        Parameters
        ----------
        repeat : scalar or shape (n,), probability that a reading equals the last one, [0, 1)

        Raises
        ------
        ValueError
            Where a probability is out of range.
        """
        wanted = np.array(arl, dtype=np.float64, ndmin=1)
        p = np.broadcast_to(np.asarray(repeat, dtype=np.float64), wanted.shape)
        if not np.all((p >= 0) & (p < 1)):
            raise ValueError(f"flatline chart: repeat is {repeat!r}; give a probability in [0, 1)")
        safe = np.maximum(p, 1e-9)
        runs = np.ceil(np.log1p(wanted * (1 - safe)) / -np.log(safe) - 1e-9)
        return cls(np.maximum(runs, 1) - 0.5)

    @classmethod
    def of(cls, arl: ArrayLike, found: Sequence[FlatRuns]) -> Flatline:
        """Charts whose limits keep the promise for signals that stay as still as they were on their baselines."""
        chart = cls(np.ones(len(found)))
        chart.expect(arl, found)
        return chart

    def expect(self, arl: ArrayLike, found: Sequence[FlatRuns]) -> None:
        """Take limits and ranges from baselines; counts go on."""
        wanted = np.broadcast_to(np.asarray(arl, dtype=np.float64), (self.n,))
        self.set_limit([s.limit(float(a)) for s, a in zip(found, wanted, strict=True)])
        self.low = _ends([s.low for s in found], self.n, -np.inf)
        self.high = _ends([s.high for s in found], self.n, np.inf)

    def _step(self, z: FloatArray) -> Verdicts:
        phase, statistic, direction, age = _count(
            z, self.low, self.high, self.limit, self.count, self.age, self.last, self.begun, self.latched, self.side,
            self.onset,
        )  # fmt: skip
        return Verdicts(phase, statistic, self.limit, direction, age)

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        self.count[rows], self.age[rows], self.last[rows], self.begun[rows] = 0, 0, 0.0, 0


def _ends(value: ArrayLike | None, n: int, nothing: float) -> FloatArray:
    ends = np.full(n, nothing) if value is None else np.array(np.broadcast_to(value, (n,)), dtype=np.float64)
    return np.ascontiguousarray(ends)


@numba.njit(cache=True)
def _count(
    z: FloatArray,
    low: FloatArray,
    high: FloatArray,
    limit: FloatArray,
    count: IntArray,
    age: IntArray,
    last: FloatArray,
    begun: NDArray[np.int8],
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.int8], IntArray]:
    n = z.shape[0]
    phase = np.empty(n, dtype=np.uint8)
    statistic = np.empty(n)
    direction = np.zeros(n, dtype=np.int8)
    since = np.empty(n, dtype=np.int64)
    for i in range(n):
        value = min(max(z[i], -HUGE), HUGE)
        rests = value == low[i] or value == high[i]
        seen = not np.isnan(z[i]) and not rests
        # Time passes in a gap too: ages count updates, so that the onset is a time.
        age[i] = age[i] + 1 if count[i] > 0 else 0
        if seen and begun[i] == 1 and value == last[i]:
            count[i] = min(count[i] + 1, int(CAP * limit[i]))
            age[i] = max(age[i], 1)
        elif seen or rests:
            count[i], age[i] = 0, 0
            last[i], begun[i] = value, 1
        statistic[i] = count[i]
        phase[i], _, since[i] = conclude(i, seen, statistic[i], 0, age[i], limit[i], latched, side, onset)
    return phase, statistic, direction, since
