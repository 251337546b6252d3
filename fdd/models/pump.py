"""Circulation pump: head curve, affinity laws, efficiency.

    dp = p_0 s^2 - c m^2,  P = P_0 + m dp / (rho eta),  eta = eta_max (1 - ((m/s - m_opt)/m_opt)^2)

A parabola at full speed, moved by the affinity laws: flow with the relative speed s, head with its square.
"""

from __future__ import annotations

from typing import Any

from fdd.models.declare import ComponentModel, Fault, Namespace, Parameter, Quantity, State
from fdd.models.fluid import get_fluid
from fdd.models.functions import maximum

SOURCE = "ASHRAE Handbook, HVAC Systems and Equipment (2020), ch. 44"


def pump(density: float | None = None, fluid: str = "water") -> ComponentModel:
    """Pump model.

    Parameters
    ----------
    density : of what flows [kg/m3]; 990 for water, a fluid's own at its temperature where it is not given
    fluid : what flows, see :mod:`fdd.models.fluid`

    Raises
    ------
    ModelError : a fluid that is not known
    """
    medium = get_fluid(fluid)
    rho = density if density is not None else 990.0 if fluid == "water" else float(medium.density(medium.at))

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        head = p.p_0 * u.speed * u.speed - p.c * u.m_flow * u.m_flow
        off = (u.m_flow / (u.speed + 1e-3) - p.m_opt) / p.m_opt
        efficiency = p.eta * maximum(1.0 - off * off, 0.05)
        power = p.P_0 + u.m_flow * maximum(head, 0.0) / (rho * efficiency)
        return {"dp": (head - x.dp) / p.tau, "P": (power - x.P) / p.tau}

    return ComponentModel(
        name="pump",
        version="1",
        title="Circulation pump",
        states=(State("dp", "Pa", "head", 2e3), State("P", "W", "electric power", 20.0)),
        inputs=(Quantity("speed", "1", "relative speed"), Quantity("m_flow", "kg/s", "flow")),
        outputs=(Quantity("dp_pump", "Pa", "measured head"), Quantity("P_el", "W", "electric power")),
        parameters=(
            Parameter("p_0", "Pa", "head at full speed without flow", 6e4, 1e3, 2e6, SOURCE),
            Parameter("c", "Pa/(kg/s)^2", "fall of the head with the flow", 1e4, 1e-3, 1e9, SOURCE),
            Parameter("eta", "1", "best efficiency of pump and motor", 0.45, 0.02, 0.9, SOURCE, transform="logit"),
            Parameter("m_opt", "kg/s", "flow at best efficiency and full speed", 1.5, 1e-3, 1e3, SOURCE),
            Parameter("P_0", "W", "power of the electronics", 5.0, 0.01, 1e4, SOURCE),
            Parameter("tau", "s", "lag of drive and sensors", 5.0, 0.1, 600.0, SOURCE),
            Parameter("sigma_dp", "Pa/s^0.5", "process noise of the head", 50.0, 1e-3, 1e5, SOURCE, kind="noise"),
            Parameter("sigma_P", "W/s^0.5", "process noise of the power", 0.5, 1e-5, 1e4, SOURCE, kind="noise"),
            Parameter("noise_dp", "Pa", "measurement noise of the head", 200.0, 0.1, 1e5, SOURCE, kind="noise"),
            Parameter("noise_P", "W", "measurement noise of the power", 1.0, 1e-3, 1e4, SOURCE, kind="noise"),
        ),
        drift=drift,
        diffusion=lambda x, u, p: {"dp": p.sigma_dp, "P": p.sigma_P},
        observe=lambda x, u, p: {"dp_pump": x.dp, "P_el": x.P},
        noise=lambda x, u, p: {"dp_pump": p.noise_dp, "P_el": p.noise_P},
        start=lambda y, u, p: {"dp": y.dp_pump, "P": y.P_el},
        options={"density": rho} if fluid == "water" else {"density": rho, "fluid": fluid},
        valid={"speed": (0.0, 1.2), "m_flow": (0.0, 500.0)},
        faults=(
            Fault(
                "wear",
                "worn impeller: less head at the same speed and flow",
                {"p_0": -1, "innovation:dp_pump": -1},
                (
                    "compare head and flow with the maker's curve at full speed",
                    "listen for cavitation",
                    "open and look",
                ),
            ),
            Fault(
                "bearing",
                "friction: more power for the same work",
                {"eta": -1, "innovation:P_el": 1},
                ("listen to the bearings", "feel the motor's temperature"),
            ),
        ),
        references=(SOURCE,),
    )
