"""Units as plant people spell them, converted once at the door to the SI units used inside.

Inside: Celsius temperature [degC], temperature *difference* [K], mass flow [kg/s], power [W], pressure [Pa], fractions
as numbers. Gauge pressures (psig, barg) stay gauge. A temperature and a temperature difference are different
quantities: 50 degF is 10 degC, a difference of 50 degF is 27.8 K. A volume flow becomes a mass flow only where a fluid
or its density is declared.

Every conversion is ``value * scale + offset``, so that a column of samples costs one multiplication and one addition.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import pint
from numpy.typing import ArrayLike, NDArray

from fdd.limits import UNIT_CHARACTERS, UNIT_POWER

FloatArray = NDArray[np.float64]
QuantityKind = Literal["temperature", "difference"]

REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=False, cache_folder=None)

# Spelling (any capitals) to pint's name. Where pint and the plant room disagree the plant room wins: C is not coulomb,
# F not farad, a ton is 12 000 Btu/h. Water columns are conventional (NIST SP 811: 1 inH2O = 249.0889 Pa).
_SPELT: Mapping[str, str] = {
    **dict.fromkeys(("°c", "ºc", "℃", "c", "degc", "deg_c", "deg.c", "celsius", "degrees-celsius"), "degC"),
    **dict.fromkeys(("°f", "ºf", "℉", "f", "degf", "deg_f", "deg.f", "fahrenheit", "degrees-fahrenheit"), "degF"),
    **dict.fromkeys(("k", "°k", "degk", "kelvin", "kelvins", "dk", "Δk"), "kelvin"),
    **dict.fromkeys(("Δ°c", "Δc", "delta_degc", "delta_c", "delta_°c", "c_diff"), "delta_degC"),
    **dict.fromkeys(("Δ°f", "Δf", "delta_degf", "delta_f", "delta_°f", "f_diff"), "delta_degF"),
    **dict.fromkeys(("gpm", "usgpm", "us_gpm"), "(gallon/minute)"),
    **dict.fromkeys(("gph",), "(gallon/hour)"),
    **dict.fromkeys(("cfm", "acfm", "scfm"), "(foot**3/minute)"),
    **dict.fromkeys(("cmh", "cbm/h"), "(meter**3/hour)"),
    **dict.fromkeys(("lps",), "(liter/second)"),
    **dict.fromkeys(("lpm",), "(liter/minute)"),
    **dict.fromkeys(("lph",), "(liter/hour)"),
    **dict.fromkeys(("l", "litre", "litres", "liter", "liters", "ltr"), "liter"),
    **dict.fromkeys(("gal", "gals", "gallon", "gallons"), "gallon"),
    **dict.fromkeys(("ton", "tons", "tr", "rt", "tonr", "tonsr", "ton_ref", "tons_ref", "tonref", "tonsref"), "TR"),
    **dict.fromkeys(("t", "tonne", "tonnes"), "metric_ton"),
    **dict.fromkeys(("btu", "btus"), "Btu_it"),
    **dict.fromkeys(("kbtu",), "(1000*Btu_it)"),
    **dict.fromkeys(("mmbtu",), "(1000000*Btu_it)"),
    **dict.fromkeys(("btuh", "btu/hr"), "(Btu_it/hour)"),
    **dict.fromkeys(("mbh", "mbtuh", "kbtuh"), "(1000*Btu_it/hour)"),
    **dict.fromkeys(("mmbtuh",), "(1000000*Btu_it/hour)"),
    **dict.fromkeys(("therm", "therms"), "(100000*Btu_it)"),
    **dict.fromkeys(("hp", "bhp", "horsepower"), "horsepower"),
    **dict.fromkeys(("psi", "psig", "psia", "psid"), "psi"),
    **dict.fromkeys(("inh2o", "inwc", "inwg", "iwc", "in_wc", "in_wg", "in_h2o"), "(inch*H2O_column)"),
    **dict.fromkeys(("fth2o", "ftwc", "ft_wc", "ft_h2o", "fthd"), "(foot*H2O_column)"),
    **dict.fromkeys(("mmh2o", "mmwc"), "(millimeter*H2O_column)"),
    **dict.fromkeys(("mh2o", "mwc", "mws"), "(meter*H2O_column)"),
    **dict.fromkeys(("inhg",), "inHg"),
    **dict.fromkeys(("bar", "barg", "bara"), "bar"),
    **dict.fromkeys(("%", "percent", "pct", "%rh", "rh%", "%open"), "percent"),
    **dict.fromkeys(
        ("", "1", "-", "fraction", "ratio", "bool", "boolean", "on/off", "onoff", "state"), "dimensionless"
    ),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "second"),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "minute"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), "hour"),
    **dict.fromkeys(("d", "day", "days"), "day"),
    **dict.fromkeys(("week", "weeks"), "week"),
    **dict.fromkeys(("lb", "lbs", "lbm"), "pound"),
    **dict.fromkeys(("klb", "klbs"), "(1000*pound)"),
    **dict.fromkeys(("fpm",), "(foot/minute)"),
    **dict.fromkeys(("ft", "feet", "foot"), "foot"),
    **dict.fromkeys(("in", "inch", "inches"), "inch"),
    **dict.fromkeys(("sqft", "sf"), "foot**2"),
    **dict.fromkeys(("kwh",), "kilowatt_hour"),
    **dict.fromkeys(("mwh",), "megawatt_hour"),
    **dict.fromkeys(("wh",), "watt_hour"),
    **dict.fromkeys(("kw", "kwe", "kwt", "kwth", "kwr"), "kilowatt"),
    **dict.fromkeys(("kva", "kvar"), "(1000*volt*ampere)"),
    **dict.fromkeys(("va", "var"), "(volt*ampere)"),
    **dict.fromkeys(("rpm",), "(1/minute)"),
    **dict.fromkeys(("hz",), "(1/second)"),
    **dict.fromkeys(("ppm",), "ppm"),
    **dict.fromkeys(("kpa",), "kilopascal"),
    **dict.fromkeys(("lx", "lux"), "lux"),
}
SPELLINGS: Mapping[str, str] = {spelling.lower(): name for spelling, name in _SPELT.items()}
REGISTRY.define("TR = 12000 * Btu_it / hour")
REGISTRY.define("H2O_column = 9806.65 * pascal / meter")

# What a dimension is called in an error, by the SI unit it is carried in.
NAMES: Mapping[str, str] = {
    "degC": "temperature",
    "K": "temperature difference",
    "kg/s": "mass flow",
    "m3/s": "volume flow",
    "W": "power",
    "J": "energy",
    "Pa": "pressure",
    "W/m2": "irradiance",
    "1": "fraction",
    "m/s": "speed",
    "s": "time",
    "W/K": "heat transfer coefficient times area",
    "J/K": "heat capacity",
    "J/(kg*K)": "specific heat capacity",
    "J/kg": "specific enthalpy",
    "kg/m3": "density",
    "1/s": "frequency",
    "K/W": "thermal resistance",
    "W/(m2*K)": "heat transfer coefficient",
    "kg": "mass",
    "m": "length",
    "m2": "area",
    "m3": "volume",
    "A": "current",
    "V": "voltage",
    "lx": "illuminance",
    "K/s": "rate of temperature",
}

# What fits nanoseconds in 64 bits, as times are counted everywhere [s].
LONGEST_SECONDS = 2.0**63 / 1e9

# Density at 20 degC [kg/m3]. Water: Kell (1975); air at 101 325 Pa: ideal gas; glycols: ASHRAE Fundamentals, ch. 31.
DENSITIES: Mapping[str, float] = {
    "air": 1.2041,
    "ethylene glycol 30 %": 1040.0,
    "propylene glycol 30 %": 1025.0,
}


class UnitError(ValueError):
    """A unit that does not fit: what, where, the value, what was expected, the remedy."""

    def __init__(self, problem: str, *, where: str = "", value: str = "", expected: str = "", remedy: str = "") -> None:
        self.problem, self.where, self.value, self.expected, self.remedy = problem, where, value, expected, remedy
        text = f"{where}: {self.statement}" if where else self.statement
        super().__init__(f"{text}. {remedy}" if remedy else text)

    @property
    def statement(self) -> str:
        """The problem and what was expected instead, without place and remedy."""
        return f"{self.problem}; expected {self.expected}" if self.expected else self.problem


@dataclass(frozen=True, slots=True)
class Conversion:
    """``value * scale + offset`` gives ``si``; ``spread`` (a standard deviation) takes the scale alone."""

    unit: str
    si: str
    scale: float
    offset: float

    def __call__(self, values: ArrayLike) -> FloatArray:
        """Values in SI, same shape; NaN stays NaN."""
        return np.asarray(values, dtype=np.float64) * self.scale + self.offset

    def back(self, values: ArrayLike) -> FloatArray:
        """Values in the declared unit from values in SI."""
        return (np.asarray(values, dtype=np.float64) - self.offset) / self.scale

    def spread(self, value: float) -> float:
        """A standard deviation or width in SI: no offset."""
        return abs(value * self.scale)


_WORD = re.compile(r"[A-Za-z°ºΔ℃℉µμ%Ω_][A-Za-z0-9°º_%]*")
_CLOSE_POWER = re.compile(r"(?<![A-Za-z_])([A-Za-z]+)([23])(?![A-Za-z0-9])")
_SUPERSCRIPT = {"²": "**2", "³": "**3", "⁻¹": "**-1", "·": "*", "⋅": "*", "×": "*", "^": "**"}


def normalise(text: str) -> str:
    """Pint's spelling of a unit; single words through :data:`SPELLINGS` first, then word by word."""
    squeezed = text.strip()
    for joined in (squeezed, squeezed.replace(" ", ""), squeezed.replace(" ", "_").replace(".", "")):
        # A capital decides between W and w only in pint; in a table of whole spellings none differ by capitals but MW.
        known = SPELLINGS.get(joined.lower())
        if known is not None and joined not in {"MW", "mW"}:
            return known
    for sign, plain in _SUPERSCRIPT.items():
        squeezed = squeezed.replace(sign, plain)
    squeezed = re.sub(r"\bper\b", "/", squeezed)
    squeezed = re.sub(r"(?i)\bsq\.?\s*(ft|m)\b", r"\1**2", squeezed)
    squeezed = _CLOSE_POWER.sub(r"\1**\2", squeezed)

    def word(match: re.Match[str]) -> str:
        name = SPELLINGS.get(match.group().lower(), match.group())
        # Inside a compound (W/°C) only a difference makes sense.
        return {"degC": "delta_degC", "degF": "delta_degF"}.get(name, name)

    return _WORD.sub(word, squeezed)


_POWER = re.compile(r"\*\*\s*(?:\(\s*)?([-+]?\d{1,3}(?:\.\d{1,6})?)(?![\d.eExX_])(?:\s*\))?(?!\s*\*\*)")


def _bounded(text: str) -> str:
    """Pint's spelling of a unit that is cheap to work out: short, and with small plain numbers as exponents.

    Raises
    ------
    UnitError : neither.
    """
    if len(text) > UNIT_CHARACTERS:
        raise UnitError(
            f"a unit of {len(text)} characters", value=text[:40], expected=f"at most {UNIT_CHARACTERS} characters"
        )
    spelt = normalise(text)
    powers = _POWER.findall(spelt)
    if len(powers) != spelt.count("**") or any(abs(float(p)) > UNIT_POWER for p in powers):
        raise UnitError(f"unit {text!r} has an exponent that is no number up to {UNIT_POWER}", value=text)
    return spelt


@lru_cache(maxsize=4096)
def _parsed(text: str, quantity: QuantityKind | None) -> tuple[str, float, float]:
    """(SI unit, scale, offset) of a spelled unit."""
    spelt = _bounded(text)
    try:
        value = REGISTRY.parse_expression(spelt)
        measure = value if isinstance(value, pint.Quantity) else REGISTRY.Quantity(float(value), "dimensionless")
        name = str(measure.units)
        base = measure.to_base_units()
        scale, symbol = float(base.magnitude), si_symbol(base.units)
    except Exception as error:  # pint raises its own, tokenizer, arithmetic and attribute errors alike
        raise UnitError(f"unit {text!r} is not known", value=text, remedy=_spelling_advice(text)) from error
    if name in {"degree_Celsius", "degree_Fahrenheit"}:
        if float(measure.magnitude) != 1.0:
            raise UnitError(f"unit {text!r} is a number of degrees, not a unit", value=text, remedy="Write degC.")
        if quantity == "difference":
            return "K", 5.0 / 9.0 if name == "degree_Fahrenheit" else 1.0, 0.0
        return ("degC", 5.0 / 9.0, -160.0 / 9.0) if name == "degree_Fahrenheit" else ("degC", 1.0, 0.0)
    if not 0.0 < abs(scale) < np.inf:
        raise UnitError(f"unit {text!r} is {scale:g} {symbol}, no unit", value=text)
    if quantity == "temperature":
        if symbol != "K" or name.startswith("delta"):
            raise UnitError(f"unit {text!r} is no temperature", value=text, expected="degC, degF or K")
        return "degC", scale, -273.15
    return symbol, scale, 0.0


def _spelling_advice(text: str) -> str:
    from difflib import get_close_matches

    close = get_close_matches(text.lower(), [s for s in SPELLINGS if len(s) > 1], n=2, cutoff=0.6)
    hint = f"Did you mean {' or '.join(repr(c) for c in close)}? " if close else ""
    return hint + "Write units like degF, °C, gpm, l/s, m3/h, kg/s, tons, kBtu/h, kW, psi, inH2O, %, W/m2."


@lru_cache(maxsize=1024)
def si_symbol(unit: pint.Unit) -> str:
    """The project's symbol of an SI base unit combination: ``kg*m**2/s**3`` is ``W``."""
    for symbol in NAMES:
        pretty = "delta_degC" if symbol in {"degC", "K"} else symbol
        if symbol != "degC" and REGISTRY.Unit(normalise(pretty)).dimensionality == unit.dimensionality:
            return symbol
    return f"{unit:~C}" or "1"


def dimension_name(unit: str) -> str:
    """What a unit measures, in words: ``power`` for kW."""
    symbol = conversion(unit).si
    return NAMES.get(symbol, symbol)


_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?"


def water_density(temperature: float) -> float:
    """Density of water at atmospheric pressure [kg/m3] at a temperature [degC], 0 to 150 degC (Kell, 1975, Eq. 16)."""
    t = temperature
    top = 999.83952 + t * (
        16.945176 + t * (-7.9870401e-3 + t * (-46.170461e-6 + t * (105.56302e-9 - 280.54253e-12 * t)))
    )
    return top / (1.0 + 16.879850e-3 * t)


def density(fluid: str | float) -> float:
    """Density [kg/m3] of a named fluid (``water``, ``water at 70 degC``, ``air``, ``1035 kg/m3``) or a number [kg/m3].

    Raises
    ------
    UnitError : a fluid that is not in :data:`DENSITIES`.
    """
    if isinstance(fluid, int | float):
        return float(fluid)
    text = " ".join(fluid.lower().split())
    if len(text) > UNIT_CHARACTERS:
        raise UnitError(f"a fluid of {len(text)} characters", value=text[:40], expected=f"at most {UNIT_CHARACTERS}")
    match = re.fullmatch(rf"water(?: at ({_NUMBER}) ?(\S+))?", text)
    if match:
        at = float(convert(float(match[1]), match[2], "degC")) if match[1] else 20.0
        if not 0.0 <= at <= 150.0:
            raise UnitError(
                f"water at {at:g} degC is outside 0 to 150 degC", value=fluid, remedy="Give the density in kg/m3."
            )
        return water_density(at)
    if text in DENSITIES:
        return DENSITIES[text]
    number = re.fullmatch(rf"({_NUMBER}) ?(\S+)", text)
    if number and 0.0 < float(number[1]) < 1e9:
        return float(to_si(float(number[1]), number[2], "kg/m3"))
    raise UnitError(
        f"fluid {fluid!r} is not known",
        value=fluid,
        expected=", ".join(["water", "water at 70 degC", *DENSITIES]),
        remedy="Or give its density, for example '1035 kg/m3'.",
    )


def conversion(
    unit: str,
    expected: str | None = None,
    *,
    quantity: QuantityKind | None = None,
    fluid: str | float | None = None,
    where: str = "",
) -> Conversion:
    """How values in a plant's unit become SI.

    Parameters
    ----------
    unit : as the plant spells it
    expected : a unit the result must fit, for example the unit of a model's input; None takes any
    quantity : says that K are absolute (``temperature``), or that degC or degF are differences (``difference``)
    fluid : name or density [kg/m3]; turns a volume flow into a mass flow [kg/s]
    where : what to name in an error

    Raises
    ------
    UnitError : unknown unit, or one that does not fit ``expected``.
    """
    try:
        si, scale, offset = _parsed(unit, quantity)
    except UnitError as error:
        raise UnitError(
            error.problem, where=where, value=error.value, expected=error.expected, remedy=error.remedy
        ) from None
    target = None if expected is None else _parsed(expected, None)[0]
    if fluid is not None and si == "m3/s" and target in {None, "kg/s"}:
        si, scale = "kg/s", scale * density(fluid)
    if target is not None and si != target:
        raise UnitError(
            f"unit {unit!r} is a {NAMES.get(si, si)}",
            where=where,
            value=unit,
            expected=f"a {NAMES.get(target, target)} such as {expected}",
            remedy=_misfit_advice(si, target),
        )
    return Conversion(unit, si, scale, offset)


def _misfit_advice(si: str, target: str) -> str:
    return {
        ("K", "degC"): "If these are absolute temperatures in kelvin, say quantity: temperature.",
        ("degC", "K"): "If this is a difference of two temperatures, say quantity: difference.",
        ("m3/s", "kg/s"): "Declare what flows, for example fluid: water or fluid: 1035 kg/m3.",
    }.get((si, target), "Correct the unit, or map another point.")


def to_si(
    values: ArrayLike,
    unit: str,
    expected: str | None = None,
    *,
    quantity: QuantityKind | None = None,
    fluid: str | float | None = None,
    where: str = "",
) -> FloatArray:
    """Values in SI, same shape; see :func:`conversion`."""
    return conversion(unit, expected, quantity=quantity, fluid=fluid, where=where)(values)


def convert(values: ArrayLike, source: str, target: str) -> FloatArray:
    """Values from one unit to another of the same quantity, same shape."""
    onward = conversion(target)
    return onward.back(conversion(source, onward.si)(values))


def si_unit(unit: str, *, quantity: QuantityKind | None = None, fluid: str | float | None = None) -> str:
    """The SI unit in which values of ``unit`` are carried inside."""
    return conversion(unit, quantity=quantity, fluid=fluid).si


_DURATION = re.compile(rf"({_NUMBER})\s*([A-Za-z]+)")


def seconds(text: str | float) -> float:
    """Seconds of a duration such as ``5 min``, ``30 s``, ``1.5 h``, ``7 days``.

    Raises
    ------
    UnitError : a bare number (its unit would be a guess), a unit that is no time, more than can be counted.
    """
    short = isinstance(text, str) and len(text) <= UNIT_CHARACTERS
    match = _DURATION.fullmatch(text.strip()) if isinstance(text, str) and short else None
    if match is None:
        raise UnitError(
            f"{text!r:.100} is no duration",
            value=str(text)[:UNIT_CHARACTERS],
            expected="a number with a unit",
            remedy="Write it like '5 min' or '2 h'.",
        )
    number, unit = float(match[1]), conversion(match[2], "s")
    if not abs(number) < LONGEST_SECONDS / unit.scale:
        raise UnitError(f"{text!r} is longer than can be counted", value=str(text), expected="less than 290 years")
    return float(unit(number))
