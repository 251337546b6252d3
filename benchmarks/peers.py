"""Other detectors on the same standardised innovations: what rings for nothing, what is found, what goes silent.

Each detector is given the series in order and returns the updates at which it rings. Peers that are not installed are
left out and named; they are no dependency of the service.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from fdd.records import FloatArray
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.glr import Glr
from fdd.residual_monitors.whiten import Whitener

YEAR = 105_192
"""Five-minute samples a year."""
BASELINE = 8 * 2016
"""Eight weeks of healthy samples for those that learn."""
Ring = Callable[[FloatArray, FloatArray], list[int]]


def ours(design: Callable[[float], Cusum | Glr], false_alarms_a_year: float = 1.0, whiten: bool = True) -> Ring:
    """One of our charts, pre-whitened on the baseline, cleared by an operator as soon as it rings."""

    def ring(baseline: FloatArray, series: FloatArray) -> list[int]:
        white = Whitener.fit(baseline[:, None], order=1 if whiten else 0)
        chart = design(YEAR / false_alarms_a_year)
        rings = []
        for t, value in enumerate(series):
            if chart.update(white.update(np.array([value]))).phase[0] == Phase.ALARM:
                rings.append(t)
                chart.reset()
        return rings

    return ring


def three_sigma(baseline: FloatArray, series: FloatArray) -> list[int]:
    """A value beyond three standard deviations of the baseline; one alarm for values in a row."""
    beyond = np.abs(series - np.nanmean(baseline)) > 3 * np.nanstd(baseline)
    return np.flatnonzero(beyond & ~np.concatenate([[False], beyond[:-1]])).tolist()


def _river(name: str) -> Ring | None:
    try:
        from river import drift
    except ImportError:
        return None

    def ring(baseline: FloatArray, series: FloatArray) -> list[int]:
        detector = getattr(drift, name)()
        for value in baseline[-2016:]:
            detector.update(value)
        rings = []
        for t, value in enumerate(series):
            detector.update(value)
            if detector.drift_detected:
                rings.append(t)
        return rings

    return ring


def _camber() -> Ring | None:
    try:
        from camber.chillerdrift import ApproachDriftMonitor
    except ImportError:
        return None

    def ring(baseline: FloatArray, series: FloatArray) -> list[int]:
        good = baseline[np.isfinite(baseline)]
        lag = float(np.corrcoef(good[1:], good[:-1])[0, 1])
        # Its own baseline takes a lag that is not significant as none.
        lag = lag if lag > 2 / np.sqrt(len(good)) else 0.0
        model = SimpleNamespace(predict=lambda load: float(good.mean()), sigma_f=float(good.std()), resid_lag1=lag)
        monitor = ApproachDriftMonitor(model, direction="both")
        rings = []
        for t, value in enumerate(series):
            if monitor.update(1.0, value).alarming:
                rings.append(t)
                monitor.reset()
        return rings

    return ring


def detectors() -> tuple[dict[str, Ring], list[str]]:
    """Those that can run here, and the names of those that cannot."""
    every: dict[str, Ring | None] = {
        "ours: cusum, k = 0.5": ours(lambda arl: Cusum.design([arl])),
        "ours: cusum, k = 0.25": ours(lambda arl: Cusum.design([arl], k=0.25)),
        "ours: glr": ours(lambda arl: Glr.design([arl])),
        "3 sigma": three_sigma,
        "river PageHinkley": _river("PageHinkley"),
        "river ADWIN": _river("ADWIN"),
        "camber drift CUSUM": _camber(),
    }
    return {k: v for k, v in every.items() if v is not None}, [k for k, v in every.items() if v is None]


def coloured(rng: np.random.Generator, count: int, rho: float) -> FloatArray:
    """Standard normal values with an AR(1) memory."""
    from scipy.signal import lfilter

    noise = rng.standard_normal(count + 500) * np.sqrt(1 - rho * rho)
    return np.asarray(lfilter([1.0], [1.0, -rho], noise)[500:])


@dataclass(frozen=True)
class Score:
    """Of one detector: false alarms a year, median delay [h] by shift, and whether it survives one NaN."""

    false_alarms: float
    delay: dict[float, float]
    survives: bool


def judge(ring: Ring, rho: float, years: float, cases: int, shifts: Iterable[float], seed: int) -> Score:
    """The same series for every detector: healthy years, then shifts that come at the 2 000th value and stay.

    A detector that rings before the shift is judged by its next ring. "Survives": after a single NaN it still finds a
    shift of three standard deviations within a day.
    """
    rng = np.random.default_rng(seed)
    baseline = coloured(rng, BASELINE, rho)
    healthy = coloured(rng, int(years * YEAR), rho)
    rate = len(ring(baseline, healthy)) / years
    delay = {}
    for shift in shifts:
        found = []
        for _ in range(cases):
            series = coloured(rng, 2000 + 4032, rho)
            series[2000:] += shift
            late = [t for t in ring(baseline, series) if t >= 2000]
            found.append((late[0] - 1999) / 12 if late else np.inf)
        delay[shift] = float(np.median(found))
    broken = coloured(rng, 1500, rho)
    broken[500] = np.nan
    broken[1000:] += 3.0
    survives = any(1000 <= t < 1288 for t in ring(baseline, broken))
    return Score(rate, delay, survives)
