"""The evidence engine by Monte-Carlo: chances are what they say, before and after learning."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fdd.diagnosis.evidence import Beliefs, allowed_chance, judge, learn, prior, statistics
from fdd.models.equipment.air_handler import AIR_HANDLER
from fdd.models.expectation import Day, EquipmentModel, Residual, Role, Row, Term

ONE = Role("T_a", "degC", "a temperature", 0.5)
TWO = Role("T_b", "degC", "another", 0.5)


def difference(day: Day) -> Residual:
    return day["T_a"] - day["T_b"], {"T_a": 1.0, "T_b": -1.0, "slope": day["x"]}


ROW = Row(
    "difference", ("T_a", "T_b", "x"), difference, "made for this test", high="apart", low="apart",
    terms=(Term("slope", 0.3, "unknown slope"),), sd=0.2,
)  # fmt: skip
MODEL = EquipmentModel("toy", "Toy", (ONE, TWO, Role("x", "1", "driver")), (ROW,), ())


def day(bias: float, slope: float, x: float, rng: np.random.Generator) -> Day:
    """One stretch of an hour: what is left has the declared spread."""
    n = 12
    left = 0.2 * rng.standard_normal()
    a = 20.0 + bias + slope * x + left
    return Day(np.arange(n) * 300.0, {"T_a": np.full(n, a), "T_b": np.full(n, 20.0), "x": np.full(n, x)}, 300.0)


def test_chances_are_uniform_over_plants_before_anything_is_learned() -> None:
    rng = np.random.default_rng(3)
    chances = []
    for _ in range(600):
        bias, slope = rng.normal(0, np.hypot(0.5, 0.5)), rng.normal(0, 0.3)
        seen = statistics(MODEL, day(bias, slope, rng.uniform(0, 4), rng))
        chances.append(judge(MODEL, seen, Beliefs(), 0.01)[0].chance)
    assert stats.kstest(chances, "uniform").pvalue > 0.001


def test_chances_of_one_learned_plant_are_kept() -> None:
    rng = np.random.default_rng(4)
    rung = 0
    for _ in range(200):
        bias, slope = rng.normal(0, 0.7), rng.normal(0, 0.3)
        normal = [statistics(MODEL, day(bias, slope, rng.uniform(0, 4), rng)) for _ in range(6)]
        beliefs = learn(MODEL, normal)
        seen = statistics(MODEL, day(bias, slope, rng.uniform(0, 4), rng))
        rung += judge(MODEL, seen, beliefs, 0.05)[0].rings
    # Binomial with 200 of 0.05: 10, and 3 sd are 9; the drift that is granted makes it rarer.
    assert rung <= 19


def test_learning_is_bayesian_regression() -> None:
    rng = np.random.default_rng(5)
    normal = [statistics(MODEL, day(0.4, 0.2, x, rng)) for x in (0.0, 1.0, 2.0, 3.0, 4.0)]
    belief = learn(MODEL, normal).tests["difference +"]
    h = np.array([d[0].factors for d in normal])
    r = np.array([d[0].value for d in normal])
    before = prior(MODEL, ROW)
    exact = np.linalg.solve(
        h.T @ h / belief.variance + np.linalg.inv(before.covariance), h.T @ r / belief.variance
    )  # fmt: skip
    assert belief.mean == pytest.approx(exact, rel=1e-6)


def test_four_days_teach_nothing() -> None:
    rng = np.random.default_rng(6)
    assert learn(MODEL, [statistics(MODEL, day(0.4, 0.0, 1.0, rng)) for _ in range(4)]).tests == {}


def test_an_inequality_that_is_kept_is_never_evidence() -> None:
    n = 288
    warm = np.full(n, 21.0)
    values = {"T_supply": warm, "T_mixed": warm, "fan": np.full(n, 0.8), "heat": np.zeros(n), "cool": np.full(n, 0.5)}
    found = statistics(AIR_HANDLER, Day(np.arange(n) * 300.0, values, 300.0))
    kept = [s for s in found if s.row == "air over the cooling coil"]
    tests = judge(AIR_HANDLER, kept, learn(AIR_HANDLER, [kept] * 8), 0.2)
    assert [t.chance for t in tests] == [1.0]


def test_the_days_tests_share_the_budget() -> None:
    assert allowed_chance(2.0, 10) * 10 * 365.25 == pytest.approx(2.0)
