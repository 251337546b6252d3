"""Steady states of real machines from manufacturers' performance curves (DOE-2 electric EIR models).

For commissioning without history, and for testing the method on machines that do not follow it exactly.

References: M. Hydeman et al., ASHRAE Transactions 108 (2002); the curve sets of the Modelica Buildings library
(``Buildings.Fluid.Chillers.Data``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.chiller_eiv.model import WATER_HEAT_CAPACITY, ZERO_CELSIUS, ChillerError
from fdd.records import FloatArray


@dataclass(frozen=True)
class EirCurves:
    """One machine.

    Attributes
    ----------
    capacity, cop : nominal [W], [1]
    evaporator_flow, condenser_flow : nominal [kg/s]
    capacity_temperature, eir_temperature : six coefficients of the biquadratic in (T_cho, T_condenser) [degC]
    eir_load : three coefficients of the quadratic in part-load ratio, or ten of the bicubic in (T_condenser, PLR)
    leaving : whether the curves take the leaving condenser water (reformulated EIR) and not the entering
    """

    capacity: float
    cop: float
    evaporator_flow: float
    condenser_flow: float
    capacity_temperature: tuple[float, ...]
    eir_temperature: tuple[float, ...]
    eir_load: tuple[float, ...]
    leaving: bool

    def __post_init__(self) -> None:
        """Refuse sets with a wrong number of coefficients."""
        for name, want in (
            ("capacity_temperature", 6),
            ("eir_temperature", 6),
            ("eir_load", 10 if self.leaving else 3),
        ):
            if len(getattr(self, name)) != want:
                raise ChillerError(f"{name} must have {want} coefficients; got {len(getattr(self, name))}")

    def operate(self, share: FloatArray, T_cho: FloatArray, T_cdi: FloatArray) -> FloatArray:
        """Steady states (n, 4): (T_cdi [K], T_chi [K], Q [W], E [W]) at constant water flows.

        Parameters
        ----------
        share : part-load ratio [1]
        T_cho : leaving chilled water [degC]
        T_cdi : entering condenser water [degC]
        """
        T_cond = T_cdi.copy()
        Q = E = np.zeros_like(share)
        for _ in range(40 if self.leaving else 1):
            available = self.capacity * _biquadratic(self.capacity_temperature, T_cho, T_cond)
            Q = share * available
            eir = _biquadratic(self.eir_temperature, T_cho, T_cond) * self._load(share, T_cond)
            E = available / self.cop * eir
            if self.leaving:
                T_cond = T_cdi + (Q + E) / (self.condenser_flow * WATER_HEAT_CAPACITY)
        T_chi = T_cho + Q / (self.evaporator_flow * WATER_HEAT_CAPACITY)
        return np.stack([T_cdi + ZERO_CELSIUS, T_chi + ZERO_CELSIUS, Q, E], axis=1)

    def _load(self, share: FloatArray, T: FloatArray) -> FloatArray:
        c = self.eir_load
        if not self.leaving:
            return np.asarray(c[0] + c[1] * share + c[2] * share**2)
        linear = c[0] + c[1] * T + c[2] * T**2 + c[3] * share + c[4] * share**2 + c[5] * T * share
        return np.asarray(linear + c[6] * T**3 + c[7] * share**3 + c[8] * T**2 * share + c[9] * T * share**2)


def _biquadratic(c: tuple[float, ...], a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(c[0] + c[1] * a + c[2] * a**2 + c[3] * b + c[4] * b**2 + c[5] * a * b)
