import numpy as np
import pytest

from fdd.models.building import building
from fdd.models.declare import ModelError
from tests.models.numeric import jacobian, simulate, steady, typical

# Andersen (2001), Paper F, Tab. 1, in kJ/(K h) and kJ/K.
TABLE_1 = {
    "B_out_south": 12.65, "B_boundary": 32.39, "B_south_north": 38.95, "B_floor_south": 542.18,
    "B_out_north": 28.35, "B_floor_north": 624.34,
    "C_air_south": 421.28, "C_floor_south": 1531.85, "C_air_north": 810.19, "C_floor_north": 3314.74,
    "A_south": 1.67, "A_north": 0.9,
}  # fmt: skip


def si(symbol, value):
    return value / 3.6 if symbol[0] == "B" else value * 1e3 if symbol[0] == "C" else value


def house(**options):
    model = building(outside="each", boundary=True, **options)
    return model, typical(model, **{s: si(s, v) for s, v in TABLE_1.items()})


def weather(model, **changed):
    u = {q.symbol: 0.0 for q in model.inputs}
    return u | {"T_boundary": 18.0} | changed


def test_time_constants_follow_from_the_papers_table_1():
    model, p = house()
    a = jacobian(model, np.full(4, 15.0), weather(model), p)
    minutes = np.sort(-1 / np.linalg.eigvals(a).real) / 60
    assert minutes[:2] == pytest.approx([33, 57], abs=0.5)
    assert minutes[2:] / 60 == pytest.approx([22.6, 62.9], abs=0.05)


def test_energy_balance_closes():
    model, p = house()
    u = weather(model, I_south=300.0, I_north=50.0, P_heat_south=400.0, P_heat_north=600.0, P_gain_north=150.0)
    x0 = np.array([19.0, 17.0, 21.0, 20.0])
    capacity = np.array([p.C_air_south, p.C_floor_south, p.C_air_north, p.C_floor_north])

    def powers(x):
        gains = 400 + 600 + 150 + p.A_south * 300 + p.A_north * 50
        out = p.B_out_south * x[0] + p.B_out_north * x[2] + p.B_boundary * (x[0] + x[2] - 36)
        return np.array([gains - out, gains])

    x, (net, throughput) = simulate(model, x0, u, p, 86400.0, powers)
    assert abs(capacity @ (x - x0) - net) < 1e-9 * throughput


def test_dynamic_radiator_gives_the_water_s_power_to_the_room_in_the_end():
    model, p = house(heating="dynamic")
    u = weather(model, T_supply=55.0, T_return_south=40.0, T_return_north=40.0, m_flow_south=0.01, m_flow_north=0.02)
    x = steady(model, np.array([20.0, 20, 20, 20, 40, 40]), u, p, 3e6)
    for i, (r, m) in enumerate([("south", 0.01), ("north", 0.02)]):
        d = x[4 + i] - x[2 * i]
        assert getattr(p, f"H_rad_{r}") * d * (d * d + 1e-4) ** 0.15 == pytest.approx(4186 * m * 15, rel=1e-6)


def test_water_power_heats_like_the_same_power_given():
    given, p = house()
    water, q = house(heating="water")
    power = 4186 * 0.01 * 15
    a = steady(given, np.full(4, 20.0), weather(given, P_heat_south=power), p, 3e6)
    u = weather(water, T_supply=55.0, T_return_south=40.0, T_return_north=40.0, m_flow_south=0.01)
    assert steady(water, np.full(4, 20.0), u, q, 3e6) == pytest.approx(a, abs=1e-6)


def test_mean_temperature_power_vanishes_when_the_radiator_is_as_warm_as_the_room():
    model = building(rooms=["only"], heating="mean")
    u = {q.symbol: 0.0 for q in model.inputs} | {"T_out": 20.0, "T_supply": 20.0, "T_return_only": 20.0}
    x = steady(model, np.array([20.0, 20.0]), u, typical(model), 1e5)
    assert x == pytest.approx([20.0, 20.0])


def test_rooms_without_a_common_wall_do_not_exchange_heat():
    model = building(rooms=("a", "b", "c"), walls=[("a", "b")])
    u = {q.symbol: 20.0 if q.symbol == "T_out" else 0.0 for q in model.inputs}
    jac = jacobian(model, np.full(6, 20.0), u, typical(model))
    index = [s.symbol for s in model.states].index
    assert jac[index("T_air_a"), index("T_air_b")] > 0
    assert jac[index("T_air_a"), index("T_air_c")] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rooms": []}, "at least one"),
        ({"rooms": ["a", "a"]}, "each once"),
        ({"rooms": ["a b"]}, "letters"),
        ({"walls": [("south", "attic")]}, "attic"),
        ({"heating": "magic"}, "dynamic"),
        ({"outside": "none"}, "common"),
        ({"solar_split": 2.0}, r"\[0, 1\]"),
    ],
)
def test_wrong_options_are_refused_with_the_remedy(options, words):
    with pytest.raises(ModelError, match=words):
        building(**options)
