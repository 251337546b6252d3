"""Regressors and their covariance from raw readings."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.chiller_eiv.errors import Instrumentation, SensorError, heat_balance, regressors
from fdd.chiller_eiv.model import ChillerError

BASE = ("T_cdi", "T_chi", "Q", "E")
RAW = {"T_cdi": 28.0, "T_chi": 12.0, "T_cho": 7.0, "flow_ch": 20.0, "power": 80e3, "load": 420e3, "auxiliary": 5e3}
ERRORS = {
    "T_cdi": SensorError(0.1),
    "T_chi": SensorError(0.08),
    "T_cho": SensorError(0.06),
    "flow_ch": SensorError(relative=0.02),
    "power": SensorError(500.0),
    "load": SensorError(4e3),
    "auxiliary": SensorError(200.0),
}


def raw(*names: str) -> dict[str, np.ndarray]:
    return {k: np.array([RAW[k]]) for k in names}


def test_load_from_flow_correlates_with_the_chilled_water_temperature() -> None:
    instruments = Instrumentation(ERRORS)
    x, cov = regressors(raw("T_cdi", "T_chi", "T_cho", "flow_ch", "power"), 1, instruments, BASE)
    c, m, d = 4190.0, 20.0, 5.0
    np.testing.assert_allclose(x[0], [301.15, 285.15, c * m * d, 80e3])
    assert cov[0, 2, 1] == pytest.approx(c * m * 0.08**2)
    assert cov[0, 2, 2] == pytest.approx((c * m) ** 2 * (0.08**2 + 0.06**2) + (c * d) ** 2 * 0.4**2)


def test_covariance_agrees_with_simulation() -> None:
    instruments = Instrumentation(ERRORS, chilled_water="entering", load_from="meter", auxiliary=1e3)
    del_T_chi = {k: v for k, v in ERRORS.items() if k != "T_chi"}
    instruments = Instrumentation(del_T_chi, load_from="meter", auxiliary=1e3)
    names = ("T_cdi", "T_cho", "flow_ch", "power", "load", "auxiliary")
    rng = np.random.default_rng(1)
    n = 40_000
    sd = {k: ERRORS[k].sd(RAW[k]) for k in names}
    noisy = {k: RAW[k] + sd[k] * rng.standard_normal(n) for k in names}
    x, _ = regressors(noisy, 1, instruments, BASE)
    mean, cov = regressors(raw(*names), 1, instruments, BASE)
    np.testing.assert_allclose(mean[0], [301.15, 7 + 273.15 + 420e3 / (4190 * 20), 420e3, 74e3])
    sampled = np.cov(x.T)
    scale = np.sqrt(np.outer(np.diag(cov[0]), np.diag(cov[0])))
    assert np.max(np.abs(sampled - cov[0]) / scale) < 0.03


def test_averaging_shrinks_random_errors_only() -> None:
    error = SensorError(random=0.4, slow=0.1)
    assert error.variance(np.array([20.0]), 16)[0] == pytest.approx(0.01 + 0.01)


def test_leaving_water_is_taken_as_it_is_when_asked() -> None:
    instruments = Instrumentation(ERRORS, load_from="meter", chilled_water="leaving")
    x, _ = regressors(raw("T_cdi", "T_cho", "load", "power"), 1, instruments, BASE)
    assert x[0, 1] == pytest.approx(280.15)


def test_heat_balance_sees_a_flow_that_reads_low() -> None:
    cold = {"T_cdi": np.array([28.0]), "T_cdo": np.array([33.0]), "flow_cd": np.array([500e3 / 4190 / 5])}
    assert heat_balance(cold, np.array([420e3]), np.array([80e3]), 4190.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert heat_balance(cold, np.array([420e3 * 0.95]), np.array([80e3]), 4190.0)[0] == pytest.approx(0.0438, abs=1e-3)
    assert np.isnan(heat_balance({}, np.array([1.0]), np.array([1.0]), 4190.0)[0])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Instrumentation({"T_condenser": SensorError(0.1)}), "unknown chiller quantity"),
        (lambda: Instrumentation({}, load_from="guess"), "load_from"),  # type: ignore[arg-type]
        (lambda: SensorError(-1.0), "zero or positive"),
        (lambda: regressors(raw("T_cdi"), 1, Instrumentation(ERRORS), BASE), "lack T_chi"),
        (
            lambda: regressors(
                raw("T_cdi", "T_chi", "T_cho", "flow_ch", "power"), 1, Instrumentation(ERRORS), (*BASE, "V")
            ),
            "flow_cd",
        ),
    ],
)
def test_bad_declarations_are_refused(make, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ChillerError, match=words):
        make()
