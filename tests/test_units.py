"""Units against the published factors of NIST SP 811 (2008), Appendix B, and against hand-checked temperatures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.units import (
    SPELLINGS,
    UnitError,
    conversion,
    convert,
    density,
    dimension_name,
    seconds,
    si_unit,
    to_si,
    water_density,
)

# Unit, SI unit, factor as printed in NIST SP 811 Appendix B.8; accurate to the printed digits.
NIST_SP_811 = [
    ("gpm", "m3/s", 6.309020e-05),
    ("cfm", "m3/s", 4.719474e-04),
    ("BTU", "J", 1.055056e03),
    ("Btu/h", "W", 2.930711e-01),
    ("kBtu/h", "W", 2.930711e02),
    ("MBH", "W", 2.930711e02),
    ("tons", "W", 3.516853e03),
    ("psi", "Pa", 6.894757e03),
    ("inH2O", "Pa", 2.490889e02),
    ("ftH2O", "Pa", 2.989067e03),
    ("mmH2O", "Pa", 9.806650e00),
    ("inHg", "Pa", 3.386389e03),
    ("bar", "Pa", 1.0e05),
    ("hp", "W", 7.456999e02),
    ("lb/h", "kg/s", 1.259979e-04),
    ("fpm", "m/s", 5.080000e-03),
    ("ft2", "m2", 9.290304e-02),
    ("Btu/lb", "J/kg", 2.326000e03),
    ("gal", "m3", 3.785412e-03),
    ("therm", "J", 1.055056e08),
    ("kWh", "J", 3.6e06),
    ("l/s", "m3/s", 1e-3),
    ("m3/h", "m3/s", 2.777778e-04),
    ("t/h", "kg/s", 2.777778e-01),
    ("rpm", "1/s", 1.666667e-02),
    ("Btu/(h*ft2*F)", "W/(m2*K)", 5.678263),
    ("Btu/(lb*F)", "J/(kg*K)", 4.186800e03),
]


@pytest.mark.parametrize(("unit", "si", "factor"), NIST_SP_811)
def test_factor_agrees_with_nist(unit: str, si: str, factor: float) -> None:
    found = conversion(unit)
    assert found.si == si
    assert found.offset == 0
    assert found.scale == pytest.approx(factor, rel=2e-7)


@pytest.mark.parametrize(
    ("spellings", "si"),
    [
        (("°C", "degC", "C", "deg C", "celsius", "℃", "°F", "degF", "F", "deg F"), "degC"),
        (("K", "delta_degC", "Δ°C", "Δ°F", "delta_degF"), "K"),
        (("gpm", "GPM", "USgpm", "l/s", "L/s", "lps", "m3/h", "m³/h", "m^3/h", "CFM", "cfm", "l/min"), "m3/s"),
        (("kg/s", "kg/h", "t/h", "lb/h", "klb/h"), "kg/s"),
        (("kW", "KW", "W", "MW", "kBtu/h", "kBTU/hr", "MBH", "tons", "Tons", "TR", "BTUH", "hp"), "W"),
        (("psi", "PSIG", "inH2O", "in. w.c.", "inWC", "bar", "mbar", "kPa", "Pa", "mmH2O", "hPa"), "Pa"),
        (("%", "percent", "pct", "1", "", "-", "on/off", "ppm", "kW/ton"), "1"),
        (("W/m2", "W/m²", "W/m^2", "kW/m2", "W/m**2"), "W/m2"),
        (("J/(kg*K)", "kJ/(kg·K)", "Btu/lb/F"), "J/(kg*K)"),
        (("W/K", "W/°C", "kW/K", "Btu/h/F"), "W/K"),
    ],
)
def test_plant_spellings_are_understood(spellings: tuple[str, ...], si: str) -> None:
    assert {s: si_unit(s) for s in spellings} == dict.fromkeys(spellings, si)


def test_every_spelling_in_the_table_converts() -> None:
    for spelling in SPELLINGS:
        assert np.isfinite(conversion(spelling).scale), spelling


def test_capitals_keep_mega_and_milli_apart() -> None:
    assert conversion("MW").scale == 1e6
    assert conversion("mW").scale == pytest.approx(1e-3)


@pytest.mark.parametrize(("fahrenheit", "celsius"), [(32, 0), (212, 100), (-40, -40), (98.6, 37)])
def test_fahrenheit_temperature_has_an_offset(fahrenheit: float, celsius: float) -> None:
    assert to_si(fahrenheit, "degF") == pytest.approx(celsius, abs=1e-12)


def test_fahrenheit_difference_has_none() -> None:
    assert to_si(18.0, "degF", quantity="difference") == pytest.approx(10.0)
    assert si_unit("degF", quantity="difference") == "K"


def test_kelvin_is_a_difference_unless_said_to_be_a_temperature() -> None:
    assert si_unit("K") == "K"
    assert to_si(297.85, "K", quantity="temperature") == pytest.approx(24.7)


@pytest.mark.parametrize(
    ("unit", "expected", "says"),
    [
        ("K", "degC", "quantity: temperature"),
        ("degF", "K", "quantity: difference"),
        ("gpm", "kg/s", "fluid: water"),
        ("kW", "degC", "a power; expected a temperature"),
        ("furlongg", "m", "not known"),
        ("gpmm", "kg/s", "Did you mean 'gpm'"),
    ],
)
def test_unit_that_does_not_fit_says_what_where_and_how_to_mend_it(unit: str, expected: str, says: str) -> None:
    with pytest.raises(UnitError, match=says) as caught:
        conversion(unit, expected, where="point P-7")
    assert "point P-7" in str(caught.value)
    assert caught.value.value == unit


def test_volume_flow_becomes_mass_flow_with_a_declared_fluid() -> None:
    # 1 gpm of 70 degC water: 6.30902e-5 m3/s * 977.76 kg/m3 (CRC Handbook)
    assert to_si(1.0, "gpm", "kg/s", fluid="water at 158 degF") == pytest.approx(6.30902e-5 * 977.76, rel=2e-5)
    assert to_si(2.0, "l/s", fluid=1035.0) == pytest.approx(2.07)
    assert to_si(2.0, "l/s", fluid="1.035 kg/l") == pytest.approx(2.07)
    assert si_unit("l/s") == "m3/s"


# CRC Handbook of Chemistry and Physics, density of air-free water at 101.325 kPa [kg/m3], good to the last digit.
@pytest.mark.parametrize(
    ("t", "rho"), [(4, 999.97), (10, 999.70), (20, 998.21), (40, 992.22), (60, 983.20), (80, 971.80)]
)
def test_water_density_agrees_with_the_handbook(t: float, rho: float) -> None:
    assert water_density(t) == pytest.approx(rho, abs=0.011)


def test_unknown_fluid_names_the_known_ones() -> None:
    with pytest.raises(UnitError, match="propylene glycol"):
        density("brine")
    with pytest.raises(UnitError, match="outside 0 to 150"):
        density("water at 300 degC")


def test_nan_stays_nan_and_shape_stays() -> None:
    got = to_si([[50.0, np.nan]], "degF")
    assert got.shape == (1, 2)
    assert got[0, 0] == pytest.approx(10)
    assert np.isnan(got[0, 1])


def test_standard_deviation_takes_the_scale_alone() -> None:
    assert conversion("degF").spread(1.8) == pytest.approx(1.0)


@settings(deadline=None, max_examples=200)
@given(st.sampled_from(sorted(SPELLINGS)), st.floats(-1e6, 1e6))
def test_there_and_back_is_the_same(unit: str, value: float) -> None:
    both = conversion(unit)
    assert float(both.back(both(value))) == pytest.approx(value, rel=1e-9, abs=1e-6)


def test_convert_between_units_of_one_quantity() -> None:
    assert float(convert(1.0, "tons", "kBtu/h")) == pytest.approx(12.0)
    assert float(convert(100.0, "degC", "degF")) == pytest.approx(212.0)
    with pytest.raises(UnitError):
        convert(1.0, "tons", "psi")


def test_duration_needs_its_unit() -> None:
    assert seconds("5 min") == 300
    assert seconds("1.5h") == 5400
    assert seconds("7 days") == 604800
    for wrong in ("5", 5, "5 kW", "min"):
        with pytest.raises(UnitError):
            seconds(wrong)


def test_dimension_has_a_name() -> None:
    assert dimension_name("kBtu/h") == "power"
    assert dimension_name("degF") == "temperature"
