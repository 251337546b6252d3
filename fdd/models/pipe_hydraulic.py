"""Pipe, hydraulic: flow with a smooth change from laminar to turbulent (Andersen 2001, Paper C).

    dm/dt = A/l (dp - psi rho v|v|/2 - (1 - w) f_l - w f_t),  f = lambda l/d rho v|v|/2,  w = threshold(|Re|)
    v = m/(rho A),  lambda_l = 64/Re (Eq. 4),  lambda_t by Blasius (Eq. 6) or Colebrook (Eq. 5)

The paper's Eq. 3 holds for forward flow; v|v| serves either direction. The threshold is centred in Re, and so depends
on temperature through the viscosity: the paper's 48 kg/h at 30 degC and 10 mm is Re 2130.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.fluid import get_fluid
from fdd.models.friction import friction_blasius, friction_colebrook, threshold

PAPER = "Andersen (2001), Paper C"


def pipe_hydraulic(
    diameter: float = 0.01,
    length: float = 12.0,
    turbulent: Literal["blasius", "colebrook"] = "blasius",
    fluid: str = "water",
) -> ComponentModel:
    """Flow through a pipe under a pressure difference.

    Parameters
    ----------
    diameter, length : inside [m]; the paper's rig by default
    turbulent : ``"blasius"`` (smooth) or ``"colebrook"`` (with roughness as a parameter)
    fluid : what flows, see :mod:`fdd.models.fluid`; its density and viscosity follow the measured temperature

    Raises
    ------
    ModelError : a size that is not positive, an unknown turbulent law or fluid
    """
    if not (diameter > 0 and length > 0):
        raise ModelError(f"pipe_hydraulic: diameter {diameter} m and length {length} m must be positive")
    if turbulent not in ("blasius", "colebrook"):
        raise ModelError(f"pipe_hydraulic: turbulent law {turbulent!r} is unknown; use 'blasius' or 'colebrook'")
    medium = get_fluid(fluid)
    area = math.pi * diameter**2 / 4.0

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        rho, mu = medium.density(u.T), medium.viscosity(u.T)
        v = x.m / (rho * area)
        reynolds = rho * v * diameter / mu
        head = 0.5 * rho * v * (v * v + 1e-12) ** 0.5
        rough = (
            friction_blasius(reynolds)
            if turbulent == "blasius"
            else friction_colebrook(reynolds, p.roughness / diameter)
        )
        # 64/Re times v|v| is linear in v: written out, it has no zero to divide by.
        laminar = 32.0 * mu * length / diameter**2 * v
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
        version="2",
        title="Pipe, hydraulic",
        states=(State("m", "kg/s", "flow", 0.01),),
        inputs=(Quantity("dp", "Pa", "pressure difference"), Quantity("T", "degC", "temperature of the fluid")),
        outputs=(Quantity("m_flow", "kg/s", "flow"),),
        parameters=tuple(parameters),
        drift=drift,
        diffusion=lambda x, u, p: {"m": p.sigma},
        observe=lambda x, u, p: {"m_flow": x.m},
        noise=lambda x, u, p: {"m_flow": p.noise},
        start=lambda y, u, p: {"m": y.m_flow},
        options={
            "diameter": diameter,
            "length": length,
            "turbulent": turbulent,
            **({} if fluid == "water" else {"fluid": fluid}),
        },
        valid={"T": (medium.coldest, medium.warmest), "dp": (-1e6, 1e6)},
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
