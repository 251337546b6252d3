"""The bank against exact results: a linear form whose evidence is a normal density, and frequencies of drawn faults."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from fdd.diagnosis import bank
from fdd.models.expectation import Alternative, Day, EquipmentFault, EquipmentModel, Prior, Role, SteadyForm, Values
from fdd.records import FloatArray


def predict(v: Values, p: Values) -> Values:
    return {"y": p["a"] + p["b"] * v["x"]}


SHIFTED = Alternative("shifted", lambda v, p, s: (v, {**p, "a": p["a"] + s}), -3.0, 3.0, "identity", "K", (-1.5, 1.5))
STEEPER = Alternative("steeper", lambda v, p, s: (v, {**p, "b": p["b"] + s}), -3.0, 3.0, "identity", "1", (-1.5, 1.5))
FORM = SteadyForm(
    lambda day: np.isfinite(day["x"]), ("x", "y"), predict,
    (Prior("a", "K", "offset", 1.0, 0.3), Prior("b", "1", "slope", 0.5, 0.2)), {"y": 0.3}, (SHIFTED, STEEPER),
)  # fmt: skip
MODEL = EquipmentModel(
    "line", "Line", (Role("x", "1", "input"), Role("y", "K", "output")), (),
    (EquipmentFault("shifted", "offset", "a shift", ()), EquipmentFault("steeper", "slope", "a slope", ())), FORM,
)  # fmt: skip


def held(x: FloatArray, y: FloatArray) -> Values:
    """Independent values, each seen in as many blocks as count for one."""
    blocks = round(1 / bank.WORTH)
    return {"x": np.repeat(x, blocks), "y": np.repeat(y, blocks)}


def test_the_evidence_of_a_linear_form_is_its_normal_density() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 2, 20), rng.normal(1, 1, 20)
    got = bank.weigh(MODEL, held(x, y), bank.prior(FORM)).normal.evidence
    design = np.column_stack([np.ones(20), x])
    covariance = design @ np.diag([0.09, 0.04]) @ design.T + 0.09 * np.eye(20)
    exact = stats.multivariate_normal(design @ [1.0, 0.5], covariance).logpdf(y)
    assert got - 10 * np.log(2 * np.pi * 0.09) == pytest.approx(exact, abs=1e-5)


def test_probabilities_are_frequencies() -> None:
    rng = np.random.default_rng(1)
    told, right = [], []
    for _ in range(120):
        a, b = rng.normal(1.0, 0.3), rng.normal(0.5, 0.2)
        which, size = int(rng.integers(2)), rng.uniform(-3, 3)
        x = rng.uniform(0, 2, 6)
        y = a + (size if which == 0 else 0.0) + (b + (size if which else 0.0)) * x + 0.3 * rng.standard_normal(6)
        found = {f.name: f.evidence for f in bank.weigh(MODEL, held(x, y), bank.prior(FORM)).faults}
        p = 1 / (1 + np.exp(found["steeper"] - found["shifted"]))
        told.append(max(p, 1 - p))
        right.append((p > 0.5) == (which == 0))
    # 120 draws: three standard deviations of a share of about 0.85 are 0.1.
    assert np.mean(right) == pytest.approx(np.mean(told), abs=0.1)


def test_chance_rarely_favours_the_faults_together() -> None:
    rng = np.random.default_rng(2)
    share = {"shifted": 0.5, "steeper": 0.5}
    above = 0
    for _ in range(200):
        a, b, x = rng.normal(1.0, 0.3), rng.normal(0.5, 0.2), rng.uniform(0, 2, 6)
        y = a + b * x + 0.3 * rng.standard_normal(6)
        above += bank.weigh(MODEL, held(x, y), bank.prior(FORM)).odds_against_normal(share) > np.log(20)
    # Markov: at most 1 in 20; 200 draws give 10, and 3 sd are 9.
    assert above <= 19


def test_normal_days_sharpen_the_parameters_to_their_truth() -> None:
    rng = np.random.default_rng(3)
    days = []
    for _ in range(8):
        x = rng.uniform(0, 2, 24)
        days.append({"x": x, "y": 1.4 + 0.4 * x + 0.3 * rng.standard_normal(24)})
    learned = bank.learn(FORM, days)
    assert learned is not None
    sd = np.sqrt(np.diag(learned.root @ learned.root.T))
    assert np.all(np.abs(learned.mean - [1.4, 0.4]) < 3 * sd)
    assert np.all(sd < [0.3, 0.2])
    assert bank.learn(FORM, days[:4]) is None


def test_blocks_are_means_of_half_hours() -> None:
    time = np.arange(48) * 300.0
    day = Day(time, {"x": time / 1800.0, "y": np.ones(48)}, 300.0)
    found = bank.blocks(FORM, day)
    assert found is not None
    assert found["x"] == pytest.approx(np.arange(8) + 2.5 / 6)
