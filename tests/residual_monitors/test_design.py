from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest

from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.design import (
    baseline_table,
    design_chart,
    design_plot,
    design_table,
    duration,
    quantile_table,
    sampling_effect,
    sampling_table,
)
from fdd.residual_monitors.run_length import Rule, arl, limit_for, run_length_quantile


def test_one_false_alarm_a_year_needs_the_limits_of_the_literature() -> None:
    """h of the R package spc for one a year of 365 days at 15 min is 9.3063, at 1 h 7.9208."""
    for interval, h in ((900.0, 9.3063), (3600.0, 7.9208)):
        design = design_chart("cusum", 365.25 / 365, interval)
        assert design.limit == pytest.approx(h, abs=2e-4)
        assert arl(design.rule, design.limit) == pytest.approx(YEAR / interval / (365.25 / 365), rel=1e-4)


def test_delays_fall_with_the_shift_and_ninety_per_cent_come_later_than_the_mean() -> None:
    design = design_chart("ewma", 2.0, 300.0, lam=0.1)
    assert list(design.delay) == sorted(design.delay, reverse=True)
    assert all(late > mean for late, mean in zip(design.late, design.delay, strict=True))


def test_table_has_a_row_a_chart_and_a_column_a_shift() -> None:
    head, rows = design_table([design_chart("cusum", 1.0, 300.0), design_chart("shewhart", 1.0, 300.0, shifts=(1.0,))])
    assert "1 sd" in head
    assert len(rows) == 2
    assert all(len(r) == len(head) for r in rows)
    assert rows[0][0].startswith("cusum, k = 0.5, h = 10.4")
    assert rows[1][head.index("2 sd")] == ""


def test_plot_is_written(tmp_path: Path) -> None:
    path = tmp_path / "design.svg"
    design_plot([design_chart("cusum", 1.0, 900.0)], path)
    assert "<svg" in path.read_text()


def test_means_over_longer_intervals_lose_little_and_point_samples_much() -> None:
    point, mean = (
        [
            d.delay[0]
            for d in sampling_effect("cusum", 1.0, (300.0, 3600.0), 0.5, base=300.0, sampling=s)  # type: ignore[arg-type]
        ]
        for s in ("point", "mean")
    )
    assert point[1] > 5 * point[0]
    assert mean[1] < mean[0]


def test_short_baselines_cost_false_alarms() -> None:
    _, rows = baseline_table(design_chart("cusum", 1.0, 300.0), (100, 1000))
    assert float(rows[0][2]) > 4 > 1.6 > float(rows[1][2]) > 1


def test_a_baseline_widens_the_limit() -> None:
    assert design_chart("cusum", 1.0, 300.0, baseline=500).limit > design_chart("cusum", 1.0, 300.0).limit


@pytest.mark.parametrize(
    ("seconds", "text"), [(90, "90 s"), (600, "10 min"), (10800, "3 h"), (864000, "10 d"), (4e8, "12.7 a")]
)
def test_durations_read_well(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_bad_requests_say_what_to_do() -> None:
    with pytest.raises(ValueError, match="must be positive"):
        design_chart("cusum", 0.0, 300.0)


def test_very_rare_alarms_follow_the_exponential_law_of_the_cusum() -> None:
    """The mean run length grows by exp(2 k) with every unit of h: the nonzero root of the step's cumulant generating
    function is 2 k (Siegmund 1985, chapter 2)."""
    for k in (0.25, 0.5, 1.0):
        for rarity in (1e9, 1e12, 1e14):
            h = float(limit_for("cusum", rarity, k=k))
            grown = arl(Rule("cusum", k=k), h + 1.0) / arl(Rule("cusum", k=k), h)
            assert grown == pytest.approx(np.exp(2 * k), rel=1e-6)


def test_very_rare_alarms_agree_with_thirty_digits() -> None:
    """The same integral equation in multiple precision, by plain elimination."""
    h, k, n = 24.0, 0.5, 80
    nodes, weights = np.polynomial.legendre.leggauss(n)
    with mpmath.workdps(30):
        y = [mpmath.mpf(0)] + [mpmath.mpf(h) / 2 * (1 + mpmath.mpf(float(x))) for x in nodes]
        w = [mpmath.mpf(h) / 2 * mpmath.mpf(float(v)) for v in weights]
        matrix = mpmath.matrix(n + 1, n + 1)
        for i in range(n + 1):
            matrix[i, 0] = -mpmath.ncdf(k - y[i])
            for j in range(n):
                matrix[i, j + 1] = -w[j] * mpmath.npdf(y[j + 1] + k - y[i])
            matrix[i, i] += 1
        one = mpmath.lu_solve(matrix, mpmath.ones(n + 1, 1))
    # Nodes in double precision carry their own rounding, times the condition of the plain equation.
    assert arl(Rule("cusum", k=k, sided=1), h) == pytest.approx(float(one[0]), rel=1e-3)


def test_quantiles_of_very_rare_alarms_are_those_of_the_exponential() -> None:
    limit = float(limit_for("cusum", 1e12))
    for p in (0.05, 0.5, 0.95):
        wanted = -np.log1p(-p) * 1e12
        assert run_length_quantile(Rule("cusum"), limit, p) == pytest.approx(wanted, rel=2e-3)


def test_a_promise_that_no_limit_keeps_is_refused_with_the_remedy() -> None:
    with pytest.raises(ValueError, match=r"not above 1e\+15: raise the false-alarm budget"):
        design_chart("cusum", 1e-11, 300.0)


def test_quantile_table_brackets_the_mean_and_false_alarms_are_geometric() -> None:
    design = design_chart("cusum", 1.0, 300.0)
    false = design.quantiles(0.0)
    assert false[2] == pytest.approx(np.log(2) * YEAR, rel=0.01)
    assert false[4] == pytest.approx(np.log(20) * YEAR, rel=0.01)
    delays = design.quantiles(1.0)
    assert delays == sorted(delays)
    assert delays[1] < design.delay[design.shifts.index(1.0)] < delays[4]
    head, rows = quantile_table(design, (0.5, 1.0, 2.0))
    assert [r[0] for r in rows] == ["none", "0.5 sd", "1 sd", "2 sd"]
    assert rows[0][1] in ("365 d", "366 d")
    assert all(len(r) == len(head) for r in rows)


def test_sampling_table_says_what_taking_fewer_samples_costs() -> None:
    head, rows = sampling_table(design_chart("cusum", 1.0, 300.0))
    assert [r[0] for r in rows] == ["5 min", "15 min", "60 min"]
    assert all(len(r) == len(head) for r in rows)
    assert rows[0][1:3] == rows[0][3:5]  # the first interval is the same for both


@pytest.mark.parametrize("shift", [5.0, 20.0, 100.0, 1000.0])
def test_the_side_that_a_large_shift_never_reaches_is_no_obstacle(shift: float) -> None:
    rule, h = Rule("cusum"), 10.0
    least = int(np.ceil(h / (shift - 0.5)))  # sums of shift - k until they pass h
    assert arl(rule, h, shift) == pytest.approx(least, abs=0.5)
    assert least <= run_length_quantile(rule, h, 0.5, shift) <= least + 1
