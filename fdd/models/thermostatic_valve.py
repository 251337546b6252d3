"""Self-acting thermostatic valve with hysteresis (Andersen 2001, Paper E), and two sibling models of the friction.

Force balance, Eq. 11, forces in N, lengths in m, pressures in Pa
    x = (A_k (dp_k - dp_k0) + A_s (dp_s - dp_s0) - A_b (p_b(T) - p_set) + F) / (C_v + C_i + C_b + K_f dp_k)

Friction
    dahl            dF = v sigma (1 - F/F_max sgn v), v = dT/dt, Eq. 14 with alpha = 1
    bliman-sorine   two of these, a fast one less a slow one (Bliman & Sorine 1995), named but not done in the paper
    play            no force: the stem follows the balance without friction once it has moved by the play

The sign is rounded (tanh) over a temperature rate of 1e-5 K/s. The paper's Tab. 2 lists C_v twice; the third row
(3.2 N/mm) is C_b, the bellows' spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.functions import maximum, minimum, smooth_sign

PAPER = "Andersen (2001), Paper E, Tab. 2"
STIFFNESS = 18.7e3  # N/m, C_v + C_i + C_b = 1.8 + 13.7 + 3.2 N/mm
BELLOWS = 1032e-6  # m2
RATE = 1e-5  # K/s over which the sign of the rate is rounded
FOLLOW = 0.05  # 1/s, how fast the stem follows outside the play


def thermostatic_valve(
    friction: Literal["dahl", "play", "bliman-sorine"] = "dahl",
    gas_charge: Sequence[float] = (-27.4e3, 3.5e3),
    set_pressures: Sequence[float] = (0.0, 0.0),
) -> ComponentModel:
    """Thermostatic valve model.

    Parameters
    ----------
    friction : see the module
    gas_charge : coefficients of the manufacturer's p_b(T) = c0 + c1 T + c2 T^2 + ... [Pa], T in degC
    set_pressures : dp_k and dp_s at the set point [Pa]

    Raises
    ------
    ModelError : unknown friction or an empty gas charge curve
    """
    if friction not in ("dahl", "play", "bliman-sorine"):
        raise ModelError(f"thermostatic_valve: friction {friction!r} is unknown; use dahl, play or bliman-sorine")
    if not gas_charge:
        raise ModelError(
            "thermostatic_valve: gas_charge is empty; give the manufacturer's polynomial, lowest power first"
        )

    def position(u: Namespace, p: Namespace, force: Any) -> Any:
        pressure: Any = 0.0
        for c in reversed(list(gas_charge)):
            pressure = pressure * u.T_gas + c
        push = p.A_k * (u.dp_k - set_pressures[0]) + p.A_s * (u.dp_s - set_pressures[1])
        return (push - BELLOWS * (pressure - p.p_set) + force) / (STIFFNESS + p.K_f * u.dp_k)

    def dahl(f: Any, rate: Any, sigma: Any, largest: Any) -> Any:
        return rate * sigma * (1.0 - f / largest * smooth_sign(rate, RATE))

    def drift(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        if friction == "play":
            free = position(u, p, 0.0)
            return {"x": FOLLOW * (maximum(free - p.play - x.x, 0.0) + minimum(free + p.play - x.x, 0.0))}
        if friction == "dahl":
            return {"F": dahl(x.F, u.rate, p.sigma_f, p.F_max)}
        return {
            "F": dahl(x.F, u.rate, p.sigma_f, p.F_max),
            "F_slow": dahl(x.F_slow, u.rate, p.sigma_slow, p.F_slow_max),
        }

    def observe(x: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        if friction == "play":
            return {"opening": x.x}
        return {"opening": position(u, p, x.F - x.F_slow if friction == "bliman-sorine" else x.F)}

    names = {"play": ["x"], "dahl": ["F"], "bliman-sorine": ["F", "F_slow"]}[friction]
    states = tuple(
        State("x", "m", "valve opening", 2e-4) if s == "x" else State(s, "N", "friction force", 0.7) for s in names
    )
    return ComponentModel(
        name="thermostatic_valve",
        version="1",
        title="Thermostatic valve with hysteresis",
        states=states,
        inputs=(
            Quantity("T_gas", "degC", "temperature of the gas charge"),
            Quantity("rate", "K/s", "rate of change of that temperature"),
            Quantity("dp_k", "Pa", "pressure difference across the cone"),
            Quantity("dp_s", "Pa", "pressure in front of the valve, over the surroundings"),
        ),
        outputs=(Quantity("opening", "m", "valve opening"),),
        parameters=_parameters(friction),
        drift=drift,
        diffusion=lambda x, u, p: dict.fromkeys(names, p.sigma),
        observe=observe,
        noise=lambda x, u, p: {"opening": p.noise},
        start=lambda y, u, p: {s: y.opening if s == "x" else 0.0 for s in names},
        options={"friction": friction, "gas_charge": list(gas_charge), "set_pressures": list(set_pressures)},
        valid={"T_gas": (-10.0, 100.0), "dp_k": (0.0, 5e5)},
        faults=(
            Fault(
                "sticking",
                "deposits or a dry seal: the stem moves late and by jumps",
                {"play": 1, "innovation:opening": 1} if friction == "play" else {"F_max": 1, "innovation:opening": 1},
                ("turn the head from end to end: the stem must spring back", "clean or change the insert"),
            ),
            Fault(
                "gas charge lost",
                "the sensing element has lost charge: the valve stays open",
                {"p_set": 1, "innovation:opening": 1},
                ("change the thermostatic head",),
            ),
        ),
        references=(
            "Knop, O., Andersen, K.K., Madsen, H., Gregersen, N.H., Paulsen, O. (2000). Modeling of a thermostatic "
            "valve with hysteresis effects. In: Andersen (2001), IMM-PHD-2001-79, Paper E.",
            "Bliman, P.A., Sorine, M. (1995). Easy-to-use realistic dry friction models for automatic control. ECC 95.",
        ),
    )


def _parameters(friction: str) -> tuple[Parameter, ...]:
    table = [
        Parameter("p_set", "Pa", "pressure of the gas charge at the set point", 77.6e3, 1e3, 1e6, PAPER),
        Parameter("A_k", "m^2", "area of the cone", 52e-6, 1e-7, 1e-2, PAPER),
        Parameter("A_s", "m^2", "area of the spindle", 2.45e-6, 1e-8, 1e-3, PAPER),
        Parameter("K_f", "m", "flow force", 0.0997, 1e-4, 10.0, PAPER),
    ]
    if friction == "play":
        table.append(Parameter("play", "m", "half of the play", 7e-5, 1e-7, 1e-2, PAPER))
        noise = Parameter("sigma", "m/s^0.5", "process noise", 1e-7, 1e-10, 1e-3, PAPER, kind="noise")
    else:
        table += [
            Parameter("sigma_f", "N/K", "stiffness of the friction", 6.41, 0.01, 1e3, PAPER),
            Parameter("F_max", "N", "largest friction force", 1.31, 1e-3, 100.0, PAPER),
        ]
        noise = Parameter("sigma", "N/s^0.5", "process noise", 1e-3, 1e-8, 10.0, PAPER, kind="noise")
    if friction == "bliman-sorine":
        source = "Bliman & Sorine (1995)"
        table += [
            Parameter("sigma_slow", "N/K", "stiffness of the slow friction", 1.0, 1e-3, 1e3, source),
            Parameter("F_slow_max", "N", "largest slow friction force", 0.3, 1e-4, 100.0, source),
        ]
    table += [
        noise,
        Parameter("noise", "m", "measurement noise of the opening", 2.4e-6, 1e-9, 1e-2, PAPER, kind="noise"),
    ]
    return tuple(table)
