from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from fdd.models.declare import ModelError
from fdd.models.fluid import WATER
from fdd.models.friction import friction_blasius, friction_colebrook, threshold, valve_flow
from fdd.models.pipe_hydraulic import pipe_hydraulic
from fdd.models.pipe_thermal import pipe_thermal
from fdd.models.pump import pump
from fdd.models.thermostatic_valve import thermostatic_valve
from fdd.models.valve import control_valve, relief_valve
from tests.models.numeric import drift, steady, typical


def test_48_kg_per_hour_in_the_papers_pipe_is_reynolds_2130():
    reynolds = 4 * 48 / 3600 / (np.pi * 0.01 * WATER.viscosity(30.0))
    assert reynolds == pytest.approx(2130, abs=10)


def test_colebrook_satisfies_its_own_equation():
    for re, rough in [(4e3, 1e-3), (1e5, 1e-4), (1e6, 1e-2)]:
        f = friction_colebrook(re, rough)
        assert 1 / f**0.5 == pytest.approx(-2 * np.log10(rough / 3.7 + 2.51 / (re * f**0.5)), rel=1e-4)


def test_blasius_is_near_colebrook_for_a_smooth_pipe():
    assert friction_blasius(2e4) == pytest.approx(friction_colebrook(2e4, 1e-9), rel=0.03)


def test_threshold_is_a_half_at_its_centre():
    assert threshold(2100.0, 2100.0, 0.005) == 0.5
    assert threshold(1000.0, 2100.0, 0.01) < 1e-6


@pytest.mark.parametrize("turbulent", ["blasius", "colebrook"])
def test_reversed_pressure_reverses_the_flow(turbulent):
    model = pipe_hydraulic(turbulent=turbulent)
    p = typical(model)
    forward, back = (steady(model, np.array([0.0]), {"dp": dp, "T": 30.0}, p, 600.0)[0] for dp in (8e3, -8e3))
    assert forward > 0
    assert forward == pytest.approx(-back, rel=1e-6)


def test_laminar_flow_is_hagen_poiseuille():
    model = pipe_hydraulic()
    p = typical(model, psi=1e-3)
    flow = steady(model, np.array([0.0]), {"dp": 100.0, "T": 30.0}, p, 600.0)[0]
    expected = np.pi * 0.01**4 * 100.0 * WATER.density(30.0) / (128 * WATER.viscosity(30.0) * 12.0)
    assert flow == pytest.approx(expected, rel=2e-3)


def test_pipe_cools_exponentially_along_its_length():
    model = pipe_thermal(compartments=40)
    u = {"T_in": 60.0, "m_flow": 0.1, "T_around": 10.0}
    x = steady(model, np.full(40, 30.0), u, typical(model, UA=100.0), 1e5)
    assert x[-1] - 10 == pytest.approx(50 * np.exp(-100 / (4186 * 0.1)), rel=2e-3)


def test_pump_obeys_the_affinity_laws():
    model, p = pump(), typical(pump())
    full, half = (steady(model, np.zeros(2), {"speed": s, "m_flow": m}, p, 500.0) for s, m in ((1.0, 1.2), (0.5, 0.6)))
    assert half[0] == pytest.approx(full[0] / 4, rel=1e-6)
    assert half[1] - p.P_0 == pytest.approx((full[1] - p.P_0) / 8, rel=5e-3)


def test_valve_flow_is_kv_at_one_bar_and_odd_in_pressure():
    assert valve_flow(3.6, 1e5) == pytest.approx(1.0, rel=1e-6)
    assert valve_flow(3.6, -2e4) == -valve_flow(3.6, 2e4)
    assert valve_flow(3.6, 0.0) == 0.0


def test_control_valve_closed_passes_its_leak_only():
    model = control_valve()
    p = typical(model, leak=0.01)
    closed, opened = (steady(model, np.zeros(1), {"opening": o, "dp": 3e4}, p, 500.0)[0] for o in (0.0, 1.0))
    assert closed == pytest.approx(valve_flow(p.kv * 0.01, 3e4), rel=1e-3)
    kv = (1 / p.kv**2 + 1 / p.kv_circuit**2) ** -0.5
    assert opened == pytest.approx(valve_flow(kv, 3e4), rel=1e-6)


def test_relief_valve_opens_at_its_set_pressure():
    model, p = relief_valve(), typical(relief_valve())
    low, high = (steady(model, np.zeros(1), {"dp": dp}, p, 500.0)[0] for dp in (1e4, 3e4))
    assert low < 0.02 * high


def test_dahl_friction_stays_within_its_limit_and_reverses():
    model, p = thermostatic_valve(), typical(thermostatic_valve())
    u = {"T_gas": 22.0, "dp_k": 2e4, "dp_s": 1e5}
    up, down = (steady(model, np.zeros(1), u | {"rate": r}, p, 2000.0)[0] for r in (5e-3, -5e-3))
    assert up == pytest.approx(p.F_max, rel=1e-3)
    assert down == pytest.approx(-p.F_max, rel=1e-3)
    assert drift(model, np.array([0.5]), u | {"rate": 0.0}, p)[0] == 0.0


def test_play_does_not_move_inside_the_play():
    model = thermostatic_valve("play")
    p, u = typical(model), {"T_gas": 30.0, "rate": 0.0, "dp_k": 2e4, "dp_s": 1e5}
    rest = steady(model, np.array([0.0]), u, p, 3000.0)
    assert drift(model, rest, u | {"T_gas": 30.05}, p)[0] == pytest.approx(0.0, abs=1e-12)
    assert abs(drift(model, rest, u | {"T_gas": 33.0}, p)[0]) > 1e-6


@pytest.mark.parametrize(
    "make",
    [
        lambda: pipe_hydraulic(diameter=0.0),
        lambda: pipe_thermal(0),
        lambda: control_valve("odd"),
        lambda: thermostatic_valve("odd"),
    ],
)
def test_wrong_options_are_refused(make):
    with pytest.raises(ModelError):
        make()


def test_thermostatic_valve_passes_what_its_kv_curve_says():
    table = [[0.0, 0.0], [1e-4, 0.2], [5e-4, 0.6]]
    model, opening = thermostatic_valve(output="flow", kv_curve=table), thermostatic_valve()
    p, u = typical(model), {"T_gas": 29.0, "rate": 0.0, "dp_k": 2e4, "dp_s": 1e5}
    lift = opening.observe(SimpleNamespace(F=0.0), SimpleNamespace(**u), typical(opening))["opening"]
    flow = model.observe(SimpleNamespace(F=0.0), SimpleNamespace(**u), p)["m_flow"]
    kv = np.interp(lift, *np.transpose(table))
    assert 1e-5 < lift < 5e-4
    assert flow == pytest.approx(kv * 1000 / 3600 * 0.2**0.5, rel=0.01)


def test_thermostatic_valve_closes_as_it_warms_and_does_not_pass_backwards():
    model = thermostatic_valve(output="flow")
    p = typical(model)
    flows = [
        model.observe(SimpleNamespace(F=0.0), SimpleNamespace(T_gas=t, rate=0.0, dp_k=2e4, dp_s=1e5), p)["m_flow"]
        for t in (26.0, 29.0, 31.0, 45.0)
    ]
    assert all(a > b for a, b in pairwise(flows))
    assert 0 <= flows[-1] < 1e-3 * flows[0]


def test_gas_charge_as_a_table_is_the_line_it_is_taken_from():
    line, table = thermostatic_valve(), thermostatic_valve(gas_charge=[[0.0, -27.4e3], [40.0, 112.6e3]])
    u = SimpleNamespace(T_gas=23.0, rate=0.0, dp_k=2e4, dp_s=1e5)
    values = [m.observe(SimpleNamespace(F=0.0), u, typical(m))["opening"] for m in (line, table)]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_wall_ends_as_warm_as_the_loss_says_and_delays_more():
    plain, wall = pipe_thermal(6), pipe_thermal(6, wall=True)
    u = {"T_in": 60.0, "m_flow": 0.3, "T_around": 10.0}
    p, q = typical(plain, C=4.8e5, UA=50.0), typical(wall, C=4e5, C_wall=8e4, B=1e7, UA=50.0)
    a = steady(plain, np.full(6, 30.0), u, p, 2e4)[-1]
    b = steady(wall, np.full(12, 30.0), u, q, 2e4)[5]
    assert a == pytest.approx(b, abs=1e-3)  # a wall in perfect contact is part of the water


def test_pipe_without_flow_cools_towards_its_surroundings():
    model = pipe_thermal(4)
    u = {"T_in": 60.0, "m_flow": 0.0, "T_around": 10.0}
    p = typical(model, C=1e5, UA=20.0)
    x = steady(model, np.full(4, 50.0), u, p, 5000.0)
    assert x == pytest.approx(np.full(4, 10 + 40 * np.exp(-1.0)), abs=1e-4)
