from __future__ import annotations

import json

import numpy as np
import pytest

from fdd.greybox.kernels import kernel
from fdd.greybox.likelihood import Data, Likelihood
from tests.greybox import problems
from tests.greybox.records import ORACLE, kernel_record

REFERENCE = json.loads((ORACLE / "kernel_reference.json").read_text())


def likelihood(name: str, **more: object) -> Likelihood:
    return Likelihood(
        problems.KERNEL_PROBLEMS[name](), kernel_record(name), method=problems.METHODS[name],
        substeps=problems.SUBSTEPS[name], **more,  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.mark.parametrize("at", ["true", "off"])
@pytest.mark.parametrize("name", list(problems.KERNEL_PROBLEMS))
def test_likelihood_and_gradient_are_those_of_the_reference(name: str, at: str) -> None:
    case = REFERENCE[f"{name}_{at}"]
    values = np.exp(case["log_theta"])
    made = likelihood(name)
    gradient = np.array(case["gradient"])
    assert made.value(values) == pytest.approx(case["negative_log_likelihood"], rel=1e-11)
    e = made.evaluate(values)
    assert e.value == pytest.approx(case["negative_log_likelihood"], rel=1e-11)
    # The unidentifiable sL has a slope 1e-4 of the largest: compare with the largest, as the reference does.
    assert np.abs(e.gradient - gradient).max() < 1e-8 * np.abs(gradient).max()


@pytest.mark.parametrize("name", list(problems.KERNEL_PROBLEMS))
def test_generated_text_gives_the_same_as_plain_python(name: str) -> None:
    d = kernel_record(name)
    short = Data(d.t[:40], d.u[:40], d.y[:40])
    m = problems.KERNEL_PROBLEMS[name]()
    values = np.array([q.typical for q in m.parameters])
    more = {"method": problems.METHODS[name], "substeps": problems.SUBSTEPS[name]}
    fast, slow = (Likelihood(m, short, plain=plain, **more).evaluate(values) for plain in (False, True))  # type: ignore[arg-type]
    assert fast.value == pytest.approx(slow.value, rel=1e-11)
    np.testing.assert_allclose(fast.gradient, slow.gradient, rtol=1e-8, atol=1e-8 * np.abs(slow.gradient).max())
    np.testing.assert_allclose(fast.information, slow.information, rtol=1e-8, atol=1e-9 * slow.information.max())


def test_fisher_information_is_the_scatter_of_the_score() -> None:
    """At the true parameters the mean of score score' over simulated records is the information (OU process)."""
    m = problems.ou1d()
    values = np.array([5.0, 3.0, 0.2, -1.5])
    t = np.arange(150) * 0.1
    random = np.random.default_rng(3)
    scores, infos = [], []
    for _ in range(400):
        x, y = 3.0 + 0.1 * random.normal(), []
        decay = np.exp(-values[0] * 0.1)
        sd = np.exp(values[2]) * np.sqrt((1 - decay**2) / (2 * values[0]))
        for _ in t:
            y.append(x + np.exp(values[3]) * random.normal())
            x = values[1] + (x - values[1]) * decay + sd * random.normal()
        e = Likelihood(m, Data(t, np.zeros((150, 1)), np.array(y))).evaluate(values)
        scores.append(e.gradient)
        infos.append(e.information)
    scatter, info = np.cov(np.array(scores).T), np.mean(infos, axis=0)
    scale = np.sqrt(np.outer(np.diag(info), np.diag(info)))
    # A correlation estimated from 400 draws has a standard error of about 0.05, a variance one of 0.07.
    assert np.abs((scatter - info) / scale).max() < 0.25


@pytest.mark.parametrize("stiffness", [0.5, 40.0, 90.0])
def test_exact_discretisation_holds_at_any_stiffness(stiffness: float) -> None:
    """Prediction after one long step against the eigenvalue solution in mpmath-free float64."""
    m = problems.heat_exchanger()
    values = np.array([q.typical for q in m.parameters])
    u = np.array([0.37, 0.39, 70.0, 30.0])
    k = kernel(m)
    A, Q, c = _matrices(m, values, u)
    dt = stiffness / np.abs(np.linalg.eigvals(A)).max()
    w, consts = k.workspace(), k.constants()
    k.module.prepare(values, consts)
    k.module.start(w, consts, u, np.zeros(2))
    x0, P0 = w[:6].copy(), 4.0 * np.eye(6)
    k.module.predict(w, consts, dt, u, u, 0)
    lam, V = np.linalg.eig(A)
    E = (V * np.exp(lam * dt)) @ np.linalg.inv(V)
    steady = np.linalg.solve(A, -c)
    np.testing.assert_allclose(w[:6], steady + np.real(E) @ (x0 - steady), rtol=1e-10)
    W = np.linalg.inv(V) @ Q @ np.linalg.inv(V).T
    total = lam[:, None] + lam[None, :]
    P = np.real(E @ P0 @ E.T + V @ (W * np.expm1(total * dt) / total) @ V.T)
    np.testing.assert_allclose(w[6:27], P[np.triu_indices(6)], rtol=1e-8, atol=1e-10 * P.max())


def _matrices(m: object, values: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, Q and c by running the model on floats."""
    from types import SimpleNamespace as Space

    p = Space(**dict(zip(m.symbols["parameters"], values, strict=True)))  # type: ignore[attr-defined]
    inputs = Space(**dict(zip(m.symbols["inputs"], u, strict=True)))  # type: ignore[attr-defined]
    names = m.symbols["states"]  # type: ignore[attr-defined]

    def f(x: np.ndarray) -> np.ndarray:
        out = m.drift(Space(**dict(zip(names, x, strict=True))), inputs, p)  # type: ignore[attr-defined]
        return np.array([out[s] for s in names])

    c = f(np.zeros(len(names)))
    A = np.column_stack([f(e) - c for e in np.eye(len(names))])
    g = m.diffusion(None, inputs, p)  # type: ignore[attr-defined]
    return A, np.diag([g[s] ** 2 for s in names]), c


def test_exact_and_runge_kutta_agree_where_both_apply() -> None:
    d = kernel_record("building")
    m = problems.building()
    values = np.array([q.typical for q in m.parameters])
    exact = Likelihood(m, d).evaluate(values)
    fine = Likelihood(m, d, method="rk4", substeps=20).evaluate(values)
    assert fine.value == pytest.approx(exact.value, rel=1e-9)
    assert np.abs(fine.gradient - exact.gradient).max() < 1e-6 * np.abs(exact.gradient).max()
    automatic = Likelihood(m, d, method="rk4").evaluate(values)
    # What a statistician sees: a likelihood off by less than 0.01, where 0.5 is one standard error.
    assert automatic.value == pytest.approx(exact.value, abs=0.01)
    assert np.abs(automatic.gradient - exact.gradient).max() < 1e-3 * np.abs(exact.gradient).max()


def test_filterpy_gives_the_same_likelihood_for_the_radiator() -> None:
    from filterpy.kalman import ExtendedKalmanFilter

    d, m = kernel_record("radiator"), problems.radiator()
    p = {q.symbol: q.typical for q in m.parameters}
    ekf = ExtendedKalmanFilter(dim_x=4, dim_z=1)
    ekf.x, ekf.P = np.array([[45.0], [40.0], [26.0], [0.5]]), np.diag([1.0, 1.0, 1.0, 0.01])
    ekf.R = np.array([[p["r"] ** 2]])
    Q = np.diag([p["sT"] ** 2, p["sT"] ** 2, p["sL"] ** 2, p["sA"] ** 2])
    H = np.array([[0.0, 1.0, 0.0, 0.0]])
    total = 0.0
    from benchmarks.kernels import radiator_rk4

    for k in range(200):
        if k:
            ekf.x, ekf.P = radiator_rk4(ekf.x, ekf.P, d.u[k - 1], p, Q, d.dt[k - 1], 4)
        ekf.update(np.array([[d.y[k, 0]]]), lambda x: H, lambda x: H @ x)
        e, S = ekf.y.item(), ekf.S.item()
        total += 0.5 * (e * e / S + np.log(S) + np.log(2 * np.pi))
    short = Data(d.t[:200], d.u[:200], d.y[:200])
    values = np.array(list(p.values()))
    assert Likelihood(m, short, substeps=4).value(values) == pytest.approx(total, rel=1e-9)


def test_a_settled_filter_is_the_full_one_and_wakes_up() -> None:
    """Missing outputs and a longer step in the middle of a record, against the pass that keeps everything."""
    d, m = kernel_record("building"), problems.building()
    y, t = d.y.copy(), d.t.copy()
    y[1500:1503, 0] = np.nan
    t[2000:] += 1 / 3
    record, values = Data(t, d.u, y), np.array([q.typical for q in m.parameters])
    likelihood = Likelihood(m, record)
    path = likelihood.paths(values)[0]  # keeping a path never settles
    z = path.standardised
    full = 0.5 * float(np.nansum(z**2 + np.log(path.innovation_variance) + np.log(2 * np.pi)))
    e = likelihood.evaluate(values)
    assert likelihood.value(values) == pytest.approx(full, rel=1e-12)
    assert e.value == pytest.approx(full, rel=1e-12)
    step = 1e-6
    for k in (0, 7, 11, 14):
        ends = [likelihood.value(values * (1 + sign * step * (np.arange(15) == k))) for sign in (1, -1)]
        assert e.gradient[k] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5, abs=1e-2)
