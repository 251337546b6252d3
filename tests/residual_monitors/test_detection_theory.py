"""The theory that detection delays are held against, against the run-length solver and the charts themselves."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.detection import BLOCK, BLOCK_DAYS, DAY, FRAMES_A_DAY, RATE, STEP, WINDOW
from benchmarks.detection_theory import (
    K,
    compare,
    dispersion_delays,
    median,
    noise_delays,
    noisier,
    parameter_delays,
    shift_delays,
)
from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.dispersion import Dispersion
from fdd.residual_monitors.run_length import Rule, limit_for, run_length_quantile

CHARTS = 2


def sample_limit() -> float:
    return float(limit_for("cusum", YEAR / STEP / RATE * CHARTS, k=K))


@pytest.mark.parametrize("shift", [1.0, 1.5, 3.0])
def test_theory_of_a_constant_shift_is_the_solvers_median(shift: float) -> None:
    """Information of one a block and a change of ``shift``: a constant mean; medians of 400 runs, whole blocks."""
    h = float(limit_for("cusum", YEAR / STEP / RATE * CHARTS / BLOCK, k=K))
    exact = run_length_quantile(Rule("cusum", k=K), h, 0.5, shift, "steady")
    assert median(parameter_delays(-shift, np.ones(200), CHARTS)) / BLOCK_DAYS == pytest.approx(exact, abs=1.01)


def test_theory_of_no_change_finds_nothing() -> None:
    assert median(parameter_delays(0.0, np.ones(84), CHARTS)) == np.inf


def test_theory_of_a_lasting_shift_of_innovations_is_the_solvers_median() -> None:
    exact = run_length_quantile(Rule("cusum", k=K), sample_limit(), 0.5, 2.0, "steady")
    assert median(shift_delays(np.full(300, 2.0), CHARTS)) * DAY / STEP == pytest.approx(exact, abs=1.01)


def test_theory_of_grown_noise_is_the_solvers_for_a_smaller_limit() -> None:
    """A CUSUM with k and h of values with standard deviation s is one of unit values with k / s and h / s."""
    exact = run_length_quantile(Rule("cusum", k=K / 2), sample_limit() / 2, 0.5, 0.0, "steady")
    assert median(noise_delays(4.0, 6000, CHARTS)) * DAY / STEP == pytest.approx(exact, rel=0.2)


def test_theory_of_dispersion_is_what_the_chart_does() -> None:
    """400 runs of each: means within four of their standard errors."""
    variance, limit, centre = 1.3, 3.0, 0.2
    chart = Dispersion(np.full(400, limit), window=WINDOW, centre=centre)
    first = np.full(400, np.inf)
    rng = np.random.default_rng(5)
    for t in range(20 * WINDOW):
        rang = chart.update(np.sqrt(variance) * rng.standard_normal(400)).phase == Phase.ALARM
        first[rang & np.isinf(first)] = t + 1
    theory = dispersion_delays(variance, centre - limit, centre + limit, WINDOW)
    assert np.isfinite(first).all()
    difference = first.mean() / FRAMES_A_DAY - theory.mean()
    assert abs(difference) < 4 * np.hypot(first.std() / FRAMES_A_DAY, theory.std()) / 20
    assert theory.mean() > 1.1


def test_grown_noise_counts_for_the_sensors_part_only() -> None:
    """A third of the variance is the sensor's; its noise doubles: 2/3 + 4/3."""
    rng = np.random.default_rng(6)
    sensor, rest = np.sqrt(1 / 3) * rng.standard_normal(100_000), np.sqrt(2 / 3) * rng.standard_normal(100_000)
    faulty = rest + 2 * sensor
    assert noisier(faulty - (rest + sensor), 1.0) == pytest.approx(2.0, rel=0.02)
    assert np.var(faulty) == pytest.approx(2.0, rel=0.02)


def test_delays_beyond_the_end_count_as_the_end_on_both_sides() -> None:
    theory = [np.array([1.0, np.inf, 30.0, 3.0]), np.array([1.0, 1.0, 1.0, 1.0])]
    found = compare([2.0, np.inf], theory, 10.0)
    assert found.ratio == pytest.approx((2 + 10) / ((1 + 10 + 10 + 3) / 4 + 1))
    assert (found.runs, found.measured, found.theory) == (2, 2.0, 1.0)
    assert found.low < found.ratio < found.high


def test_runs_that_rang_early_leave_with_their_theory() -> None:
    found = compare([float("nan"), 2.0], [np.full(4, 100.0), np.full(4, 1.0)], 10.0)
    assert (found.runs, found.ratio) == (1, 2.0)


def test_nothing_is_compared_where_neither_finds_half() -> None:
    assert np.isnan(compare([np.inf, np.inf, 2.0], [np.full(4, np.inf)] * 3, 10.0).ratio)
