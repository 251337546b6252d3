"""Properties of water and smooth regime changes, as functions that any model's equations may use.

Polynomials are fits to IAPWS-IF97 at 1 bar between 5 and 95 degC; they cost a few multiplications where a property
library would cost a call that no kernel can make.
"""

from __future__ import annotations

from typing import Any

from fdd.models.functions import absolute, exp, log, sqrt, tanh

LN_10 = 2.302585092994046
SMALL_REYNOLDS = 1e-3


def density(t: Any) -> Any:
    """Density of water [kg/m3] at ``t`` [degC], Kell (1975) to 0.1 kg/m3."""
    return 999.85 + t * (5.332e-2 + t * (-7.564e-3 + t * (4.323e-5 - t * 1.673e-7 + t * t * 2.465e-10)))


def viscosity(t: Any) -> Any:
    """Dynamic viscosity of water [Pa s] at ``t`` [degC], Vogel: 2.414e-5 * 10^(247.8 / (T - 140 K)), to 2.5 %."""
    return 2.414e-5 * exp(LN_10 * 247.8 / (t + 133.15))


def threshold(x: Any, centre: Any, slope: Any) -> Any:
    """Weight from 0 to 1 as ``x`` passes ``centre``: (tanh(slope (x - centre)) + 1)/2, Paper C, Eq. 2."""
    return 0.5 * (tanh(slope * (x - centre)) + 1.0)


def friction_laminar(reynolds: Any) -> Any:
    """Darcy friction factor 64/Re, Paper C, Eq. 4."""
    return 64.0 / (absolute(reynolds) + SMALL_REYNOLDS)


def friction_blasius(reynolds: Any) -> Any:
    """Darcy friction factor of a smooth pipe, 0.316 Re^-1/4, for Re up to 1e5, Paper C, Eq. 6."""
    return 0.316 * exp(-0.25 * log(absolute(reynolds) + 1.0))


def friction_colebrook(reynolds: Any, relative_roughness: Any) -> Any:
    """Darcy friction factor by Colebrook, Paper C, Eq. 5: Haaland's (1983) start, then three fixed-point steps."""
    re = sqrt(reynolds * reynolds + 100.0)  # below Re 10 the iteration would leave its domain
    rough = relative_roughness / 3.7
    inverse = -1.8 / LN_10 * log(exp(1.11 * log(rough + 1e-9)) + 6.9 / re)
    for _ in range(3):
        inverse = -2.0 / LN_10 * log(rough + 2.51 / re * inverse)
    return 1.0 / (inverse * inverse)


def valve_flow(kv: Any, pressure: Any, small: float = 100.0) -> Any:
    """Mass flow [kg/s] through ``kv`` [m3/h at 1 bar] at a pressure difference [Pa] of either sign, IEC 60534-2-1.

    m = kv/3600 * 1000 * sqrt(dp / 1e5 Pa), smooth through zero within ``small`` pascal.
    """
    return kv / 3.6 * pressure / (1e5**0.5 * sqrt(sqrt(pressure * pressure + small * small)))
