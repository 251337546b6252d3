"""Pipe: flow with a smooth change from laminar to turbulent (Andersen 2001, Paper C), and heat with delay and loss.

Hydraulic
    dm/dt = A/l (dp - psi rho v|v|/2 - (1 - w) f_l - w f_t),  f = lambda l/d rho v|v|/2,  w = threshold(|Re|)
    with v = m/(rho A). The paper's Eq. 3 holds for forward flow; v|v| serves either direction. The threshold is centred
    in Re, and so depends on temperature through the viscosity: the paper's 48 kg/h at 30 degC and 10 mm is Re 2130.

Thermal
    n sections in series delay the water by about its residence time; the wall's heat capacity adds to the water's:
    C/n dT_i/dt = cp m (T_i-1 - T_i) - UA/n (T_i - T_around)
"""

from __future__ import annotations

import math
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.fluid import density, friction_blasius, friction_colebrook, threshold, viscosity
from fdd.models.radiator import WATER_HEAT_CAPACITY

PAPER = "Andersen (2001), Paper C"


def pipe_hydraulic(
    diameter: float = 0.01, length: float = 12.0, turbulent: Literal["blasius", "colebrook"] = "blasius"
) -> ComponentModel:
    """Flow through a pipe under a pressure difference.

    Parameters
    ----------
    diameter, length : inside [m]; the paper's rig by default
    turbulent : ``"blasius"`` (smooth) or ``"colebrook"`` (with roughness as a parameter)

    Raises
    ------
    ModelError : a size that is not positive, or an unknown turbulent law
    """
    if not (diameter > 0 and length > 0):
        raise ModelError(f"pipe_hydraulic: diameter {diameter} m and length {length} m must be positive")
    if turbulent not in ("blasius", "colebrook"):
        raise ModelError(f"pipe_hydraulic: turbulent law {turbulent!r} is unknown; use 'blasius' or 'colebrook'")
    area = math.pi * diameter**2 / 4.0

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        rho = density(u.T)
        v = x.m / (rho * area)
        reynolds = rho * v * diameter / viscosity(u.T)
        head = 0.5 * rho * v * (v * v + 1e-12) ** 0.5
        rough = (
            friction_blasius(reynolds)
            if turbulent == "blasius"
            else friction_colebrook(reynolds, p.roughness / diameter)
        )
        # 64/Re times v|v| is linear in v: written out, it has no zero to divide by.
        laminar = 32.0 * viscosity(u.T) * length / diameter**2 * v
        weight = threshold((reynolds * reynolds + 1.0) ** 0.5, p.Re_t, p.slope)
        loss = (1.0 - weight) * laminar + weight * rough * length / diameter * head + p.psi * head
        return {"m": area / length * (u.dp - loss)}

    parameters = [
        Parameter("psi", "1", "minor losses", 2.0, 1e-3, 1e3, f"{PAPER}, Eq. 3"),
        Parameter(
            "Re_t", "1", "Reynolds number half way from laminar to turbulent", 2200.0, 500.0, 1e4, f"{PAPER}, Eq. 7"
        ),
        Parameter("slope", "1", "how sharply the flow changes, per unit of Re", 5e-3, 1e-4, 0.1, f"{PAPER}, Eq. 7"),
        Parameter("sigma", "kg/s^1.5", "process noise of the flow", 1e-4, 1e-8, 0.1, f"{PAPER}, Eq. 12", kind="noise"),
        Parameter("noise", "kg/s", "measurement noise of the flow", 1e-4, 1e-8, 1.0, f"{PAPER}, Eq. 13", kind="noise"),
    ]
    if turbulent == "colebrook":
        parameters.insert(1, Parameter("roughness", "m", "wall roughness", 2e-5, 1e-8, 5e-3, f"{PAPER}, Eq. 5"))
    return ComponentModel(
        name="pipe_hydraulic",
        version="1",
        title="Pipe, hydraulic",
        states=(State("m", "kg/s", "flow", 0.01),),
        inputs=(Quantity("dp", "Pa", "pressure difference"), Quantity("T", "degC", "water temperature")),
        outputs=(Quantity("m_flow", "kg/s", "flow"),),
        parameters=tuple(parameters),
        drift=drift,
        diffusion=lambda x, u, p: {"m": p.sigma},
        observe=lambda x, u, p: {"m_flow": x.m},
        noise=lambda x, u, p: {"m_flow": p.noise},
        start=lambda y, u, p: {"m": y.m_flow},
        options={"diameter": diameter, "length": length, "turbulent": turbulent},
        valid={"T": (0.5, 110.0), "dp": (-1e6, 1e6)},
        faults=(
            Fault(
                "blocked",
                "deposits or a closed valve narrow the way",
                {"psi": 1, "innovation:m_flow": -1},
                ("check strainers and shut-off valves on the way", "measure the pressure drop section by section"),
            ),
            Fault(
                "scaling",
                "the flow meter reads a wrong share",
                {"psi": -1, "innovation:m_flow": 1},
                ("compare with a clamp-on meter",),
            ),
        ),
        references=(
            "Andersen, K.K., Lundby, M., Madsen, H., Paulsen, O. (1999). Identification of continuous time smooth "
            "threshold models of physical systems. In: Andersen (2001), IMM-PHD-2001-79, Paper C.",
            "Haaland, S.E. (1983). Simple and explicit formulas for the friction factor. J. Fluids Eng. 105, 89-90.",
        ),
    )


def pipe_thermal(compartments: int = 12, heat_capacity: float = WATER_HEAT_CAPACITY) -> ComponentModel:
    """Temperature at a pipe's end: delayed, dispersed and cooled on the way.

    Raises
    ------
    ModelError : a number of compartments outside 1 to 40
    """
    if not 1 <= compartments <= 40:
        raise ModelError(f"pipe_thermal: {compartments} compartments; use 1 to 40 (more for less dispersion)")
    n = compartments

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        before, rates = u.T_in, {}
        for i in range(1, n + 1):
            here = getattr(x, f"T_{i}")
            rates[f"T_{i}"] = n * heat_capacity * u.m_flow / p.C * (before - here) - p.UA / p.C * (here - u.T_around)
            before = here
        return rates

    def start(y: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        return {f"T_{i}": u.T_in + (y.T_out - u.T_in) * i / n for i in range(1, n + 1)}

    return ComponentModel(
        name="pipe_thermal",
        version="1",
        title="Pipe, thermal",
        states=tuple(State(f"T_{i}", "degC", f"water and wall of section {i}", 2.0) for i in range(1, n + 1)),
        inputs=(
            Quantity("T_in", "degC", "inlet temperature"),
            Quantity("m_flow", "kg/s", "flow"),
            Quantity("T_around", "degC", "temperature around the pipe"),
        ),
        outputs=(Quantity("T_out", "degC", "outlet temperature"),),
        parameters=(
            Parameter("C", "J/K", "heat capacity of water and wall", 4e5, 100.0, 1e9, f"{PAPER}, own balance"),
            Parameter("UA", "W/K", "loss to the surroundings", 10.0, 1e-3, 1e5, "own balance"),
            Parameter("sigma", "K/s^0.5", "process noise of the water", 0.02, 1e-6, 2.0, "own balance", kind="noise"),
            Parameter("noise", "K", "measurement noise of the outlet", 0.05, 1e-3, 5.0, "own balance", kind="noise"),
        ),
        drift=drift,
        diffusion=lambda x, u, p: {f"T_{i}": p.sigma for i in range(1, n + 1)},
        observe=lambda x, u, p: {"T_out": getattr(x, f"T_{n}")},
        noise=lambda x, u, p: {"T_out": p.noise},
        start=start,
        options={"compartments": n, "heat_capacity": heat_capacity},
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
