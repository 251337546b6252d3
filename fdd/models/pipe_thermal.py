"""Pipe, thermal: what enters leaves later, dispersed and cooled on the way.

n sections in series delay the water by its residence time C/(cp m), with a dispersion of the delay over root n; the
wall is as warm as its water:
    C/n dT_i/dt = cp m (T_i-1 - T_i) - UA/n (T_i - T_around)

With ``wall=True`` it follows its water and gives off the heat, which rounds the foot of a step:
    C/n dT_i/dt          = cp m (T_i-1 - T_i) - B/n (T_i - T_wall_i)
    C_wall/n dT_wall_i/dt = B/n (T_i - T_wall_i) - UA/n (T_wall_i - T_around)

At m = 0 the pipe cools where it stands. The model holds for m >= 0: where the flow turns, the other end is the inlet,
and a flow below zero counts as none.
"""

from __future__ import annotations

from typing import Any

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.fluid import chosen
from fdd.models.functions import forward

BALANCE = "heat balance of a section, van der Heijde et al. (2017), Eq. 1"


def pipe_thermal(
    compartments: int = 12, heat_capacity: float | None = None, wall: bool = False, fluid: str = "water"
) -> ComponentModel:
    """Temperature at a pipe's end: delayed, dispersed and cooled on the way.

    Parameters
    ----------
    compartments : sections along the pipe; more for less dispersion
    heat_capacity : of what flows [J/(kg K)]; the fluid's where it is not given
    wall : with the wall's temperature as a further state of every section
    fluid : what flows, see :mod:`fdd.models.fluid`

    Raises
    ------
    ModelError : a number of compartments outside 1 to 40 (20 with walls), or a fluid that is not known
    """
    largest = 20 if wall else 40
    if not 1 <= compartments <= largest:
        raise ModelError(
            f"pipe_thermal: {compartments} compartments; use 1 to {largest}"
            f"{' with walls' if wall else ''} (more for less dispersion)"
        )
    _, cp, medium = chosen("pipe_thermal", fluid, heat_capacity)
    n = compartments
    sections = range(1, n + 1)

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        before, flow, rates = u.T_in, forward(u.m_flow), {}
        for i in sections:
            here = getattr(x, f"T_{i}")
            carried = n * cp * flow / p.C * (before - here)
            if wall:
                skin = getattr(x, f"T_wall_{i}")
                rates[f"T_{i}"] = carried - p.B / p.C * (here - skin)
                rates[f"T_wall_{i}"] = (p.B * (here - skin) - p.UA * (skin - u.T_around)) / p.C_wall
            else:
                rates[f"T_{i}"] = carried - p.UA / p.C * (here - u.T_around)
            before = here
        return rates

    def diffusion(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        return {s.symbol: p.sigma for s in _states(n, wall)}

    def start(y: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        line = {f"T_{i}": u.T_in + (y.T_out - u.T_in) * i / n for i in sections}
        return line | ({f"T_wall_{i}": line[f"T_{i}"] for i in sections} if wall else {})

    return ComponentModel(
        name="pipe_thermal",
        version="1",
        title="Pipe, thermal",
        states=_states(n, wall),
        inputs=(
            Quantity("T_in", "degC", "inlet temperature"),
            Quantity("m_flow", "kg/s", "flow"),
            Quantity("T_around", "degC", "temperature around the pipe"),
        ),
        outputs=(Quantity("T_out", "degC", "outlet temperature"),),
        parameters=_parameters(wall),
        drift=drift,
        diffusion=diffusion,
        observe=lambda x, u, p: {"T_out": getattr(x, f"T_{n}")},
        noise=lambda x, u, p: {"T_out": p.noise},
        start=start,
        options={"compartments": n, **medium, **({"wall": True} if wall else {})},
        valid={"m_flow": (0.0, 500.0), "T_in": (-30.0, 180.0), "T_out": (-30.0, 180.0)},
        faults=(
            Fault(
                "insulation",
                "wet or missing insulation: more heat is lost on the way",
                {"UA": 1, "innovation:T_out": -1},
                ("walk along the pipe, feel or film the insulation", "look for leaks into ducts and pits"),
            ),
            Fault(
                "bias",
                "the outlet sensor reads wrong by a constant",
                {"innovation:T_out": 1},
                ("compare the sensor with a hand-held one",),
            ),
        ),
        references=(
            "van der Heijde, B. et al. (2017). Dynamic equation-based thermo-hydraulic pipe model for district heating "
            "and cooling systems. Energy Conversion and Management 151, 158-169 (the measured pipes).",
        ),
    )


def _states(n: int, wall: bool) -> tuple[State, ...]:
    what = "water of section" if wall else "water and wall of section"
    states = [State(f"T_{i}", "degC", f"{what} {i}", 2.0) for i in range(1, n + 1)]
    if wall:
        states += [State(f"T_wall_{i}", "degC", f"wall of section {i}", 2.0) for i in range(1, n + 1)]
    return tuple(states)


def _parameters(wall: bool) -> tuple[Parameter, ...]:
    whose = "water" if wall else "water and wall"
    table = [Parameter("C", "J/K", f"heat capacity of {whose}", 4e5, 100.0, 1e9, BALANCE)]
    if wall:
        table += [
            Parameter("C_wall", "J/K", "heat capacity of the wall", 8e4, 100.0, 1e9, BALANCE),
            Parameter("B", "W/K", "transfer from the water to the wall", 3e3, 1.0, 1e7, BALANCE),
        ]
    table += [
        Parameter("UA", "W/K", "loss to the surroundings", 10.0, 1e-3, 1e5, BALANCE),
        Parameter("sigma", "K/s^0.5", "process noise of the water", 0.02, 1e-6, 2.0, BALANCE, kind="noise"),
        Parameter("noise", "K", "measurement noise of the outlet", 0.05, 1e-3, 5.0, BALANCE, kind="noise"),
    ]
    return tuple(table)
