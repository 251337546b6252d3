"""Single-zone building: indoor air with heater, envelope and sun (Bacher & Madsen 2011).

The smallest models that describe a whole building from its indoor temperature: the model of the data is chosen from
``Ti`` upwards by likelihood-ratio tests. Use :func:`fdd.models.building.building` where rooms are measured apart.

Equations
    Ti       C_i dT_i = (T_out - T_i)/R_ia + A_w I + P
    TiTe     C_i dT_i = (T_e - T_i)/R_ie + A_w I + P ;  C_e dT_e = (T_i - T_e)/R_ie + (T_out - T_e)/R_ea
    TiTh     C_i dT_i = (T_out - T_i)/R_ia + (T_h - T_i)/R_ih + A_w I ;  C_h dT_h = (T_i - T_h)/R_ih + P
    TiTeTh   both
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State

PAPER = "Bacher & Madsen (2011)"
NODES = ("Ti", "TiTe", "TiTh", "TiTeTh")


def zone(nodes: Literal["Ti", "TiTe", "TiTh", "TiTeTh"] = "TiTeTh") -> ComponentModel:
    """Single-zone building model with the temperatures that ``nodes`` names: indoor, envelope, heater.

    Raises
    ------
    ModelError : unknown nodes
    """
    if nodes not in NODES:
        raise ModelError(f"zone: nodes {nodes!r} is unknown; use one of {', '.join(NODES)}")
    envelope, heater = "Te" in nodes, "Th" in nodes

    def drift(x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        heat = p.A_w * u.I_solar
        rates: dict[str, Any] = {}
        if envelope:
            heat = heat + (x.T_e - x.T_i) / p.R_ie
            rates["T_e"] = ((x.T_i - x.T_e) / p.R_ie + (u.T_out - x.T_e) / p.R_ea) / p.C_e
        else:
            heat = heat + (u.T_out - x.T_i) / p.R_ia
        if heater:
            heat = heat + (x.T_h - x.T_i) / p.R_ih
            rates["T_h"] = ((x.T_i - x.T_h) / p.R_ih + u.P_heat) / p.C_h
        else:
            heat = heat + u.P_heat
        return {**rates, "T_i": heat / p.C_i}

    def diffusion(x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        return {
            "T_i": p.sigma_i,
            **({"T_e": p.sigma_e} if envelope else {}),
            **({"T_h": p.sigma_h} if heater else {}),
        }

    def start(y: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        state = {"T_i": y.T_room}
        if envelope:
            # Where a steady envelope lies between inside and outside.
            state["T_e"] = (y.T_room * p.R_ea + u.T_out * p.R_ie) / (p.R_ea + p.R_ie)
        if heater:
            state["T_h"] = y.T_room
        return state

    return ComponentModel(
        name="zone",
        version="1",
        title="Single-zone building",
        states=_states(envelope, heater),
        inputs=(
            Quantity("T_out", "degC", "outdoor temperature"),
            Quantity("I_solar", "W/m^2", "global radiation"),
            Quantity("P_heat", "W", "heater power"),
        ),
        outputs=(Quantity("T_room", "degC", "indoor temperature"),),
        parameters=_parameters(envelope, heater),
        drift=drift,
        diffusion=diffusion,
        observe=lambda x, u, p: {"T_room": x.T_i},
        noise=lambda x, u, p: {"T_room": p.noise_in},
        start=start,
        options={"nodes": nodes},
        valid={"T_out": (-50.0, 60.0), "I_solar": (0.0, 1400.0), "T_room": (-20.0, 60.0)},
        faults=_faults(envelope),
        references=(
            "Bacher, P., Madsen, H. (2011). Identifying suitable models for the heat dynamics of buildings. "
            "Energy and Buildings 43(7), 1511-1522. doi:10.1016/j.enbuild.2011.02.005",
        ),
    )


def _states(envelope: bool, heater: bool) -> tuple[State, ...]:
    states = [State("T_i", "degC", "indoor air with what follows it quickly", 0.2)]
    if envelope:
        states.append(State("T_e", "degC", "building envelope", 3.0))
    if heater:
        states.append(State("T_h", "degC", "heater", 3.0))
    return tuple(states)


def _parameters(envelope: bool, heater: bool) -> tuple[Parameter, ...]:
    table = [
        Parameter("C_i", "J/K", "heat capacity of the indoor air and furniture", 5e6, 1e4, 1e12, f"{PAPER}, Tab. 2")
    ]
    if envelope:
        table += [
            Parameter("C_e", "J/K", "heat capacity of the envelope", 1e7, 1e4, 1e13, f"{PAPER}, Tab. 2"),
            Parameter("R_ie", "K/W", "resistance from indoors to the envelope", 1e-3, 1e-8, 10.0, f"{PAPER}, Tab. 2"),
            Parameter("R_ea", "K/W", "resistance from the envelope to outdoors", 4e-3, 1e-8, 10.0, f"{PAPER}, Tab. 2"),
        ]
    else:
        table.append(
            Parameter("R_ia", "K/W", "resistance from indoors to outdoors", 5e-3, 1e-8, 10.0, f"{PAPER}, Tab. 2")
        )
    if heater:
        table += [
            Parameter("C_h", "J/K", "heat capacity of the heater", 2e5, 1e2, 1e11, f"{PAPER}, Tab. 2"),
            Parameter("R_ih", "K/W", "resistance from indoors to the heater", 2e-3, 1e-8, 10.0, f"{PAPER}, Tab. 2"),
        ]
    table.append(Parameter("A_w", "m^2", "effective window area", 5.0, 1e-3, 1e5, f"{PAPER}, Tab. 2"))
    # A light heater is disturbed most: its heat capacity is small.
    nodes = [("i", "indoors", 1e-3)] + [("e", "the envelope", 1e-3)] * envelope + [("h", "the heater", 0.05)] * heater
    table += [
        Parameter(
            f"sigma_{s}", "K/s^0.5", f"process noise of {name}", rough, 1e-8, 1.0, f"{PAPER}, Eq. 1", kind="noise"
        )
        for s, name, rough in nodes
    ]
    table.append(
        Parameter(
            "noise_in",
            "K",
            "measurement noise of the indoor temperature",
            0.03,
            1e-8,
            2.0,
            f"{PAPER}, Eq. 2",
            kind="noise",
        )
    )
    return tuple(table)


def _faults(envelope: bool) -> tuple[Fault, ...]:
    resistance = "R_ea" if envelope else "R_ia"
    return (
        Fault(
            "open-window",
            "more heat leaves than the envelope explains",
            {resistance: -1, "innovation:T_room": -1},
            ("look for open windows and doors", "check the ventilation's schedule and supply temperature"),
        ),
        Fault(
            "heater",
            "the heater gives off less than its meter says",
            {"innovation:T_room": -1, "C_i": 1},
            ("compare the heat meter with the flow and temperatures at the heater",),
        ),
        Fault(
            "bias",
            "the indoor sensor reads wrong by a constant",
            {"innovation:T_room": 0},
            ("compare the sensor with a hand-held one", "look whether sun or a heat source reaches it"),
        ),
        Fault(
            "stuck",
            "the indoor sensor keeps its last value",
            {"innovation:T_room": 0, "C_i": 1, **({"C_e": 1, "R_ie": -1} if envelope else {})},
            ("look whether the reading changes at all", "warm the sensor with a hand: it must follow within minutes"),
        ),
    )
