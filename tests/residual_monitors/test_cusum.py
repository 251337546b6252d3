from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.random import default_rng

from fdd.residual_monitors.chart import Phase, StateError
from fdd.residual_monitors.cusum import Cusum


def test_recursion_by_hand() -> None:
    chart = Cusum([3.0], k=0.5)
    up = [chart.update([z]).statistic[0] for z in (1.5, 0.0, 2.0)]
    np.testing.assert_allclose(up, [1.0, 0.5, 2.0])
    verdict = chart.update([2.5])
    assert verdict.statistic[0] == 4.0
    assert verdict.phase[0] == Phase.ALARM
    assert verdict.direction[0] == 1
    assert verdict.onset_age[0] == 4  # the upper sum was last zero four updates ago


def test_direction_is_negative_for_a_fall() -> None:
    chart = Cusum([3.0])
    for _ in range(8):
        verdict = chart.update([-1.0])
    assert verdict.phase[0] == Phase.ALARM
    assert verdict.direction[0] == -1
    assert verdict.onset_age[0] == 8


def test_onset_age_dates_the_change() -> None:
    rng = default_rng(1)
    z = rng.standard_normal((400, 2000))
    z[200:] += 1.0
    chart = Cusum(np.full(2000, 8.0))
    estimate = np.full(2000, -1)
    for t, row in enumerate(z):
        verdict = chart.update(row)
        new = (verdict.phase == Phase.ALARM) & (estimate < 0)
        estimate[new] = t + 1 - verdict.onset_age[new]
    found = estimate[estimate >= 0]
    assert found.size == 2000
    assert abs(np.median(found) - 200) <= 4


def test_gap_holds_the_statistic_and_counts_in_the_age() -> None:
    chart = Cusum([5.0])
    before = chart.update([2.0])
    gap = chart.update([np.nan])
    assert gap.phase[0] == Phase.NO_DATA
    assert gap.statistic[0] == before.statistic[0]
    assert gap.onset_age[0] == 2
    assert chart.update([2.0]).phase[0] == Phase.QUIET


def test_head_start_is_taken_again_after_reset() -> None:
    chart = Cusum([4.0, 4.0], head_start=0.5)
    assert chart.update([1.0, 1.0]).statistic[0] == 2.5
    chart.reset([True, False])
    np.testing.assert_allclose(chart.update([1.0, 1.0]).statistic, [2.5, 3.0])


def test_learned_mean_and_spread_are_frozen_before_testing() -> None:
    rng = default_rng(2)
    chart = Cusum([50.0], learn=400)
    learned = [chart.update([3.0 + 0.5 * v]).phase[0] for v in rng.standard_normal(400)]
    assert set(learned) == {Phase.LEARNING}
    mean, m2 = chart.mean.copy(), chart.m2.copy()
    z = [chart.update([3.0 + 0.5 * v]).statistic[0] for v in rng.standard_normal(400)]
    assert np.mean(z) < 3.0
    np.testing.assert_array_equal(mean, chart.mean)
    np.testing.assert_array_equal(m2, chart.m2)
    assert mean[0] == pytest.approx(3.0, abs=0.1)
    chart.reset(relearn=True)
    assert chart.update([3.0]).phase[0] == Phase.LEARNING


@pytest.mark.parametrize(
    "change", [{"schema": 99}, {"kind": "ewma"}, {"n": 3}, {"upper": None}, {"upper": [np.nan] * 2}]
)
def test_foreign_state_is_refused_and_changes_nothing(change: dict[str, object]) -> None:
    chart = Cusum([4.0, 5.0])
    chart.update([1.0, 2.0])
    own = chart.export_state()
    state = {k: v for k, v in {**own, **change}.items() if v is not None}
    with pytest.raises(StateError, match=r"start the chart anew|restore with"):
        chart.restore_state(state)
    np.testing.assert_array_equal(chart.upper, own["upper"])


def test_bad_settings_say_what_to_do() -> None:
    with pytest.raises(ValueError, match="positive finite"):
        Cusum([0.0])
    with pytest.raises(ValueError, match="zero or more"):
        Cusum([1.0], k=-1.0)
    with pytest.raises(ValueError, match="share of the limit"):
        Cusum([1.0], head_start=2.0)
    with pytest.raises(ValueError, match="give NaN"):
        Cusum([1.0, 2.0]).update([1.0])


@pytest.mark.parametrize(("n", "microseconds"), [(20, 15), (5000, 100)])
def test_update_is_cheap(n: int, microseconds: float) -> None:
    chart = Cusum(np.full(n, 10.0))
    z = default_rng(0).standard_normal(n)
    chart.update(z)
    best = np.inf
    for _ in range(20):
        begun = time.perf_counter()
        for _ in range(20):
            chart.update(z)
        best = min(best, (time.perf_counter() - begun) / 20)
    assert best * 1e6 < microseconds


def test_forgiven_shift_is_added_to_the_reference_value() -> None:
    chart = Cusum([5.0, 5.0], k=0.5)
    chart.allow_bias([0.0, 1.0])
    np.testing.assert_allclose(chart.update([2.0, 2.0]).statistic, [1.5, 0.5])
    np.testing.assert_allclose(chart.update([-3.0, -3.0]).statistic, [2.5, 1.5])
    chart.allow_bias(0.0)
    np.testing.assert_allclose(chart.update([-1.0, -1.0]).statistic, [3.0, 2.0])


def test_forgiving_a_standing_bias_restores_the_promised_rate() -> None:
    rng = default_rng(8)
    plain, allowing = Cusum.design(np.full(400, 300.0)), Cusum.design(np.full(400, 300.0))
    allowing.allow_bias(0.4)
    rings = np.zeros(2)
    for _ in range(1000):
        z = rng.standard_normal(400) + 0.4
        for i, chart in enumerate((plain, allowing)):
            rang = chart.update(z).phase == Phase.ALARM
            rings[i] += rang.sum()
            chart.reset(rang)
    promised = 400 * 1000 / 300.0
    assert rings[0] > 3 * promised  # a chart that forgives nothing breaks its promise
    assert rings[1] < 1.1 * promised
