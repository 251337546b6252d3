import numpy as np
import pytest

from fdd.models.declare import ModelError
from fdd.models.radiator import radiator
from tests.models.numeric import drift, jacobian, simulate, steady, typical

U = {"T_supply": 60.0, "T_room": 20.0, "m_flow": 0.02}
CP = 4186.0


def shares(x):
    a = 0.02 + 0.96 / (1 + np.exp(-x[3]))
    return a, 1 - a


def stored(x, p):
    a, b = shares(x)
    return p.C * (a * x[0] + b * x[1]) + p.C_air * x[2]


@pytest.mark.parametrize("flow_change", [3.0, 0.2], ids=["boundary falls", "boundary rises"])
def test_energy_stored_equals_energy_in_minus_out_while_the_boundary_moves(flow_change):
    model, p = radiator(), typical(radiator())
    x0 = np.array([55.0, 40.0, 25.0, -0.5])
    u = U | {"m_flow": 0.02 * flow_change}

    def powers(x):
        return np.array(
            [CP * u["m_flow"] * (u["T_supply"] - x[1]) - p.B_air * (x[2] - u["T_room"]), CP * u["m_flow"] * 40]
        )

    x, (net, throughput) = simulate(model, x0, u, p, 3600.0, powers)
    assert abs(stored(x, p) - stored(x0, p) - net) < 1e-9 * throughput


@pytest.mark.parametrize("n", [2, 5])
def test_fixed_sections_conserve_energy(n):
    model = radiator(sections=n, surroundings=False)
    p = typical(model)
    x0 = np.linspace(55.0, 35.0, n)

    def powers(x):
        emitted = sum(p.H / n * (t - 20) * ((t - 20) ** 2 + 1e-4) ** 0.15 for t in x)
        return np.array([CP * 0.02 * (60 - x[-1]) - emitted, CP * 0.02 * 40])

    x, (net, throughput) = simulate(model, x0, U, p, 3600.0, powers)
    assert abs(p.C / n * (x.sum() - x0.sum()) - net) < 1e-9 * throughput


def test_printed_form_takes_the_outflow_twice():
    model = radiator(form="printed")
    p = typical(model)
    x = np.array([55.0, 40.0, 25.0, 0.5])
    warm = np.array([55.0, 40.0, 25.0])
    rates = drift(model, x, U, p)
    emitted = sum(0.5 * p.H * (t - 25) * ((t - 25) ** 2 + 1e-4) ** 0.15 for t in warm[:2])
    taken_up = p.C * 0.5 * (rates[0] + rates[1]) + emitted
    assert taken_up == pytest.approx(CP * 0.02 * (60 - 55))  # though the water gives off cp m (60 - 40)


def test_area_stays_inside_zero_and_one_after_days_without_flow_and_at_full_flow():
    model, p = radiator(), typical(radiator())
    for flow in (0.0, 0.5):
        x = steady(model, np.array([55.0, 40.0, 25.0, 0.0]), U | {"m_flow": flow}, p, 3 * 86400.0)
        assert 0 < shares(x)[0] < 1
        assert np.isfinite(x).all()


def test_boundary_settles_where_growth_balances_drift():
    model, p = radiator(), typical(radiator())
    x = steady(model, np.array([55.0, 40.0, 25.0, 0.0]), U, p, 86400.0)
    assert np.exp(x[3]) == pytest.approx(p.a * 0.02 / p.b, rel=1e-3)


def test_without_flow_everything_ends_at_room_temperature():
    model, p = radiator(), typical(radiator())
    x = steady(model, np.array([55.0, 40.0, 25.0, 0.0]), U | {"m_flow": 0.0}, p, 40 * 86400.0)
    assert x[:3] == pytest.approx([20.0] * 3, abs=0.05)


def test_a_radiator_colder_than_the_air_takes_up_heat():
    model = radiator(sections=2, surroundings=False)
    rates = drift(model, np.array([15.0, 15.0]), U | {"m_flow": 0.0}, typical(model))
    assert (rates > 0).all()
    assert np.isfinite(rates).all()


def test_one_section_agrees_with_en_442_at_its_rating_point():
    # EN 442: 75/65/20 degC, so 50 K above the room; H chosen for 1000 W there, all of it taken from the water.
    model = radiator(sections=20, surroundings=False)
    p = typical(model, H=1000 / 50**1.3)
    u = {"T_supply": 75.0, "T_room": 20.0, "m_flow": 1000 / (CP * 10)}
    x = steady(model, np.full(20, 70.0), u, p, 86400.0)
    assert x[-1] == pytest.approx(65.0, abs=0.15)  # the rating uses the arithmetic mean temperature


def test_jacobian_is_finite_where_water_and_air_are_equally_warm():
    model, p = radiator(), typical(radiator())
    assert np.isfinite(jacobian(model, np.array([20.0, 20.0, 20.0, 0.0]), U, p)).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"form": "wrong"}, "printed"),
        ({"sections": "wrong"}, "moving"),
        ({"sections": 0}, "1 to 20"),
        ({"form": "printed", "sections": 2}, "drop"),
        ({"exponent": 3.0}, "EN 442"),
    ],
)
def test_wrong_options_are_refused_with_the_remedy(options, words):
    with pytest.raises(ModelError, match=words):
        radiator(**options)
