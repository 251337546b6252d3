import numpy as np
import pytest

from fdd.models.declare import ModelError
from fdd.models.heat_exchanger import heat_exchanger
from tests.models.numeric import drift, jacobian, simulate, steady, typical

U = {"m_flow_hot": 0.4, "m_flow_cold": 0.5, "T_hot_in": 75.0, "T_cold_in": 35.0}
CP = 4186.0


@pytest.mark.parametrize("metal", [False, True])
@pytest.mark.parametrize("flow", ["counter", "parallel"])
@pytest.mark.parametrize("transfer", ["constant", "flow", "flow-symmetric", "flow-temperature"])
def test_energy_balance_closes(transfer, flow, metal):
    model = heat_exchanger(transfer=transfer, flow=flow, metal=metal)
    p = typical(model)
    n, walls = 3, 3 if metal else 0
    x0 = np.concatenate([[70.0, 60, 50], [38.0, 45, 50], [55.0] * walls])
    weight = np.concatenate([[p.M_hot * CP / n] * n, [p.M_cold * CP / n] * n, [p.C_wall / n if metal else 0.0] * walls])

    def powers(x):
        return np.array([CP * 0.4 * (75 - x[n - 1]) + CP * 0.5 * (35 - x[2 * n - 1]), CP * 0.4 * 40])

    x, (net, throughput) = simulate(model, x0, U, p, 120.0, powers)
    assert abs(weight @ (x - x0) - net) < 1e-9 * throughput


@pytest.mark.parametrize("flow", ["counter", "parallel"])
@pytest.mark.parametrize(("m_hot", "m_cold", "ua"), [(0.4, 0.5, 2000.0), (0.7, 0.3, 1500.0), (0.3, 0.6, 500.0)])
def test_steady_outlets_approach_effectiveness_ntu(flow, m_hot, m_cold, ua):
    model = heat_exchanger(compartments=12, transfer="constant", flow=flow)
    u = U | {"m_flow_hot": m_hot, "m_flow_cold": m_cold}
    x = steady(model, np.full(24, 50.0), u, typical(model, UA=ua), 3000.0)
    smaller, larger = sorted([m_hot * CP, m_cold * CP])
    ratio, ntu = smaller / larger, ua / smaller
    # Incropera et al. (2007), Tab. 11.3
    if flow == "counter":
        e = np.exp(-ntu * (1 - ratio))
        effectiveness = (1 - e) / (1 - ratio * e)
    else:
        effectiveness = (1 - np.exp(-ntu * (1 + ratio))) / (1 + ratio)
    heat = effectiveness * smaller * 40
    assert x[11] == pytest.approx(75 - heat / (m_hot * CP), abs=0.1)
    assert x[23] == pytest.approx(35 + heat / (m_cold * CP), abs=0.1)


def test_metal_ends_at_the_same_outlets():
    states = []
    for metal in (False, True):
        model = heat_exchanger(metal=metal)
        states.append(steady(model, np.full(9 if metal else 6, 50.0), U, typical(model), 3000.0)[:6])
    assert states[0] == pytest.approx(states[1], abs=1e-6)


def test_time_constants_are_those_of_the_paper():
    # Tab. 2: 4 to 25 s for flows of 0.36 to 0.84 kg/s in an exchanger of 8.6 l and 105 kW.
    model = heat_exchanger(transfer="constant")
    p = typical(model, UA=3500.0, M_hot=4.3, M_cold=4.3)
    slowest = []
    for hot, cold in [(0.72, 0.84), (0.36, 0.42)]:
        u = U | {"m_flow_hot": hot, "m_flow_cold": cold}
        a = jacobian(model, np.full(6, 50.0), u, p)
        slowest.append(-1 / np.linalg.eigvals(a).real.max())
    assert 1 < slowest[0] < slowest[1] < 25


@pytest.mark.parametrize("transfer", ["constant", "flow", "flow-symmetric", "flow-temperature"])
@pytest.mark.parametrize("flows", [(0.0, 0.0), (0.0, 0.5), (0.4, 0.0)])
def test_no_flow_has_finite_rates_and_derivatives(transfer, flows):
    model = heat_exchanger(transfer=transfer)
    u = U | {"m_flow_hot": flows[0], "m_flow_cold": flows[1]}
    p, x = typical(model), np.array([70.0, 60, 50, 38, 45, 50])
    assert np.isfinite(drift(model, x, u, p)).all()
    assert np.isfinite(jacobian(model, x, u, p)).all()


def test_no_flow_on_one_side_passes_next_to_no_heat():
    model = heat_exchanger()
    u = U | {"m_flow_hot": 0.0}
    rates = drift(model, np.array([70.0, 60, 50, 35, 35, 35]), u, typical(model))
    assert np.abs(rates[:3]).max() < 1e-3


def test_zero_difference_passes_no_heat():
    model = heat_exchanger()
    rates = drift(model, np.full(6, 40.0), U | {"T_hot_in": 40.0, "T_cold_in": 40.0}, typical(model))
    assert np.abs(rates).max() < 1e-12


@pytest.mark.parametrize(
    ("options", "words"),
    [({"compartments": 0}, "1 to 12"), ({"flow": "cross"}, "counter"), ({"transfer": "guess"}, "flow-symmetric")],
)
def test_wrong_options_are_refused_with_the_remedy(options, words):
    with pytest.raises(ModelError, match=words):
        heat_exchanger(**options)
