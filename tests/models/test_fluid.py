"""Fluids by name, against published tables: none of the numbers below comes from this project or from CoolProp."""

import numpy as np
import pytest

from fdd.models.declare import ModelError
from fdd.models.fluid import WATER, get_fluid
from fdd.models.registry import get_model
from tests.models.numeric import drift, steady, typical

# Steam tables (IAPWS-IF97 at 1 bar): degC, kg/m3, mPa s, J/(kg K).
STEAM = [
    (10, 999.70, 1.306, 4195.5),
    (30, 995.65, 0.797, 4179.8),
    (60, 983.20, 0.466, 4185.0),
    (80, 971.8, 0.354, 4196),
]
# A chiller maker's design data for propylene glycol by volume (Airedale DeltaChill manual, p. 53), after ASHRAE:
# percent, degC, kJ/(kg K), kg/m3.
PROPYLENE = [
    (20, 5, 3.94, 1024.3), (20, 40, 4.02, 1010.2), (30, 0, 3.79, 1036.2), (30, 20, 3.85, 1028.4),
    (30, 40, 3.90, 1018.4), (40, 0, 3.64, 1045.1), (40, 20, 3.70, 1036.2), (40, 45, 3.78, 1022.2),
]  # fmt: skip
# Dynamic viscosity of ethylene glycol by volume, degC, percent, mPa s (The Engineering ToolBox), printed to 5 to 10 %.
ETHYLENE = [(4.4, 25, 3.0), (4.4, 40, 4.8), (26.7, 30, 1.7), (26.7, 40, 2.2), (48.9, 25, 0.9), (48.9, 30, 1.0)]
# Density of inhibited ethylene glycol by mass, percent, degC, kg/m3 (a supplier's table): inhibitors add up to 1 %.
ETHYLENE_MASS = [(20, 20, 1030), (30, 20, 1046), (30, 60, 1027), (40, 40, 1052)]


@pytest.mark.parametrize(("t", "rho", "mu", "cp"), STEAM)
def test_water_is_that_of_the_steam_tables(t, rho, mu, cp):
    assert WATER.density(float(t)) == pytest.approx(rho, abs=0.1)
    assert 1e3 * WATER.viscosity(float(t)) == pytest.approx(mu, rel=2e-3)
    assert WATER.heat_capacity == pytest.approx(cp, rel=3e-3)
    library = get_fluid(f"water at {t} degC")
    assert library.heat_capacity == pytest.approx(cp, rel=1e-3)
    assert library.density(float(t)) == pytest.approx(rho, abs=0.25)


@pytest.mark.parametrize(("percent", "t", "cp", "rho"), PROPYLENE)
def test_propylene_glycol_is_that_of_a_makers_table(percent, t, cp, rho):
    fluid = get_fluid(f"propylene glycol {percent} % by volume at {t} degC")
    assert fluid.heat_capacity / 1e3 == pytest.approx(cp, abs=0.012)  # two decimals are printed
    assert fluid.density(float(t)) == pytest.approx(rho, rel=2e-3)


@pytest.mark.parametrize(("t", "percent", "mu"), ETHYLENE)
def test_viscosity_of_ethylene_glycol_is_that_of_a_published_table(t, percent, mu):
    assert 1e3 * get_fluid(f"ethylene glycol {percent} % by volume").viscosity(t) == pytest.approx(mu, rel=0.12)


@pytest.mark.parametrize(("percent", "t", "rho"), ETHYLENE_MASS)
def test_density_of_ethylene_glycol_by_mass_is_that_of_a_supplier(percent, t, rho):
    assert get_fluid(f"ethylene glycol {percent} %").density(float(t)) == pytest.approx(rho, rel=0.013)


@pytest.mark.parametrize("name", ["propylene glycol 45 %", "ethylene glycol 50 % by volume", "water at 20 degC"])
def test_polynomials_are_as_good_as_they_say(name):
    props = pytest.importorskip("CoolProp.CoolProp")
    fluid = get_fluid(name)
    library = {"p": "INCOMP::MPG[0.45]", "e": "INCOMP::AEG[0.50]", "w": "Water"}[name[0]]
    for t in np.linspace(fluid.coldest, fluid.warmest, 37):
        state = ("T", t + 273.15, "P", 3e5, library)
        assert fluid.density(t) == pytest.approx(props.PropsSI("D", *state), abs=0.15)
        assert fluid.viscosity(t) == pytest.approx(props.PropsSI("V", *state), rel=3e-3)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("glycol", "propylene glycol 30 %"),
        ("propylene glycol", "lacks its share"),
        ("water 30 %", "no share"),
        ("propylene glycol 90 %", "outside 10 to 60%"),
        ("ethylene glycol 30 % at -40 degC", "where it is liquid"),
    ],
)
def test_fluids_that_cannot_be_are_refused_with_the_remedy(name, words):
    with pytest.raises(ModelError, match=words):
        get_fluid(name)


def test_a_fluid_and_a_heat_capacity_are_one_too_many():
    with pytest.raises(ModelError, match="give one of them"):
        get_model("radiator", fluid="propylene glycol 30 %", heat_capacity=3900.0)


@pytest.mark.parametrize(
    ("model", "option"),
    [
        ("radiator", "fluid"), ("building", "fluid"), ("heat_exchanger", "fluid_hot"), ("heat_exchanger", "fluid_cold"),
        ("pipe_hydraulic", "fluid"), ("pipe_thermal", "fluid"), ("pump", "fluid"), ("control_valve", "fluid"),
        ("relief_valve", "fluid"), ("thermostatic_valve", "fluid"),
    ],
)  # fmt: skip
def test_every_wet_component_takes_a_fluid_and_keeps_it_with_its_options(model, option):
    name = "propylene glycol 30 %"
    made = get_model(model, **{option: name})
    assert made.options[option] == name
    assert get_model(model, **made.options).options == made.options
    assert option not in get_model(model).options  # water's kernels and baselines stay what they are


def test_glycol_carries_less_heat_through_an_exchanger_by_its_heat_capacity():
    u = {"m_flow_hot": 0.4, "m_flow_cold": 0.5, "T_hot_in": 75.0, "T_cold_in": 35.0}
    x = np.array([70.0, 60, 50, 38, 45, 50])
    rates = {}
    for fluid in ("water", "propylene glycol 30 %"):
        model = get_model("heat_exchanger", fluid_cold=fluid, transfer="constant")
        still = drift(model, x, u | {"m_flow_cold": 0.0}, typical(model))
        rates[fluid] = still[3:]
    # Without flow a cold compartment warms by what the plates give, over its heat capacity.
    assert rates["propylene glycol 30 %"] / rates["water"] == pytest.approx(np.full(3, 4186.0 / 3910.4), rel=1e-9)


def test_laminar_glycol_flows_slower_by_its_kinematic_viscosity():
    flows = {}
    for fluid in ("water", "propylene glycol 30 %"):
        model = get_model("pipe_hydraulic", fluid=fluid)
        flows[fluid] = steady(model, np.zeros(1), {"dp": 100.0, "T": 30.0}, typical(model, psi=1e-3), 900.0)[0]
    glycol = get_fluid("propylene glycol 30 %")
    ratio = WATER.viscosity(30.0) / WATER.density(30.0) * glycol.density(30.0) / glycol.viscosity(30.0)
    assert flows["propylene glycol 30 %"] / flows["water"] == pytest.approx(ratio, rel=5e-3)
