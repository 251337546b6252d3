from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from benchmarks.component_cases import CASES, experiment
from fdd.greybox.fit import ParameterError, Prior, fit
from fdd.greybox.inference import forward_selection, likelihood_ratio, profile
from fdd.greybox.likelihood import Data, DataError, Likelihood
from fdd.greybox.results import FitResult
from fdd.greybox.simulate import realise
from fdd.models.declare import ComponentModel
from tests.greybox import problems
from tests.greybox.records import ou1d

TRUE = np.array([5.0, 3.0, 0.2, -1.5])


@pytest.fixture(scope="module")
def record() -> Data:
    t = np.arange(400) * 0.1
    u = np.sign(np.sin(t * 1.3))[:, None]
    return realise(problems.ou1d(), TRUE, Data(t, u, np.zeros((400, 1))), seed=1)


@pytest.fixture(scope="module")
def result(record: Data) -> FitResult:
    return fit(problems.ou1d(), record)


def test_estimates_lie_within_their_errors_of_the_truth(result: FitResult) -> None:
    errors = np.array(list(result.bse.values()))
    assert np.abs((result.values - TRUE) / errors).max() < 4


def test_estimates_that_move_together_are_named(record: Data) -> None:
    """A level and the factor of an input far from zero: -6 / sqrt(1 + 36) for an input of plus and minus one."""
    gain = problems.identity("g", 1.0, -9, 9)
    m = dataclasses.replace(
        problems.ou1d(), name="gain", parameters=(*problems.ou1d().parameters, gain),
        drift=lambda x, u, p: {"x": p.th * (p.mu + p.g * (u.u + 6) - x.x)},
    )  # fmt: skip
    r = fit(m, record, errors="fisher")
    correlation = r.correlation[m.symbols["parameters"].index("mu"), m.symbols["parameters"].index("g")]
    assert correlation == pytest.approx(-6 / np.sqrt(37), abs=0.02)
    assert f"g and mu {correlation:+.3f}" in r.summary()
    assert "move together" not in fit(problems.ou1d(), record, errors="fisher").summary()


def test_plain_data_come_back_the_same(result: FitResult, record: Data) -> None:
    again = FitResult.from_dict(json.loads(json.dumps(result.to_dict())), problems.ou1d(), record)
    assert again.to_dict() == result.to_dict()
    np.testing.assert_array_equal(again.predict(), result.predict())
    assert again.summary() == result.summary()
    with pytest.raises(ValueError, match="fit again"):
        FitResult.from_dict({**result.to_dict(), "model_version": "0"}, problems.ou1d())


def test_two_records_count_as_the_sum(record: Data) -> None:
    m = problems.ou1d()
    one, other = Likelihood(m, record), Likelihood(m, ou1d())
    both = Likelihood(m, [record, ou1d()]).evaluate(TRUE)
    assert both.value == pytest.approx(one.value(TRUE) + other.value(TRUE), rel=1e-14)
    np.testing.assert_allclose(both.gradient, one.evaluate(TRUE).gradient + other.evaluate(TRUE).gradient)
    assert fit(m, [record, ou1d()]).nobs == 601


def test_a_sharp_prior_holds_and_a_vague_one_does_not(record: Data, result: FitResult) -> None:
    sharp = fit(problems.ou1d(), record, priors={"th": Prior(3.0, 1e-4)})
    assert sharp.params["th"] == pytest.approx(3.0, abs=1e-3)
    assert sharp.bse["th"] == pytest.approx(1e-4, rel=1e-2)
    vague = fit(problems.ou1d(), record, priors={"th": Prior(3.0, 1e4)})
    assert vague.params["th"] == pytest.approx(result.params["th"], rel=1e-3)


@pytest.mark.parametrize("huber", [np.inf, 2.5])
def test_the_only_free_parameter_has_a_profile(record: Data, huber: float) -> None:
    """Its points hold every parameter. The level's likelihood is a parabola but for outliers: Wald's interval."""
    held = {s: v for s, v in zip(problems.ou1d().symbols["parameters"], TRUE, strict=True) if s != "mu"}
    r = fit(problems.ou1d(), record, fixed=held, huber=huber)
    low, high = profile(r, "mu").interval
    error = 0.5 * (high - low) / 1.96
    assert low < r.params["mu"] < high
    assert error == pytest.approx(r.bse["mu"], rel=0.01 if np.isinf(huber) else 0.4)
    everything = fit(problems.ou1d(), record, fixed=held | {"mu": 3.1}, huber=huber, errors="sandwich")
    assert everything.free == ()
    assert (
        r.llf
        > everything.llf
        == pytest.approx(
            -Likelihood(problems.ou1d(), record, huber=huber).value(np.array(list(everything.params.values()))),
            rel=1e-12,
        )
    )


@pytest.mark.parametrize("huber", [np.inf, 1.0, 2.5])
def test_gradient_is_the_derivative_of_the_value(record: Data, huber: float) -> None:
    likelihood = Likelihood(problems.ou1d(), record, huber=huber)
    at = TRUE * 0.9
    np.testing.assert_allclose(likelihood.evaluate(at).gradient, approx_fprime(at, likelihood.value, 1e-6), rtol=1e-4)


def test_nonlinear_observation_has_exact_derivatives(record: Data) -> None:
    m = dataclasses.replace(
        problems.ou2d(), name="nonlinear",
        observe=lambda x, u, p: {"y1": x.x1 * x.x1, "y2": x.x1 * x.x2 + p.mu * x.x2},
    )  # fmt: skip
    values = np.array([0.5, 2.9, 0.4, -1.0, -1.0, -2.0, -1.0])
    d = realise(m, values, Data(record.t[:60], record.u[:60], np.zeros((60, 2))), seed=2)
    likelihood = Likelihood(m, d)
    at = values * 1.02
    gradient = likelihood.evaluate(at).gradient
    np.testing.assert_allclose(gradient, approx_fprime(at, likelihood.value, 1e-6), rtol=1e-3, atol=1e-3)


def test_diffusion_may_depend_on_inputs(record: Data) -> None:
    m = dataclasses.replace(
        problems.ou1d(), name="driven noise", diffusion=lambda x, u, p: {"x": 2.718281828**p.lsx * (1.5 + u.u)}
    )
    likelihood = Likelihood(m, record)
    assert likelihood.value(TRUE) != pytest.approx(Likelihood(problems.ou1d(), record).value(TRUE))
    np.testing.assert_allclose(
        likelihood.evaluate(TRUE).gradient, approx_fprime(TRUE, likelihood.value, 1e-6), rtol=1e-4, atol=1e-3
    )


def test_fixed_and_warm_starts(record: Data, result: FitResult) -> None:
    held = fit(problems.ou1d(), record, fixed={"th": 4.0})
    assert held.params["th"] == 4.0
    assert np.isnan(held.bse["th"])
    warm = fit(problems.ou1d(), record, start=result)
    assert warm.llf == pytest.approx(result.llf, abs=1e-5)
    assert warm.trials[0].evaluations < result.trials[0].evaluations


def test_many_searches_show_a_bar_and_a_table_of_optima(record: Data, capsys: pytest.CaptureFixture[str]) -> None:
    r = fit(problems.ou1d(), record, starts=3, progress=True)
    shown = capsys.readouterr()
    assert "3/3" in shown.err
    assert f"best {-r.llf:.4f}" in shown.err
    assert shown.out == ""
    table = r.trials_table().splitlines()
    assert len(table) == 4
    assert table[1].split()[1] == f"{-r.llf:.6f}"


def test_profile_interval_is_near_the_normal_one_and_covers_the_estimate(result: FitResult) -> None:
    p = profile(result, "mu")
    low, high = result.conf_int()["mu"]
    assert p.interval == pytest.approx((low, high), abs=0.1 * (high - low))
    assert p.drop.min() == 0.0


def test_likelihood_ratio_and_its_refusals(record: Data, result: FitResult) -> None:
    smaller = fit(problems.ou1d(), record, fixed={"mu": 3.0})
    test = likelihood_ratio(smaller, result)
    assert test.degrees == 1
    z = (3.0 - result.params["mu"]) / result.bse["mu"]  # the likelihood of the level is nearly a parabola
    assert test.statistic == pytest.approx(z**2, rel=0.1)
    assert test.p == pytest.approx(math.erfc(math.sqrt(test.statistic / 2)), rel=1e-9)
    assert likelihood_ratio(fit(problems.ou1d(), record, fixed={"mu": 2.0}), result).p < 1e-6
    with pytest.raises(ValueError, match="free parameters"):
        likelihood_ratio(result, smaller)


def test_forward_selection_reports_its_path(record: Data) -> None:
    whole = problems.ou1d()
    table = [
        dataclasses.replace(q, lower=0.0, upper=0.0, typical=0.0) if q.symbol == "mu" else q for q in whole.parameters
    ]
    small = dataclasses.replace(whole, name="no level", parameters=tuple(table))
    path = forward_selection({"small": small, "whole": whole}, {"small": ["whole"]}, record, first="small")
    assert [name for name, *_ in path.path] == ["small", "whole"]
    assert path.chosen[0] == "whole"
    assert "whole" in path.table()


def test_predictions_further_ahead_are_worse_and_simulation_is_the_limit(result: FitResult, record: Data) -> None:
    spread = [float(np.nanstd(record.y - result.predict(k))) for k in (1, 2, 20)]
    assert spread[0] < spread[1] < spread[2] * 1.02
    np.testing.assert_allclose(result.predict(1)[1:], result.paths()[0].predicted[1:])
    np.testing.assert_allclose(result.predict(399)[-1, 0], result.simulate()[-1, 0], atol=1e-6)


def test_smoothing_uses_the_future_too(result: FitResult) -> None:
    x, P = result.smooth()
    path = result.paths()[0]
    np.testing.assert_allclose(x[-1], path.xf[-1])
    assert (P[:-1, 0, 0] < path.Pf[:-1, 0, 0]).all()


def test_smoothed_state_is_that_of_the_joint_normal_distribution() -> None:
    """Smoothing by conditioning the joint distribution of all states and outputs, without any recursion."""
    m, n = problems.ou1d(), 6
    th, mu, lsx, lsy = TRUE
    t = np.arange(n) * 0.1
    d = Data(t, np.zeros((n, 1)), np.array([3.1, 2.7, 3.4, 2.2, 2.9, 3.3]))
    r = dataclasses.replace(fit(m, ou1d()), params=dict(zip(m.symbols["parameters"], TRUE, strict=True)))
    a = np.exp(-th * 0.1)
    q = np.exp(2 * lsx) * (1 - a * a) / (2 * th)
    mean, C = np.empty(n), np.empty((n, n))
    mean[0], C[0, 0] = 3.0, 0.01
    for i in range(1, n):
        mean[i] = mu + a * (mean[i - 1] - mu)
        C[i, :i] = C[:i, i] = a * C[i - 1, :i]
        C[i, i] = a * a * C[i - 1, i - 1] + q
    S = C + np.exp(2 * lsy) * np.eye(n)
    x, P = r.smooth(d)
    np.testing.assert_allclose(x[:, 0], mean + C @ np.linalg.solve(S, d.y[:, 0] - mean), rtol=1e-7)
    np.testing.assert_allclose(P[:, 0, 0], np.diag(C - C @ np.linalg.solve(S, C)), rtol=1e-6)


BAD = [
    ({"t": np.array([0.0, 1.0, 1.0, 2.0])}, "time does not increase at row 2: 1.0 after 1.0"),
    ({"t": np.array([0.0, 1.0, np.nan, 2.0])}, "time does not increase"),
    ({"y": np.full((4, 1), np.nan)}, "output y has no value in any of 4 rows"),
    ({"u": np.array([0.0, np.nan, 0.0, 1.0])}, "input u is missing in 1 of 4 rows, first in row 1"),
    ({"u": np.zeros((4, 2))}, "2 columns of inputs, but OU 1-D has 1: u"),
    ({}, "4 measured values for 4 free parameters"),
    ({"t": np.arange(3.0)}, "t has 3 rows, u 4 and y 4"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_data_are_refused_with_their_cause(change: dict[str, np.ndarray], message: str) -> None:
    good = {"t": np.arange(4.0), "u": np.array([0.0, 1.0, 0.0, 1.0]), "y": np.array([1.0, 2.0, 1.5, 1.0])}
    with pytest.raises(DataError, match=message):
        fit(problems.ou1d(), Data(**{**good, **change}))


def test_constant_input_is_a_warning_that_names_it(record: Data) -> None:
    r = fit(problems.ou1d(), dataclasses.replace(record, u=np.zeros_like(record.u)))
    assert any("input u is constant at 0" in w for w in r.warnings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": {"th": 500.0}}, r"start of th is 500 1, outside its bounds \[0.01, 100\]"),
        ({"start": {"theta": 1.0}}, "'theta', which is no parameter"),
        ({"fixed": {"th": np.nan}}, "th is fixed at nan"),
    ],
)
def test_bad_parameters_are_refused_by_name(options: dict[str, dict[str, float]], message: str, record: Data) -> None:
    with pytest.raises(ParameterError, match=message):
        fit(problems.ou1d(), record, **options)  # type: ignore[arg-type]


BENT = dataclasses.replace(
    problems.ou1d(), name="bent",
    drift=lambda x, u, p: {"x": p.th * (p.mu + u.u - x.x) - 0.3 * (x.x - p.mu) ** 3},
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("model", [problems.ou1d(), BENT], ids=["linear", "non-linear"])
def test_intervals_cover_as_they_say(model: ComponentModel, record_property: Callable[[str, object], None]) -> None:
    """200 simulated records; the binomial error of 95 % is 1.5 %."""
    t = np.arange(300) * 0.1
    u = np.sign(np.sin(t * 1.3))[:, None]
    hits = np.zeros(len(TRUE))
    for seed in range(200):
        d = realise(model, TRUE, Data(t, u, np.zeros((300, 1))), seed=seed)
        intervals = fit(model, d).conf_int().values()
        hits += [low <= true <= high for (low, high), true in zip(intervals, TRUE, strict=True)]
    record_property("covered", dict(zip(model.symbols["parameters"], (hits / 200).tolist(), strict=True)))
    assert 0.92 <= hits.mean() / 200 <= 0.98


def test_one_parameter_held_far_from_its_estimate_does_not_lose_a_warm_search() -> None:
    """The threshold of a pipe's friction: with it off, the slope that fits best leaves most choices of substeps without
    a likelihood, which must not send the search away."""
    model, record = experiment(dataclasses.replace(CASES["pipe_hydraulic"], rows=3000), 3)[:2]
    free = fit(model, record)
    near = {s: v for s, v in free.params.items() if s != "Re_t"}
    held = fit(model, record, start=near, fixed={"Re_t": free.params["Re_t"] + 4 * free.bse["Re_t"]})
    assert held.converged
    # Wilks: four standard errors off cost about 8; twice that where the likelihood is not quadratic
    assert 0 < free.llf - held.llf < 16
