"""The gate says what the data allow, and self-calibration what the sensors are worth."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.chiller_eiv.calibration import calibrate_errors
from fdd.chiller_eiv.fit import FitOptions
from fdd.chiller_eiv.gate import Level, effective_size, gate
from fdd.chiller_eiv.simulate import LAB_CHILLER, LAB_SIGMA, autocorrelated, design, operate


def points(days: int, seed: int = 3, noise: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    o = operate(days, seed, noise=noise)
    cov = np.broadcast_to(np.diag((max(noise, 0.1) * LAB_SIGMA) ** 2), (len(o.x), 4, 4))
    return o.x, cov, np.arange(len(o.x)) // 24


def test_twelve_weeks_of_varied_load_identify_everything() -> None:
    decision = gate(*points(84))
    assert decision.level is Level.FULL
    assert decision.reasons == ()
    assert decision.fit.values()["R"] == pytest.approx(LAB_CHILLER.R, rel=0.05)


def test_two_noisy_weeks_identify_loss_and_resistance_only() -> None:
    decision = gate(*points(14, noise=2.0), leak=LAB_CHILLER.Q_leak)
    assert decision.level is Level.HELD
    assert decision.fit.held == {"Q_leak": LAB_CHILLER.Q_leak}
    assert any("Q_leak" in r for r in decision.reasons)
    assert decision.fit.values()["dS"] == pytest.approx(LAB_CHILLER.dS, rel=0.05)


def test_a_load_that_does_not_move_is_refused() -> None:
    x, cov, day = points(28, noise=2.0)
    rng = np.random.default_rng(1)
    x[:, 2] = 9000.0 * (1 + 0.01 * rng.standard_normal(len(x)))
    x[:, 3] = LAB_CHILLER.power(x[:, 2], x[:, 0], x[:, 1]) + 20 * rng.standard_normal(len(x))
    x[:, 2] += 400 * rng.standard_normal(len(x))
    decision = gate(x, cov, day)
    assert decision.level is Level.RESIDUAL
    assert "the load hardly moves" in decision.sentence()
    assert decision.sentence().startswith("not identifiable, because")


def test_halves_that_disagree_are_refused() -> None:
    x, cov, day = points(28, noise=0.5)
    second = day >= 14
    other = LAB_CHILLER
    x[second, 3] = LAB_CHILLER.power(x[second, 2], x[second, 0], x[second, 1]) * 0 + _power(other, x[second], 2.2)
    decision = gate(x, cov, day)
    assert decision.level is Level.RESIDUAL
    assert any("first and second half of the data disagree on R" in r for r in decision.reasons)


def _power(machine, x: np.ndarray, factor: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    from fdd.chiller_eiv.model import power

    return power(x[:, 2], x[:, 0], x[:, 1], machine.dS, machine.Q_leak, machine.R * factor)


def test_few_independent_points_are_refused() -> None:
    x, cov, day = points(10, noise=0.2)
    slow = autocorrelated(np.random.default_rng(0), len(x), 0.99, 0.03)
    x[:, 3] *= 1 + slow
    decision = gate(x, cov, day)
    assert decision.level is Level.RESIDUAL
    assert any("independent ones" in r for r in decision.reasons)


def test_effective_size_follows_the_autocorrelation() -> None:
    rng = np.random.default_rng(5)
    assert effective_size(rng.standard_normal(5000)) > 4000
    # AR(1): n (1 - rho) / (1 + rho); the estimate's own spread is about 10 % at this length.
    assert effective_size(autocorrelated(rng, 20_000, 0.8, 1.0)) == pytest.approx(20_000 * 0.2 / 1.8, rel=0.3)


def test_a_held_parameter_is_not_held_twice() -> None:
    x, cov, day = points(7, noise=2.0)
    decision = gate(x, cov, day, options=FitOptions(held={"Q_leak": 2723.0}))
    assert decision.level in (Level.FULL, Level.RESIDUAL)


@pytest.mark.parametrize(
    ("assumed", "word", "scale"), [(1.0, "agree", 1.0), (0.5, "too small", 4.0), (2.0, "too large", 0.25)]
)
def test_self_calibration_finds_the_true_errors(assumed: float, word: str, scale: float) -> None:
    rng = np.random.default_rng(6)
    x = design("wide", 2000) + 2 * LAB_SIGMA * rng.standard_normal((2000, 4))
    c = calibrate_errors(x, np.diag((assumed * 2 * LAB_SIGMA) ** 2))
    assert word in c.note
    # sqrt(2 / 2000) = 3 % is one standard error of the ratio.
    assert c.scale == pytest.approx(scale, rel=0.1)


def test_model_error_is_not_taken_for_sensor_error() -> None:
    rng = np.random.default_rng(7)
    x = design("wide", 500)
    x[:, 3] *= 1 + 0.05 * rng.standard_normal(500)
    c = calibrate_errors(x, np.diag((0.2 * LAB_SIGMA) ** 2))
    assert c.scale == 1.0
    assert "does not fit" in c.note
