"""Plate heat exchanger: compartments on both sides (Andersen 2001, Paper B).

Correction to the paper
    Eq. 5 is printed as a difference of differences of neighbouring compartments; the driving force is the mean hot
    temperature of the pair minus the mean cold one, 1/2 (T_h,i-1 + T_h,i) - 1/2 (T_c,j-1 + T_c,j). In counter flow hot
    compartment i faces cold compartment j = n + 1 - i, each side counted along its own flow; in parallel flow j = i.

Transfer coefficients (Eq. 9-11)
    constant            U is a parameter
    flow                h = C m^y on each side, 1/U = 1/h_hot + 1/h_cold
    flow-symmetric      the same with one C for both sides, as in a plate exchanger with equal channels
    flow-temperature    h = K (1 + b T) m^y with T the mean temperature of the side

Dynamics
    compartments    water (and plates) warm up: for samples some seconds apart
    quasi-steady    the outlets follow at once: for samples further apart than water stays, see
                    :mod:`fdd.models.exchanger_steady`

At no flow h is 0 and its derivative for y < 1 is infinite: m^y is taken of sqrt(m^2 + (1e-7 kg/s)^2).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Literal

from fdd.models.declare import ComponentModel, Fault, ModelError, Namespace, Parameter, Plausible, Quantity, State
from fdd.models.exchanger_steady import SteadyExchanger, steady_exchanger
from fdd.models.fluid import chosen
from fdd.models.functions import exp, forward, log

PAPER = "Andersen (2001), Paper B"
TRANSFERS = ("constant", "flow", "flow-symmetric", "flow-temperature")
SMALL_FLOW = 1e-7  # kg/s
INPUTS = (
    Quantity("m_flow_hot", "kg/s", "flow on the hot (primary) side"),
    Quantity("m_flow_cold", "kg/s", "flow on the cold (secondary) side"),
    Quantity("T_hot_in", "degC", "inlet temperature of the hot side"),
    Quantity("T_cold_in", "degC", "inlet temperature of the cold side"),
)
OUTPUTS = (
    Quantity("T_hot_out", "degC", "outlet temperature of the hot side"),
    Quantity("T_cold_out", "degC", "outlet temperature of the cold side"),
)
VALID = {
    "m_flow_hot": (0.0, 200.0),
    "m_flow_cold": (0.0, 200.0),
    "T_hot_in": (0.0, 180.0),
    "T_cold_in": (-30.0, 150.0),
    "T_hot_out": (-30.0, 180.0),
    "T_cold_out": (-30.0, 180.0),
}
# Plates 2 to 3 mm apart that pass 3 to 5 kW/(m2 K) hold so much water on each side.
WATER_PER_TRANSFER = 7e-4  # kg per W/K


def heat_exchanger(
    compartments: int = 3,
    flow: Literal["counter", "parallel"] = "counter",
    transfer: Literal["constant", "flow", "flow-symmetric", "flow-temperature"] = "flow",
    metal: bool = False,
    heat_capacity_hot: float | None = None,
    heat_capacity_cold: float | None = None,
    fluid_hot: str = "water",
    fluid_cold: str = "water",
    dynamics: Literal["compartments", "quasi-steady"] = "compartments",
    flow_hot: float = 1.0,
    flow_cold: float = 1.0,
    exponent: float = 0.7,
) -> ComponentModel:
    """Plate heat exchanger model.

    Parameters
    ----------
    compartments : n compartments a side (Eq. 3-4)
    flow : ``"counter"`` or ``"parallel"``
    transfer : law of the transfer coefficient, see the module
    metal : with the plates' heat capacity as n further states (Sejling 1993); the fluids then exchange heat with it
    heat_capacity_hot, heat_capacity_cold : of the fluids [J/(kg K)]; the fluid's own where it is not given
    fluid_hot, fluid_cold : what flows on each side, see :mod:`fdd.models.fluid`
    dynamics : ``"compartments"``, or ``"quasi-steady"`` for samples further apart than water stays
    flow_hot, flow_cold : usual flows, at which the quasi-steady transfer is told [kg/s]
    exponent : of the flows in the quasi-steady transfer [1]; 0.7 for plates

    Raises
    ------
    ModelError : an option outside its range
    """
    if not 1 <= compartments <= 12:
        raise ModelError(f"heat_exchanger: {compartments} compartments a side; use 1 to 12 (3 in the paper)")
    if flow not in ("counter", "parallel"):
        raise ModelError(f"heat_exchanger: flow {flow!r} is unknown; use 'counter' or 'parallel'")
    if transfer not in TRANSFERS:
        raise ModelError(f"heat_exchanger: transfer {transfer!r} is unknown; use one of {', '.join(TRANSFERS)}")
    _, cp_hot, hot = chosen("heat_exchanger, hot side", fluid_hot, heat_capacity_hot)
    _, cp_cold, cold = chosen("heat_exchanger, cold side", fluid_cold, heat_capacity_cold)
    media = {**{f"{k}_hot": v for k, v in hot.items()}, **{f"{k}_cold": v for k, v in cold.items()}}
    if dynamics == "quasi-steady":
        _check_steady(transfer, metal, flow_hot, flow_cold, exponent)
        law = 0.0 if transfer == "constant" else exponent
        steady = SteadyExchanger(flow == "counter", law, (cp_hot, cp_cold), (flow_hot, flow_cold))
        made = {"dynamics": dynamics, "flow": flow, "transfer": transfer, "exponent": exponent}
        made |= {"flow_hot": flow_hot, "flow_cold": flow_cold}
        return steady_exchanger(steady, {**made, **media}, (INPUTS, OUTPUTS), VALID)
    if dynamics != "compartments":
        raise ModelError(f"heat_exchanger: dynamics {dynamics!r} is unknown; use 'compartments' or 'quasi-steady'")
    equations = _Equations(compartments, flow, transfer, metal, cp_hot, cp_cold)
    last = compartments
    return ComponentModel(
        name="heat_exchanger",
        version="1",
        title="Plate heat exchanger",
        states=_states(compartments, metal),
        inputs=INPUTS,
        outputs=OUTPUTS,
        parameters=_parameters(transfer, metal),
        drift=equations.drift,
        diffusion=equations.diffusion,
        observe=lambda x, u, p: {
            "T_hot_out": getattr(x, f"T_hot_{last}"),
            "T_cold_out": getattr(x, f"T_cold_{last}"),
        },
        noise=lambda x, u, p: {"T_hot_out": p.noise_hot, "T_cold_out": p.noise_cold},
        start=equations.start,
        options={
            "compartments": compartments,
            "flow": flow,
            "transfer": transfer,
            "metal": metal,
            **media,
        },
        valid=VALID,
        plausible=_plausible(transfer),
        faults=_faults(transfer),
        references=(
            "Andersen, K.K., Palsson, O.P., Madsen, H., Knudsen, L.H. (2000). Experimental design and setup for heat "
            "exchanger modelling. In: Andersen (2001), IMM-PHD-2001-79, Paper B.",
            "Jonsson, G., Palsson, O.P. (1994). An application of extended Kalman filtering to heat exchanger models.",
            "Sejling, K. (1993). Modelling and prediction of load in heating systems. IMSOR, DTU.",
        ),
    )


class _Equations:
    """Drift, diffusion and start of one variant."""

    def __init__(self, n: int, flow: str, transfer: str, metal: bool, cp_hot: float, cp_cold: float) -> None:
        self.n, self.counter, self.transfer, self.metal = n, flow == "counter", transfer, metal
        self.cp_hot, self.cp_cold = cp_hot, cp_cold

    def drift(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Eq. 3-4 with the corrected Eq. 5."""
        n = self.n
        hot = [u.T_hot_in, *(getattr(x, f"T_hot_{i + 1}") for i in range(n))]
        cold = [u.T_cold_in, *(getattr(x, f"T_cold_{i + 1}") for i in range(n))]
        mean_hot = [0.5 * (a + b) for a, b in pairwise(hot)]
        mean_cold = [0.5 * (a + b) for a, b in pairwise(cold)]
        facing = [n - 1 - i if self.counter else i for i in range(n)]
        from_hot, to_cold = [0.0] * n, [0.0] * n  # heat flows of the compartments, each side along its own flow [W]
        rates: dict[str, Any] = {}
        h_hot, h_cold = self._films(hot, cold, u, p)
        m_hot, m_cold = forward(u.m_flow_hot), forward(u.m_flow_cold)
        for i, j in enumerate(facing):
            if self.metal:
                wall = getattr(x, f"T_wall_{i + 1}")
                from_hot[i] = h_hot / n * (mean_hot[i] - wall)
                to_cold[j] = h_cold / n * (wall - mean_cold[j])
                rates[f"T_wall_{i + 1}"] = n * (from_hot[i] - to_cold[j]) / p.C_wall
            else:
                from_hot[i] = to_cold[j] = self._overall(h_hot, h_cold, p) / n * (mean_hot[i] - mean_cold[j])
        for i in range(n):
            rates[f"T_hot_{i + 1}"] = n * m_hot / p.M_hot * (hot[i] - hot[i + 1]) - n * from_hot[i] / (
                p.M_hot * self.cp_hot
            )
            rates[f"T_cold_{i + 1}"] = n * m_cold / p.M_cold * (cold[i] - cold[i + 1]) + n * to_cold[i] / (
                p.M_cold * self.cp_cold
            )
        return rates

    def _films(self, hot: list[Any], cold: list[Any], u: Namespace, p: Namespace) -> tuple[Any, Any]:
        """Film coefficients of the two sides [W/K] (Eq. 9 and 10)."""
        if self.transfer == "constant":
            return 2.0 * p.UA, 2.0 * p.UA
        m_hot, m_cold = _power(forward(u.m_flow_hot), p.y), _power(forward(u.m_flow_cold), p.y)
        if self.transfer == "flow-symmetric":
            return p.C * m_hot, p.C * m_cold
        if self.transfer == "flow":
            return p.C_hot * m_hot, p.C_cold * m_cold
        return (
            p.K_hot * (1.0 + p.b * 0.5 * (hot[0] + hot[-1])) * m_hot,
            p.K_cold * (1.0 + p.b * 0.5 * (cold[0] + cold[-1])) * m_cold,
        )

    def _overall(self, h_hot: Any, h_cold: Any, p: Namespace) -> Any:
        """Eq. 11."""
        return p.UA if self.transfer == "constant" else 1.0 / (1.0 / h_hot + 1.0 / h_cold)

    def diffusion(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """One intensity a side; the plates are as noisy as the hot side."""
        intensity = {f"T_hot_{i + 1}": p.sigma_hot for i in range(self.n)}
        intensity |= {f"T_cold_{i + 1}": p.sigma_cold for i in range(self.n)}
        if self.metal:
            intensity |= {f"T_wall_{i + 1}": p.sigma_hot for i in range(self.n)}
        return intensity

    def start(self, y: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Straight lines from inlet to outlet."""
        n = self.n
        share = [(i + 1) / n for i in range(n)]
        state = {f"T_hot_{i + 1}": u.T_hot_in + (y.T_hot_out - u.T_hot_in) * s for i, s in enumerate(share)}
        state |= {f"T_cold_{i + 1}": u.T_cold_in + (y.T_cold_out - u.T_cold_in) * s for i, s in enumerate(share)}
        if self.metal:
            for i in range(n):
                j = n - 1 - i if self.counter else i
                state[f"T_wall_{i + 1}"] = 0.5 * (state[f"T_hot_{i + 1}"] + state[f"T_cold_{j + 1}"])
        return state


def _check_steady(transfer: str, metal: bool, flow_hot: float, flow_cold: float, exponent: float) -> None:
    if metal:
        raise ModelError("heat_exchanger: quasi-steady outlets do not show the plates' heat capacity; drop 'metal'")
    if transfer == "flow-temperature":
        raise ModelError("heat_exchanger: quasi-steady transfer is 'constant', 'flow' or 'flow-symmetric'")
    if not (flow_hot > 0 and flow_cold > 0):
        raise ModelError(f"heat_exchanger: usual flows {flow_hot} and {flow_cold} kg/s; give positive ones")
    if not 0.0 <= exponent <= 1.2:
        raise ModelError(f"heat_exchanger: exponent {exponent} is outside [0, 1.2]; plates have 0.6 to 0.8")


def _plausible(transfer: str) -> tuple[Plausible, ...]:
    """Water content over transfer at 1 kg/s, each side."""

    def transfer_of(p: Mapping[str, float]) -> float:
        if transfer == "constant":
            return p["U"]
        if transfer == "flow-symmetric":
            return 0.5 * p["C"]
        letter = "C" if transfer == "flow" else "K"
        return 1.0 / (1.0 / p[f"{letter}_hot"] + 1.0 / p[f"{letter}_cold"])

    def content(side: str) -> Plausible:
        return Plausible(
            f"water on the {side} side over the transfer at 1 kg/s",
            lambda p: p[f"M_{side}"] / transfer_of(p),
            "kg K/W",
            WATER_PER_TRANSFER,
            8.0,
            f"give M_{side} from the plate (parameters: {{M_{side}: {{plate: ...}}}}) or let fdd fit take quasi-steady "
            "outlets (drop the options compartments and metal)",
        )

    return tuple(content(side) for side in ("hot", "cold"))


def _power(flow: Any, y: Any) -> Any:
    """|m|^y, with a finite slope at no flow."""
    return exp(0.5 * y * log(flow * flow + SMALL_FLOW * SMALL_FLOW))


def _states(n: int, metal: bool) -> tuple[State, ...]:
    states = [State(f"T_hot_{i + 1}", "degC", f"hot compartment {i + 1} along its flow", 2.0) for i in range(n)]
    states += [State(f"T_cold_{i + 1}", "degC", f"cold compartment {i + 1} along its flow", 2.0) for i in range(n)]
    if metal:
        states += [State(f"T_wall_{i + 1}", "degC", f"plates at hot compartment {i + 1}", 2.0) for i in range(n)]
    return tuple(states)


def _coefficients(transfer: str) -> list[Parameter]:
    exponent = Parameter("y", "1", "exponent of the flow", 0.7, 0.2, 1.2, f"{PAPER}, Eq. 10", transform="logit")
    film = ("W/K (kg/s)^-y", 8e3, 10.0, 1e7)
    if transfer == "constant":
        return [
            Parameter("UA", "W/K", "overall heat transfer coefficient times area", 4e3, 10.0, 1e7, f"{PAPER}, Eq. 3")
        ]
    if transfer == "flow-symmetric":
        return [
            Parameter("C", film[0], "film coefficient of either side at 1 kg/s", *film[1:], f"{PAPER}, Eq. 10"),
            exponent,
        ]
    symbol, equation = ("C", "Eq. 10") if transfer == "flow" else ("K", "Eq. 9")
    sides = [
        Parameter(
            f"{symbol}_{side}",
            film[0],
            f"film coefficient of the {side} side at 1 kg/s",
            *film[1:],
            f"{PAPER}, {equation}",
        )
        for side in ("hot", "cold")
    ]
    if transfer == "flow-temperature":
        slope = Parameter(
            "b", "1/K", "slope of the film coefficients with temperature", 0.008, 1e-4, 0.1, f"{PAPER}, Eq. 9"
        )
        return [*sides, slope, exponent]
    return [*sides, exponent]


def _parameters(transfer: str, metal: bool) -> tuple[Parameter, ...]:
    table = [
        Parameter(f"M_{side}", "kg", f"water on the {side} side", 5.0, 0.05, 5e3, f"{PAPER}, Eq. 3-4")
        for side in ("hot", "cold")
    ]
    table += _coefficients(transfer)
    if metal:
        table.append(Parameter("C_wall", "J/K", "heat capacity of the plates", 2e4, 100.0, 1e7, "Sejling (1993)"))
    for side in ("hot", "cold"):
        table.append(
            Parameter(
                f"sigma_{side}",
                "K/s^0.5",
                f"process noise of the {side} side",
                0.02,
                1e-6,
                2.0,
                f"{PAPER}",
                kind="noise",
            )
        )
    for side in ("hot", "cold"):
        table.append(
            Parameter(
                f"noise_{side}",
                "K",
                f"measurement noise of the {side} outlet",
                0.05,
                1e-3,
                5.0,
                f"{PAPER}",
                kind="noise",
            )
        )
    return tuple(table)


def _faults(transfer: str) -> tuple[Fault, ...]:
    films = {
        "constant": ("UA",),
        "flow": ("C_hot", "C_cold"),
        "flow-symmetric": ("C",),
        "flow-temperature": ("K_hot", "K_cold"),
    }
    lower: dict[str, int] = dict.fromkeys(films[transfer], -1)
    return (
        Fault(
            "fouling",
            "deposits on the plates: less heat passes at the same flows",
            {**lower, "innovation:T_hot_out": 1, "innovation:T_cold_out": -1},
            (
                "compare the primary return temperature with the secondary return: the gap grows with fouling",
                "measure the pressure drop on both sides",
                "clean the plates; check the strainer and the water treatment",
            ),
        ),
        Fault(
            "bias",
            "an outlet sensor reads wrong by a constant",
            {"innovation:T_hot_out": 1},
            (
                "compare the sensor with a hand-held one in the same pocket",
                "look at the pocket's contact and insulation",
            ),
        ),
        Fault(
            "scaling",
            "a flow meter reads a wrong share of the flow",
            {"innovation:T_hot_out": 1, "innovation:T_cold_out": 1},
            (
                "compare the heat given off by the hot side with that taken up by the cold side",
                "check the meter's pulse value",
            ),
        ),
    )
