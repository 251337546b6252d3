"""Water radiator: two compartments whose boundary moves with the flow (Andersen 2001, Paper D), and fixed siblings.

Hot water enters at the top and pushes the boundary between warm and cool water down; without flow the boundary rises
again. Moving the boundary with the flow describes with two compartments what fixed ones need many for.

Corrections to the paper
    Eq. 7 and 12 take the outflow of the upper compartment twice; here it gains cp m (T_supply - T_upper), the lower one
    cp m (T_upper - T_lower), so that together they take up what the water gives off. Water that changes sides with the
    boundary carries its enthalpy (conservative). The area fraction follows Eq. 10's balance a m against b, but on the
    logit scale, dL/dt = b (ln(a m / b) - L), so that it stays inside ]0, 1[ whatever the noise does. The power n of
    the temperature difference is signed and smooth at zero. ``form="printed"`` gives the paper's own equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Plausible, Quantity, State
from fdd.models.fluid import chosen
from fdd.models.functions import exp, forward, gpow, log, sqrt

SMALLEST_SECTION = 0.02  # no compartment is thinner than this share of the radiator: its water is always moving
SEEPAGE = 1e-5  # kg/s added to the flow in the boundary's balance, so that a closed valve has a logarithm

PAPER = "Andersen (2001), Paper D"
# Panel radiators hold 3 to 5 kg of water and 15 to 30 kg of steel for a kilowatt at 50 K (EN 442 data sheets).
CAPACITY_PER_EMISSION = 20.0  # J/(K W)


def radiator(
    form: Literal["corrected", "printed"] = "corrected",
    sections: Literal["moving"] | int = "moving",
    surroundings: bool = True,
    exponent: float = 1.3,
    heat_capacity: float | None = None,
    fluid: str = "water",
) -> ComponentModel:
    """Radiator model.

    Parameters
    ----------
    form : ``"corrected"`` (conservative) or ``"printed"`` (Eq. 12-15 as they stand in the paper, for comparison)
    sections : ``"moving"`` for the paper's two compartments, or a number of fixed equal ones
    surroundings : with the warm air around the radiator as a state (Eq. 9); False lets it give off heat to the room
    exponent : radiator exponent n [1], EN 442: 1.2 to 1.4
    heat_capacity : of the heating water [J/(kg K)]; the fluid's where it is not given
    fluid : what flows, see :mod:`fdd.models.fluid`

    Raises
    ------
    ModelError : an option outside its range
    """
    _check(form, sections, surroundings, exponent)
    _, cp, medium = chosen("radiator", fluid, heat_capacity)
    moving = sections == "moving"
    count = 2 if isinstance(sections, str) else sections
    equations = _Equations(form, count, moving, surroundings, exponent, cp)
    return ComponentModel(
        name="radiator",
        version="1",
        title="Water radiator",
        states=_states(form, count, moving, surroundings),
        inputs=(
            Quantity("T_supply", "degC", "water temperature at the inlet"),
            Quantity("T_room", "degC", "room air temperature"),
            Quantity("m_flow", "kg/s", "water flow"),
        ),
        outputs=(Quantity("T_return", "degC", "water temperature at the outlet"),),
        parameters=_parameters(form, moving, surroundings),
        drift=equations.drift,
        diffusion=equations.diffusion,
        observe=lambda x, u, p: {"T_return": getattr(x, f"T_{count}")},
        noise=lambda x, u, p: {"T_return": p.noise_return},
        start=equations.start,
        options={
            "form": form,
            "sections": sections,
            "surroundings": surroundings,
            "exponent": exponent,
            **medium,
        },
        valid={"T_supply": (5.0, 110.0), "T_room": (-10.0, 40.0), "m_flow": (0.0, 20.0), "T_return": (5.0, 110.0)},
        faults=FAULTS,
        plausible=(
            Plausible(
                "heat capacity over the emission at 50 K",
                lambda p: p["C"] / (p["H"] * 50.0**exponent),
                "J/(K W)",
                CAPACITY_PER_EMISSION,
                5.0,
                "see that flow and temperatures are those of the radiators alone, or give C from the data sheet "
                "(parameters: {C: {plate: ...}})",
            ),
        ),
        references=(
            "Andersen, K.K., Hansen, L.H., Madsen, H. (2000). A model for the heat dynamics of a radiator. "
            "In: Andersen (2001), Stochastic Modelling of Energy Systems, IMM-PHD-2001-79, Paper D.",
            "EN 442-2: Radiators and convectors - Test methods and rating.",
        ),
    )


class _Equations:
    """Drift, diffusion and start of one variant."""

    def __init__(self, form: str, count: int, moving: bool, surroundings: bool, exponent: float, cp: float) -> None:
        self.printed = form == "printed"
        self.count, self.moving, self.surroundings = count, moving, surroundings
        self.exponent, self.cp = exponent, cp

    def drift(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Energy balances of the compartments and of the air around, and the boundary's balance."""
        temperatures = [getattr(x, f"T_{i + 1}") for i in range(self.count)]
        flow = forward(u.m_flow)
        around = x.T_air if self.surroundings else u.T_room
        emitted = [gpow(t - around, self.exponent) for t in temperatures]
        if self.moving:
            share = x.A if self.printed else _share(x.L)
            shares = [share, 1.0 - share]
        else:
            shares = [1.0 / self.count] * self.count
        rates = {}
        if self.printed:
            rates["A"] = p.a * u.m_flow - p.b * x.A
            gains = self._printed_gains(x, u)
        else:
            gains = [self.cp * flow * (a - b) for a, b in zip([u.T_supply, *temperatures], temperatures, strict=False)]
            if self.moving:
                rates["L"] = p.b * (log(p.a * (flow + SEEPAGE) / p.b) - x.L)
                gains = self._moved(gains, rates["L"], x, p)
        for i, (gain, section, heat) in enumerate(zip(gains, shares, emitted, strict=True)):
            rates[f"T_{i + 1}"] = gain / (p.C * section) - p.H / p.C * heat
        if self.surroundings:
            to_air = sum(p.H * s * h for s, h in zip(shares, emitted, strict=True))
            rates["T_air"] = to_air / p.C_air - p.B_air / p.C_air * (x.T_air - u.T_room)
        return rates

    def _printed_gains(self, x: Namespace, u: Namespace) -> list[Any]:
        """Eq. 12-13 as printed: the outflow of the upper compartment is taken twice."""
        flow = self.cp * u.m_flow
        return [flow * (u.T_supply - 2.0 * x.T_1 + x.T_2), flow * (x.T_1 - x.T_2)]

    def _moved(self, gains: list[Any], rate: Any, x: Namespace, p: Namespace) -> list[Any]:
        """The compartment that grows takes in water at the other's temperature [W]."""
        weight = 1.0 / (1.0 + exp(-x.L))
        growth = (1.0 - 2.0 * SMALLEST_SECTION) * weight * (1.0 - weight) * rate
        # Positive part, smooth within 1e-6 of the radiator a second; the two parts differ by exactly the growth.
        up = 0.5 * (growth + sqrt(growth * growth + 1e-12))
        down = up - growth
        return [gains[0] + p.C * up * (x.T_2 - x.T_1), gains[1] + p.C * down * (x.T_1 - x.T_2)]

    def diffusion(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """One intensity for the compartments, one for the air, one for the boundary."""
        intensity = {f"T_{i + 1}": p.sigma_T for i in range(self.count)}
        if self.surroundings:
            intensity["T_air"] = p.sigma_air
        if self.moving:
            intensity["A" if self.printed else "L"] = p.sigma_A
        return intensity

    def start(self, y: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """A straight line from supply to return; the boundary at rest."""
        n = self.count
        state: dict[str, Any] = {
            f"T_{i + 1}": y.T_return + (u.T_supply - y.T_return) * (n - 1 - i) / (2.0 * n) for i in range(n)
        }
        if self.surroundings:
            state["T_air"] = u.T_room
        if self.moving:
            if self.printed:
                state["A"] = 0.5
            else:
                state["L"] = log(p.a * (forward(u.m_flow) + SEEPAGE) / p.b)
        return state


def _share(logit: Any) -> Any:
    """Area fraction of the upper compartment, inside ]0, 1[ by construction."""
    return SMALLEST_SECTION + (1.0 - 2.0 * SMALLEST_SECTION) / (1.0 + exp(-logit))


def _check(form: str, sections: str | int, surroundings: bool, exponent: float) -> None:
    if form not in ("corrected", "printed"):
        raise ModelError(f"radiator: form {form!r} is unknown; use 'corrected' or 'printed'")
    if isinstance(sections, str):
        if sections != "moving":
            raise ModelError(f"radiator: sections {sections!r} is unknown; use 'moving' or a number of fixed ones")
    elif not 1 <= sections <= 20:
        raise ModelError(f"radiator: {sections} fixed sections; use 1 to 20")
    if form == "printed" and (sections != "moving" or not surroundings):
        raise ModelError("radiator: the printed form has moving sections and surroundings; drop those options")
    if not 1.0 <= exponent <= 2.0:
        raise ModelError(f"radiator: exponent {exponent} is outside [1, 2]; EN 442 radiators have 1.2 to 1.4")


def _states(form: str, count: int, moving: bool, surroundings: bool) -> tuple[State, ...]:
    states = [
        State(f"T_{i + 1}", "degC", f"water and metal of section {i + 1} from the top", 2.0) for i in range(count)
    ]
    if surroundings:
        states.append(State("T_air", "degC", "air around the radiator", 2.0))
    if moving and form == "printed":
        states.append(State("A", "1", "share of the upper compartment", 0.1))
    elif moving:
        states.append(State("L", "1", "logit of the upper compartment's share", 0.5))
    return tuple(states)


def _parameters(form: str, moving: bool, surroundings: bool) -> tuple[Parameter, ...]:
    table = [
        Parameter("C", "J/K", "heat capacity of water and metal", 5e4, 500.0, 5e6, f"{PAPER}, Eq. 6"),
        Parameter(
            "H",
            "W/K^n",
            "heat transfer to the air: emitted power per (K difference)^n",
            10.0,
            0.05,
            2e3,
            f"{PAPER}, Eq. 7",
        ),
    ]
    if surroundings:
        table += [
            Parameter("C_air", "J/K", "heat capacity of the air around", 9e3, 50.0, 1e6, f"{PAPER}, Eq. 9"),
            Parameter("B_air", "W/K", "transfer from the air around to the room", 60.0, 0.5, 1e4, f"{PAPER}, Eq. 9"),
        ]
    if moving:
        table += [
            Parameter(
                "a", "1/kg", "how the upper compartment grows with the flow", 0.1, 1e-4, 20.0, f"{PAPER}, Eq. 10"
            ),
            Parameter("b", "1/s", "how it shrinks by natural drift", 1.5e-3, 1e-5, 0.1, f"{PAPER}, Eq. 10"),
        ]
    table.append(
        Parameter(
            "sigma_T", "K/s^0.5", "process noise of the water", 5e-3, 1e-6, 1.0, f"{PAPER}, Eq. 12-13", kind="noise"
        )
    )
    if surroundings:
        table.append(
            Parameter(
                "sigma_air",
                "K/s^0.5",
                "process noise of the air around",
                1e-2,
                1e-6,
                1.0,
                f"{PAPER}, Eq. 14",
                kind="noise",
            )
        )
    if moving:
        table.append(
            Parameter(
                "sigma_A", "1/s^0.5", "process noise of the boundary", 1e-3, 1e-7, 0.5, f"{PAPER}, Eq. 15", kind="noise"
            )
        )
    table.append(
        Parameter(
            "noise_return",
            "K",
            "measurement noise of the return temperature",
            0.05,
            1e-3,
            5.0,
            f"{PAPER}, Eq. 16",
            kind="noise",
        )
    )
    return tuple(table)


FAULTS = (
    Fault(
        "air",
        "air in the upper part: less surface gives off heat",
        {"H": -1, "C": -1, "innovation:T_return": 1},
        (
            "feel the top of the radiator: cold means air",
            "bleed it, then check the system pressure and the expansion vessel",
        ),
    ),
    Fault(
        "sludge",
        "deposits in the lower part: less flow and less surface",
        {"H": -1, "innovation:T_return": 1},
        (
            "feel the lower middle: cold means sludge",
            "compare the flow at full opening with its design",
            "flush the radiator",
        ),
    ),
    Fault(
        "covered",
        "furniture or curtains hinder the air",
        {"H": -1, "innovation:T_return": 1},
        ("look whether the radiator stands free",),
    ),
    Fault(
        "bias",
        "the return sensor reads wrong by a constant",
        {"innovation:T_return": 1},
        (
            "compare the sensor with a hand-held one",
            "look whether a pipe-mounted sensor has lost contact or insulation",
        ),
    ),
)
