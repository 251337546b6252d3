"""Valves in a circuit: control valve with authority and leakage, and differential pressure relief valve.

Flow through a valve by IEC 60534-2-1, m = kv sqrt(dp/1 bar) 1000/3600; the circuit in series has a kv of its own, which
gives the control valve its authority N = kv_circuit^2 / (kv_circuit^2 + kv^2).
"""

from __future__ import annotations

from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.fluid import get_fluid
from fdd.models.friction import valve_flow
from fdd.models.functions import exp, log, logistic

IEC = "IEC 60534-2-1 and 60534-2-4"
CHECK = ("close the valve by hand and feel whether the pipe behind it cools", "check seat, stroke and actuator")


def control_valve(
    characteristic: Literal["equal-percentage", "linear"] = "equal-percentage", fluid: str = "water"
) -> ComponentModel:
    """Control valve in series with its circuit.

    Inherent characteristic (IEC 60534-2-4): phi = leak + (1 - leak) R^(opening - 1), less its value at
    the seat, or linear.

    Parameters
    ----------
    characteristic : inherent characteristic
    fluid : what flows, see :mod:`fdd.models.fluid`; its density counts

    Raises
    ------
    ModelError : unknown characteristic or fluid
    """
    if characteristic not in ("equal-percentage", "linear"):
        raise ModelError(f"control_valve: characteristic {characteristic!r} is unknown; use equal-percentage or linear")
    rho = _density(fluid)

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        share = u.opening
        if characteristic == "equal-percentage":
            seat = exp(-log(p.R))
            share = (exp((u.opening - 1.0) * log(p.R)) - seat) / (1.0 - seat)
        phi = p.leak + (1.0 - p.leak) * share
        kv = 1.0 / (1.0 / (p.kv * phi + 1e-9) ** 2 + 1.0 / (p.kv_circuit * p.kv_circuit)) ** 0.5
        return {"m": (valve_flow(kv, u.dp, density=rho) - x.m) / p.tau}

    parameters = [
        Parameter("kv", "m^3/h", "flow at 1 bar, valve open", 2.5, 1e-3, 1e4, IEC),
        Parameter("kv_circuit", "m^3/h", "the same of the rest of the circuit", 4.0, 1e-3, 1e5, IEC),
        Parameter("leak", "1", "share of the flow through the closed valve", 1e-3, 1e-6, 0.9, IEC),
        Parameter("tau", "s", "lag of actuator and meter", 15.0, 0.1, 600.0, IEC),
        Parameter("sigma", "kg/s^1.5", "process noise", 1e-3, 1e-8, 10.0, IEC, kind="noise"),
        Parameter("noise", "kg/s", "measurement noise of the flow", 2e-3, 1e-7, 10.0, IEC, kind="noise"),
    ]
    if characteristic == "equal-percentage":
        parameters.insert(2, Parameter("R", "1", "rangeability", 30.0, 5.0, 200.0, IEC))
    return ComponentModel(
        name="control_valve",
        version="1",
        title="Control valve in its circuit",
        states=(State("m", "kg/s", "flow", 0.05),),
        inputs=(Quantity("opening", "1", "position"), Quantity("dp", "Pa", "pressure difference across the circuit")),
        outputs=(Quantity("m_flow", "kg/s", "flow"),),
        parameters=tuple(parameters),
        drift=drift,
        diffusion=lambda x, u, p: {"m": p.sigma},
        observe=lambda x, u, p: {"m_flow": x.m},
        noise=lambda x, u, p: {"m_flow": p.noise},
        start=lambda y, u, p: {"m": y.m_flow},
        options={"characteristic": characteristic, **_medium(fluid)},
        valid={"opening": (0.0, 1.0), "dp": (-1e6, 1e6)},
        faults=(
            Fault("leak", "the seat leaks through", {"leak": 1, "innovation:m_flow": 1}, CHECK),
            Fault(
                "blocked",
                "dirt in the valve or its circuit",
                {"kv": -1, "kv_circuit": -1, "innovation:m_flow": -1},
                CHECK,
            ),
        ),
        references=("IEC 60534-2-1: Flow capacity.", "IEC 60534-2-4: Inherent flow characteristics and rangeability."),
    )


def relief_valve(fluid: str = "water") -> ComponentModel:
    """Differential pressure relief valve: opens by the share logistic((dp - p_set)/band).

    Parameters
    ----------
    fluid : what flows, see :mod:`fdd.models.fluid`; its density counts

    Raises
    ------
    ModelError : a fluid that is not known
    """
    rho = _density(fluid)

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        lift = p.leak + (1.0 - p.leak) * logistic((u.dp - p.p_set) / p.band)
        return {"m": (valve_flow(p.kv * lift, u.dp, density=rho) - x.m) / p.tau}

    return ComponentModel(
        name="relief_valve",
        version="1",
        title="Differential pressure relief valve",
        states=(State("m", "kg/s", "flow", 0.05),),
        inputs=(Quantity("dp", "Pa", "pressure difference across the valve"),),
        outputs=(Quantity("m_flow", "kg/s", "flow"),),
        parameters=(
            Parameter("kv", "m^3/h", "flow at 1 bar, valve open", 3.0, 1e-3, 1e4, IEC),
            Parameter("p_set", "Pa", "pressure difference at half lift", 2e4, 500.0, 1e6, IEC),
            Parameter("band", "Pa", "pressure over which it opens", 2e3, 10.0, 2e5, IEC),
            Parameter("leak", "1", "share of the lift when closed", 1e-3, 1e-6, 0.9, IEC),
            Parameter("tau", "s", "lag of valve and meter", 5.0, 0.1, 600.0, IEC),
            Parameter("sigma", "kg/s^1.5", "process noise", 1e-3, 1e-8, 10.0, IEC, kind="noise"),
            Parameter("noise", "kg/s", "measurement noise of the flow", 2e-3, 1e-7, 10.0, IEC, kind="noise"),
        ),
        drift=drift,
        diffusion=lambda x, u, p: {"m": p.sigma},
        observe=lambda x, u, p: {"m_flow": x.m},
        noise=lambda x, u, p: {"m_flow": p.noise},
        start=lambda y, u, p: {"m": y.m_flow},
        options=_medium(fluid),
        valid={"dp": (-1e6, 1e6)},
        faults=(
            Fault(
                "weak spring",
                "it opens too early",
                {"p_set": -1, "innovation:m_flow": 1},
                ("check the set screw", *CHECK),
            ),
            Fault("leak", "the seat leaks through", {"leak": 1, "innovation:m_flow": 1}, CHECK),
        ),
        references=("IEC 60534-2-1: Flow capacity.", "EN 1267: Valves - Test of flow resistance."),
    )


def _density(fluid: str) -> float:
    """Water as IEC 60534 has it, another fluid at its temperature [kg/m3]."""
    medium = get_fluid(fluid)
    return 1000.0 if fluid == "water" else float(medium.density(medium.at))


def _medium(fluid: str) -> dict[str, Any]:
    return {} if fluid == "water" else {"fluid": fluid}
