"""The estimators against reference vectors, exact data, finite differences and an outside solver."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import odrpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.chiller_eiv.estimators import (
    choose_k,
    combine_with_prior,
    estimate,
    fit_orthogonal,
    hold,
    lambda_min,
    positive_definite,
)
from fdd.chiller_eiv.fit import FitOptions, Prior, fit_by_every_estimator, fit_gordon_ng
from fdd.chiller_eiv.forms import DIVISION_FREE, FRACTIONAL, VARIABLE_FLOW, VARIABLE_SPEED, variable_speed_by_load
from fdd.chiller_eiv.intervals import cluster_sandwich, groups_of, half_width, jackknife, sandwich, standard_errors
from fdd.chiller_eiv.model import ChillerError, GordonNg, load_from_power, power, power_sensitivity
from fdd.chiller_eiv.moments import Moments, regression_terms, sum_moments
from fdd.chiller_eiv.simulate import LAB_CHILLER, LAB_SIGMA, design

TRUTH = np.array([LAB_CHILLER.dS, LAB_CHILLER.Q_leak, LAB_CHILLER.R])
KILO = np.array([1e3, 1e3, 1e-3])  # the vectors are in kW; kW/K, kW, K/kW to SI
CASES = {"wide": "wide", "paperlike": "narrow"}


@pytest.fixture(params=sorted(CASES))
def case(request: pytest.FixtureRequest, oracle: Path) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Measurements [SI], covariance and the reference numbers [kW]."""
    vectors = json.loads((oracle / "chiller_eiv_vectors.json").read_text())[request.param]
    with (oracle / f"chiller_eiv_{CASES[request.param]}.csv").open() as f:
        rows = list(csv.DictReader(f))
    names = ("Tcdi", "Tchi", "Q", "E")
    si = np.array([1.0, 1.0, 1e3, 1e3])
    x = np.array([[float(r[k]) for k in names] for r in rows]) * si
    sigma = np.array([vectors["sigma"][k] for k in names]) * si
    return x, np.diag(sigma**2), vectors


def test_every_estimator_agrees_with_the_reference_vectors(case: Any) -> None:
    x, cov, v = case
    exact = sum_moments(regression_terms(DIVISION_FREE, x, cov, "exact"))
    plain = sum_moments(regression_terms(DIVISION_FREE, x, cov, "propagation"))
    paper = sum_moments(regression_terms(FRACTIONAL, x, cov, "propagation"))
    calculus = sum_moments(regression_terms(FRACTIONAL, x, cov, "calculus"))
    for moments, estimator, name in (
        (paper, "ols", "OLS"),
        (paper, "cls", "CLS_a"),
        (calculus, "cls", "CLS_b"),
        (plain, "ols", "polyOLS"),
        (exact, "cls", "polyCLS"),
        (exact, "tls", "polyTLS_alpha0"),
        (exact, "capped", "cap1_poly"),
    ):
        np.testing.assert_allclose(estimate(moments, estimator) / KILO, v[name], rtol=1e-6, err_msg=name)
    assert lambda_min(exact) == pytest.approx(v["lambda_min_poly"], rel=1e-6)


def test_error_moments_agree_with_the_reference_vectors(case: Any) -> None:
    x, cov, v = case
    kilo = np.array([1e3, 1.0, 1.0, 1e6])
    S = sum_moments(regression_terms(DIVISION_FREE, x, cov)).S
    np.testing.assert_allclose(S / np.outer(kilo, kilo), v["poly_S_sum_4x4"], rtol=1e-6, atol=1e-9)
    kilo = np.array([1.0, 1e-3, 1e-3, 1e3])
    S = sum_moments(regression_terms(FRACTIONAL, x, cov, "propagation")).S
    np.testing.assert_allclose(S / np.outer(kilo, kilo), v["S_a_sum_4x4"], rtol=1e-6)


def test_standard_errors_agree_with_the_reference_vectors(case: Any) -> None:
    x, cov, v = case
    for form, method, name in (
        (FRACTIONAL, "propagation", "se_CLS_a_sandwich"),
        (DIVISION_FREE, "exact", "se_polyCLS_sandwich"),
    ):
        terms = regression_terms(form, x, cov, method)  # type: ignore[arg-type]
        se = standard_errors(sandwich(terms, estimate(sum_moments(terms), "cls"), 1.0))
        np.testing.assert_allclose(se / KILO, v[name], rtol=1e-6)
    each = sum_moments(regression_terms(DIVISION_FREE, x, cov), np.arange(len(x)))
    np.testing.assert_allclose(standard_errors(jackknife(each)) / KILO, v["se_cap1_jackknife"], rtol=1e-6)


def test_orthogonal_regression_agrees_with_the_vectors(case: Any) -> None:
    x, cov, v = case
    terms = regression_terms(FRACTIONAL, x, cov, "propagation")
    beta, minimum = fit_orthogonal(terms, estimate(sum_moments(terms), "cls"))
    np.testing.assert_allclose(beta / KILO, v["Sampson"], rtol=1e-6)
    assert minimum == pytest.approx(v["Sampson_chi2"], rel=1e-6)


@pytest.mark.parametrize(("noise", "tolerance"), [(0.1, 5e-4), (2.0, 0.25)])
def test_orthogonal_regression_agrees_with_odrpack(noise: float, tolerance: float) -> None:
    """Sampson's distance is the first-order form of the full one: equal at small noise, within its error at large."""
    sigma = noise * LAB_SIGMA
    x = design("wide", 30) + sigma * np.random.default_rng(0).standard_normal((30, 4))
    terms = regression_terms(DIVISION_FREE, x, np.diag(sigma**2), "propagation")
    beta, _ = fit_orthogonal(terms, estimate(sum_moments(terms)))
    se = standard_errors(sandwich(terms, beta, 1.0))

    def model(inputs: np.ndarray, b: np.ndarray) -> np.ndarray:
        return power(inputs[2] * sigma[2], inputs[0] * sigma[0], inputs[1] * sigma[1], *(b * TRUTH)) / sigma[3]

    outside = odrpack.odr_fit(model, (x[:, :3] / sigma[:3]).T, x[:, 3] / sigma[3], beta / TRUTH)
    difference = np.abs(outside.beta * TRUTH - beta)
    assert np.all(difference < (tolerance * TRUTH if noise < 1 else tolerance * se))


def test_noise_free_data_give_the_truth() -> None:
    x = design("wide", 60)
    for form in (DIVISION_FREE, FRACTIONAL):
        for estimator in ("ols", "cls", "tls", "capped"):
            m = sum_moments(regression_terms(form, x, np.zeros((4, 4))))
            np.testing.assert_allclose(estimate(m, estimator), TRUTH, rtol=1e-8)  # type: ignore[arg-type]


def test_noise_free_variable_flow_and_speed_give_the_truth() -> None:
    rng = np.random.default_rng(1)
    x = design("wide", 240)
    flow, speed = rng.uniform(0.5, 1.2, len(x)), rng.uniform(0.4, 1.0, len(x))
    machine = GordonNg(5.0, 2700.0, 1.9e-3, R_flow=0.8e-3)
    for form, chiller, extra in (
        (VARIABLE_FLOW, machine, flow),
        (VARIABLE_SPEED, GordonNg(2.0, 1500.0, 2.7e-3, dS_speed=3.5), speed),
    ):
        y = x.copy()
        y[:, 3] = chiller.power(x[:, 2], x[:, 0], x[:, 1], flow, speed)
        fit = fit_gordon_ng(np.column_stack([y, extra]), np.zeros((5, 5)), options=FitOptions(form=form))
        for name in form.parameters:
            assert fit.values()[name] == pytest.approx(getattr(chiller, name), rel=1e-8)
        np.testing.assert_allclose(fit.predicted_power(np.column_stack([y, extra])), y[:, 3], rtol=1e-8)


def test_speed_by_load_gives_the_truth_without_a_speed_sensor() -> None:
    x = design("wide", 60)
    chiller = GordonNg(2.0, 1500.0, 2.7e-3, dS_speed=3.5)
    x[:, 3] = chiller.power(x[:, 2], x[:, 0], x[:, 1], 1.0, x[:, 2] / 10e3)
    fit = fit_gordon_ng(x, np.zeros((4, 4)), options=FitOptions(form=variable_speed_by_load(10e3)))
    assert fit.values()["dS_speed"] == pytest.approx(3.5, rel=1e-7)
    np.testing.assert_allclose(fit.predicted_power(x), x[:, 3], rtol=1e-8)


@pytest.mark.parametrize(
    "form", [DIVISION_FREE, FRACTIONAL, VARIABLE_FLOW, VARIABLE_SPEED, variable_speed_by_load(1e4)]
)
def test_gradients_and_hessians_agree_with_differences(form: Any) -> None:
    x = design("wide", 30)
    x = np.column_stack([x, np.linspace(0.5, 1.1, len(x))])[:, : len(form.measured)]
    step = np.cbrt(np.finfo(float).eps) * np.abs(x)
    _, J, H = form.evaluate(x)
    for a in range(x.shape[1]):
        up, down = x.copy(), x.copy()
        up[:, a] += step[:, a]
        down[:, a] -= step[:, a]
        (zu, Ju, _), (zd, Jd, _) = form.evaluate(up), form.evaluate(down)
        width = (up - down)[:, a][:, None]
        scale = np.abs(form.evaluate(x)[0]) / x[:, a][:, None] + np.abs(J[:, :, a])
        assert np.max(np.abs((zu - zd) / width - J[:, :, a]) / scale) < 1e-6
        scale2 = np.abs(J) / x[:, a][:, None, None] + np.abs(H[:, :, a]) + 1e-300
        assert np.max(np.abs((Ju - Jd) / width[..., None] - H[:, :, a]) / scale2) < 1e-6


def test_power_sensitivities_agree_with_differences() -> None:
    x = design("wide", 30)
    base = [x[:, 0], x[:, 1], x[:, 2], *TRUTH]
    gradient = power_sensitivity(x[:, 2], x[:, 0], x[:, 1], LAB_CHILLER)

    def at(values: list[Any]) -> np.ndarray:
        return power(values[2], values[0], values[1], values[3], values[4], values[5])

    for j in range(6):
        h = 1e-5 * np.mean(base[j])
        up, down = list(base), list(base)
        up[j], down[j] = base[j] + h, base[j] - h
        np.testing.assert_allclose(gradient[:, j], (at(up) - at(down)) / (2 * h), rtol=1e-6)


def test_power_agrees_with_a_calculation_by_hand() -> None:
    # (303.15 x 10000 + 5.518 x 303.15 x 285.15 + 2723 x 18) / (285.15 - 26.89) - 10000
    assert power(np.array([1e4]), np.array([303.15]), np.array([285.15]), 5.518, 2723.0, 2.689e-3)[0] == pytest.approx(
        3774.9, abs=0.05
    )


@settings(deadline=None, max_examples=50)
@given(
    load=st.floats(4e3, 12e3),
    T_cdi=st.floats(288, 308),
    T_chi=st.floats(280, 288),
    dS=st.floats(2, 8),
    R=st.floats(1e-3, 4e-3),
)
def test_load_from_power_is_the_inverse(load: float, T_cdi: float, T_chi: float, dS: float, R: float) -> None:
    electric = power(np.array([load]), np.array([T_cdi]), np.array([T_chi]), dS, 2500.0, R)
    back = load_from_power(electric, np.array([T_cdi]), np.array([T_chi]), dS, 2500.0, R)
    assert back[0] == pytest.approx(load, rel=1e-9)


def test_load_from_power_is_missing_below_no_load_power() -> None:
    assert np.isnan(load_from_power(np.array([100.0]), np.array([303.0]), np.array([285.0]), 5.5, 2700.0, 2.7e-3))[0]


def test_simulated_error_moments_agree_with_calculus(case: Any) -> None:
    x, cov, _ = case
    # Small errors: there the two differ only by the simulation's own noise, 1/sqrt(2 x 4000 draws) per point.
    cov = cov / 100
    a = sum_moments(regression_terms(FRACTIONAL, x, cov, "calculus")).S
    b = sum_moments(regression_terms(FRACTIONAL, x, cov, "simulation", draws=4000, seed=3)).S
    scale = np.sqrt(np.outer(np.diag(a).clip(1e-300), np.diag(a)))
    assert np.max(np.abs(a - b) / np.abs(scale)) < 0.03


def monte_carlo(kind: Any, n: int, noise: float, repeats: int, seed: int, assumed: float = 1.0) -> Moments:
    """Grouped moments (repeats, groups, 4, 4) of noisy designs."""
    rng = np.random.default_rng(seed)
    x = design(kind, n) + noise * LAB_SIGMA * rng.standard_normal((repeats, n, 4))
    terms = regression_terms(DIVISION_FREE, x.reshape(-1, 4), np.diag((assumed * noise * LAB_SIGMA) ** 2))
    g = 25
    group = (np.arange(repeats)[:, None] * g + groups_of(n, g)).ravel()
    m = sum_moments(terms, group, repeats * g)
    return Moments(m.M.reshape(-1, g, 4, 4), m.S.reshape(-1, g, 4, 4), m.n.reshape(-1, g))


def test_capped_estimates_are_unbiased_and_covered_where_ols_is_not() -> None:
    m = monte_carlo("wide", 500, 2.0, 300, seed=11)
    beta = estimate(m.total(), "capped")
    bias = np.abs(beta.mean(0) / TRUTH - 1)
    error = beta.std(0) / TRUTH / np.sqrt(len(beta))
    assert np.all(bias < np.array([0.002, 0.01, 0.002]) + 3 * error)
    inside = np.abs(beta - TRUTH) < half_width(standard_errors(jackknife(m)), 24)
    assert np.all(np.abs(inside.mean(0) - 0.95) < 0.025 + 3 * np.sqrt(0.95 * 0.05 / len(beta)))
    ols = estimate(m.total(), "ols")
    covered = np.abs(ols - TRUTH) < half_width(standard_errors(jackknife(m, "ols")), 24)
    assert covered[:, 2].mean() < 0.2


def test_lambda_min_estimates_the_ratio_of_error_variances() -> None:
    for assumed, want, tolerance in ((1.0, 1.0, 0.1), (0.5, 4.0, 0.3), (2.0, 0.25, 0.02)):
        m = monte_carlo("wide", 500, 2.0, 100, seed=5, assumed=assumed).total()
        assert abs(lambda_min(m).mean() - want) < tolerance


def test_errors_not_summed_or_uncorrelated_are_worse() -> None:
    """The three misreadings of Eq. 11 the reference warns of, on the narrow design."""
    rng = np.random.default_rng(2)
    x = design("narrow", 30)
    sigma = 2 * LAB_SIGMA
    bias: dict[str, list[np.ndarray]] = {"right": [], "no S_xy": [], "not summed": [], "ols": []}
    for _ in range(400):
        m = sum_moments(regression_terms(FRACTIONAL, x + sigma * rng.standard_normal(x.shape), np.diag(sigma**2)))
        wrong = m.S.copy()
        wrong[0, 1:] = wrong[1:, 0] = 0
        bias["right"].append(estimate(m, "capped"))
        bias["ols"].append(estimate(m, "ols"))
        bias["no S_xy"].append(estimate(Moments(m.M, wrong, m.n), "cls"))
        bias["not summed"].append(estimate(Moments(m.M, m.S / 30, m.n), "cls"))
    R = {k: abs(np.mean(v, axis=0)[2] / TRUTH[2] - 1) for k, v in bias.items()}
    assert R["right"] < 0.1
    assert R["ols"] > 0.25
    assert R["not summed"] > 0.9 * R["ols"]
    assert R["no S_xy"] > 1.5 * R["ols"]


def test_capped_is_positive_definite_where_plain_cls_breaks_down() -> None:
    rng = np.random.default_rng(4)
    x = design("narrow", 30)[:, :] + 0
    x = x + 4 * LAB_SIGMA * rng.standard_normal((200, *x.shape))
    terms = regression_terms(DIVISION_FREE, x.reshape(-1, 4), np.diag((4 * LAB_SIGMA) ** 2))
    m = sum_moments(terms, np.repeat(np.arange(200), 30))
    assert positive_definite(m, choose_k(m, "capped")).all()
    broken = ~positive_definite(m, choose_k(m, "cls"))
    assert 0 < broken.mean() < 0.15


def test_holding_the_leak_narrows_dS() -> None:
    rng = np.random.default_rng(8)
    cov = np.diag((2 * LAB_SIGMA) ** 2)
    x = design("wide", 168) + 2 * LAB_SIGMA * rng.standard_normal((168, 4))
    free = fit_gordon_ng(x, cov)
    held = fit_gordon_ng(x, cov, options=FitOptions(held={"Q_leak": TRUTH[1]}))
    assert held.parameters == ("dS", "R")
    assert held.se[0] < 0.5 * free.se[0]
    assert abs(held.estimate[0] - TRUTH[0]) < 4 * held.se[0]
    assert held.values()["Q_leak"] == TRUTH[1]


def test_a_group_map_gives_the_same_as_mapped_terms() -> None:
    x = design("wide", 40)
    terms = regression_terms(DIVISION_FREE, x, np.diag(LAB_SIGMA**2))
    T, _ = hold(DIVISION_FREE, {"Q_leak": 1000.0})
    m = sum_moments(terms).map(T)
    fit = fit_gordon_ng(x, np.diag(LAB_SIGMA**2), options=FitOptions(held={"Q_leak": 1000.0}))
    np.testing.assert_allclose(estimate(m), fit.estimate, rtol=1e-10)


def test_a_prior_draws_and_a_bound_stops() -> None:
    rng = np.random.default_rng(9)
    cov = np.diag((4 * LAB_SIGMA) ** 2)
    x = design("narrow", 100) + 4 * LAB_SIGMA * rng.standard_normal((100, 4))
    plain = fit_gordon_ng(x, cov)
    sharp = fit_gordon_ng(x, cov, options=FitOptions(priors={"Q_leak": Prior(mean=2723.0, sd=100.0)}))
    assert abs(sharp.values()["Q_leak"] - 2723) < 150
    assert np.all(sharp.se < plain.se)
    ceiling = 0.9 * plain.values()["R"]
    bounded = fit_gordon_ng(x, cov, options=FitOptions(priors={"R": Prior(upper=ceiling)}))
    assert bounded.values()["R"] == pytest.approx(ceiling)


def test_prior_and_estimate_join_as_two_measurements() -> None:
    value, cov = combine_with_prior(
        np.array([2.0]), np.array([[4.0]]), mean=np.array([0.0]), precision=np.array([[0.25]]),
        lower=np.array([-np.inf]), upper=np.array([np.inf]),
    )  # fmt: skip
    assert value[0] == pytest.approx(1.0)
    assert cov[0, 0] == pytest.approx(2.0)


def test_cluster_sandwich_of_single_points_is_the_sandwich() -> None:
    rng = np.random.default_rng(10)
    x = design("wide", 200) + LAB_SIGMA * rng.standard_normal((200, 4))
    terms = regression_terms(DIVISION_FREE, x, np.diag(LAB_SIGMA**2))
    each = sum_moments(terms, np.arange(200))
    beta = estimate(each.total(), "cls")
    a, b = sandwich(terms, beta, 1.0), cluster_sandwich(each, beta, np.array(1.0))
    np.testing.assert_allclose(a * (197 / 200), b * (199 / 200), rtol=1e-6)


def test_every_estimator_is_reported_side_by_side() -> None:
    rng = np.random.default_rng(12)
    x = design("wide", 120) + 2 * LAB_SIGMA * rng.standard_normal((120, 4))
    fits = fit_by_every_estimator(x, np.diag((2 * LAB_SIGMA) ** 2))
    assert {"ols", "cls", "tls", "capped", "orthogonal", "cls, simulation"} <= fits.keys()
    for f in fits.values():
        assert f.interval()[2, 0] < f.estimate[2] < f.interval()[2, 1]
        assert 0 < f.residual_sd < 0.1


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: fit_gordon_ng(design("wide", 3), np.eye(4)), "too few"),
        (lambda: regression_terms(DIVISION_FREE, np.full((5, 4), np.nan), np.eye(4)), "not finite"),
        (lambda: regression_terms(DIVISION_FREE, np.ones((5, 3)), np.eye(4)), "T_cdi, T_chi, Q, E"),
        (lambda: regression_terms(DIVISION_FREE, np.ones((5, 4)), np.eye(3)), "covariance"),
        (lambda: power(np.array([1e7]), np.array([300.0]), np.array([280.0]), 5.0, 0.0, 2e-3), "R x load"),
        (lambda: hold(DIVISION_FREE, {"dS": 1, "Q_leak": 1, "R": 1}), "at least one"),
        (lambda: hold(DIVISION_FREE, {"leak": 1}), "no parameter"),
        (lambda: Prior(sd=0.0), "positive"),
        (lambda: Prior(lower=1.0, upper=1.0), "below"),
        (lambda: variable_speed_by_load(0.0), "positive"),
    ],
)
def test_bad_requests_are_refused_with_the_reason(call: Any, words: str) -> None:
    with pytest.raises(ChillerError, match=words):
        call()
