"""Friction, flow through a valve, and smooth regime changes, as functions that any model's equations may use."""

from __future__ import annotations

from typing import Any

from fdd.models.functions import absolute, exp, log, sqrt, tanh

LN_10 = 2.302585092994046
SMALL_REYNOLDS = 1e-3


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


def valve_flow(kv: Any, pressure: Any, small: float = 100.0, density: float = 1000.0) -> Any:
    """Mass flow [kg/s] through ``kv`` [m3/h at 1 bar] at a pressure difference [Pa] of either sign, IEC 60534-2-1.

    m = kv/3600 sqrt(1000 rho) sqrt(dp / 1e5 Pa), smooth through zero within ``small`` pascal; ``density`` [kg/m3].
    """
    return kv / 3.6 * (density / 1000.0) ** 0.5 * pressure / (1e5**0.5 * sqrt(sqrt(pressure * pressure + small**2)))
