"""Other detectors on the same standardised innovations: what rings for nothing, what is found, what goes silent.

Each detector is given the series in order and returns the updates at which it rings. Peers that are not installed are
left out and named; they are no dependency of the service: install the extra ``bench`` beside it.

    python -m benchmarks.peers [--quick] [--json] [--plot peers.svg]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.common import context, figure, report
from fdd.records import FloatArray
from fdd.residual_monitors.budget import poisson_interval
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.whiten import Whitener

YEAR = 105_192
"""Five-minute samples a year."""
BASELINE = 8 * 2016
"""Eight weeks of healthy samples for those that learn."""
WHOLE, QUICK = (5.0, 15), (1.0, 3)
"""Healthy years, and cases a shift."""
Ring = Callable[[FloatArray, FloatArray], list[int]]


def ours(design: Callable[[float], Cusum], false_alarms_per_year: float = 1.0, whiten: bool = True) -> Ring:
    """One of our charts, pre-whitened on the baseline, cleared by an operator as soon as it rings."""

    def ring(baseline: FloatArray, series: FloatArray) -> list[int]:
        white = Whitener.fit(baseline[:, None], order=1 if whiten else 0)
        chart = design(YEAR / false_alarms_per_year)
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


SHIFTS = (0.5, 1.0, 2.0)
Table = dict[float, dict[str, Score]]


def compare(memories: Iterable[float], years: float, cases: int, seed: int) -> Table:
    """Every detector on the same series, by the series' memory."""
    able, _ = detectors()
    return {
        rho: {name: judge(ring, rho, years, cases, SHIFTS, seed) for name, ring in able.items()} for rho in memories
    }


def figures_of(table: Table, years: float) -> dict[str, dict[str, Any]]:
    """What is promised is held against ours alone; the others are there to be compared with."""
    most = poisson_interval(int(np.ceil(years)), 0.999)[1] / years
    found = {}
    for rho, scores in table.items():
        for name, score in scores.items():
            words = "_".join("".join(c if c.isalnum() else " " for c in name).lower().split())
            key, own = f"peers_{words}" + ("" if rho == 0 else "_coloured"), name.startswith("ours")
            found[f"{key}_false_alarms"] = figure(
                score.false_alarms, "1/a", f"<= {most:.1f}" if own else "compare",
                bool(score.false_alarms <= most) if own else None,
            )  # fmt: skip
            for shift, delay in score.delay.items():
                found[f"{key}_delay_{shift:g}_sd"] = figure(delay, "h", "compare", None)
            found[f"{key}_survives_nan"] = figure(
                score.survives, "", "true" if own else "compare", score.survives if own else None
            )
    return found


def plot(table: Table, years: float, path: Path) -> None:
    """Median delay against false alarms a year, a panel a shift; bars are 95 % Poisson intervals."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 3.8), layout="constrained")
    panels = canvas.subplots(1, len(SHIFTS), sharey=True, sharex=True)
    least = 0.3 / years  # where none rang
    for axes, shift in zip(panels, SHIFTS, strict=True):
        axes.axvline(1.0, color="#999", lw=0.8, ls=":")
        for i, name in enumerate(next(iter(table.values()))):
            for rho, scores in table.items():
                count = round(scores[name].false_alarms * years)
                low, high = (v / years for v in poisson_interval(count))
                x = max(count / years, least)
                axes.errorbar(
                    x, scores[name].delay[shift], xerr=[[max(x - max(low, least / 2), 0.0)], [max(high - x, 0.0)]],
                    marker="o" if rho == 0 else "s", ms=5, mfc=f"C{i}" if rho == 0 else "white", color=f"C{i}", lw=0.8,
                    label=name if rho == 0 else None,
                )  # fmt: skip
        axes.set(xscale="log", yscale="log", title=f"shift {shift:g} sd", xlabel="false alarms a year")
        axes.set_yticks([0.25, 1, 4, 16, 64], ["15 min", "1 h", "4 h", "16 h", "64 h"])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("median delay")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    canvas.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one year, three cases a shift")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--plot", type=Path, help="write delay against false alarms here: .svg or .png")
    given = parser.parse_args()
    years, cases = QUICK if given.quick else WHOLE
    table = compare((0.0, 0.3), years, cases, 11)
    if given.plot:
        plot(table, years, given.plot)
    about = {"years": years, "cases": cases, "promised": 1.0, "not installed": detectors()[1], "seed": 11}
    report(figures_of(table, years), context(**about), given.json)


if __name__ == "__main__":
    main()
