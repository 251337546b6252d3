"""The Gordon-Ng chiller model: power from load and temperatures, load from power, and its equation.

A chiller is described by three numbers: the internal entropy production dS [W/K], the heat leak Q_leak [W] and the
total heat-exchanger resistance R [K/W]. With the load Q [W], the electrical power E [W], the condenser water entering
at T_cdi [K] and the chilled water entering the evaporator at T_chi [K]::

    (Q + E) T_chi - Q T_cdi = dS T_chi T_cdi + Q_leak (T_cdi - T_chi) + R Q (Q + E)

References: J.M. Gordon and K.C. Ng, *Cool Thermodynamics*, 2000; K.C. Ng et al., "Diagnostics and optimization of
reciprocating chillers", Applied Thermal Engineering 17 (1997); Andersen and Reddy (2000), Eq. 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.records import FloatArray

ZERO_CELSIUS = 273.15
"""0 degC [K]."""

WATER_HEAT_CAPACITY = 4190.0
"""Specific heat capacity of water near 10 degC [J/(kg K)]."""


class ChillerError(ValueError):
    """Data or a request the chiller method cannot work with; the text says where, the value, and the remedy."""


@dataclass(frozen=True, slots=True)
class GordonNg:
    """A chiller's parameters in SI units.

    Attributes
    ----------
    dS : internal entropy production [W/K]
    Q_leak : heat leak from or into the chiller [W]
    R : heat-exchanger resistance at nominal condenser flow [K/W]
    R_flow : share of the resistance that goes with the reciprocal of relative condenser flow, r1 in
        R(V) = R + R_flow / V [K/W]; zero for constant flow
    dS_speed : growth of dS from standstill to full compressor speed (or full load where speed is not measured) [W/K]
    """

    dS: float
    Q_leak: float
    R: float
    R_flow: float = 0.0
    dS_speed: float = 0.0

    def power(
        self,
        load: FloatArray,
        T_cdi: FloatArray,
        T_chi: FloatArray,
        flow: FloatArray | float = 1.0,
        speed: FloatArray | float = 0.0,
    ) -> FloatArray:
        """Electrical power the machine takes, see :func:`power`; ``flow`` and ``speed`` are relative to nominal [1]."""
        return power(load, T_cdi, T_chi, self.dS + self.dS_speed * speed, self.Q_leak, self.R + self.R_flow / flow)


def power(
    load: FloatArray,
    T_cdi: FloatArray,
    T_chi: FloatArray,
    dS: FloatArray | float,
    Q_leak: FloatArray | float,
    R: FloatArray | float,
) -> FloatArray:
    """Electrical power of a chiller [W], the Gordon-Ng model solved for E.

    Parameters
    ----------
    load : evaporator load Q [W], positive
    T_cdi, T_chi : condenser and chilled water entering [K]
    dS, Q_leak, R : [W/K], [W], [K/W]

    Raises
    ------
    ChillerError : where R Q reaches T_chi, which no machine can

    Examples
    --------
    >>> round(float(power(10e3, 303.15, 285.15, 5.518, 2723.0, 2.689e-3)), 1)
    3774.9
    """
    margin = T_chi - R * load
    if np.any(margin <= 0):
        raise ChillerError(
            f"R x load reaches the chilled water temperature (smallest margin {float(np.min(margin)):.4g} K); "
            "give load in W, R in K/W and temperatures in K"
        )
    return np.asarray((T_cdi * load + dS * T_chi * T_cdi + Q_leak * (T_cdi - T_chi)) / margin - load)


def load_from_power(
    electric: FloatArray,
    T_cdi: FloatArray,
    T_chi: FloatArray,
    dS: FloatArray | float,
    Q_leak: FloatArray | float,
    R: FloatArray | float,
) -> FloatArray:
    """Evaporator load [W] at which the machine takes the power ``electric`` [W]; NaN below its no-load power.

    The positive root of R Q^2 + (R E + T_cdi - T_chi) Q = E T_chi - dS T_chi T_cdi - Q_leak (T_cdi - T_chi).
    """
    b = R * electric + T_cdi - T_chi
    c = dS * T_chi * T_cdi + Q_leak * (T_cdi - T_chi) - electric * T_chi
    discriminant = np.asarray(b * b - 4 * R * c, dtype=float)
    root = 2 * -c / (b + np.sqrt(np.where(discriminant < 0, np.nan, discriminant)))
    return np.where(root > 0, root, np.nan)


def power_sensitivity(
    load: FloatArray,
    T_cdi: FloatArray,
    T_chi: FloatArray,
    parameters: GordonNg,
) -> FloatArray:
    """Derivatives of :func:`power` with respect to (T_cdi, T_chi, Q, dS, Q_leak, R), shape (n, 6).

    Units: W/K, W/K, 1, K, 1, W^2/K. Used to carry sensor and parameter errors into the power residual.
    """
    dS, leak, R = parameters.dS, parameters.Q_leak, parameters.R
    electric = power(load, T_cdi, T_chi, dS, leak, R)
    margin = T_chi - R * load
    total = load + electric
    return np.stack(
        [
            (load + dS * T_chi + leak) / margin,
            (dS * T_cdi - leak - total) / margin,
            (T_cdi + R * total) / margin - 1,
            T_cdi * T_chi / margin,
            (T_cdi - T_chi) / margin,
            load * total / margin,
        ],
        axis=-1,
    )
