from __future__ import annotations

from types import SimpleNamespace as Space

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from fdd.models.declare import ModelError
from fdd.models.registry import get_model

OPTIONS = {"dynamics": "quasi-steady", "flow_hot": 0.2, "flow_cold": 0.4}
PARAMETERS = {"UA": 2500.0, "balance": 1.0, "memory": 2e4, "wander": 0.03}
NOISE = {"meter_hot": 0.01, "meter_cold": 0.02, "noise_hot": 0.05, "noise_cold": 0.07}


def outlets(hot: float, cold: float, flow: str = "counter", **changes: float) -> dict[str, float]:
    m = get_model("heat_exchanger", flow=flow, **OPTIONS)
    u = Space(m_flow_hot=hot, m_flow_cold=cold, T_hot_in=80.0, T_cold_in=35.0)
    found = m.observe(Space(w=0.0), u, Space(**{**PARAMETERS, **NOISE, **changes}))
    return {k: float(v) for k, v in found.items()}


@pytest.mark.parametrize("flow", ["counter", "parallel"])
@pytest.mark.parametrize(("hot", "cold"), [(0.2, 0.4), (0.3, 0.3), (0.5, 0.2)])
def test_outlets_are_those_of_the_differential_equations(hot: float, cold: float, flow: str) -> None:
    """Along the plates d T_hot = -UA (T_hot - T_cold) / C_hot, and the cold side the one or the other way."""
    c_hot, c_cold = 4186.0 * hot, 4186.0 * cold
    UA = 2500.0 / (0.5 * (hot / 0.2) ** -0.7 + 0.5 * (cold / 0.4) ** -0.7)
    sign = -1.0 if flow == "counter" else 1.0

    def slopes(z: np.ndarray, T: np.ndarray) -> np.ndarray:
        q = UA * (T[0] - T[1])
        return np.vstack([-q / c_hot, sign * q / c_cold])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0] - 80.0, (b if flow == "counter" else a)[1] - 35.0])

    z = np.linspace(0, 1, 50)
    solved = solve_bvp(slopes, ends, z, np.vstack([80 - 20 * z, 35 + 0 * z]), tol=1e-6)
    assert solved.success
    expected = solved.y[0, -1], solved.y[1, 0 if flow == "counter" else -1]
    found = outlets(hot, cold, flow)
    assert (found["T_hot_out"], found["T_cold_out"]) == pytest.approx(
        expected, abs=5e-3
    )  # a hundredth of the usual flow seeps


def test_heat_is_kept_and_fouling_lets_less_through() -> None:
    clean, fouled = outlets(0.2, 0.4), outlets(0.2, 0.4, UA=2000.0)
    assert 0.2 * (80 - clean["T_hot_out"]) == pytest.approx(0.4 * (clean["T_cold_out"] - 35), rel=1e-12)
    assert fouled["T_hot_out"] > clean["T_hot_out"]
    assert fouled["T_cold_out"] < clean["T_cold_out"]


def test_nothing_breaks_where_water_stands() -> None:
    for hot, cold in ((0.0, 0.0), (0.0, 0.4), (0.3, 0.0), (-0.01, 0.2)):
        found = outlets(hot, cold)
        assert all(35.0 - 1e-9 <= v <= 80.0 + 1e-9 for v in found.values()), (hot, cold, found)


def test_errors_of_a_flow_show_more_where_it_is_small() -> None:
    m = get_model("heat_exchanger", **OPTIONS)

    def noise(hot: float) -> float:
        u = Space(m_flow_hot=hot, m_flow_cold=0.4, T_hot_in=80.0, T_cold_in=35.0)
        return float(m.noise(Space(), u, Space(**PARAMETERS, **NOISE))["T_cold_out"])

    assert noise(0.05) > noise(0.1) > noise(0.2) > 0.07


@pytest.mark.parametrize(
    "wrong", [{"metal": True}, {"transfer": "flow-temperature"}, {"flow_hot": 0.0}, {"exponent": 2.0}]
)
def test_options_that_need_dynamics_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ModelError, match=r"quasi-steady|usual flows|exponent"):
        get_model("heat_exchanger", **{**OPTIONS, **wrong})
