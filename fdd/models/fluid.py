"""Fluids by name, their properties folded into constants and polynomials before any equation is traced.

    water                            built in: polynomials made once from CoolProp's IAPWS-95
    propylene glycol 30 %            by mass (Melinder 2010), through CoolProp when the model is made
    ethylene glycol 35 % by volume   by volume (ASHRAE Handbook Fundamentals 2001)
    propylene glycol 30 % at 5 degC  the heat capacity taken at 5 degC; 40 degC where nothing is said

A kernel cannot call a property library and should not: density and the logarithm of viscosity are polynomials in
temperature, of the lowest degree within 0.1 kg/m3 and 0.2 % of the library; the heat capacity is a constant, so that
energy balances close.
CoolProp comes with the extra ``fluids``; a site of water alone does not need it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from fdd.models.declare import ModelError
from fdd.models.functions import exp

# (kind, by volume) to CoolProp's name and the largest share it knows.
_MIXTURES = {
    ("propylene glycol", False): ("MPG", 0.6),
    ("ethylene glycol", False): ("MEG", 0.6),
    ("propylene glycol", True): ("APG", 0.6),
    ("ethylene glycol", True): ("AEG", 0.6),
}
_NAME = re.compile(
    r"(?P<kind>water|propylene glycol|ethylene glycol)"
    r"(?: (?P<share>\d+(?:\.\d+)?) ?%(?P<volume> by volume)?)?"
    r"(?: at (?P<at>-?\d+(?:\.\d+)?) ?degC)?"
)
PRESSURE = 3e5  # Pa, at which properties are taken; liquids hardly feel it
USUAL = 40.0  # degC, where the heat capacity is taken if the name does not say
WARMEST = 99.0  # degC, upper end of the polynomials
COLDEST = -34.0  # degC, where the library's tables of mixtures by volume begin
REMEDY = "write 'water', 'propylene glycol 30 %', 'ethylene glycol 35 % by volume', each with ' at 5 degC' where wanted"


@dataclass(frozen=True, slots=True)
class Fluid:
    """A liquid's properties.

    Attributes
    ----------
    name : as asked for
    at : temperature at which what is a constant is taken [degC]
    heat_capacity : specific [J/(kg K)]
    densities : coefficients of the density [kg/m3] in powers of the temperature [degC], lowest first
    viscosities : the same of the logarithm of the dynamic viscosity [Pa s]
    coldest, warmest : where the polynomials hold [degC]
    """

    name: str
    at: float
    heat_capacity: float
    densities: tuple[float, ...]
    viscosities: tuple[float, ...]
    coldest: float
    warmest: float = WARMEST

    def density(self, t: Any) -> Any:
        """Density [kg/m3] at ``t`` [degC]."""
        return horner(self.densities, t)

    def viscosity(self, t: Any) -> Any:
        """Dynamic viscosity [Pa s] at ``t`` [degC]."""
        return exp(horner(self.viscosities, t))


# Fitted to CoolProp 8.0 (IAPWS-95 and IAPWS 2008) at 3 bar, 0.5 to 110 degC: within 0.005 kg/m3 and 0.1 %.
# The heat capacity is that of 10 to 80 degC within 0.25 %.
WATER = Fluid(
    "water",
    USUAL,
    4186.0,
    (999.9503, 0.06374314, -0.008628299, 7.734444e-05, -6.439752e-07, 3.287305e-09, -7.418228e-12),
    (-6.325842, -0.03441443, 3.203347e-04, -2.860165e-06, 1.681039e-08, -4.315899e-11),
    0.5,
    110.0,
)


def horner(coefficients: tuple[float, ...], t: Any) -> Any:
    """A polynomial's value, on floats, traced expressions or SymPy symbols."""
    value: Any = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = value * t + c
    return value


@cache
def get_fluid(name: str) -> Fluid:
    """The fluid of a name such as ``"propylene glycol 30 %"``.

    Raises
    ------
    ModelError : a name that is not understood, a share or temperature outside what is known, or CoolProp missing

    Examples
    --------
    >>> get_fluid("water").heat_capacity
    4186.0
    """
    found = _NAME.fullmatch(name.strip())
    if found is None:
        raise ModelError(f"fluid {name!r} is unknown; {REMEDY}")
    kind, share, at = found["kind"], found["share"], found["at"]
    if kind == "water":
        if share is not None:
            raise ModelError(f"fluid {name!r}: water has no share; {REMEDY}")
        return WATER if at is None else _from_library(name, "Water", float(at), WATER.coldest)
    if share is None:
        raise ModelError(f"fluid {name!r} lacks its share of glycol; {REMEDY}")
    library, largest = _MIXTURES[(kind, found["volume"] is not None)]
    part = float(share) / 100.0
    if not 0.1 <= part <= largest:
        raise ModelError(f"fluid {name!r}: {share} % is outside 10 to {largest:.0%}; thinner mixtures are nearly water")
    mixture = f"INCOMP::{library}[{part:.4f}]"
    # A margin of 1 K above freezing, where slush would begin.
    freezing = _property("T_FREEZE", 20.0, mixture) - 273.15
    return _from_library(name, mixture, USUAL if at is None else float(at), max(np.ceil(freezing) + 1.0, COLDEST))


def chosen(model: str, fluid: str, heat_capacity: float | None = None) -> tuple[Fluid, float, dict[str, Any]]:
    """Fluid, heat capacity and the options that say so, for a model that takes either.

    Raises
    ------
    ModelError : both a fluid other than water and a heat capacity, or a fluid that is not known
    """
    if fluid == "water":
        value = WATER.heat_capacity if heat_capacity is None else heat_capacity
        return WATER, value, {"heat_capacity": value}
    if heat_capacity is not None:
        raise ModelError(f"{model}: both fluid {fluid!r} and heat_capacity {heat_capacity} J/(kg K); give one of them")
    found = get_fluid(fluid)
    return found, found.heat_capacity, {"fluid": fluid}


def _from_library(name: str, library: str, at: float, coldest: float) -> Fluid:
    if not coldest <= at <= WARMEST:
        raise ModelError(f"fluid {name!r}: {at:g} degC is outside {coldest:g} to {WARMEST:g} degC, where it is liquid")
    t = np.linspace(coldest, WARMEST, 60)
    densities = np.array([_property("D", x, library) for x in t])
    viscosities = np.log([_property("V", x, library) for x in t])
    heat_capacity = round(_property("C", at, library), 1)
    return Fluid(name, at, heat_capacity, _fit(t, densities, 0.1), _fit(t, viscosities, 2e-3), float(coldest))


def _fit(t: Any, values: Any, tolerance: float) -> tuple[float, ...]:
    """Seven digits: what a later release of the library changes behind them shall not change a model."""
    for degree in range(1, 8):
        fitted = Polynomial.fit(t, values, degree)
        if np.abs(fitted(t) - values).max() <= tolerance:
            break
    return tuple(float(f"{c:.7g}") for c in fitted.convert().coef)


def _property(symbol: str, t: float, library: str) -> float:
    try:
        from CoolProp.CoolProp import PropsSI
    except ImportError:
        raise ModelError(
            f"the properties of {library} come from CoolProp, which is not installed; pip install 'hvac-fdd[fluids]'"
        ) from None
    return float(PropsSI(symbol, "T", float(t) + 273.15, "P", PRESSURE, library))
