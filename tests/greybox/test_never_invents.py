"""What the data do not tell is said to be unknown, and what cannot be used is refused."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from fdd.greybox.fit import Objective, Prior, fit
from fdd.greybox.identifiability import identified
from fdd.greybox.inference import profile
from fdd.greybox.likelihood import Data, DataError, Likelihood
from fdd.greybox.results import FitResult
from fdd.greybox.scale import from_scale, scale_bounds, to_scale
from fdd.greybox.simulate import realise
from fdd.models.declare import ComponentModel
from fdd.models.registry import MODELS, get_model
from tests.greybox import problems

TRUE = np.array([5.0, 3.0, 0.2, -1.5])


def record(n: int = 400, seed: int = 1) -> Data:
    t = np.arange(n) * 0.1
    u = np.sign(np.sin(t * 1.3))[:, None]
    return realise(problems.ou1d(), TRUE, Data(t, u, np.zeros((n, 1))), seed=seed)


def room() -> ComponentModel:
    """A room and its walls, hours, with a heater whose power is not known: all sizes may be scaled together."""
    symbols = {"C_i": 2.0, "C_w": 10.0, "A_w": 3.0, "W": 1.0, "R_iw": 0.5, "R_wa": 4.0, "sigma": 0.1, "noise": 0.05}
    return problems.declared(
        "room",
        states=problems._states(T_i=1.0, T_w=2.0),
        inputs=problems._q("T_a sun heater"),
        outputs=problems._q("T"),
        parameters=tuple(
            problems.log_parameter(s, v, v / 1e3, v * 1e3, kind="noise" if s in ("sigma", "noise") else "physical")
            for s, v in symbols.items()
        ),
        drift=lambda x, u, p: {
            "T_i": ((x.T_w - x.T_i) / p.R_iw + p.A_w * u.sun + p.W * u.heater) / p.C_i,
            "T_w": ((x.T_i - x.T_w) / p.R_iw + (u.T_a - x.T_w) / p.R_wa) / p.C_w,
        },
        diffusion=lambda x, u, p: {"T_i": p.sigma, "T_w": p.sigma},
        observe=lambda x, u, p: {"T": x.T_i},
        noise=lambda x, u, p: {"T": p.noise},
        start=lambda y, u, p: {"T_i": y.T, "T_w": y.T},
    )


def room_record(seed: int, n: int = 600) -> Data:
    random, t = np.random.default_rng(seed), np.arange(n) * 0.25
    sun = np.maximum(0.0, np.sin(2 * np.pi * t / 24))
    heater = 10.0 * np.repeat(random.integers(0, 2, n // 12 + 1), 12)[:n]
    u = np.column_stack([5 * np.sin(2 * np.pi * t / 60), sun, heater])
    m = room()
    values = np.array([q.typical for q in m.parameters])
    return realise(m, values, Data(t, u, np.full((n, 1), 10.0)), seed)


@pytest.fixture(scope="module")
def scaled() -> FitResult:
    return fit(room(), room_record(1))


def test_whole_numbers_as_start_give_the_same_estimates() -> None:
    d, m = record(), problems.ou1d()
    whole = {"th": 4, "mu": 2, "lsx": -1, "lsy": -2}
    found = fit(m, d, start=whole)
    same = fit(m, d, start={k: float(v) for k, v in whole.items()})
    assert found.params == same.params
    assert found.llf == pytest.approx(fit(m, d).llf, abs=1e-4)


def test_a_flat_direction_is_told_in_words_and_leaves_no_error(scaled: FitResult) -> None:
    moving = {"C_i", "C_w", "A_w", "W", "R_iw", "R_wa"}
    assert set(scaled.unidentifiable) == moving
    assert all(math.isinf(scaled.bse[s]) for s in moving)
    assert all(math.isfinite(scaled.bse[s]) for s in ("sigma", "noise"))
    assert [f.words for f in scaled.flat] == ["C_i, C_w, A_w, W times c, R_iw, R_wa over c: no change"]
    assert scaled.conf_int()["C_i"] == (-math.inf, math.inf)
    assert "not identified" in scaled.summary()
    assert any("no change" in w for w in scaled.warnings)


def test_the_flat_direction_is_one_of_the_likelihood_itself(scaled: FitResult) -> None:
    likelihood, at = Likelihood(room(), room_record(1)), dict(scaled.params)
    moved = {s: v * 3.0 ** scaled.flat[0].powers.get(s, 0.0) for s, v in at.items()}
    assert moved != at
    values = [likelihood.value(np.array(list(p.values()))) for p in (at, moved)]
    assert values[0] == pytest.approx(values[1], rel=1e-10)


def test_products_of_untold_parameters_are_known_with_errors_that_cover_the_truth() -> None:
    truth = {q.symbol: q.typical for q in room().parameters}
    z = []
    for seed in range(8):
        result = fit(room(), room_record(seed))
        assert len(result.known) == 5, result.known
        for known in result.known:
            above, _, below = known.words.partition(" / ")
            true = math.prod(truth[s] for s in above.split()) / math.prod(truth[s] for s in below.split() if s)
            z.append(math.log(known.value / true) / known.error)
    assert np.std(z) < 1.6
    assert np.max(np.abs(z)) < 4


def test_over_parameterised_sets_never_have_a_finite_error_on_the_flat_direction() -> None:
    for seed in range(5):
        result = fit(room(), room_record(seed, 300))
        assert all(math.isinf(result.bse[s]) for s in ("C_i", "C_w", "A_w", "W", "R_iw", "R_wa"))


def test_two_that_are_known_only_together_have_no_error_each() -> None:
    """Correlation -1 with errors of two hundred e-folds, as a heater's capacity and resistance: neither is told."""
    rows = [problems.log_parameter(s, 1.0) for s in ("C_h", "R_ih", "C_i")]
    both = np.array([1.0, 1.0, 0.0]) / math.sqrt(2)
    F = 1e4 * np.outer(both, both) + 2.5e-5 * (np.eye(3) - np.outer(both, both)) + np.diag([0.0, 0.0, 1e3])
    told = identified(F, None, np.zeros(3, bool), rows, np.array([100.17, 8.4, 5.0]))
    assert told.untold == ("C_h", "R_ih")
    assert [k.words for k in told.known] == ["C_h R_ih"]
    assert told.known[0].value == pytest.approx(841.4, rel=1e-3)
    assert told.covariance[2, 2] == pytest.approx(1e-3, rel=1e-3)


def test_whoever_moves_along_with_one_at_its_bound_is_not_told_either() -> None:
    rows = [problems.log_parameter(s, 1.0) for s in ("C_h", "R_ih", "C_i")]
    F = 1e4 * np.outer([1.0, 1.0, 0.0], [1.0, 1.0, 0.0]) + np.diag([0.0, 0.0, 1e3])
    told = identified(F, None, np.array([True, False, False]), rows, np.ones(3))
    assert told.untold == ("R_ih",)
    assert told.covariance[1, 1] == 0.0
    assert told.covariance[2, 2] == pytest.approx(1e-3)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_bound_survives_the_way_to_the_scale_and_back(name: str) -> None:
    for q in get_model(name).parameters:
        for bound, theta in zip((q.lower, q.upper), scale_bounds(q), strict=True):
            back = from_scale(q, to_scale(q, bound))
            assert q.lower <= back <= q.upper
            assert q.lower <= from_scale(q, theta) <= q.upper
            assert abs(back - bound) <= 1e-6 * (q.upper - q.lower) if q.transform == "logit" else back == bound


def test_profiles_and_warm_starts_go_on_from_a_bound() -> None:
    m = problems.ou1d()
    narrow = [dataclasses.replace(q, upper=3.3, typical=3.0) if q.symbol == "th" else q for q in m.parameters]
    tight = dataclasses.replace(m, parameters=tuple(narrow))
    found = fit(tight, record())
    assert found.at_bound == ("th",)
    assert fit(tight, record(), start=found).llf == pytest.approx(found.llf, abs=1e-6)
    assert profile(found, "th", points=3).values.max() == 3.3


def test_a_start_of_the_wrong_size_is_refused() -> None:
    d, m = record(), problems.ou1d()
    for bad in ({"x0": np.zeros(2)}, {"P0": np.eye(3)}, {"x0": np.array([np.nan])}, {"P0": np.array([[-1.0]])}):
        with pytest.raises(DataError, match=r"x0|P0"):
            Likelihood(m, dataclasses.replace(d, **bad))
    assert math.isfinite(Likelihood(m, dataclasses.replace(d, x0=np.ones(1), P0=np.eye(1))).value(TRUE))


def test_a_fit_with_priors_says_that_it_is_one(scaled: FitResult) -> None:
    d = room_record(1)
    told = fit(room(), d, priors={"W": Prior(1.0, 0.1, log=True)})
    text = told.summary()
    assert text.count("maximum a posteriori") == 1
    assert "AIC " not in text.replace("AIC and BIC", "")
    assert math.isnan(told.aic)
    assert math.isnan(told.bic)
    assert told.unidentifiable == ()
    assert "known mainly from the prior: W" in text
    assert told.bse["W"] == pytest.approx(0.1 * told.params["W"], rel=0.01)
    again = FitResult.from_dict(json.loads(json.dumps(told.to_dict())), room(), d)
    assert again.summary() == text


def test_log_normal_priors_have_exact_derivatives() -> None:
    likelihood, m = Likelihood(problems.ou1d(), record()), problems.ou1d()
    values = TRUE.copy()
    objective = Objective(likelihood, values, np.arange(4), {m.parameters[0].symbol: Prior(4.0, 0.2, log=True)})
    theta = objective.theta(values)
    step = 1e-5 * np.eye(4)
    slopes = [(objective(theta + h)[0] - objective(theta - h)[0]) / 2e-5 for h in step]
    np.testing.assert_allclose(objective(theta)[1], slopes, rtol=1e-4, atol=1e-3)


def test_errors_from_another_information_than_asked_for_are_said_in_the_result() -> None:
    """A saddle in the observed information: errors are Fisher's, in a warning and in the kind, not only in a header."""
    rows = [problems.log_parameter("a", 1.0), problems.log_parameter("b", 1.0)]
    told = identified(np.eye(2) * 10, np.diag([10.0, -1.0]), np.zeros(2, bool), rows, np.ones(2))
    assert not told.observed
    assert told.covariance[1, 1] == pytest.approx(0.1)
    from fdd.greybox.identifiability import reservations

    assert any("Fisher" in w for w in reservations(told, (), True, "", "observed", "fisher"))
