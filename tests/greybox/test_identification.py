"""Numbers of other programs: CTSM 2.3 (A), ctsmTMB (B, C), exact filters (D, E), pySIP (F), published data (G)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from fdd.greybox.alternatives import filtered
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.scale import from_scale, scale_bounds, to_scale
from fdd.models.declare import ComponentModel, Parameter
from tests.greybox import problems
from tests.greybox.records import building_d, ou1d, radiator_e, table

A_VALUES = np.array([103.94, 0.96509, 2.0215, 49.320, 0.50929, 7.3779e-8, 2.6951e-9, 0.010330])
B_ZERO = np.array([1.8339552772, 2.9060307478, 0.4620672142, 0.3336742310, -0.9332218718, -12.17987428, -2.0276983689])
B_FIRST = np.array([1.9060833969, 2.9213057873, 0.4661808142, 0.2914021550, -0.9313049911, -12.81116887, -2.0306623984])
D_OPTIMUM = {
    "Bus": (12.4095, 0.1912), "Bb": (34.384, 1.212), "Bn": (39.018, 1.364), "Bas": (535.69, 6.530),
    "Bun": (28.0744, 0.2552), "Ban": (616.816, 8.130), "Cis": (433.140, 5.193), "Cas": (1533.46, 17.08),
    "Cin": (817.757, 7.220), "Can": (3289.47, 81.69), "Aes": (1.68269, 0.01452), "lsis": (-3.54551, 0.1155),
    "lsas": (-3.91930, 0.1211), "lsin": (-3.55159, 0.0837), "lsan": (-3.90090, 0.1233), "lrs": (-3.48660, 0.0208),
    "lrn": (-3.48206, 0.0195),
}  # fmt: skip
E_OPTIMUM = {
    "Cr": (30.188, 0.218), "Hr": (12.026, 0.547), "Cl": (14.94, 2.87), "Bl": (120.7, 17.0), "a": (0.05857, 0.00311),
    "b": (2.8819, 0.181), "ls1": (-2.47066, 0.1498), "lsy": (-2.97187, 0.0258),
}  # fmt: skip


def wall() -> Data:
    from scipy.linalg import expm

    rows = table("ctsm_heat_data", header=0, delimiter=";")
    G1, H1, H2, G2, H3, s1, s2, _ = A_VALUES
    A = np.array([[-(1 / H1 + 1 / H2) / G1, 1 / (H2 * G1)], [1 / (H2 * G2), -(1 / H2 + 1 / H3) / G2]])
    # Start covariance: the noise of the first interval (Van Loan).
    block = expm(np.block([[-A, np.diag([s1**2, s2**2])], [np.zeros((2, 2)), A.T]]))
    P0 = block[2:, 2:].T @ block[:2, 2:]
    return Data(rows[:, 0], rows[:, 1:3], rows[:, 3:], x0=np.array([13.134, 25.330]), P0=P0)


def test_a_ctsm_likelihood_and_predictions() -> None:
    likelihood = Likelihood(problems.ctsm_wall(), wall())
    assert likelihood.value(A_VALUES) == pytest.approx(-623.3564, abs=2e-4)
    path, theirs = likelihood.paths(A_VALUES)[0], table("ctsm_heat_predictions", header=0, delimiter=";")
    assert np.abs(path.x - theirs[:, 1:3]).max() < 6e-4
    assert np.sqrt(np.mean((path.predicted[:, 0] - theirs[:, 5]) ** 2)) < 1.5e-3
    np.testing.assert_allclose(np.sqrt(path.variance[:, 0]), theirs[:, 6], rtol=1e-4)


@pytest.mark.parametrize(
    ("hold", "values", "expected"), [("zero", B_ZERO, 4.80814948092), ("first", B_FIRST, 1.75327931962)]
)
def test_b_ctsmtmb_reference(hold: str, values: np.ndarray, expected: float) -> None:
    rows = table("id_ou2d")
    d = Data(rows[:, 0], rows[:, 1:2], rows[:, 2:4], hold=hold)  # type: ignore[arg-type]
    e = Likelihood(problems.ou2d(), d).evaluate(values)
    assert e.value == pytest.approx(expected, abs=1e-9)
    # They are optima of the identified parameters.
    assert np.abs(np.delete(e.gradient, 5)).max() < 2e-3


def test_b_fit_names_what_is_not_identified() -> None:
    rows = table("id_ou2d")
    result = fit(problems.ou2d(), Data(rows[:, 0], rows[:, 1:2], rows[:, 2:4]))
    assert -result.llf == pytest.approx(4.80814948092, abs=1e-4)
    assert result.unidentifiable == ("lr1",)
    assert np.isinf(result.bse["lr1"])
    assert np.isfinite([v for k, v in result.bse.items() if k != "lr1"]).all()
    assert any("lr1" in w for w in result.warnings)


@pytest.mark.parametrize(
    ("kind", "values", "expected", "within"),
    [
        ("", (2, 2, np.log(0.5), np.log(0.05)), 455.1148284941, 1e-9),
        ("", (5.29, 2.98, 0.22, -2.48), 59.1994526780, 1e-9),
        ("_irregular", (5.29, 2.98, 0.22, -2.48), 70.2984766, 1e-7),
        ("_growing", (5.29, 2.98, 0.22, -2.48), 53.3317051, 1e-7),
        ("_missing", (5.29, 2.98, 0.22, -2.48), 49.2237602, 1e-7),
    ],
)
def test_c_sampling_of_every_kind(kind: str, values: tuple[float, ...], expected: float, within: float) -> None:
    assert Likelihood(problems.ou1d(), ou1d(kind)).value(np.array(values)) == pytest.approx(expected, abs=within)


def test_c_optimum_and_standard_errors() -> None:
    r = fit(problems.ou1d(), ou1d())
    assert -r.llf == pytest.approx(59.1970478, abs=1e-6)
    expected = {
        "th": (5.288194, 0.6188),
        "mu": (2.983602, 0.05413),
        "lsx": (0.220886, 0.07011),
        "lsy": (-2.482343, 0.4689),
    }
    for name, (value, error) in expected.items():
        assert r.params[name] == pytest.approx(value, abs=2e-3 * error)
        assert r.bse[name] == pytest.approx(error, rel=2e-3)


def test_d_ends_in_the_global_optimum_never_in_the_trap() -> None:
    m, d = problems.id_building(), building_d()
    start = np.array([q.typical for q in m.parameters])
    assert Likelihood(m, d).value(start) == pytest.approx(-4730.5462803391, abs=1e-8)
    r = fit(m, d)
    assert -r.llf == pytest.approx(-9362.46640947, abs=1e-6)
    for name, (value, error) in D_OPTIMUM.items():
        assert r.params[name] == pytest.approx(value, abs=max(2e-3 * error, 6e-6 * abs(value)))
        assert r.bse[name] == pytest.approx(error, rel=3e-3)
    for k in range(10):
        random = np.random.default_rng(k)
        away = {q.symbol: _scattered(q, random) for q in m.parameters}
        assert -fit(m, d, start=away, errors="fisher").llf == pytest.approx(-9362.46640947, abs=1e-4)


@pytest.mark.parametrize("seed", range(30))
def test_d_ends_in_the_global_optimum_from_anywhere_within_the_bounds(seed: int) -> None:
    m, d = problems.id_building(), building_d()
    result = fit(m, d, start=_anywhere(m, seed), errors="fisher")
    assert -result.llf == pytest.approx(-9362.46640947, abs=1e-4)


@pytest.mark.slow
def test_e_ends_in_the_optimum_from_eight_of_ten_starts_within_the_bounds() -> None:
    m, d = problems.id_radiator(), radiator_e()
    ends = [-fit(m, d, start=_anywhere(m, seed), errors="fisher").llf for seed in range(10)]
    assert sum(end == pytest.approx(-1465.1178, abs=1e-3) for end in ends) >= 8


def _scattered(q: Parameter, random: np.random.Generator) -> float:
    """A factor around the given start: half of the draws beyond 1/2 and 2."""
    low, high = scale_bounds(q)
    return from_scale(q, float(np.clip(to_scale(q, q.typical) + random.normal(), low, high)))


def _anywhere(m: ComponentModel, seed: int) -> dict[str, float]:
    """Each parameter drawn evenly between its bounds, on the scale of estimation."""
    random = np.random.default_rng(seed)
    drawn = {q.symbol: from_scale(q, random.uniform(*scale_bounds(q))) for q in m.parameters}
    return {q.symbol: min(max(drawn[q.symbol], q.lower), q.upper) for q in m.parameters}


def test_e_radiator_values_and_optimum() -> None:
    m, d = problems.id_radiator(), radiator_e()
    start = np.array([q.typical for q in m.parameters])
    assert Likelihood(m, d, substeps=1).value(start) == pytest.approx(5817.0275, abs=1e-4)
    assert Likelihood(m, d, substeps=4).value(start) == pytest.approx(5817.013557, abs=1e-6)
    assert Likelihood(m, d).value(start) == pytest.approx(5817.013512464, abs=2e-3)
    r = fit(m, d, substeps=4)
    assert -r.llf == pytest.approx(-1465.117787, abs=2e-6)
    for name, (value, error) in E_OPTIMUM.items():
        assert r.params[name] == pytest.approx(value, abs=5e-3 * error)
        assert r.bse[name] == pytest.approx(error, rel=6e-3)


def test_f_armadillo_with_estimated_start_and_first_order_hold(shared_data: Path) -> None:
    rows = np.genfromtxt(shared_data / "armadillo_30min.csv", delimiter=",", names=True)[:-1]
    u = np.column_stack([rows["T_ext"], rows["P_hea"]])
    r = fit(problems.armadillo(), Data(rows["Time"] / 86400, u, rows["T_int"], hold="first"))
    assert -r.llf == pytest.approx(-331.0573, abs=2e-3)
    expected = {
        "Ro": (0.017593, 0.000927), "Ri": (0.001984, 0.000075), "Cw": (169.597, 7.663), "Ci": (18.946, 0.772),
        "s_w": (0.52134, 0.0470), "s_v": (0.034325, 0.00233), "Tw0": (26.5945, 0.1305),
    }  # fmt: skip
    for name, (value, error) in expected.items():
        assert r.params[name] == pytest.approx(value, abs=0.05 * error)
        # pySIP takes its errors from a difference Hessian on another scale.
        assert r.bse[name] == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize(
    ("kind", "expected", "values"),
    [
        ("Ti", -2478.6437, {"Ci": 2.07094, "Ria": 5.28354, "Aw": 8.0078, "p11": -1.63852}),
        ("TiTe", -3528.8306, {"Ci": 6.2155, "Ce": 1.2335, "Rie": 0.91883, "Rea": 3.2489, "Aw": 28.630}),
        ("TiTh", -3900.7291, {"Ci": 1.6254, "Ch": 0.043364, "Ria": 5.2979, "Rih": 3.7507, "Aw": 6.6825}),
        ("TiTeTh", -5430.2149, {"Ci": 1.0687, "Ce": 2.8959, "Rie": 0.85629, "Rea": 4.6131, "Aw": 6.1041}),
    ],
)  # fmt: skip
def test_g_flexhouse(kind: str, expected: float, values: dict[str, float], shared_data: Path) -> None:
    rows = np.genfromtxt(shared_data / "flexhouse_prbs_5min.csv", delimiter=",", skip_header=1, usecols=range(5))
    r = fit(problems.flexhouse(kind), Data(rows[:, 0], rows[:, 1:4], rows[:, 4]), errors="fisher")
    assert -r.llf == pytest.approx(expected, abs=2e-3)
    for name, value in values.items():
        assert r.params[name] == pytest.approx(value, rel=3e-4)


def test_a_drift_with_one_over_a_state_builds() -> None:
    """ctsmTMB does not build it; against the filter in plain matrices, which knows neither tracer nor kernels."""
    m = dataclasses.replace(problems.ou1d(), drift=lambda x, u, p: {"x": p.th * (p.mu + u.u - x.x) - 1 / (20 + x.x)})
    values, d = np.array([5.29, 2.98, 0.22, -2.48]), ou1d()
    expected = filtered(m, d, values, "extended", substeps=10).value
    assert Likelihood(m, d, substeps=10).value(values) == pytest.approx(expected, abs=1e-5)


def test_natural_scale_ends_where_logarithms_do() -> None:
    """In ctsmTMB the search on the natural scale does not finish."""
    m = problems.id_radiator()
    natural = tuple(dataclasses.replace(q, transform="identity") for q in m.parameters)
    r = fit(dataclasses.replace(m, name="radiator, natural", parameters=natural), radiator_e(), substeps=4)
    assert -r.llf == pytest.approx(-1465.117787, abs=1e-5)
    for name, (value, error) in E_OPTIMUM.items():
        assert r.params[name] == pytest.approx(value, abs=5e-3 * error)
        assert r.bse[name] == pytest.approx(error, rel=1e-2)


def test_a_row_with_one_missing_value_is_used() -> None:
    """pySIP drops such rows whole: against the joint normal density of everything measured, without any filter."""
    rows = table("id_ou2d")[:20]
    y = rows[:, 2:4].copy()
    y[5, 0] = y[11, 1] = np.nan
    likelihood = Likelihood(problems.ou2d(), Data(rows[:, 0], rows[:, 1:2], y))
    assert likelihood.value(B_ZERO) == pytest.approx(-_joint_density(rows[:, 0], rows[:, 1], y, B_ZERO), abs=1e-8)


def _joint_density(t: np.ndarray, u: np.ndarray, y: np.ndarray, values: np.ndarray) -> float:
    """Log density of the measured values of problem B from the mean and covariance of all states at all times."""
    from scipy.linalg import block_diag, expm
    from scipy.stats import multivariate_normal

    th, mu, al, s1, s2, r1, r2 = np.where(np.arange(7) == 1, values, np.exp(values))
    A, Q = np.array([[-th, 0.0], [al, -al]]), np.diag([s1**2, s2**2])
    n = len(t)
    mean, C = np.empty((n, 2)), np.zeros((n, 2, n, 2))
    mean[0], C[0, :, 0] = 3.0, 0.1 * np.eye(2)
    for k in range(n - 1):
        dt = t[k + 1] - t[k]
        drift = np.array([th * (mu + u[k]), 0.0])
        whole = expm(np.block([[A, drift[:, None]], [np.zeros((1, 3))]]) * dt)
        noise = expm(np.block([[-A, Q], [np.zeros((2, 2)), A.T]]) * dt)
        F = whole[:2, :2]
        mean[k + 1] = F @ mean[k] + whole[:2, 2]
        for i in range(k + 1):
            C[k + 1, :, i] = F @ C[k, :, i]
            C[i, :, k + 1] = C[k + 1, :, i].T
        C[k + 1, :, k + 1] = F @ C[k, :, k] @ F.T + noise[2:, 2:].T @ noise[:2, 2:]
    seen = np.isfinite(y).ravel()
    S = C.reshape(2 * n, 2 * n) + block_diag(*[np.diag([r1**2, r2**2])] * n)
    found = multivariate_normal.logpdf(y.ravel()[seen], mean.ravel()[seen], S[np.ix_(seen, seen)])
    return float(found)
