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
from fdd.residual_monitors.dispersion import Dispersion
from fdd.residual_monitors.drift import Drift
from fdd.residual_monitors.ewma import Ewma
from fdd.residual_monitors.glr import WINDOWS, Glr
from fdd.residual_monitors.mewma import Mewma
from fdd.residual_monitors.nis import Nis, _scores, normal_scores
from fdd.residual_monitors.periodogram import Periodogram
from fdd.residual_monitors.run_length import Rule, arl
from fdd.residual_monitors.run_rules import rule_limits, rules_arl
from fdd.residual_monitors.scan import scan_arl
from fdd.residual_monitors.shewhart import Shewhart
from fdd.residual_monitors.window import blocks

OFF = np.inf
ZERO = 1e-12


@pytest.mark.parametrize(
    ("limits", "published"),
    [
        ((3, OFF, OFF, OFF), 370.40),
        ((3, 2, OFF, OFF), 225.44),
        ((3, OFF, 1, OFF), 166.05),
        ((3, OFF, OFF, ZERO), 152.73),
        ((3, 2, 1, ZERO), 91.75),
    ],
)
def test_run_rules_agree_with_champ_and_woodall(limits: tuple[float, ...], published: float) -> None:
    """Champ, C. W., Woodall, W. H. (1987), Technometrics 29, 393-399, Table 1."""
    assert rules_arl(limits) == pytest.approx(published, abs=0.01)


def test_rule_limits_keep_the_rate_of_all_rules_together() -> None:
    for wanted in (500.0, 1e5, 1e7):
        limits = rule_limits(wanted)
        assert rules_arl(limits) == pytest.approx(wanted, rel=1e-5)
        assert limits[0] > limits[1] > limits[2] > limits[3]
    with pytest.raises(ValueError, match="100 to 1e8"):
        rule_limits(10.0)


def test_shewhart_alarms_on_each_pattern() -> None:
    for values in ([3.1], [2.1, 0.0, 2.1], [1.1, 1.1, 0.0, 1.1, 1.1], [0.1] * 8):
        for sign in (1, -1):
            chart = Shewhart([3.0], ratios=(1, 2 / 3, 1 / 3, 0.02))
            phases = [chart.update([sign * v]) for v in values]
            assert phases[-1].phase[0] == Phase.ALARM
            assert phases[-1].direction[0] == sign
            assert all(p.phase[0] == Phase.QUIET for p in phases[:-1])


@pytest.mark.parametrize("limit", [3.0, 3.6])
def test_scan_rate_agrees_with_simulation(limit: float) -> None:
    n, steps = 800, 1500
    rng, chart = default_rng(1), Glr(np.full(n, limit))
    first = np.zeros(n)
    for t in range(steps):
        rang = (chart.update(rng.standard_normal(n)).phase == Phase.ALARM) & (first == 0)
        first[rang] = t + 1
    found = np.count_nonzero(first)
    mean = np.where(first > 0, first, steps).sum() / found
    assert mean == pytest.approx(scan_arl(limit, WINDOWS), rel=4 / np.sqrt(found) + 0.05)


def test_glr_dates_a_jump() -> None:
    rng, n = default_rng(2), 500
    z = rng.standard_normal((300, n))
    z[200:] += 2.0
    chart, age = Glr(np.full(n, 5.0)), np.zeros(n, dtype=int)
    for t, row in enumerate(z):
        said = chart.update(row)
        new = (said.phase == Phase.ALARM) & (age == 0)
        age[new] = t + 1 - said.onset_age[new]
    assert np.median(age) == 200
    assert np.mean(np.abs(age - 200) <= 3) > 0.85


def test_ewma_statistic_is_in_its_own_standard_deviations() -> None:
    rng = default_rng(3)
    plain, exact = Ewma(np.full(20_000, 50.0), lam=0.2), Ewma(np.full(20_000, 50.0), lam=0.2, exact=True)
    for t in range(40):
        z = rng.standard_normal(20_000)
        a, b = plain.update(z).statistic, exact.update(z).statistic
        assert np.sqrt(np.mean(b**2)) == pytest.approx(1.0, abs=0.02)
        if t > 30:
            assert np.sqrt(np.mean(a**2)) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_mewma_statistic_is_chi_square_also_with_missing_elements(missing: float) -> None:
    rng = default_rng(4)
    chart = Mewma(np.full(5000, 1e3), dimension=3)
    for _ in range(100):
        z = rng.standard_normal((5000, 3))
        z[rng.random(z.shape) < missing] = np.nan
        statistic = chart.update(z).statistic
    assert kstest(statistic, chi2(3).cdf).pvalue > 1e-3


@pytest.mark.parametrize("dimension", [1, 2, 5])
def test_nis_score_is_standard_normal_for_any_number_seen(dimension: int) -> None:
    z = default_rng(5).standard_normal((40_000, 6))
    z[:, dimension:] = np.nan
    assert kstest(_scores(z, normal_scores(6)), "norm").pvalue > 1e-3


def test_nis_tells_too_large_from_too_small() -> None:
    rng = default_rng(6)
    for factor, direction in ((1.5, 1), (0.5, -1)):
        chart = Nis([8.0], dimension=2)
        for _ in range(300):
            said = chart.update(factor * rng.standard_normal((1, 2)))
        assert said.phase[0] == Phase.ALARM
        assert said.direction[0] == direction


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


def test_drift_takes_estimates_with_their_errors() -> None:
    chart = Drift([4.0], reference=2.0, most_error=0.5)
    said = chart.update_estimates([2.3], [0.1])
    assert said.statistic[0] == pytest.approx(2.5)
    assert chart.update_estimates([9.0], [0.6]).phase[0] == Phase.NO_DATA
    assert chart.update_estimates([9.0], [np.inf]).phase[0] == Phase.NO_DATA
    assert chart.update_estimates([9.0], [0.0]).phase[0] == Phase.NO_DATA
    assert chart.update_estimates([2.3], [0.1]).phase[0] == Phase.ALARM


@pytest.mark.parametrize(("kind", "shift"), [("cusum", 1.0), ("ewma", 0.5), ("mewma", 1.0)])
def test_charts_need_as_long_as_the_solver_says(kind: str, shift: float) -> None:
    from fdd.residual_monitors.registry import make

    rng, n = default_rng(10), 4000
    chart, rule = make(kind, np.full(n, 1000.0)), Rule(kind)  # type: ignore[arg-type]
    first, t = np.zeros(n), 0
    while np.any(first == 0):
        t += 1
        z = rng.standard_normal((n, 2)) if kind == "mewma" else rng.standard_normal(n)
        if kind == "mewma":
            z[:, 0] += shift
        else:
            z += shift
        first[(chart.update(z).phase == Phase.ALARM) & (first == 0)] = t
    expected = arl(rule, float(chart.limit[0]), shift)
    assert first.mean() == pytest.approx(expected, abs=4 * first.std() / np.sqrt(n))
