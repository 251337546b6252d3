"""What single charts promise beyond the common contract, against numbers from elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.stats import chi2, kstest, kstwo, norm
from scipy.stats import t as student

from fdd.residual_monitors.autocorrelation import Autocorrelation
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.dispersion import Dispersion
from fdd.residual_monitors.periodogram import Periodogram
from fdd.residual_monitors.run_length import Rule, arl
from fdd.residual_monitors.window import blocks


def test_portmanteau_holds_in_the_tail() -> None:
    """Where the budget lives: one window in a thousand."""
    rng, chart = default_rng(7), Autocorrelation([30.0], window=96, lags=8)
    q = np.concatenate([chart.statistics(rng.standard_normal((20_000, 96))) for _ in range(5)])
    for p in (0.1, 0.01, 1e-3):
        share = np.mean(q > chi2.isf(p, 8))
        assert share == pytest.approx(p, abs=4 * np.sqrt(p / q.size) + 0.15 * p)


def test_whiteness_charts_find_colour_and_leave_a_shift_alone() -> None:
    rng, n = default_rng(8), 100
    for chart in (Autocorrelation.design(np.full(n, 1e5), window=288), Periodogram.design(np.full(n, 1e5), window=288)):
        for _ in range(2 * 288):
            said = chart.update(2.0 + rng.standard_normal(n))
        assert np.mean(said.phase == Phase.ALARM) < 0.05
        chart.reset()
        x = np.zeros(n)
        for _ in range(288):
            x = 0.5 * x + rng.standard_normal(n)
            said = chart.update(x)
        assert np.mean(said.phase == Phase.ALARM) > 0.95
        assert np.all(said.direction[said.phase == Phase.ALARM] == 1)
        assert np.all(said.onset_age[said.phase == Phase.ALARM] == 288)


def test_periodogram_finds_a_hidden_line() -> None:
    rng = default_rng(9)
    chart = Periodogram.design([1e5], window=288)
    t = np.arange(288)
    for value in rng.standard_normal(288) + 1.2 * np.sin(2 * np.pi * t / 9):
        said = chart.update([value])
    assert said.phase[0] == Phase.ALARM
    statistic = chart.statistics(rng.standard_normal((4000, 288)))
    assert kstest(statistic, lambda d: kstwo.cdf(d, 142)).pvalue > 1e-3


@pytest.mark.parametrize("window", [96, 288])
def test_cumulated_periodogram_of_white_windows_is_nearly_normal_on_its_scale(window: int) -> None:
    """By the exact distribution: Student's limits of 27 windows are passed as often as they say; 20 000 baselines."""
    chart, n = Periodogram([1.0], window=window), (window - 1) // 2 - 1
    grid = np.linspace(-5, 5.5, 1000)
    d = kstwo.isf(norm.sf(grid), n)
    scale = chart.straightened(d)
    assert_allclose(chart.bent(scale), d, rtol=1e-12)
    own = np.interp(default_rng(3).standard_normal((20_000, 27)), grid, scale)
    for p in (1e-2, 1e-3):
        limit = own.mean(axis=1) + student.isf(p, 26) * own.std(axis=1, ddof=1) * np.sqrt(1 + 1 / 27)
        passed = norm.sf(np.interp(limit, scale, grid)) / p
        assert abs(passed.mean() - 1) < 0.12 + 3 * passed.std() / np.sqrt(20_000)


def test_window_of_blocks_says_what_a_window_of_their_sums_says() -> None:
    """Through gaps, and with the onset in updates."""
    rng, block = default_rng(21), 5
    z = rng.standard_normal(96 * block)
    coarse = Dispersion.design([1e5], window=96)
    for value in blocks(z, block):
        wanted = coarse.update([value])
    fine = Dispersion(coarse.limit, window=96, block=block)
    for i, value in enumerate(z):
        if i % 7 == 3:
            fine.update([np.nan])
        said = fine.update([value])
    assert said.statistic[0] == wanted.statistic[0]
    assert said.phase[0] == Phase.QUIET
    for value in 3.0 * z:
        said = fine.update([value])
    assert said.phase[0] == Phase.ALARM
    assert said.onset_age[0] == 96 * block


def test_cusum_needs_as_long_as_the_solver_says() -> None:
    rng, n, shift = default_rng(10), 4000, 1.0
    chart = Cusum.design(np.full(n, 1000.0))
    first, t = np.zeros(n), 0
    while np.any(first == 0):
        t += 1
        rang = chart.update(rng.standard_normal(n) + shift).phase == Phase.ALARM
        first[rang & (first == 0)] = t
    expected = arl(Rule("cusum"), float(chart.limit[0]), shift)
    assert first.mean() == pytest.approx(expected, abs=4 * first.std() / np.sqrt(n))
