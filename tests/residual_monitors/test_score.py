"""Score charts on a regression whose scores and informations are known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.information import change, inverse
from fdd.residual_monitors.score import Score

Array = NDArray[Any]


def regression(
    rng: Generator, steps: int, n: int, delta: Array, design: Array | None = None, noise: Array | None = None
) -> tuple[Array, Array]:
    """Scores and informations of y = x' theta + e at theta off by delta: innovation x' delta + e, w = -x, S = 1."""
    p = len(delta)
    x = rng.standard_normal((steps, n, p)) if design is None else rng.standard_normal((steps, n, len(design))) @ design
    e = x @ delta + (rng.standard_normal((steps, n)) if noise is None else noise)
    return x * e[..., None], x[..., :, None] * x[..., None, :]


def first_alarm(chart: Score, score: Array, information: Array) -> Array:
    first = np.full(chart.n, -1)
    for t, (s, i) in enumerate(zip(score, information, strict=True)):
        rang = (chart.update_scores(s, i).phase == Phase.ALARM) & (first < 0)
        first[rang] = t
    return first


def test_block_is_standardised_by_hand() -> None:
    chart = Score([[5.0, 5.0]], block=2, k=0.5)
    information = np.array([[[4.0, 0.0], [0.0, 1.0]]])
    assert np.all(chart.update_scores([[8.0, -1.0]], information).statistic == 0)
    said = chart.update_scores([[4.0, -1.0]], information)
    # s = (12, -2), I = diag(8, 2): z = 12 / sqrt 8, -2 / sqrt 2; the sums lose k
    np.testing.assert_allclose(said.statistic, [12 / np.sqrt(8) - 0.5, 2 / np.sqrt(2) - 0.5])
    np.testing.assert_array_equal(said.direction, [1, -1])
    np.testing.assert_array_equal(said.onset_age, [2, 2])


def test_no_chart_rings_for_a_change_inside_the_slack_and_each_for_one_well_beyond() -> None:
    """Of either parameter, though their scores are correlated; at the end of the deadband the promised rate is kept."""
    deadband, n, steps = 0.15, 60, 1500
    mix = np.array([[1.0, 0.8], [0.0, 0.6]])
    for delta in ([deadband, 0.0], [0.0, -deadband]):
        rang = {}
        for factor in (0.0, 1.0, 3.0):
            scores = regression(default_rng(3), steps, n, factor * np.array(delta), mix)
            chart = Score.design(np.full((n, 2), 5000.0), parameters=2, block=25)
            chart.tolerate(deadband)
            rang[factor] = float((first_alarm(chart, *scores).reshape(n, 2) >= 0).any(axis=1).mean())
            if factor == 1.0:
                strict = Score.design(np.full((n, 2), 5000.0), parameters=2, block=25)
                assert (first_alarm(strict, *scores).reshape(n, 2) >= 0).any(axis=1).all()
        # One of two sides and two charts may ring at the end of the deadband: 1 - exp(-1500 / 5000) of components.
        assert rang[1.0] < 0.26 + 4 * np.sqrt(0.26 * 0.74 / n)
        assert rang[0.0] <= rang[1.0]
        assert rang[3.0] == 1.0


def test_size_of_the_change_is_estimated_with_an_honest_error() -> None:
    rng, n = default_rng(1), 300
    delta = np.array([0.2, 0.0, -0.1])
    mix = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.6], [0.0, 0.0, 1.0]])
    chart = Score(np.full((n, 3), 1e3), block=50)
    for s, i in zip(*regression(rng, 400, n, delta, mix), strict=True):
        chart.update_scores(s, i)
    found = [chart.estimate(c, 10_000) for c in range(n)]
    deviation = np.array([(f.joint - delta) / f.joint_error for f in found])
    assert np.abs(deviation.mean(axis=0)).max() < 4 / np.sqrt(n)
    assert np.abs(deviation.std(axis=0) - 1).max() < 4 / np.sqrt(2 * n)


def test_the_parameter_that_moved_is_named() -> None:
    rng, n = default_rng(2), 200
    mix = np.array([[1.0, 0.7, 0.0], [0.0, 1.0, 0.7], [0.0, 0.0, 1.0]])
    for moved in range(3):
        delta = np.zeros(3)
        delta[moved] = 0.3
        score, information = (a.sum(axis=0) for a in regression(rng, 300, n, delta, mix))
        named = np.argmax(change(score, information).gain, axis=1)
        assert np.mean(named == moved) > 0.9


def test_isolated_chart_is_still_while_another_parameter_moves() -> None:
    rng, n = default_rng(3), 200
    mix = np.array([[1.0, 0.8], [0.0, 0.6]])
    score, information = regression(rng, 800, n, np.array([0.5, 0.0]), mix)
    raw, alone = (Score.design(np.full((n, 2), 1e5), parameters=2, block=20, isolated=b) for b in (False, True))
    first_raw, first_alone = (first_alarm(c, score, information).reshape(n, 2) for c in (raw, alone))
    assert np.mean(first_raw[:, 1] >= 0) > 0.9  # correlated with what moved
    assert np.mean(first_alone[:, 1] >= 0) < 0.05
    assert np.mean(first_alone[:, 0] >= 0) > 0.9


def test_unexcited_parameter_is_not_visible_and_never_alarms() -> None:
    rng, n = default_rng(4), 50
    chart = Score.design(np.full((n, 3), 500.0), parameters=3, block=10)
    score, information = regression(rng, 3000, n, np.array([0.0, 0.0]))
    score = np.concatenate([score, np.zeros((3000, n, 1))], axis=2)
    information = np.pad(information, ((0, 0), (0, 0), (0, 1), (0, 1)))
    for s, i in zip(score, information, strict=True):
        said = chart.update_scores(s, i)
    phase = said.phase.reshape(n, 3)
    assert np.all(phase[:, 2] == Phase.NO_DATA)
    found = chart.estimate(0, 10_000)
    assert np.isinf(found.joint_error[2])
    assert np.isnan(found.joint[2])
    assert np.all(np.isfinite(found.joint[:2]))
    assert np.isinf(chart.visibility(0)[2])
    assert np.all(chart.visibility(0)[:2] <= chart.visibility(0, joint=True)[:2])


def test_two_parameters_that_only_act_together_have_no_joint_estimate() -> None:
    rng = default_rng(5)
    score, information = (
        a.sum(axis=0) for a in regression(rng, 200, 1, np.array([0.3, 0.0, 0.0]), np.array([[1.0, 1, 0], [0, 0, 1]]))
    )
    found = change(score, information)
    assert np.all(np.isinf(found.joint_error[0, :2]))
    assert np.isfinite(found.joint_error[0, 2])
    assert np.all(np.isfinite(found.single[0]))


def test_pseudo_inverse_is_the_inverse_where_there_is_one() -> None:
    x = default_rng(6).standard_normal((5, 20, 4)) * [1.0, 1e-6, 1e6, 3.0]
    information = np.einsum("rti,rtj->rij", x, x)
    np.testing.assert_allclose(inverse(information)[0], np.linalg.inv(information), rtol=1e-6)


def test_long_run_spread_keeps_the_rate_when_innovations_are_not_white() -> None:
    """AR(1) innovations of rho 0.6: the spread of a block's z is about 2, and is learned on the baseline."""
    rng, n, steps = default_rng(7), 200, 20_000
    rates = {}
    for learn in (0, 200):
        chart = Score.design(np.full((n, 1), 5000.0), parameters=1, block=60, learn=learn)
        e, alarms, exposed = rng.standard_normal(n), 0, 0.0
        for _ in range(steps):
            e = 0.6 * e + 0.8 * rng.standard_normal(n)
            said = chart.update_scores(e[:, None], np.ones((n, 1, 1)))
            rang = said.phase == Phase.ALARM
            exposed += np.count_nonzero(said.phase != Phase.LEARNING)
            alarms += int(np.count_nonzero(rang))
            if rang.any():
                chart.reset(rang)
        rates[learn] = alarms / exposed * 5000
    assert rates[0] > 5
    assert 0.5 < rates[200] < 1.6  # the spread itself is learned from 200 blocks


def test_limits_widened_for_the_baseline_keep_the_rate() -> None:
    """Baselines fitted on 2 000 samples: their error moves every later score."""
    rng, n, block, m = default_rng(8), 400, 20, 2000
    rates = {}
    for known in (np.inf, float(m)):
        chart = Score.design(np.full((n, 1), 5000.0), parameters=1, block=block, baseline_samples=known)
        error = rng.standard_normal(n) / np.sqrt(m)
        alarms = 0
        for _ in range(10_000):
            e = rng.standard_normal(n) + error
            rang = chart.update_scores(e[:, None], np.ones((n, 1, 1))).phase == Phase.ALARM
            alarms += int(np.count_nonzero(rang))
            if rang.any():
                chart.reset(rang)
        rates[known] = alarms / (n * 10_000) * 5000
    assert rates[np.inf] > 1.3
    assert rates[float(m)] == pytest.approx(1.0, abs=0.25)


def test_one_absurd_sample_does_not_drown_a_block() -> None:
    rng = default_rng(9)
    chart = Score([[8.0]], block=50)
    score, information = regression(rng, 500, 1, np.array([0.0]))
    score[100] = 1e200
    for s, i in zip(score, information, strict=True):
        chart.update_scores(s, i)
    assert np.all(np.isfinite(chart.past_score))


def test_shapes_are_checked() -> None:
    chart = Score(np.full((2, 3), 5.0))
    with pytest.raises(ValueError, match="2 components and 3 parameters"):
        chart.update_scores(np.zeros((3, 2)), np.zeros((3, 2, 2)))
    with pytest.raises(TypeError, match="update_scores"):
        chart.update(np.zeros(6))


@pytest.mark.parametrize("isolated", [False, True])
def test_components_with_fitted_baselines_say_what_each_says_alone(isolated: bool) -> None:
    rng, n, p = default_rng(11), 5, 7
    root = rng.standard_normal((n, p, 2 * p))
    covariance = 1e-3 * root @ root.transpose(0, 2, 1)
    options = {"block": 10, "isolated": isolated}
    big = Score(np.full((n, p), 50.0), covariance=covariance, **options)  # type: ignore[arg-type]
    alone = [Score(np.full((1, p), 50.0), covariance=covariance[i : i + 1], **options) for i in range(n)]  # type: ignore[arg-type]
    score, information = regression(rng, 120, n, np.zeros(p))
    score[rng.random((120, n)) < 0.2] = np.nan
    for s, i in zip(score, information, strict=True):
        said = big.update_scores(s, i).statistic.reshape(n, p)
        for c, chart in enumerate(alone):
            assert chart.update_scores(s[c : c + 1], i[c : c + 1]).statistic.tobytes() == said[c].tobytes()
    assert big.estimate(2, 10_000).joint.tobytes() == alone[2].estimate(0, 10_000).joint.tobytes()


def test_what_the_baseline_error_explains_is_forgiven_and_more_is_not() -> None:
    rng, n, m = default_rng(12), 200, 400
    covariance = np.tile([[1 / m]], (n, 1, 1))
    share = {}
    for errors in (1.0, 8.0):
        chart = Score.design(np.full((n, 1), 1e5), parameters=1, block=20, covariance=covariance)
        delta = np.array([errors / np.sqrt(m)])
        share[errors] = np.mean(first_alarm(chart, *regression(rng, 4000, n, delta)) >= 0)
    assert share[1.0] < 0.06
    assert share[8.0] > 0.95


def blocks(rng: Generator, count: int, n: int, sd: float, mean: float = 0.0) -> Array:
    """Scores of blocks of one sample with information 1 of ``n`` components with one parameter."""
    return rng.normal(mean, sd, (count, n, 1))


def watch(chart: Score, scores: Array) -> Array:
    return first_alarm(chart, scores, np.ones((*scores.shape, 1)))


def test_spread_within_chance_is_taken_as_one() -> None:
    n, m = 2000, 84
    found = np.sqrt(np.square(default_rng(5).standard_normal((m, n))).mean(axis=0))
    chart = Score(np.full((n, 1), 9.0), block=1)
    chart.presume(np.ones(n, dtype=bool), found[:, None], m)
    widened = np.mean([chart.spread_of(c)[0] > 1 for c in range(n)])
    # one in twenty, by the normal approximation to chi squared with 84 degrees: 5.7 %; three Monte-Carlo errors
    assert abs(widened - 0.057) < 3 * np.sqrt(0.057 * 0.943 / n)


def test_spread_that_the_baseline_missed_is_learned_while_quiet() -> None:
    n = 400
    everyone = np.ones(n, dtype=bool)
    learning, given = Score(np.full((n, 1), 9.0), block=1, enough=112.0), Score(np.full((n, 1), 9.0), block=1)
    for chart in (learning, given):
        chart.presume(everyone, np.ones((n, 1)), 84)
    scores = blocks(default_rng(6), 400, n, 1.4)
    rang = [np.mean(watch(chart, scores) >= 0) for chart in (learning, given)]
    assert rang[0] < 0.5 * rang[1]
    quiet = learning.latched == 0
    found = np.array([learning.spread_of(c)[0] for c in np.flatnonzero(quiet).tolist()])
    # 84 blocks of the baseline say 1, up to 112 of the present say 1.4
    assert 1.15 < np.median(found) < np.sqrt((84 + 112 * 1.96) / 196)


def test_fault_is_not_learned_as_spread() -> None:
    n = 200
    chart = Score(np.full((n, 1), 9.0), block=1, enough=112.0)
    chart.presume(np.ones(n, dtype=bool), np.ones((n, 1)), 84)
    rang = watch(chart, blocks(default_rng(7), 60, n, 1.0, mean=1.25))
    assert (rang >= 0).all()
    # the run length of a CUSUM with k = 0.5 and h = 9 at this shift is about 13 blocks
    assert np.mean(rang) < 1.25 * 13
    assert max(chart.spread_of(c)[0] for c in range(n)) < 1.25


def test_new_baseline_of_one_component_leaves_what_others_learned() -> None:
    chart = Score(np.full((2, 1), 50.0), block=1, enough=112.0)
    chart.presume(np.ones(2, dtype=bool), np.ones((2, 1)), 84)
    watch(chart, blocks(default_rng(8), 112, 2, 2.0))
    learned = chart.spread_of(1).copy()
    chart.presume(np.array([True, False]), np.ones((2, 1)), 84)
    assert learned > 1.3
    np.testing.assert_array_equal(chart.spread_of(1), learned)
    np.testing.assert_array_equal(chart.spread_of(0), [1.0])


def test_phase_is_learning_until_a_direction_is_known_as_from_enough_blocks() -> None:
    """Variance 1/100 at an information of 100 a block is what one block would tell; 112 are wanted."""
    covariance = np.array([[[0.01, 0.0], [0.0, 0.0]]])
    chart = Score(np.full((1, 2), 50.0), block=1, covariance=covariance, enough=112.0)
    information = np.array([[[100.0, 0.0], [0.0, 100.0]]])
    rng = default_rng(9)
    phase = np.array([chart.update_scores(10.0 * rng.standard_normal((1, 2)), information).phase for _ in range(130)])
    known = np.argmax(phase[:, 0] == Phase.QUIET)
    assert known == pytest.approx(112, abs=2)
    assert np.all(phase[:known, 0] == Phase.LEARNING)
    assert np.all(phase[known:, 0] == Phase.QUIET)
    assert np.all(phase[:, 1] == Phase.QUIET)
    chart.depart(np.ones(1, dtype=bool), covariance)
    assert chart.update_scores(np.zeros((1, 2)), information).phase[0] == Phase.LEARNING
