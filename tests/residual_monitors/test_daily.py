"""The chart of days: its promise for models that are a little wrong, and what it may never learn."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.daily import Daily, bounded_limit, bounded_power
from fdd.residual_monitors.extremes import Extremes

N, PARTS = 150, 4
YEAR = 365


def feed(chart: Daily, x: np.ndarray, c: np.ndarray, *, held: bool = False) -> np.ndarray:
    """Sums of days (t, n) in parts, with one condition (t,); alarms are cleared when they come. Days they came on."""
    rang = np.zeros(x.shape, dtype=bool)
    for t in range(len(x)):
        for _ in range(PARTS):
            v = chart.update_days(x[t] / np.sqrt(PARTS), np.full((chart.n, 1), c[t]), np.full(chart.n, held))
        rang[t] = v.phase == Phase.ALARM
        if rang[t].any():
            chart.reset(rang[t])
    return rang


def chart_of(n: int = N, a_year: float = 2.0) -> Daily:
    chart = Daily.design(np.full(n, PARTS * YEAR / a_year), block=PARTS, conditions=1, probation=28)
    chart.presume(np.ones(n, dtype=bool), np.zeros((n, 1)), np.ones((n, 1)))
    return chart


def bounded(x: np.ndarray) -> np.ndarray:
    return np.clip(x, -2.0, 2.0)


@pytest.mark.parametrize("length", [50.0, 365.0])
def test_limits_for_bounded_values_keep_their_run_length(length: float) -> None:
    """Against plain simulation of the recursion."""
    rng = np.random.default_rng(1)
    h = float(bounded_limit(length, 0.5))
    upper, lower, alarms, steps = np.zeros(4000), np.zeros(4000), 0, 2000
    for _ in range(steps):
        z = bounded(rng.standard_normal(4000))
        upper, lower = np.maximum(0, upper + z - 0.5), np.maximum(0, lower - z - 0.5)
        rang = (upper > h) | (lower > h)
        alarms += int(rang.sum())
        upper[rang], lower[rang] = 0.0, 0.0
    assert steps * 4000 / alarms == pytest.approx(length, rel=4 / np.sqrt(alarms) + 0.02)


def test_foretold_chance_is_that_of_simulation() -> None:
    rng = np.random.default_rng(2)
    h, shift = float(bounded_limit(180.0, 0.5)), 0.8
    upper, rang = np.zeros(20_000), np.zeros(20_000, dtype=bool)
    for _ in range(30):
        upper = np.maximum(0, upper + bounded(shift + rng.standard_normal(20_000)) - 0.5)
        rang |= upper > h
    assert bounded_power(h, 0.5, shift, 30) == pytest.approx(rang.mean(), abs=0.02)


@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_promise_is_kept_by_models_whose_errors_move_with_conditions_and_wander(slope: float) -> None:
    """Weather drifts from winter to summer, eight of its widths; the mean wanders from month to month."""
    rng = np.random.default_rng(3)
    c = 4.0 * (1 - np.cos(np.arange(YEAR) * 2 * np.pi / YEAR)) + 0.5 * rng.standard_normal(YEAR)
    month = np.repeat(rng.standard_normal((YEAR // 28 + 1, N)), 28, axis=0)[:YEAR]
    x = slope * c[:, None] + 0.25 * month + rng.standard_normal((YEAR, N))
    rang = feed(chart_of(), x, c)[7:].sum()
    promised = 2.0 * N * (YEAR - 7) / YEAR
    assert rang <= 1.5 * promised
    assert rang >= 0.1 * promised


def test_shift_in_known_conditions_is_found_and_a_standing_alarm_learns_nothing_of_it() -> None:
    rng = np.random.default_rng(4)
    c = 0.5 * rng.standard_normal(200)
    x = rng.standard_normal((200, N))
    x[60:] += 1.5
    chart = chart_of()
    feed(chart, x[:60], c[:60])
    assert feed(chart, x[60:90], c[60:90]).any(axis=0).mean() > 0.9
    for t in range(90, 110):
        for _ in range(PARTS):
            v = chart.update_days(x[t] / np.sqrt(PARTS), np.full((N, 1), c[t]), np.zeros(N, dtype=bool))
    standing = v.phase == Phase.ALARM
    assert standing.mean() > 0.8
    before = chart.coefficients.copy()
    for t in range(110, 200):
        for _ in range(PARTS):
            v = chart.update_days(x[t] / np.sqrt(PARTS), np.full((N, 1), c[t]), np.zeros(N, dtype=bool))
    assert np.array_equal(chart.coefficients[standing], before[standing])
    assert np.all(v.phase[standing] == Phase.ALARM)


def test_gross_departure_rings_on_probation_and_is_not_learned() -> None:
    many = Daily.design(np.full(3, 180.0 * 100), block=100, conditions=1, probation=28)
    many.presume(np.ones(3, dtype=bool), np.zeros((3, 1)), np.ones((3, 1)))
    for _ in range(300):
        v = many.update_days(np.full(3, 1.5), np.zeros((3, 1)), np.zeros(3, dtype=bool))
    assert np.all(v.phase == Phase.ALARM)
    taught = many.days.copy()
    for _ in range(500):
        many.update_days(np.full(3, 1.5), np.zeros((3, 1)), np.zeros(3, dtype=bool))
    assert np.array_equal(many.days, taught)


def test_days_far_from_all_that_was_seen_are_not_judged_until_they_are_known() -> None:
    rng = np.random.default_rng(5)
    chart = chart_of()
    feed(chart, rng.standard_normal((60, N)), 0.5 * rng.standard_normal(60))
    judged = chart.judged.copy()
    feed(chart, np.zeros((1, N)), np.full(1, 12.0))
    v = chart.update_days(np.zeros(N), np.full((N, 1), 12.0), np.zeros(N, dtype=bool))
    assert np.all(v.phase == Phase.LEARNING)
    assert np.array_equal(chart.judged, judged)
    feed(chart, rng.standard_normal((14, N)), 12.0 + rng.standard_normal(14))
    v = chart.update_days(np.zeros(N), np.full((N, 1), 12.0), np.zeros(N, dtype=bool))
    assert np.all(v.phase == Phase.QUIET)


def test_knowledge_goes_with_a_stream_and_held_streams_learn_nothing() -> None:
    rng = np.random.default_rng(6)
    chart, other = chart_of(2), chart_of(2)
    feed(chart, rng.standard_normal((40, 2)), rng.standard_normal(40))
    other.recall(0, chart.knowledge(0))
    assert other.knowledge(0) == chart.knowledge(0)
    assert other.days.tolist() == [chart.days[0], 0]
    assert chart.days[0] > 28
    feed(other, rng.standard_normal((10, 2)), rng.standard_normal(10), held=True)
    assert other.knowledge(0) == chart.knowledge(0)


@pytest.mark.parametrize("spread", [0.2, 0.5])
def test_limits_of_daily_maxima_are_passed_no_more_often_than_promised(spread: float) -> None:
    """Logarithms of maxima are normal here, of a centre that the chart does not know."""
    rng = np.random.default_rng(7)
    chance, passed, days = np.full(2000, 1 / 500), 0, 400
    e = Extremes(2000, 1)
    centre = rng.uniform(0.5, 2.0, 2000)
    for _ in range(days):
        x = np.exp(centre + spread * rng.standard_normal(2000))
        passed += int((x > e.limit(chance)).sum())
        e.update(x, np.ones(2000, dtype=bool))
    assert passed / (2000 * days) < 1.5 / 500
    assert passed / (2000 * days) > 0.1 / 500
