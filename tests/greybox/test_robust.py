"""Estimates from records with gross outliers, by the robust and by the normal likelihood."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import approx_fprime
from scipy.stats import norm

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.results import FitResult
from fdd.greybox.robust import expectation, loss
from fdd.greybox.simulate import realise
from tests.greybox import problems
from tests.greybox.records import ou1d

TRUE = np.array([5.0, 3.0, 0.2, -1.5])


def drawn(seed: int, outliers: float) -> Data:
    """400 samples of a known process; a share of them off by 3 to 10 (13 to 45 standard deviations of the error)."""
    t, random = np.arange(400) * 0.1, np.random.default_rng(1000 + seed)
    d = realise(problems.ou1d(), TRUE, Data(t, np.sign(np.sin(t * 1.3))[:, None], np.zeros((400, 1))), seed)
    hit = random.random(400) < outliers
    y = d.y.copy()
    y[hit, 0] += random.choice([-1, 1], hit.sum()) * random.uniform(3, 10, hit.sum())
    return dataclasses.replace(d, y=y)


def deviations(huber: float, outliers: float) -> np.ndarray:
    """Estimates less truth over their standard errors, (20 records, 4 parameters)."""
    fits = [fit(problems.ou1d(), drawn(seed, outliers), huber=huber) for seed in range(100, 120)]
    return np.array([(r.values - TRUE) / np.array(list(r.bse.values())) for r in fits])


def test_estimates_with_five_per_cent_outliers_stay_within_their_errors() -> None:
    """As often as those of the normal likelihood from records without outliers.

    Of 240 of those (60 records) 4 are beyond 3 errors, all of noise parameters, whose distribution is not yet normal at
    400 samples; of 80, that rate gives more than 4 in 1 % of cases.
    """
    z = deviations(2.5, 0.05)
    assert (np.abs(z[:, :2]) < 3).all()  # rate and level
    assert (np.abs(z) > 3).sum() <= 4
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.35  # one, with a standard error of 8 % from 80 of them


def test_normal_likelihood_does_not_stand_them() -> None:
    z = deviations(np.inf, 0.05)
    assert (~(np.abs(z) <= 3)).any(axis=1).sum() >= 15  # of 20 records some estimate is off, or its error is lost


@pytest.mark.parametrize("huber", [1.5, 2.5])
def test_outliers_to_one_side_pull_the_level_by_less_than_half(huber: float) -> None:
    """Every fiftieth sample reads 8 too high; against the normal likelihood, and from the estimate without outliers."""
    d = drawn(1, 0.0)
    y = d.y.copy()
    y[::50] += 8.0
    spoilt = dataclasses.replace(d, y=y)
    level, plain, robust = (
        fit(problems.ou1d(), data, huber=bound).params["mu"]
        for data, bound in ((d, np.inf), (spoilt, np.inf), (spoilt, huber))
    )
    assert abs(robust - level) < 0.5 * abs(plain - level)


def test_without_outliers_little_is_lost() -> None:
    """Against the normal likelihood: estimates differ by a fraction of an error."""
    d = drawn(7, 0.0)
    plain, careful = fit(problems.ou1d(), d), fit(problems.ou1d(), d, huber=2.5)
    errors = np.array(list(plain.bse.values()))
    assert (np.abs(plain.values - careful.values) < 0.6 * errors).all()
    np.testing.assert_allclose(list(careful.bse.values()), errors, rtol=0.4)


def test_sandwich_is_the_information_where_the_model_holds() -> None:
    d = drawn(7, 0.0)
    plain, careful = fit(problems.ou1d(), d), fit(problems.ou1d(), d, errors="sandwich")
    assert careful.errors == "sandwich"
    np.testing.assert_allclose(list(careful.bse.values()), list(plain.bse.values()), rtol=0.25)


@pytest.mark.parametrize("bound", [1.0, 2.5])
def test_loss_and_its_expectation_are_the_derivative_and_the_integral(bound: float) -> None:
    def influence(z: float) -> float:
        ends = [float(loss(np.array([(z * (1 + s)) ** 2]), bound)[0]) * expectation(bound) for s in (1e-5, -1e-5)]
        return 0.5 * (ends[0] - ends[1]) / 2e-5

    assert influence(50.0) == pytest.approx(min(1.5, bound**2), rel=0.01)
    mean = 2 * quad(lambda z: influence(z) * norm.pdf(z), 0, 12, points=[bound], limit=200)[0]
    assert expectation(bound) == pytest.approx(mean, rel=1e-6)


def test_nonlinear_models_and_two_outputs_have_exact_gradients() -> None:
    m = dataclasses.replace(
        problems.ou2d(), name="bent two", observe=lambda x, u, p: {"y1": x.x1 * x.x1, "y2": x.x1 * x.x2 + p.mu * x.x2}
    )
    values = np.array([0.5, 2.9, 0.4, -1.0, -1.0, -2.0, -1.0])
    t = np.arange(60) * 0.1
    d = realise(m, values, Data(t, np.sin(t)[:, None], np.zeros((60, 2))), seed=2)
    y = d.y.copy()
    y[::9] += 5.0
    likelihood = Likelihood(m, dataclasses.replace(d, y=y), huber=2.0)
    slope = approx_fprime(values * 1.02, likelihood.value, 1e-7)
    np.testing.assert_allclose(likelihood.evaluate(values * 1.02).gradient, slope, rtol=1e-3, atol=1e-2)
    assert likelihood.losses(values).sum() == pytest.approx(likelihood.value(values), rel=1e-12)


def test_a_robust_result_keeps_its_bound() -> None:
    r = fit(problems.ou1d(), drawn(3, 0.05), huber=2.5)
    again = FitResult.from_dict(r.to_dict(), problems.ou1d(), drawn(3, 0.05))
    assert "robust: innovations bounded at 2.5" in again.summary()
    np.testing.assert_array_equal(again.paths()[0].predicted, r.paths()[0].predicted)
    assert not np.array_equal(
        again.paths()[0].predicted, Likelihood(r._model(), drawn(3, 0.05)).paths(r.values)[0].predicted
    )


def test_a_bound_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="huber is 0; give a positive number"):
        Likelihood(problems.ou1d(), ou1d(), huber=0)
