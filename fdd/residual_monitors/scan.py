"""False-alarm rate of a scan over windows: how often the largest standardised window sum exceeds a limit.

Exceedances come in clumps. The probability of any in a span is the sum of their probabilities, each weighted with one
over the number that come with it; that mean is found by importance sampling: a window is drawn, its sum drawn beyond
the limit, the rest of the noise kept (Naiman and Priebe 2001, Journal of Computational and Graphical Statistics 10,
296-328). The relative error does not grow with the run length, where plain simulation of 1e7 updates would take hours.
"""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from fdd.records import FloatArray, IntArray

CLUMPS = 8000
SEED = 20_240_611
_GRID = (3.2, 3.6, 4.1, 4.7, 5.4, 6.2)
_SPANS = (1, 5)
"""Spans compared, in longest windows: the rate is what the second adds to the first, without the opening."""


def probability(limit: float, windows: tuple[int, ...], span: int, clumps: int = CLUMPS, seed: int = SEED) -> float:
    """Probability that some window inside ``span`` values exceeds the limit; no bias, at any limit."""
    rng = np.random.default_rng(seed)
    places = np.array([span - w + 1 for w in windows])
    which = rng.choice(len(windows), clumps, p=places / places.sum())
    first = (rng.uniform(size=clumps) * places[which]).astype(np.int64)
    drawn = -ndtri(rng.uniform(size=clumps) * ndtr(-limit))
    noise = rng.standard_normal((clumps, span))
    weight = _clumps(noise, which, first, drawn, limit, np.array(windows, dtype=np.int64))
    return float(places.sum() * 2 * ndtr(-limit) * weight)


@numba.njit(cache=True)
def _clumps(
    noise: FloatArray, which: IntArray, first: IntArray, drawn: FloatArray, limit: float, windows: IntArray
) -> float:
    """Mean of one over the number of windows beyond the limit, given that the drawn one is."""
    total = 0.0
    span = noise.shape[1]
    sums = np.empty(span + 1)
    for c in range(noise.shape[0]):
        w, begin = windows[which[c]], first[c]
        have = 0.0
        for t in range(begin, begin + w):
            have += noise[c, t]
        lift = (drawn[c] * np.sqrt(w) - have) / w
        sums[0] = 0.0
        for t in range(span):
            sums[t + 1] = sums[t] + noise[c, t] + (lift if begin <= t < begin + w else 0.0)
        beyond = 0
        for v in windows:
            edge = limit * np.sqrt(v)
            for t in range(v, span + 1):
                if abs(sums[t] - sums[t - v]) > edge:
                    beyond += 1
        total += 1.0 / max(1, beyond)
    return float(total / noise.shape[0])


def alarm_rate(limit: float, windows: tuple[int, ...]) -> float:
    """False alarms an update, by importance sampling."""
    short, long = (max(1, m * windows[-1]) for m in _SPANS)
    survived = [np.log1p(-probability(limit, windows, span)) for span in (short, long)]
    return float((survived[0] - survived[1]) / (long - short))


@lru_cache(maxsize=16)
def _fit(windows: tuple[int, ...]) -> tuple[float, ...]:
    """log of the rate less its leading term, as a quadratic of the limit: smooth, and computed once for the windows."""
    logs = [np.log(alarm_rate(b, windows)) - np.log(ndtr(-b)) for b in _GRID]
    return tuple(float(c) for c in np.polyfit(_GRID, logs, 2))


def scan_arl(limit: float, windows: tuple[int, ...]) -> float:
    """Mean number of updates between false alarms; good to some three per cent for 200 and more."""
    return float(1.0 / (ndtr(-limit) * np.exp(np.polyval(_fit(windows), limit))))


@lru_cache(maxsize=512)
def scan_limit(arl: float, windows: tuple[int, ...]) -> float:
    """Limit for a wanted mean number of updates between false alarms, from 200 to 1e8.

    Raises
    ------
    ValueError
        Where the run length is out of that range.
    """
    if not 200 <= arl <= 1e8:
        raise ValueError(f"the scan's run length is known from 200 to 1e8 updates, got {arl:g}; change the budget")
    return float(brentq(lambda b: np.log(scan_arl(b, windows) / arl), 2.5, 7.5))
