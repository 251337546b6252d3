from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data
from fdd.greybox.plots import diagnostics, html
from fdd.greybox.results import FitResult
from fdd.greybox.simulate import realise
from fdd.greybox.validate import (
    Verdict,
    autocorrelation,
    cumulated_periodogram,
    kolmogorov_band,
    lag_dependence,
    propagated_sd,
    time_constants,
    validate,
)  # fmt: skip
from fdd.models.declare import ComponentModel
from tests.greybox import problems
from tests.greybox.records import ou1d

TRUE = np.array([5.0, 3.0, 0.2, -1.5])


def simulated(seed: int, n: int = 800) -> Data:
    t = np.arange(n) * 0.1
    return realise(problems.ou1d(), TRUE, Data(t, np.sin(t * 0.7)[:, None], np.zeros((n, 1))), seed)


@pytest.fixture(scope="module")
def good() -> FitResult:
    return fit(problems.ou1d(), simulated(3))


def test_a_model_that_holds_passes_everything(good: FitResult) -> None:
    v = validate(good, other=simulated(4))
    assert v.passed, v.table()
    tests = {w.test for w in v.verdicts}
    assert {"autocorrelation", "Ljung-Box", "cumulated periodogram", "lag dependence", "residual against", "normality",
            "variance", "cross-validation", "time constant"} <= tests  # fmt: skip


def test_a_forgotten_input_shows_against_that_input(good: FitResult) -> None:
    blind = dataclasses.replace(problems.ou1d(), drift=lambda x, u, p: {"x": p.th * (p.mu - x.x)})
    v = validate(fit(blind, simulated(3)))
    failed = {(w.test, w.about) for w in v.verdicts if not w.passed}
    assert ("residual against", "y / u") in failed


def test_too_simple_a_model_is_not_white() -> None:
    """A second-order process fitted with a first-order model."""
    t = np.arange(1500) * 0.1
    d = realise(problems.ou2d(), np.array([0.7, 3.0, 0.2, 0.3, -3.0, -3.0, -2.5]),
                Data(t, np.sin(t)[:, None], np.zeros((1500, 2))), 5)  # fmt: skip
    v = validate(fit(problems.ou1d(), dataclasses.replace(d, y=d.y[:, 1:])))
    failed = {w.test for w in v.verdicts if not w.passed}
    assert {"autocorrelation", "Ljung-Box"} <= failed


def test_autocorrelation_is_that_of_statsmodels() -> None:
    from statsmodels.tsa.stattools import acf

    z = np.random.default_rng(0).normal(size=500)
    # statsmodels divides every lag by N, here each mean has its own number of products.
    np.testing.assert_allclose(autocorrelation(z, 10), acf(z, nlags=10, adjusted=True), atol=1e-12)


def test_periodogram_band_holds_its_level() -> None:
    random, outside = np.random.default_rng(1), 0
    for _ in range(600):
        f, c = cumulated_periodogram(random.normal(size=401))
        outside += np.abs(c - f / f[-1]).max() > kolmogorov_band(401, 0.05)
    # The band is asymptotic and a little wide; 5 % of 600 is 30 with a standard error of 5.3.
    assert 8 <= outside <= 46


def test_lag_dependence_sees_what_the_autocorrelation_does_not() -> None:
    random = np.random.default_rng(2)
    parabola = np.empty(4000)
    parabola[0] = 0.1
    for k in range(1, 4000):
        parabola[k] = 1 - 2 * parabola[k - 1] ** 2  # deterministic, uncorrelated
    assert abs(autocorrelation(parabola, 1)[1]) < 0.05
    assert lag_dependence(parabola, 3)[0] > 0.9
    assert np.abs(lag_dependence(random.normal(size=4000), 5)).max() < 0.1


def test_measurement_errors_propagate_through_the_predictor(good: FitResult) -> None:
    """With an error on the output alone: e_k + gain-weighted older ones; never less than the error itself."""
    sd = propagated_sd(good, simulated(3), {"y": 0.2})[0]
    assert 0.2 < sd < 0.2 * np.sqrt(2)
    assert propagated_sd(good, simulated(3), {"u": 0.2})[0] > 0


def test_propagated_errors_are_those_of_the_settled_filter(good: FitResult) -> None:
    """An error v at the output alone gives e_k = v_k - a K sum (a (1 - K))^j v_k-1-j, settled gain K and decay a."""
    d = simulated(3, 8000)
    path = good.paths(d)[0]
    P, a = path.P[-1, 0, 0], np.exp(-good.params["th"] * 0.1)
    K = P / (P + np.exp(2 * good.params["lsy"]))
    expected = 0.2 * np.sqrt(1 + (a * K) ** 2 / (1 - (a * (1 - K)) ** 2))
    # A standard deviation from 8000 correlated values is good to about one per cent.
    assert propagated_sd(good, d, {"y": 0.2})[0] == pytest.approx(expected, rel=0.03)


def test_residuals_larger_than_measurement_errors_explain_are_a_verdict(good: FitResult) -> None:
    def verdict(sd: float) -> Verdict:
        return next(w for w in validate(good, uncertainty={"y": sd}).verdicts if w.test == "Eq. 2.29")

    sd = float(np.nanstd((simulated(3).y - good.predict())[1:]))
    enough = sd / (propagated_sd(good, simulated(3), {"y": 1.0})[0])
    assert verdict(1.05 * enough).passed
    assert not verdict(0.8 * enough).passed


def test_other_data_of_another_process_fail_cross_validation(good: FitResult) -> None:
    t = np.arange(800) * 0.1
    other = TRUE + np.array([0.0, 2.0, 0.0, 0.0])  # another level
    d = realise(problems.ou1d(), other, Data(t, np.sin(t * 0.7)[:, None], np.zeros((800, 1))), 4)
    crossed = {w.about: w for w in validate(good, other=d).verdicts if w.test == "cross-validation"}
    assert set(crossed) == {"y one step", "y simulation"}
    assert not crossed["y simulation"].passed
    # Ahead from the start value alone, nothing measured: the rms is the level's shift and the process's own spread.
    assert crossed["y simulation"].statistic == pytest.approx(
        np.hypot(2.0, float(np.std(good.simulate() - simulated(3).y))), rel=0.1
    )


def test_what_physics_cannot_mean_is_a_verdict() -> None:
    fast = fit(problems.ou1d(), simulated(3), fixed={"th": 99.99}, errors="fisher")
    slow = fit(problems.ou1d(), simulated(3), fixed={"th": 0.0011}, errors="fisher")
    for r, tau in ((fast, 1 / 99.99), (slow, 1 / 0.0011)):
        found = next(w for w in validate(r).verdicts if w.test == "time constant")
        assert found.statistic == pytest.approx(tau, rel=1e-6)
        assert found.passed is (tau > 0.1 / 10 and tau < 5 * 80)
    unstable = dataclasses.replace(problems.ou1d(), drift=lambda x, u, p: {"x": 1e-3 * x.x + p.mu * 0.01 + p.th * 0.01})
    r = fit(unstable, simulated(3), errors="fisher")
    assert not next(w for w in validate(r).verdicts if w.test == "time constant").passed
    bounded = dataclasses.replace(
        problems.ou1d(), parameters=tuple(
            dataclasses.replace(q, upper=2.5) if q.symbol == "mu" else q for q in problems.ou1d().parameters
        ),
    )  # fmt: skip
    assert ("plausible", "mu") in {
        (w.test, w.about) for w in validate(fit(bounded, simulated(3))).verdicts if not w.passed
    }


def test_page_of_plots_has_every_test_of_every_output() -> None:
    t = np.arange(300) * 0.1
    d = realise(problems.ou2d(), np.array([0.7, 3.0, 0.2, 0.3, -1.0, -3.0, -2.5]),
                Data(t, np.sin(t)[:, None], np.zeros((300, 2))), 5)  # fmt: skip
    axes = diagnostics(validate(fit(problems.ou2d(), d))).axes
    titles = [a.get_title() for a in axes]
    for symbol in ("y1", "y2"):
        assert f"{symbol}: one-step prediction" in titles
    assert titles.count("lag dependent function") == titles.count("autocorrelation") == 2
    against = [a.get_xlabel() for a in axes if a.get_title() == ""]
    assert against == ["u [1]", "y1 predicted [1]", "y2 predicted [1]"] * 2


def test_time_constant_is_one_over_the_rate(good: FitResult) -> None:
    assert time_constants(good, simulated(3)) == pytest.approx([1 / good.params["th"]], rel=1e-6)


def test_page_is_one_file_with_every_verdict(good: FitResult) -> None:
    page = html(validate(good))
    assert page.count("<tr") == len(validate(good).verdicts) + 1
    assert "data:image/png;base64" in page
    assert "http" not in page


def test_real_reference_record_validates_against_itself() -> None:
    v = validate(fit(problems.ou1d(), ou1d()))
    assert v.to_dict()["verdicts"][0]["about"] == "y"


def walk(n: int = 600, seed: int = 3) -> tuple[ComponentModel, Data]:
    """A true integrator: a store that an input fills, with leaks nobody knows."""
    m = problems.declared(
        "store",
        states=problems._states(x=0.5),
        inputs=problems._q("u"),
        outputs=problems._q("y"),
        parameters=tuple(problems.log_parameter(s, v, v / 1e3, v * 1e3) for s, v in dict(k=0.5, s=0.2, r=0.1).items()),
        drift=lambda x, u, p: {"x": p.k * u.u},
        diffusion=lambda x, u, p: {"x": p.s},
        observe=lambda x, u, p: {"y": x.x},
        noise=lambda x, u, p: {"y": p.r},
        start=problems.constant_start(x=0.0),
    )
    u = np.random.default_rng(seed).normal(size=(n, 1))
    return m, realise(m, np.array([0.5, 0.2, 0.1]), Data(np.arange(n) * 0.5, u, np.zeros((n, 1))), seed)


def test_a_true_integrator_is_called_one_and_passes() -> None:
    m, d = walk()
    v = validate(fit(m, d), hour=1.0)
    (tau,) = [w for w in v.verdicts if w.test == "time constant"]
    assert tau.passed
    assert "integrates" in tau.remark
    assert v.passed, v.table()


def test_a_model_worse_than_as_now_has_no_skill() -> None:
    """A first-order model pulled to a level that drifts away: fine one step ahead, useless a day ahead."""
    n = 24 * 40
    random = np.random.default_rng(4)
    y = 20 + np.cumsum(0.15 * random.normal(size=n)) + 0.05 * random.normal(size=n)
    d = Data(np.arange(float(n)), np.zeros((n, 1)) + 0.01 * random.normal(size=(n, 1)), y[:, None])
    m = dataclasses.replace(
        problems.ou1d(), drift=lambda x, u, p: {"x": p.th * (p.mu + u.u - x.x)}, start=lambda y, u, p: {"x": y.y}
    )
    found = fit(m, d, fixed={"th": 0.08, "mu": 12.0})
    v = validate(found, hour=1.0)
    worse = [w for w in v.verdicts if w.test == "skill" and not w.passed]
    assert [w.about for w in worse][-1] == "y 24 h"
    assert "no skill" in worse[-1].remark
    assert any("skill of y 24 h" in cause for cause in v.causes())


def test_forecasts_have_the_moments_of_the_process_itself() -> None:
    """An Ornstein-Uhlenbeck process k steps ahead: mean and variance in closed form."""
    d = simulated(6, 400)
    found = fit(problems.ou1d(), dataclasses.replace(d, u=np.zeros((400, 1)) + 0.0 * d.u), errors="fisher")
    th, mu, lsx, lsy = found.values
    quiet = dataclasses.replace(d, u=np.zeros((400, 1)))
    ahead = found.forecast([100, 250], 30, quiet)
    path = found.paths(quiet)[0]
    for j, i in enumerate((100, 250)):
        for k in (1, 10, 30):
            decay = np.exp(-th * 0.1 * k)
            mean = mu + (path.xf[i, 0] - mu) * decay
            variance = path.Pf[i, 0, 0] * decay**2 + np.exp(2 * lsx) * (1 - decay**2) / (2 * th)
            assert ahead.x[j, k - 1, 0] == pytest.approx(mean, rel=1e-9)
            assert ahead.P[j, k - 1, 0, 0] == pytest.approx(variance, rel=1e-9)
            assert ahead.variance[j, k - 1, 0] == pytest.approx(variance + np.exp(2 * lsy), rel=1e-9)
    np.testing.assert_allclose(ahead.y[:, 4, 0], found.predict(5, quiet)[[105, 255], 0], rtol=1e-12)


def test_sampled_paths_have_the_forecast_distribution() -> None:
    d = simulated(6, 400)
    found = fit(problems.ou1d(), d, errors="fisher")
    states, outputs = found.sample(200, 20, 1500, seed=1)
    ahead = found.forecast([200], 20)
    for k in (0, 4, 19):
        assert states[:, k, 0].mean() == pytest.approx(ahead.x[0, k, 0], abs=4 * np.sqrt(ahead.P[0, k, 0, 0] / 1500))
        assert outputs[:, k, 0].var() == pytest.approx(ahead.variance[0, k, 0], rel=4 * np.sqrt(2 / 1500))


def test_intervals_that_are_too_narrow_fail_their_coverage(good: FitResult) -> None:
    d = simulated(3)
    assert all(w.passed for w in validate(good).verdicts if w.test == "coverage")
    wrong = dataclasses.replace(good, params={**good.params, "lsx": good.params["lsx"] - 1.0})
    failed = {w.about for w in validate(wrong, d).verdicts if w.test == "coverage" and not w.passed}
    assert "y 1 sample 95%" in failed
