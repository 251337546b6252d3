"""How to build and feed any chart alike: standard normal values in, whatever the chart is fed with inside."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.special import ndtri

from benchmarks.chart_kinds import charts, make
from fdd.residual_monitors.chart import Chart, Feed, Verdicts

Array = NDArray[Any]

KINDS = list(charts())
OPTIONS: dict[str, dict[str, Any]] = {
    "autocorrelation": {"window": 96, "lags": 6},
    "daily": {"block": 4},
    "dispersion": {"window": 96},
    "periodogram": {"window": 96},
    "score": {"parameters": 2, "block": 4},
}
"""Small windows and blocks, so that weeks pass quickly; a new chart needs no entry."""
WIDTH = 2
"""Elements of a vector, parameters of a component."""
RESTING = 0.9
"""Share of readings that a closed valve, say, gives as the same number; the others are all different."""
INFORMATION = np.array([[4.0, 1.0], [1.0, 2.0]])
ROOT = np.linalg.cholesky(INFORMATION)


def build(kind: str, units: int, arl: float = 2000.0, options: dict[str, Any] | None = None) -> Chart:
    """A chart of so many streams (components, for score charts); ``options`` instead of the small ones here."""
    streams = units * WIDTH if charts()[kind].feed is Feed.SCORES else units
    own = OPTIONS.get(kind, {}) if options is None else options
    if charts()[kind].feed is Feed.SCORES:
        own = {"parameters": WIDTH, **own}
    if charts()[kind].feed is Feed.READINGS:
        own = {"repeat": RESTING, **own}
    return make(kind, np.full(streams, arl), **own)


def draw(rng: Generator, kind: str, steps: int, units: int) -> Array:
    """White standard normal values (steps, units, elements)."""
    width = WIDTH if charts()[kind].feed is Feed.SCORES else 1
    return rng.standard_normal((steps, units, width))


def fault(rng: Generator, kind: str, steps: int, units: int) -> Array:
    """What every chart must see: shifted, too wide, and coloured; frozen, where readings themselves are charted."""
    if charts()[kind].feed is Feed.READINGS:
        return np.full((steps, units, 1), 3.0)
    x = 3 * draw(rng, kind, steps, units)
    for t in range(1, steps):
        x[t] += 0.9 * x[t - 1]
    return x + 3.0


def push(chart: Chart, x: Array) -> Verdicts:
    """One update with values (units, elements)."""
    if chart.feed is Feed.VALUES:
        return chart.update(x[:, 0])
    if chart.feed is Feed.READINGS:
        return chart.update(np.where(x[:, 0] < ndtri(RESTING), 0.0, x[:, 0]))
    score = np.stack([ROOT[0, 0] * x[:, 0], ROOT[1, 0] * x[:, 0] + ROOT[1, 1] * x[:, 1]], axis=1)
    return chart.update_scores(score, np.tile(INFORMATION, (len(x), 1, 1)))  # type: ignore[attr-defined,no-any-return]


def rows_of(verdicts: Verdicts) -> Array:
    """All that a chart said, as one array of floats, (5, n)."""
    v = verdicts
    return np.array([v.phase, v.statistic, v.limit, v.direction, v.onset_age], dtype=np.float64)


def run(chart: Chart, values: Array) -> Array:
    """Everything said over a run, (steps, 5, n)."""
    return np.array([rows_of(push(chart, x)) for x in values])
