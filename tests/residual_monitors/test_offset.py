"""An uncertain baseline: what its error adds to the reference value, and how it is learned and then left alone."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.typing import NDArray

from fdd.records import FloatArray
from fdd.residual_monitors.predictive import Uncertainty, siegmund_rate
from fdd.residual_monitors.run_length import Rule, arl, false_alarm_rate, limit_for
from fdd.residual_monitors.score import Score

BLOCKS = 400


@pytest.mark.parametrize("drift", [0.3, 0.5])
def test_rate_agrees_with_the_run_length_solver(drift: float) -> None:
    limit = float(limit_for("cusum", 5000.0, k=drift))
    exact = 1.0 / arl(Rule("cusum", k=drift), limit)
    assert 2 * float(siegmund_rate(np.array(drift), limit)) == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize("sd", [0.05, 0.1, 0.2])
def test_widened_reference_keeps_the_average_rate(sd: float) -> None:
    limit = float(limit_for("cusum", 5000.0))
    extra = float(Uncertainty([limit], 0.5).extra(np.array([sd * sd]))[0])
    assert false_alarm_rate(Rule("cusum", k=0.5 + extra), limit, sd) * 5000.0 == pytest.approx(1.0, rel=0.15)
    assert false_alarm_rate(Rule("cusum", k=0.5), limit, sd) * 5000.0 > (1.1 if sd < 0.1 else 1.9)


def _blocks(chart: Score, error: FloatArray, first: int, blocks: int, seed: int) -> NDArray[np.bool_]:
    """Feed blocks of a baseline that is off by ``error`` (n, p); returns which streams have rung."""
    rng, (n, p) = default_rng(seed), error.shape
    rang = np.zeros(n * p, dtype=bool)
    for block in range(first, first + blocks):
        root = np.eye(p) * (3.0 if block % 2 else 6.0)
        root[0, 1] = 2.0
        information = np.tile(root @ root.T, (n, 1, 1))
        score = np.einsum("nij,nj->ni", information, error) + rng.standard_normal((n, p)) @ root.T
        rang |= chart.update_scores(score, information).phase == 3
    return rang


def _chart(n: int, prior: float, enough: float = 112.0) -> Score:
    covariance = np.tile(np.eye(2) * prior**2, (n, 1, 1))
    return Score.design(np.full((n, 2), 2000.0), parameters=2, block=1, covariance=covariance, enough=enough)


def test_error_within_the_prior_is_learned_without_false_alarms() -> None:
    n, prior = 1500, 0.5
    error = prior * default_rng(1).standard_normal((n, 2))
    chart = _chart(n, prior)
    rang = _blocks(chart, error, 0, BLOCKS, 2)
    promised = -np.expm1(-BLOCKS / 2000.0)
    assert rang.mean() == pytest.approx(promised, rel=0.3)
    assert np.std(chart.offset - error) < 0.05
    deaf = _blocks(_chart(n, 1e-6), error, 0, BLOCKS, 2)
    assert deaf.mean() > 0.5


def test_what_is_learned_is_frozen_and_a_later_fault_is_found() -> None:
    n, prior = 200, 0.5
    error = prior * default_rng(3).standard_normal((n, 2))
    chart = _chart(n, prior)
    _blocks(chart, error, 0, BLOCKS, 4)
    known = chart.offset.copy()
    chart.reset()
    assert _blocks(chart, error + np.array([0.3, 0.0]), BLOCKS, 60, 5).reshape(n, 2)[:, 0].mean() > 0.95
    assert np.abs(chart.offset - known).max() < 0.05


def test_error_beyond_the_prior_rings_instead_of_being_swallowed() -> None:
    chart = _chart(100, 0.1)
    assert _blocks(chart, np.tile([1.0, 0.0], (100, 1)), 0, 12, 6).reshape(100, 2).any(axis=1).mean() > 0.95
