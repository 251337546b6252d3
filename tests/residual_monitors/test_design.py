from __future__ import annotations

from pathlib import Path

import pytest

from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.design import (
    baseline_table,
    design_chart,
    design_plot,
    design_table,
    duration,
    sampling_effect,
)
from fdd.residual_monitors.run_length import arl


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
