"""Building: rooms of an air zone and a floor zone with walls between them (Andersen 2001, Paper F, Eq. 10-19).

Light walls have a resistance and no capacity of their own; the room's air carries that of furniture and inner linings;
the floor is the slow store. Eq. 17-18 of the paper are one equation on two lines. The two-room test house is
``building(rooms=("south", "north"), outside="each", boundary=True)``; its Tab. 1 gives time constants of 33 and
57 minutes and of 22.6 and 62.9 hours (the paper's Tab. 2 does not follow from its Tab. 1).

Radiator power (``heating``)
    power      P is an input [W]
    water      Eq. 12: cp m (T_supply - T_return) from measured water temperatures and flow
    mean       Eq. 13: c ((T_supply + T_return)/2 - T_room), where the flow is not known and varies little
    dynamic    Eq. 14: C_r dT_rad/dt = cp m (T_supply - T_return) - H (T_rad - T_room)^n, the second term heats the room
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Quantity, State
from fdd.models.fluid import chosen
from fdd.models.functions import forward, gpow

PAPER = "Andersen (2001), Paper F"
HEATING = ("power", "water", "mean", "dynamic")


def building(
    rooms: Sequence[str] = ("south", "north"),
    walls: Sequence[Sequence[str]] | None = None,
    outside: Literal["common", "each"] = "common",
    boundary: bool = False,
    heating: Literal["power", "water", "mean", "dynamic"] = "power",
    solar_split: float = 0.1,
    exponent: float = 1.3,
    heat_capacity: float | None = None,
    fluid: str = "water",
) -> ComponentModel:
    """Building model.

    Parameters
    ----------
    rooms : their names; each has air and floor temperature, a window, a radiator and other heat gains
    walls : pairs of rooms that share a wall; by default each room and the next
    outside : one outdoor temperature, or ``"each"`` room its own (a sunny facade is warmer)
    boundary : with a neighbouring space at a measured temperature behind every room (the paper's room B)
    heating : how the radiators' power comes in, see the module
    solar_split : share of the sun that reaches the floor directly (Eq. 9) [1]
    exponent : radiator exponent for ``heating="dynamic"`` [1]
    heat_capacity : of the heating water [J/(kg K)]; the fluid's where it is not given
    fluid : what flows through the radiators, see :mod:`fdd.models.fluid`

    Raises
    ------
    ModelError : an option outside its range
    """
    rooms = tuple(rooms)
    pairs = tuple((a, b) for a, b in (walls if walls is not None else pairwise(rooms)))
    _check(rooms, pairs, outside, heating, solar_split)
    _, cp, medium = chosen("building", fluid, heat_capacity)
    house = _House(rooms, pairs, outside, boundary, heating, solar_split, exponent, cp)
    return ComponentModel(
        name="building",
        version="1",
        title="Building of rooms with air and floor zones",
        states=house.states(),
        inputs=house.inputs(),
        outputs=tuple(Quantity(f"T_{r}", "degC", f"air temperature of room {r}") for r in rooms),
        parameters=house.parameters(),
        drift=house.drift,
        diffusion=house.diffusion,
        observe=lambda x, u, p: {f"T_{r}": getattr(x, f"T_air_{r}") for r in rooms},
        noise=lambda x, u, p: {f"T_{r}": getattr(p, f"noise_{r}") for r in rooms},
        start=house.start,
        options={
            "rooms": list(rooms),
            "walls": [list(pair) for pair in pairs],
            "outside": outside,
            "boundary": boundary,
            "heating": heating,
            "solar_split": solar_split,
            "exponent": exponent,
            **medium,
        },
        valid={
            **{
                q.symbol: (-50.0, 60.0)
                for q in house.inputs()
                if q.symbol.startswith("T_out") or q.symbol == "T_boundary"
            },
            **{f"I_{r}": (0.0, 1400.0) for r in rooms},
            **{f"T_{r}": (-20.0, 60.0) for r in rooms},
        },
        faults=house.faults(),
        references=(
            "Andersen, K.K., Madsen, H., Hansen, L.H. (2000). Modelling the heat dynamics of a building using "
            "stochastic differential equations. Energy and Buildings 31(1), 13-24. doi:10.1016/S0378-7788(98)00069-3",
        ),
    )


def _check(
    rooms: tuple[str, ...], pairs: tuple[tuple[str, str], ...], outside: str, heating: str, solar_split: float
) -> None:
    if not rooms:
        raise ModelError("building: no rooms; name at least one")
    for room in rooms:
        if not room.isidentifier() or rooms.count(room) > 1:
            raise ModelError(f"building: room {room!r} is not a name of its own; use letters, digits and _, each once")
    for a, b in pairs:
        for room in (a, b):
            if room not in rooms:
                raise ModelError(
                    f"building: wall {a}-{b} names the unknown room {room!r}; rooms are {', '.join(rooms)}"
                )
    if outside not in ("common", "each"):
        raise ModelError(f"building: outside {outside!r} is unknown; use 'common' or 'each'")
    if heating not in HEATING:
        raise ModelError(f"building: heating {heating!r} is unknown; use one of {', '.join(HEATING)}")
    if not 0.0 <= solar_split <= 1.0:
        raise ModelError(f"building: solar_split {solar_split} is outside [0, 1]")


class _House:
    """Tables and equations of one building."""

    def __init__(
        self,
        rooms: tuple[str, ...],
        walls: tuple[tuple[str, str], ...],
        outside: str,
        boundary: bool,
        heating: str,
        solar_split: float,
        exponent: float,
        cp: float,
    ) -> None:
        self.rooms, self.walls, self.each, self.boundary = rooms, walls, outside == "each", boundary
        self.heating, self.split, self.exponent, self.cp = heating, solar_split, exponent, cp

    def states(self) -> tuple[State, ...]:
        states = []
        for r in self.rooms:
            states.append(State(f"T_air_{r}", "degC", f"air of room {r} with what follows it quickly", 0.5))
            states.append(State(f"T_floor_{r}", "degC", f"floor of room {r}", 1.0))
        if self.heating == "dynamic":
            states += [State(f"T_rad_{r}", "degC", f"mean radiator temperature in room {r}", 5.0) for r in self.rooms]
        return tuple(states)

    def inputs(self) -> tuple[Quantity, ...]:
        if self.each:
            table = [Quantity(f"T_out_{r}", "degC", f"outdoor temperature at room {r}") for r in self.rooms]
        else:
            table = [Quantity("T_out", "degC", "outdoor temperature")]
        if self.boundary:
            table.append(Quantity("T_boundary", "degC", "air temperature of the neighbouring space"))
        table += [Quantity(f"I_{r}", "W/m^2", f"sun on the window of room {r}") for r in self.rooms]
        if self.heating == "power":
            table += [Quantity(f"P_heat_{r}", "W", f"radiator power in room {r}") for r in self.rooms]
        else:
            table.append(Quantity("T_supply", "degC", "supply temperature of the radiators"))
            table += [
                Quantity(f"T_return_{r}", "degC", f"return temperature of the radiator in room {r}") for r in self.rooms
            ]
            if self.heating != "mean":
                table += [
                    Quantity(f"m_flow_{r}", "kg/s", f"water flow of the radiator in room {r}") for r in self.rooms
                ]
        table += [Quantity(f"P_gain_{r}", "W", f"other heat gains in room {r}") for r in self.rooms]
        return tuple(table)

    def parameters(self) -> tuple[Parameter, ...]:
        table = []
        for r in self.rooms:
            table += [
                Parameter(
                    f"B_out_{r}", "W/K", f"conductance from room {r} to the outside", 60.0, 0.1, 1e5, f"{PAPER}, Eq. 15"
                ),
                Parameter(
                    f"B_floor_{r}",
                    "W/K",
                    f"conductance from air to floor of room {r}",
                    400.0,
                    0.5,
                    1e6,
                    f"{PAPER}, Eq. 16",
                ),
                Parameter(
                    f"C_air_{r}",
                    "J/K",
                    f"heat capacity of the air zone of room {r}",
                    2e6,
                    1e4,
                    1e10,
                    f"{PAPER}, Eq. 15",
                ),
                Parameter(
                    f"C_floor_{r}",
                    "J/K",
                    f"heat capacity of the floor of room {r}",
                    1.5e7,
                    5e4,
                    1e11,
                    f"{PAPER}, Eq. 16",
                ),
                Parameter(f"A_{r}", "m^2", f"effective window area of room {r}", 2.0, 1e-3, 1e4, f"{PAPER}, Eq. 8"),
            ]
            if self.heating == "mean":
                table.append(
                    Parameter(
                        f"c_{r}", "W/K", f"radiator power per kelvin in room {r}", 40.0, 0.1, 1e5, f"{PAPER}, Eq. 13"
                    )
                )
            if self.heating == "dynamic":
                table.append(
                    Parameter(
                        f"C_rad_{r}",
                        "J/K",
                        f"heat capacity of the radiator in room {r}",
                        5e4,
                        500.0,
                        1e8,
                        f"{PAPER}, Eq. 14",
                    )
                )
                table.append(
                    Parameter(
                        f"H_rad_{r}", "W/K^n", f"radiator transfer in room {r}", 10.0, 0.05, 1e5, f"{PAPER}, Eq. 14"
                    )
                )
        table += [
            Parameter(_wall(a, b), "W/K", f"conductance of the wall {a}-{b}", 30.0, 0.05, 1e5, f"{PAPER}, Eq. 15")
            for a, b in self.walls
        ]
        if self.boundary:
            table.append(
                Parameter(
                    "B_boundary",
                    "W/K",
                    "conductance of each room to the neighbouring space",
                    10.0,
                    0.05,
                    1e5,
                    f"{PAPER}, Eq. 15",
                )
            )
        for r in self.rooms:
            table.append(
                Parameter(
                    f"sigma_air_{r}",
                    "K/s^0.5",
                    f"process noise of the air of {r}",
                    1e-3,
                    1e-7,
                    0.1,
                    f"{PAPER}, Eq. 20",
                    kind="noise",
                )
            )
            table.append(
                Parameter(
                    f"sigma_floor_{r}",
                    "K/s^0.5",
                    f"process noise of the floor of {r}",
                    3e-4,
                    1e-7,
                    0.1,
                    f"{PAPER}, Eq. 20",
                    kind="noise",
                )
            )
            if self.heating == "dynamic":
                table.append(
                    Parameter(
                        f"sigma_rad_{r}",
                        "K/s^0.5",
                        f"process noise of the radiator in {r}",
                        5e-3,
                        1e-6,
                        1.0,
                        f"{PAPER}, Eq. 20",
                        kind="noise",
                    )
                )
        table += [
            Parameter(
                f"noise_{r}",
                "K",
                f"measurement noise of the air of {r}",
                0.03,
                1e-3,
                2.0,
                f"{PAPER}, Eq. 21",
                kind="noise",
            )
            for r in self.rooms
        ]
        return tuple(table)

    def drift(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Eq. 15-19 for any number of rooms."""
        rates: dict[str, Any] = {}
        for r in self.rooms:
            air, floor = getattr(x, f"T_air_{r}"), getattr(x, f"T_floor_{r}")
            outdoor = getattr(u, f"T_out_{r}") if self.each else u.T_out
            sun = getattr(p, f"A_{r}") * getattr(u, f"I_{r}")
            to_floor = getattr(p, f"B_floor_{r}") * (air - floor)
            heat = getattr(p, f"B_out_{r}") * (outdoor - air) - to_floor + (1.0 - self.split) * sun
            heat = heat + getattr(u, f"P_gain_{r}") + self._radiator(r, air, x, u, p, rates)
            for a, b in self.walls:
                if r in (a, b):
                    other = getattr(x, f"T_air_{b if r == a else a}")
                    heat = heat + getattr(p, _wall(a, b)) * (other - air)
            if self.boundary:
                heat = heat + p.B_boundary * (u.T_boundary - air)
            rates[f"T_air_{r}"] = heat / getattr(p, f"C_air_{r}")
            rates[f"T_floor_{r}"] = (to_floor + self.split * sun) / getattr(p, f"C_floor_{r}")
        return rates

    def _radiator(self, r: str, air: Any, x: Namespace, u: Namespace, p: Namespace, rates: dict[str, Any]) -> Any:
        """Power into the room's air [W]: an input, Eq. 12, 13 or 14."""
        if self.heating == "power":
            return getattr(u, f"P_heat_{r}")
        back = getattr(u, f"T_return_{r}")
        if self.heating == "mean":
            return getattr(p, f"c_{r}") * (0.5 * (u.T_supply + back) - air)
        water = self.cp * forward(getattr(u, f"m_flow_{r}")) * (u.T_supply - back)
        if self.heating == "water":
            return water
        power = getattr(p, f"H_rad_{r}") * gpow(getattr(x, f"T_rad_{r}") - air, self.exponent)
        rates[f"T_rad_{r}"] = (water - power) / getattr(p, f"C_rad_{r}")
        return power

    def diffusion(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        intensity = {}
        for r in self.rooms:
            intensity[f"T_air_{r}"] = getattr(p, f"sigma_air_{r}")
            intensity[f"T_floor_{r}"] = getattr(p, f"sigma_floor_{r}")
            if self.heating == "dynamic":
                intensity[f"T_rad_{r}"] = getattr(p, f"sigma_rad_{r}")
        return intensity

    def start(self, y: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Floors as warm as the air; radiators between supply and return."""
        state = {}
        for r in self.rooms:
            state[f"T_air_{r}"] = state[f"T_floor_{r}"] = getattr(y, f"T_{r}")
            if self.heating == "dynamic":
                state[f"T_rad_{r}"] = 0.5 * (u.T_supply + getattr(u, f"T_return_{r}"))
        return state

    def faults(self) -> tuple[Fault, ...]:
        table = []
        for r in self.rooms:
            table.append(
                Fault(
                    f"open-window-{r}",
                    f"more heat leaves room {r} than its envelope explains",
                    {f"B_out_{r}": 1, f"innovation:T_{r}": -1},
                    (
                        f"look for open windows and doors in room {r}",
                        "check the ventilation's schedule and supply temperature",
                    ),
                )
            )
            table.append(
                Fault(
                    f"bias-{r}",
                    f"the sensor of room {r} reads wrong by a constant",
                    {f"innovation:T_{r}": 1},
                    (
                        f"compare the sensor of room {r} with a hand-held one",
                        "look whether sun or a heat source reaches it",
                    ),
                )
            )
        return tuple(table)


def _wall(a: str, b: str) -> str:
    return f"B_{a}_{b}"
