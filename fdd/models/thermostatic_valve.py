"""Self-acting thermostatic valve with hysteresis (Andersen 2001, Paper E), and two sibling models of the friction.

Force balance, Eq. 11, forces in N, lengths in m, pressures in Pa
    x = (A_k (dp_k - dp_k0) + A_s (dp_s - dp_s0) - A_b (p_b(T) - p_set) + F) / (C_v + C_i + C_b + K_f dp_k)

Friction
    dahl            dF = v sigma (1 - F/F_max sgn v), v = dT/dt, Eq. 14 with alpha = 1
    bliman-sorine   two of these, a fast one less a slow one (Bliman & Sorine 1995), named but not done in the paper
    play            no force: the stem follows the balance without friction once it has moved by the play

Flow (``output="flow"``), IEC 60534-2-1 with the manufacturer's curve kv(x)
    m = kv(x)/3600 sqrt(1000 rho) sqrt(dp_k/1 bar), x no less than 0, the closed seat

The sign is rounded (tanh) over a temperature rate of 1e-5 K/s. The paper's Tab. 2 lists C_v twice; the third row
(3.2 N/mm) is C_b, the bellows' spring.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.fluid import chosen, horner
from fdd.models.friction import valve_flow
from fdd.models.functions import maximum, minimum, smooth_maximum, smooth_sign

PAPER = "Andersen (2001), Paper E, Tab. 2"
STIFFNESS = 18.7e3  # N/m, C_v + C_i + C_b = 1.8 + 13.7 + 3.2 N/mm
BELLOWS = 1032e-6  # m2
RATE = 1e-5  # K/s over which the sign of the rate is rounded
SEAT = 2e-6  # m over which the seat is rounded
FOLLOW = 0.05  # 1/s, how fast the stem follows outside the play


def thermostatic_valve(
    friction: Literal["dahl", "play", "bliman-sorine"] = "dahl",
    gas_charge: Sequence[float] | Sequence[Sequence[float]] = (-27.4e3, 3.5e3),
    set_pressures: Sequence[float] = (0.0, 0.0),
    output: Literal["opening", "flow"] = "opening",
    kv_curve: Sequence[float] | Sequence[Sequence[float]] = (0.0, 1.2e3),
    fluid: str = "water",
) -> ComponentModel:
    """Thermostatic valve model.

    Parameters
    ----------
    friction : see the module
    gas_charge : the manufacturer's p_b(T) [Pa], T in degC: coefficients c0 + c1 T + c2 T^2 + ..., or a table of pairs
    set_pressures : dp_k and dp_s at the set point [Pa]
    output : what is measured: the ``"opening"`` of the stem or the ``"flow"`` through the valve
    kv_curve : the manufacturer's kv [m3/h at 1 bar] over the opening [m], coefficients or a table of pairs
    fluid : what flows, see :mod:`fdd.models.fluid`; its density counts

    Raises
    ------
    ModelError : unknown friction, output or fluid, or a curve that is empty or whose table does not rise
    """
    if friction not in ("dahl", "play", "bliman-sorine"):
        raise ModelError(f"thermostatic_valve: friction {friction!r} is unknown; use dahl, play or bliman-sorine")
    if output not in ("opening", "flow"):
        raise ModelError(f"thermostatic_valve: output {output!r} is unknown; use opening or flow")
    charge, kv = _curve("gas_charge", gas_charge), _curve("kv_curve", kv_curve)
    medium, _, named = chosen("thermostatic_valve", fluid)
    rho = 1000.0 if fluid == "water" else float(medium.density(medium.at))

    def position(u: Namespace, p: Namespace, force: Any) -> Any:
        pressure = charge(u.T_gas)
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
        opening = x.x if friction == "play" else position(u, p, x.F - x.F_slow if friction == "bliman-sorine" else x.F)
        if output == "opening":
            return {"opening": opening}
        return {"m_flow": valve_flow(kv(smooth_maximum(opening, 0.0, SEAT)), u.dp_k, density=rho)}

    measured = Quantity("opening", "m", "valve opening") if output == "opening" else Quantity("m_flow", "kg/s", "flow")

    def start(y: Namespace, u: Namespace, p: Namespace) -> dict[str, Any]:
        rest = y.opening if output == "opening" else position(u, p, 0.0)
        return {s: rest if s == "x" else 0.0 for s in names}

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
        outputs=(measured,),
        parameters=_parameters(friction, output),
        drift=drift,
        diffusion=lambda x, u, p: dict.fromkeys(names, p.sigma),
        observe=observe,
        noise=lambda x, u, p: {measured.symbol: p.noise},
        start=start,
        options={
            "friction": friction,
            "gas_charge": _plain(gas_charge),
            "set_pressures": list(set_pressures),
            **({"output": output, "kv_curve": _plain(kv_curve)} if output == "flow" else {}),
            **({"fluid": named["fluid"]} if "fluid" in named else {}),
        },
        valid={"T_gas": (-10.0, 100.0), "dp_k": (0.0, 5e5)},
        faults=(
            Fault(
                "sticking",
                "deposits or a dry seal: the stem moves late and by jumps",
                {"play" if friction == "play" else "F_max": 1, f"innovation:{measured.symbol}": 1},
                ("turn the head from end to end: the stem must spring back", "clean or change the insert"),
            ),
            Fault(
                "gas charge lost",
                "the sensing element has lost charge: the valve stays open",
                {"p_set": 1, f"innovation:{measured.symbol}": 1},
                ("change the thermostatic head",),
            ),
        ),
        references=(
            "Knop, O., Andersen, K.K., Madsen, H., Gregersen, N.H., Paulsen, O. (2000). Modeling of a thermostatic "
            "valve with hysteresis effects. In: Andersen (2001), IMM-PHD-2001-79, Paper E.",
            "Bliman, P.A., Sorine, M. (1995). Easy-to-use realistic dry friction models for automatic control. ECC 95.",
        ),
    )


def _curve(name: str, curve: Sequence[Any]) -> Callable[[Any], Any]:
    """A polynomial, lowest power first, or a table joined by straight lines and level beyond its ends."""
    if len(curve) == 0:
        raise ModelError(f"thermostatic_valve: {name} is empty; give the manufacturer's polynomial or table")
    if not isinstance(curve[0], Sequence):
        coefficients = tuple(float(c) for c in curve)
        return lambda t: horner(coefficients, t)
    xs, ys = zip(*((float(a), float(b)) for a, b in curve), strict=True)
    if any(b <= a for a, b in pairwise(xs)):
        raise ModelError(f"thermostatic_valve: the table of {name} does not rise from row to row; sort it")

    def table(t: Any) -> Any:
        value: Any = ys[0]
        for (a, b), (low, high) in zip(pairwise(xs), pairwise(ys), strict=True):
            value = value + (high - low) / (b - a) * (minimum(maximum(t, a), b) - a)
        return value

    return table


def _plain(curve: Sequence[Any]) -> list[Any]:
    return [list(c) if isinstance(c, Sequence) else c for c in curve]


def _parameters(friction: str, output: str) -> tuple[Parameter, ...]:
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
        Parameter("noise", "m", "measurement noise of the opening", 2.4e-6, 1e-9, 1e-2, PAPER, kind="noise")
        if output == "opening"
        else Parameter("noise", "kg/s", "measurement noise of the flow", 5e-4, 1e-8, 1.0, PAPER, kind="noise"),
    ]
    return tuple(table)
