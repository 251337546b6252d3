"""Run lengths by theory of the charts that watch the simulated house, and measured delays held against them.

Nothing of a faulty house's own innovations enters. What a fault does to a chart's values is foreseen by one of three:

a parameter has moved    the shift that the filter's information predicts for the scores, block by block
innovations have moved   their difference from those of the same house without the fault, under the same weather and
                         noise, sample by sample
noise has grown          the variance that innovations must then have, by what the sensor's noise does to them

The designed chart then runs on independent normal values with this mean and variance. Theory and measurement see the
same watch: charts that began as long before the onset, blocks and windows that begin with it, and an end beyond which
nothing is found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.stats import chi2

from benchmarks.detection import BLOCK, BLOCK_DAYS, DAY, FRAMES_A_DAY, RATE, SETTLED, STEP
from fdd.records import FloatArray
from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.chart import CLIP
from fdd.residual_monitors.run_length import limit_for

K = 0.5
REPEATS = 400
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Compared:
    """Measured delays against those of theory, both cut off at the end of the watch [days].

    ``measured`` and ``theory`` are medians, inf where fewer than half were found by the end. ``ratio`` is that of the
    run lengths, which are means; NaN where neither finds half. ``low`` and ``high``: where 95 % of such ratios lie if
    theory is right times the ratio, from the run lengths' own scatter in theory.
    """

    runs: int
    measured: float
    theory: float
    ratio: float
    low: float
    high: float

    @property
    def error(self) -> float:
        """Half of the interval; NaN where nothing is compared."""
        return (self.high - self.low) / 2


def compare(measured: Sequence[float], theory: Sequence[FloatArray], end: float) -> Compared:
    """Hold each run's delay against theory's delays in the same life.

    Parameters
    ----------
    measured : a delay a run; inf: not found, NaN: the chart rang before the onset, left out with its theory
    theory : delays of each run by theory, (repeats,); inf: not found
    end : of what is compared, after the onset
    """
    kept = [i for i, d in enumerate(measured) if not np.isnan(d)]
    own = np.array([d if d <= end else np.inf for d in (measured[i] for i in kept)])
    drawn = [np.where(theory[i] <= end, theory[i], np.inf) for i in kept]
    middle = median(own), median(np.concatenate([np.empty(0), *drawn]))
    if not np.isfinite(middle).any():
        return Compared(len(kept), *middle, *[float("nan")] * 3)
    cut = [np.minimum(d, end) for d in drawn]
    foreseen = sum(float(d.mean()) for d in cut)
    scatter = float(np.sqrt(sum(d.var() for d in cut)))
    ratio = float(np.minimum(own, end).sum()) / foreseen
    half = NORMAL_95 * scatter / foreseen
    return Compared(len(kept), *middle, ratio, ratio - half, ratio + half)


def median(delay: FloatArray) -> float:
    """Not interpolated, since infinity is among the values; NaN of none."""
    kept = np.sort(delay[~np.isnan(delay)])
    return float(kept[(len(kept) - 1) // 2]) if len(kept) else float("nan")


def parameter_delays(change: float, information: FloatArray, charts: int) -> FloatArray:
    """Of a parameter's CUSUM over blocks with this information (blocks,) after a change [days]."""
    h = float(limit_for("cusum", YEAR / STEP / RATE * charts / BLOCK, k=K))
    return _first_alarms(change * np.sqrt(information), h, SETTLED // BLOCK) * BLOCK_DAYS


def shift_delays(course: FloatArray, charts: int) -> FloatArray:
    """Of an innovation CUSUM to a shift that takes this course (samples,) [days]."""
    return _first_alarms(np.nan_to_num(course), _sample_limit(charts), SETTLED) * STEP / DAY


def noise_delays(variance: float, samples: int, charts: int) -> FloatArray:
    """Of an innovation CUSUM to innovations of this variance, 1 before [days]."""
    return _first_alarms(np.zeros(samples), _sample_limit(charts), SETTLED, float(np.sqrt(variance))) * STEP / DAY


def dispersion_delays(variance: float, least: float, most: float, window: int) -> FloatArray:
    """Of a test that each window's dispersion lies within [least, most], to innovations of this variance [days].

    (N - 1) times a window's variance over the true one is chi-square, which is what the test's statistic transforms.
    """
    dof = window - 1
    edges = dof * np.maximum(0.0, np.array([least, most]) * np.sqrt(2 / (9 * dof)) + 1 - 2 / (9 * dof)) ** 3
    chance = float(chi2.cdf(edges[0] / variance, dof) + chi2.sf(edges[1] / variance, dof))
    windows = np.random.default_rng(17).geometric(max(chance, 1e-12), REPEATS)
    return np.asarray(windows * window / FRAMES_A_DAY)


def noisier(course: FloatArray, growth: float) -> float:
    """Variance of unit-variance innovations after a sensor's noise has grown by this share of itself.

    ``course`` is their difference from those of the healthy house under the same noise: ``growth`` times the part n of
    them that is the sensor's. The rest stays as it was: 1 + ((1 + growth)^2 - 1) var n.
    """
    return float(1.0 + ((1.0 + growth) ** 2 - 1.0) * np.nanvar(course) / growth**2)


def _sample_limit(charts: int) -> float:
    return float(limit_for("cusum", YEAR / STEP / RATE * charts, k=K))


def _first_alarms(shift: FloatArray, h: float, settled: int, sd: float = 1.0) -> FloatArray:
    """Updates after the onset to the alarm of a CUSUM on normal values with these means and, from then on, this sd.

    Charts that ring before the onset are left out.
    """
    first = _run(np.random.default_rng(17), np.ascontiguousarray(shift), h, settled, sd, np.full(REPEATS, np.inf))
    return np.asarray(first[first > 0])


@numba.njit(cache=True)
def _run(
    rng: np.random.Generator, shift: FloatArray, h: float, settled: int, sd: float, first: FloatArray
) -> FloatArray:
    for r in range(len(first)):
        upper, lower = 0.0, 0.0
        for t in range(-settled, len(shift)):
            value = rng.standard_normal()
            if t >= 0:
                value = min(max(sd * value + shift[t], -CLIP), CLIP)
            upper, lower = max(0.0, upper + value - K), max(0.0, lower - value - K)
            if max(upper, lower) > h:
                first[r] = t + 1
                break
    return first
