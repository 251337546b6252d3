"""Local linearisation of a stiff model whose drift is not linear, against moments integrated by SciPy's Radau."""

from __future__ import annotations

import time
from types import SimpleNamespace as Space

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import approx_fprime

from fdd.greybox.filter_bank import FilterBank
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.results import FitResult
from fdd.greybox.simulate import realise
from fdd.models.declare import ComponentModel
from tests.greybox import problems

VALUES = np.array([2000.0, 0.3, 0.5, 0.1])


def stiff() -> ComponentModel:
    """A fast state that follows a slow one, and losses that bend: time constants of 2 s and hours, in hours."""
    return problems.declared(
        "stiff",
        states=problems._states(fast=0.5, slow=0.5),
        inputs=problems._q("u"),
        outputs=problems._q("y"),
        parameters=tuple(problems.log_parameter(s, v) for s, v in zip(("k", "b", "s", "r"), VALUES, strict=True)),
        drift=lambda x, u, p: {
            "fast": p.k * (x.slow - x.fast) - 0.2 * p.k * (x.fast * x.fast * x.fast) / 10 + 5 * u.u,
            "slow": u.u - p.b * x.fast * x.fast,
        },
        diffusion=lambda x, u, p: {"fast": p.s, "slow": p.s},
        observe=lambda x, u, p: {"y": x.fast},
        noise=lambda x, u, p: {"y": p.r},
        start=problems.constant_start(fast=2.0, slow=2.0),
    )


def record(hold: str, n: int = 20) -> Data:
    t = np.arange(n) * 0.5
    y = 1.7 + 0.3 * np.sin(t) + 0.1 * np.random.default_rng(0).normal(size=n)
    return Data(t, (1.2 + 0.4 * np.sin(t / 3))[:, None], y, hold=hold)


def radau(m: ComponentModel, d: Data, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Negative log-likelihood and standardised innovations of the extended filter, moments integrated by SciPy."""
    p = Space(**dict(zip(m.symbols["parameters"], values, strict=True)))
    names = m.symbols["states"]

    def drift(x: np.ndarray, u: float) -> np.ndarray:
        out = m.drift(Space(**dict(zip(names, x, strict=True))), Space(u=u), p)
        return np.array([out[s] for s in names])

    def jacobian(x: np.ndarray, u: float) -> np.ndarray:
        h = 1e-20  # complex step: exact to rounding
        return np.column_stack([(drift(x + 1j * h * e, u)).imag / h for e in np.eye(2)])

    def moments(t: float, z: np.ndarray, k: int) -> np.ndarray:
        share = (t - d.t[k]) / d.dt[k] if d.hold == "first" else 0.0
        u = d.u[k, 0] + share * (d.u[k + 1, 0] - d.u[k, 0])
        A, P = jacobian(z[:2], u), z[2:].reshape(2, 2)
        return np.concatenate([drift(z[:2], u), (A @ P + P @ A.T + p.s**2 * np.eye(2)).ravel()])

    x, P, total, z = np.array([2.0, 2.0]), 0.25 * np.eye(2), 0.0, []
    for k in range(len(d)):
        if k:
            start = np.concatenate([x, P.ravel()])
            end = solve_ivp(moments, (d.t[k - 1], d.t[k]), start, "Radau", args=(k - 1,), rtol=1e-8, atol=1e-11)
            x, P = end.y[:2, -1], end.y[2:, -1].reshape(2, 2)
        S, e = P[0, 0] + p.r**2, d.y[k, 0] - x[0]
        total += 0.5 * (e * e / S + np.log(S) + np.log(2 * np.pi))
        z.append(e / np.sqrt(S))
        x, P = x + P[:, 0] * e / S, P - np.outer(P[:, 0], P[:, 0]) / S
    return total, np.array(z)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_a_stiff_model_is_linearised_locally_and_has_the_likelihood_of_an_implicit_solver(hold: str) -> None:
    m, d = stiff(), record(hold)
    expected, z = radau(m, d, VALUES)
    automatic = Likelihood(m, d)
    assert automatic.value(VALUES) == pytest.approx(expected, abs=0.01)
    assert automatic.prediction().startswith("local linearisation (stiff)")
    np.testing.assert_allclose(automatic.paths(VALUES)[0].standardised[:, 0], z, atol=5e-3)


def test_halving_substeps_divides_the_error_by_four() -> None:
    m, d = stiff(), record("zero")
    expected, _ = radau(m, d, VALUES)
    errors = [Likelihood(m, d, method="local", substeps=n).value(VALUES) - expected for n in (4, 8)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_its_gradient_is_the_derivative_of_its_value(hold: str) -> None:
    likelihood = Likelihood(stiff(), record(hold))
    likelihood.choose_substeps(VALUES)

    def value(a: np.ndarray) -> float:
        return likelihood.value(np.exp(a))

    slope = approx_fprime(np.log(VALUES), value, 1e-6)
    np.testing.assert_allclose(likelihood.evaluate(VALUES).gradient, slope, rtol=1e-3, atol=1e-3)
    plain = Likelihood(stiff(), record(hold), method="local", plain=True)
    np.testing.assert_allclose(plain.evaluate(VALUES).gradient, likelihood.evaluate(VALUES).gradient, rtol=1e-8)


def test_substeps_would_cost_ten_times_as_much() -> None:
    m, d, times = stiff(), record("zero"), []
    for method in ("local", "rk4"):
        likelihood = Likelihood(m, d, method=method)
        likelihood.evaluate(VALUES)
        start = time.process_time()
        for _ in range(5):
            likelihood.evaluate(VALUES)
        times.append(time.process_time() - start)
    assert times[1] > 10 * times[0]


def test_what_is_too_fast_for_runge_kutta_has_a_likelihood_all_the_same() -> None:
    values = VALUES * [1000.0, 1.0, 1.0, 1.0]
    m, d = stiff(), record("zero")
    assert np.isinf(Likelihood(m, d, method="rk4").value(values))
    assert Likelihood(m, d).value(values) == pytest.approx(radau(m, d, values)[0], abs=0.01)


def test_a_fit_says_how_it_predicted_and_goes_on_with_it() -> None:
    m, true = stiff(), VALUES * [0.2, 1.0, 1.0, 1.0]
    d = realise(m, true, record("zero", 80), seed=1, substeps=300)
    r = fit(m, d, fixed={"k": true[0]}, errors="fisher")
    assert "prediction: local linearisation (stiff)" in r.summary()
    assert abs(r.params["b"] - 0.3) < 4 * r.bse["b"]
    assert np.isfinite(r.predict(5)[5:]).all()
    assert np.isfinite(r.smooth()[0]).all()
    assert FitResult.from_dict(r.to_dict(), m, d).summary() == r.summary()


def test_what_is_not_stiff_stays_with_runge_kutta() -> None:
    m = stiff()
    likelihood = Likelihood(m, record("zero"))
    assert np.isfinite(likelihood.value(VALUES * [1e-3, 1, 1, 1]))
    assert likelihood.prediction().startswith("Runge-Kutta of order four")


def test_a_bank_takes_it_when_told_to() -> None:
    m, d = stiff(), record("zero")
    bank = FilterBank(m, VALUES, method="local")
    z = []
    for k in range(len(d)):
        step = bank.step([d.dt[k - 1] if k else 0.0], d.u[k : k + 1], d.y[k : k + 1])
        z.append(step.standardised[0, 0])
    np.testing.assert_allclose(z[1:], Likelihood(m, d).paths(VALUES)[0].standardised[1:, 0], atol=1e-9)
