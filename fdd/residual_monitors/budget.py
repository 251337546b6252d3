"""False alarms a year for a plant, spread over its charts; and what was kept of the promise.

People think in false alarms a year, not in limits. A plant with 200 charts at "one a year each" rings four times a
week, so the budget is the plant's: each chart gets a share by weight, and from the share the mean number of updates
between its false alarms, which :func:`fdd.residual_monitors.run_length.limit_for` turns into a limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from fdd.records import FloatArray

YEAR = 365.25 * 86400.0
"""Seconds in a mean year."""


class BudgetError(ValueError):
    """A budget that cannot be spread; the text says what to change."""


def spread(
    false_alarms_per_year: float, weights: ArrayLike, interval: ArrayLike, availability: ArrayLike = 1.0
) -> FloatArray:
    """Mean number of updates between false alarms for each chart, shape (n,).

    Parameters
    ----------
    false_alarms_per_year : for all charts together [1/a]
    weights : shape (n,), share of the budget each chart may use, any scale; more for charts that guard dear faults
    interval : scalar or (n,), time between a chart's updates [s]; charts on blocks and windows divide by their length
        themselves
    availability : scalar or (n,), share of the year in which the chart sees values (machine on, data there), (0, 1]

    Raises
    ------
    BudgetError
        Where a number is out of range, or a chart would have to alarm within two updates.
    """
    w = np.array(weights, dtype=np.float64, ndmin=1)
    step = np.broadcast_to(np.asarray(interval, dtype=np.float64), w.shape)
    share = np.broadcast_to(np.asarray(availability, dtype=np.float64), w.shape)
    if not (np.isfinite(false_alarms_per_year) and false_alarms_per_year > 0):
        raise BudgetError(
            f"the budget is {false_alarms_per_year} false alarms a year; give a positive number, for example 4"
        )
    if w.ndim != 1 or w.size == 0 or not np.all(np.isfinite(w) & (w > 0)):
        raise BudgetError(
            f"weights must be positive, one a chart; got {weights!r}; leave a chart out instead of weight 0"
        )
    if not np.all(np.isfinite(step) & (step > 0)):
        raise BudgetError(f"update intervals must be positive seconds, got {interval!r}")
    if not np.all((share > 0) & (share <= 1)):
        raise BudgetError(f"availability must lie in (0, 1], got {availability!r}")
    rate = false_alarms_per_year * w / w.sum()
    updates = np.asarray(share * YEAR / step / rate)
    if np.any(updates < 2):
        worst = int(np.argmin(updates))
        raise BudgetError(
            f"chart {worst} updates {share[worst] * YEAR / step[worst]:.3g} times a year and was given "
            f"{rate[worst]:.3g} false alarms a year: it would alarm at once; lower the budget or its weight"
        )
    return updates


@dataclass(frozen=True, slots=True)
class Realised:
    """False alarms that came, against those promised.

    Attributes
    ----------
    count : alarms
    expected : alarms the budget allows in the time watched
    rate, low, high : alarms a year, with the limits of its exact Poisson interval [1/a]
    years : time watched [a]
    confidence : of the interval
    """

    count: int
    expected: float
    rate: float
    low: float
    high: float
    years: float
    confidence: float

    @property
    def consistent(self) -> bool:
        """Whether the promised rate lies in the interval."""
        return self.low * self.years <= self.expected <= self.high * self.years


def poisson_interval(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact interval for the mean of a Poisson count (Garwood 1936, Biometrika 28, 437-442)."""
    if count < 0 or not 0 < confidence < 1:
        raise ValueError(f"count {count} must be zero or more and confidence {confidence} inside (0, 1)")
    tail = (1 - confidence) / 2
    low = 0.0 if count == 0 else 0.5 * float(chi2.ppf(tail, 2 * count))
    return low, 0.5 * float(chi2.isf(tail, 2 * count + 2))


def realised(count: int, seconds: float, false_alarms_per_year: float, confidence: float = 0.95) -> Realised:
    """Compare alarms with the budget over the time watched.

    Parameters
    ----------
    count : false alarms that came
    seconds : time watched, without what was gated off [s]
    false_alarms_per_year : the promise for the same charts [1/a]
    """
    if not seconds > 0:
        raise ValueError(f"time watched is {seconds} s; give a positive time")
    years = seconds / YEAR
    low, high = poisson_interval(count, confidence)
    return Realised(count, false_alarms_per_year * years, count / years, low / years, high / years, years, confidence)
