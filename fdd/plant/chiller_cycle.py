"""A water-cooled vapour-compression chiller in steady state, with faults: what signatures are made from and tested on.

One stage: flooded evaporator and condenser as effectiveness-NTU exchangers whose conductance has a water side (flow to
the power 0.8, Dittus-Boelter) and a refrigerant side (boiling with heat flux), a liquid-cooled part of the condenser
whose size is the charge, a compressor with an efficiency that falls off on both sides of its best load, and fluids of
CoolProp (Bell et al., Ind. Eng. Chem. Res. 53, 2014). The chilled water leaves at its set point and the load is given,
as a plant holds them.

Faults follow in kind Comstock and Braun, *Development of analysis tools for the evaluation of fault detection and
diagnostics in chillers*, ASHRAE RP-1043 (1999); their sizes are drawn, because no two machines agree on them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

WATER = 4190.0
"""Heat capacity of water [J/(kg K)]."""
KELVIN = 273.15
ROUNDS = 40
"""Of the fixed point between compressor power and condenser; each divides the error by about ten."""


@dataclass(frozen=True, slots=True)
class Machine:
    """One chiller, by what its name plate and its design say.

    Attributes
    ----------
    refrigerant : CoolProp's name
    rated_load : [W]
    range_ch, range_cd : temperature change of chilled and condenser water at the rated state [K]
    approach_ev, approach_cd : least temperature difference of the exchangers at the rated state [K]
    subcooling : at the rated state [K]
    superheat : of the suction gas [K]
    water_share_ev, water_share_cd : of the exchangers' resistance [1]
    efficiency, best_load, falloff : isentropic efficiency at its best load [1], that load [1], loss per square of load
    lift_falloff : relative loss of efficiency per square of the relative change of lift [1]
    drive : share of electric power that reaches the gas [1]; the rest warms the room
    charge_to_condenser : share of a change of charge that floods condenser tubes; the rest wets evaporator tubes [1]
    wetting : loss of evaporator conductance per lost charge on its side [1]
    gas_gather : share of gas in the condenser over its share in the machine, because vapour sweeps it there [1]
    gas_blanket : loss of condenser conductance per volume share of gas in the condenser [1]
    oil_film, oil_drag, oil_heat : of a doubled oil charge: loss of evaporator conductance [1], of efficiency [1], and
        rise of the oil temperature [K]
    oil_share : place of the oil temperature between evaporating and discharge temperature [1]
    """

    refrigerant: str = "R134a"
    rated_load: float = 1e6
    range_ch: float = 5.6
    range_cd: float = 5.6
    approach_ev: float = 2.0
    approach_cd: float = 2.0
    subcooling: float = 4.0
    superheat: float = 1.0
    water_share_ev: float = 0.5
    water_share_cd: float = 0.5
    efficiency: float = 0.75
    best_load: float = 0.8
    falloff: float = 0.4
    lift_falloff: float = 0.3
    drive: float = 0.96
    charge_to_condenser: float = 0.5
    wetting: float = 0.6
    gas_gather: float = 2.0
    gas_blanket: float = 6.0
    oil_film: float = 0.2
    oil_drag: float = 0.06
    oil_heat: float = 6.0
    oil_share: float = 0.6


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with a machine; all zero is healthy.

    Attributes
    ----------
    gas : non-condensable gas, share of the machine's volume
    fouling_cd, fouling_ev : loss of the exchangers' conductance [1]
    flow_cd, flow_ch : relative change of the water flows [1]
    charge, oil : relative change of refrigerant and oil charge [1]
    efficiency : relative loss of the compressor's efficiency [1]
    """

    gas: float = 0.0
    fouling_cd: float = 0.0
    fouling_ev: float = 0.0
    flow_cd: float = 0.0
    flow_ch: float = 0.0
    charge: float = 0.0
    oil: float = 0.0
    efficiency: float = 0.0


@dataclass(frozen=True, slots=True)
class Condition:
    """What the plant imposes.

    Attributes
    ----------
    load : share of the rated load [1]
    T_cdi, T_cho : condenser water entering, chilled water leaving [degC]
    flow_ch, flow_cd : water flows as a share of the rated ones [1]
    """

    load: float = 1.0
    T_cdi: float = 29.4
    T_cho: float = 6.7
    flow_ch: float = 1.0
    flow_cd: float = 1.0


class CycleError(ValueError):
    """A state that no machine runs in."""


@cache
def _fluid(name: str) -> Any:
    from CoolProp.CoolProp import AbstractState

    return AbstractState("HEOS", name)


def _saturation_pressure(fluid: Any, T: float) -> float:
    from CoolProp import QT_INPUTS  # the extra ``fluids``

    fluid.update(QT_INPUTS, 1.0, T)
    return float(fluid.p())


@dataclass(frozen=True, slots=True)
class Exchangers:
    """Conductances at the rated state, from its approaches [W/K], its flows [kg/s] and the rejected heat [W]."""

    UA_ev: float
    UA_cd: float
    flow_ch: float
    flow_cd: float
    rejected: float
    liquid_part: float


@cache
def exchangers(machine: Machine) -> Exchangers:
    """Size a machine's exchangers so that the rated state has the approaches that are declared."""
    flow_ch = machine.rated_load / (WATER * machine.range_ch)
    UA_ev = WATER * flow_ch * np.log((machine.range_ch + machine.approach_ev) / machine.approach_ev)
    rated = Condition()
    T_ev = rated.T_cho - machine.approach_ev
    T_cd = rated.T_cdi + machine.range_cd + machine.approach_cd
    electric = _compress(machine, machine.rated_load, T_ev, T_cd, 0.0, machine.subcooling, 1.0, 1.0)[0]
    rejected = machine.rated_load + machine.drive * electric
    flow_cd = rejected / (WATER * machine.range_cd)
    UA_cd = WATER * flow_cd * np.log((machine.range_cd + machine.approach_cd) / machine.approach_cd)
    share = machine.subcooling / (machine.range_cd + machine.approach_cd)
    return Exchangers(float(UA_ev), float(UA_cd), flow_ch, flow_cd, rejected, float(-np.log(1 - min(share, 0.9))))


def _compress(
    machine: Machine, load: float, T_ev: float, T_cd: float, gas: float, subcooling: float, part: float, health: float
) -> tuple[float, float, float, float]:
    """Electric power [W], discharge temperature, saturation temperature read from the pressure, and liquid temperature
    [degC]."""
    from CoolProp import PQ_INPUTS, PT_INPUTS, HmassP_INPUTS, PSmass_INPUTS

    f = _fluid(machine.refrigerant)
    low = _saturation_pressure(f, T_ev + KELVIN)
    high = _saturation_pressure(f, T_cd + KELVIN) / (1 - gas)
    f.update(PQ_INPUTS, high, 0.0)
    T_read = float(f.T()) - KELVIN
    T_liquid = T_cd - subcooling
    f.update(PT_INPUTS, high * 1.0001, min(T_liquid, T_read - 0.01) + KELVIN)
    h_liquid = float(f.hmass())
    f.update(PT_INPUTS, low * 0.99999, T_ev + max(machine.superheat, 0.02) + KELVIN)
    h, s = float(f.hmass()), float(f.smass())
    f.update(PSmass_INPUTS, high, s)
    ideal = float(f.hmass()) - h
    lift = (T_cd - T_ev) / 32.0 - 1.0
    eta = machine.efficiency * health
    eta *= 1 - machine.falloff * (part - machine.best_load) ** 2 - machine.lift_falloff * lift**2
    work = ideal / max(eta, 0.15)
    f.update(HmassP_INPUTS, h + work, high)
    T_discharge = float(f.T()) - KELVIN
    return load / (h - h_liquid) * work / machine.drive, T_discharge, T_read, T_liquid


def steady_state(machine: Machine, condition: Condition, fault: Fault | None = None) -> dict[str, float]:
    """What ideal sensors of a chiller read.

    Returns
    -------
    By quantity, names and units of ``fdd.chiller_eiv.errors.RAW_UNITS``

    Raises
    ------
    CycleError : the condition is outside what the machine can do
    """
    fault = fault or Fault()
    x = exchangers(machine)
    load = condition.load * machine.rated_load
    m_ch = x.flow_ch * condition.flow_ch * (1 + fault.flow_ch)
    m_cd = x.flow_cd * condition.flow_cd * (1 + fault.flow_cd)
    on_condenser = machine.charge_to_condenser * fault.charge
    on_evaporator = (1 - machine.charge_to_condenser) * fault.charge
    wet = (1 + machine.wetting * min(on_evaporator, 0.0)) * (1 - machine.oil_film * fault.oil)
    share = machine.water_share_ev
    resistance = share * (m_ch / x.flow_ch) ** -0.8 + (1 - share) * condition.load**-0.4
    UA_ev = x.UA_ev / resistance * max(wet, 0.05) * (1 - fault.fouling_ev)
    T_chi = condition.T_cho + load / (WATER * m_ch)
    T_ev = T_chi - load / (WATER * m_ch) / -np.expm1(-UA_ev / (WATER * m_ch))
    # Liquid stands in the condenser as the charge lets it, and takes tubes from condensing.
    liquid = x.liquid_part * max(1 + 3.0 * on_condenser, 0.0)
    tubes = 1 - 0.08 * (liquid / x.liquid_part - 1)
    health = (1 - fault.efficiency) * (1 - machine.oil_drag * fault.oil)
    gas = machine.gas_gather * fault.gas
    electric = 0.2 * load
    T_cd = T_read = T_discharge = T_liquid = np.nan
    for _ in range(ROUNDS):
        rejected = load + machine.drive * electric
        share = machine.water_share_cd
        resistance = share * (m_cd / x.flow_cd) ** -0.8 + (1 - share) * (rejected / x.rejected) ** (1 / 3)
        UA_cd = x.UA_cd / resistance * tubes * (1 - fault.fouling_cd) / (1 + machine.gas_blanket * gas)
        T_cd = condition.T_cdi + rejected / (WATER * m_cd) / -np.expm1(-UA_cd / (WATER * m_cd))
        subcooling = (T_cd - condition.T_cdi) * -np.expm1(-liquid * x.rejected / rejected * 0.8)
        if not (T_cd > T_ev + 3 and T_cd < 80 and T_ev > -20):
            raise CycleError(f"condensing at {T_cd:.1f} and evaporating at {T_ev:.1f} degC: no state of this machine")
        found = _compress(machine, load, T_ev, T_cd, gas, subcooling, condition.load, health)
        done = abs(found[0] - electric) < 1e-9 * electric
        electric, T_discharge, T_read, T_liquid = found
        if done:
            break
    oil = T_ev + machine.oil_share * (T_discharge - T_ev) + machine.oil_heat * fault.oil
    return {
        "T_cdi": condition.T_cdi,
        "T_cdo": condition.T_cdi + (load + machine.drive * electric) / (WATER * m_cd),
        "T_chi": T_chi,
        "T_cho": condition.T_cho,
        "flow_ch": m_ch,
        "flow_cd": m_cd,
        "power": electric,
        "T_sat_cd": T_read,
        "T_sat_ev": float(T_ev),
        "T_liquid": T_liquid,
        "T_discharge": T_discharge,
        "T_oil": float(oil),
    }


REFRIGERANTS = ("R134a", "R1234ze(E)", "R1233zd(E)")


def random_machine(rng: np.random.Generator, *, wide: float = 1.0) -> Machine:
    """A machine drawn at random; ``wide`` stretches every range about its middle, for machines unlike the others."""

    def between(low: float, high: float) -> float:
        half = wide * (high - low) / 2
        return float((low + high) / 2 + half * rng.uniform(-1, 1))

    return replace(
        Machine(),
        refrigerant=str(rng.choice(REFRIGERANTS)),
        range_ch=between(4.5, 6.5),
        range_cd=between(4.5, 6.0),
        approach_ev=between(1.0, 3.0),
        approach_cd=between(1.0, 3.0),
        subcooling=between(2.0, 5.0),
        superheat=between(0.3, 3.0),
        water_share_ev=between(0.35, 0.65),
        water_share_cd=between(0.35, 0.65),
        efficiency=between(0.66, 0.82),
        best_load=between(0.65, 0.95),
        falloff=between(0.1, 0.6),
        lift_falloff=between(0.1, 0.4),
        drive=between(0.93, 0.99),
        charge_to_condenser=between(0.3, 0.8),
        wetting=between(0.3, 1.0),
        gas_gather=between(1.2, 3.0),
        gas_blanket=between(2.0, 8.0),
        oil_film=between(0.1, 0.4),
        oil_drag=between(0.03, 0.10),
        oil_heat=between(3.0, 9.0),
        oil_share=between(0.5, 0.7),
    )
