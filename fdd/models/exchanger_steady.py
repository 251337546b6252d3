"""Plate heat exchanger whose outlets follow its inlets at once: what is left of it where samples are far apart.

Water passes a plate exchanger in seconds (about two for every transfer unit). Samples a minute or more apart say
nothing of its content and of the plates' heat capacity; asked for them a search ends anywhere. Here the outlets are
those of the steady exchanger by transfer units (VDI Heat Atlas, C1).

    1/UA = e^-w/UA_ref (1/2 (m_hot/m_hot,ref)^-y + 1/2 (m_cold/m_cold,ref)^-y)

Both sides of equal plates have equal films at the reference flows, the usual ones, and the exponent y is that of
plates: flows that are read with errors would make any other of it. ``w`` is what viscosity, uneven flow and the law
leave; it fades away within hours, so that lasting changes are those of ``UA``. ``balance`` is the share of its reading
by which the hot flow fits the heat that the cold side takes up. Meters resolve a flow to so many kg/s (pulses): an
error of a flow shows in both outlets, the more the smaller the flow is. Where a flow is a small share of the usual one
water stands, and outlets say next to nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fdd.models.declare import ComponentModel, Fault, Namespace, Parameter, Plausible, Quantity, State
from fdd.models.functions import absolute, exp, forward, log, minimum, sqrt, where

ATLAS = "VDI Heat Atlas, C1"
LEAST_SHARE = 0.01  # of the reference flow: below it water stands
SLOW = 0.05  # of the reference flow: at so little water has stayed long enough to be at any temperature
STEP = 0.1  # relative change of a flow by which its effect on the outlets is found


class SteadyExchanger:
    """Equations; capacities of the fluids in J/(kg K), reference flows in kg/s, each hot and cold."""

    def __init__(self, counter: bool, exponent: float, cp: tuple[float, float], flows: tuple[float, float]) -> None:
        self.counter, self.exponent, self.cp, self.usual = counter, exponent, cp, flows
        self.cp_hot, self.cp_cold = cp
        self.flow_hot, self.flow_cold = flows

    def transfer(self, hot: Any, cold: Any, p: Namespace) -> Any:
        """Overall transfer [W/K] at two flows [kg/s]."""
        if not self.exponent:
            return p.UA
        films = 0.5 * _power(hot / self.flow_hot, -self.exponent) + 0.5 * _power(cold / self.flow_cold, -self.exponent)
        return p.UA / films

    def outlets(self, hot: Any, cold: Any, u: Namespace, UA: Any, balance: Any = 1.0) -> tuple[Any, Any]:
        """Outlet temperatures of the hot and the cold side at two flows [kg/s]."""
        a, b = UA / (self.cp_hot * balance * hot), UA / (self.cp_cold * cold)
        if self.counter:
            d = a - b
            near = absolute(d) < 1e-4
            mean = where(near, 1.0 - 0.5 * d, (1.0 - exp(minimum(-d, 50.0))) / where(near, 1.0, d))
            share = mean / (1.0 + b * mean)
        else:
            share = (1.0 - exp(-(a + b))) / (a + b)
        span = u.T_hot_in - u.T_cold_in
        return u.T_hot_in - a * share * span, u.T_cold_in + b * share * span

    def flows(self, u: Namespace) -> tuple[Any, Any]:
        """The flows of both sides, a little where there is none."""
        return (
            _at_least(forward(u.m_flow_hot), LEAST_SHARE * self.flow_hot),
            _at_least(forward(u.m_flow_cold), LEAST_SHARE * self.flow_cold),
        )

    def drift(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """What the transfer is off by fades away."""
        return {"w": -x.w / p.memory}

    def diffusion(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Such that ``wander`` is the standard deviation of ``w``."""
        return {"w": p.wander * sqrt(2.0 / p.memory)}

    def observe(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Steady outlets and what they are off by."""
        flows = self.flows(u)
        hot, cold = self.outlets(*flows, u, self.transfer(*flows, p) * exp(x.w), p.balance)
        return {"T_hot_out": hot, "T_cold_out": cold}

    def noise(self, x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
        """Errors of the outlets' sensors, what errors of the flows make of them, and water that stands."""
        hot, cold = self.flows(u)
        here = self.outlets(hot, cold, u, self.transfer(hot, cold, p))
        by_hot = self.outlets(hot * (1.0 + STEP), cold, u, self.transfer(hot * (1.0 + STEP), cold, p))
        by_cold = self.outlets(hot, cold * (1.0 + STEP), u, self.transfer(hot, cold * (1.0 + STEP), p))
        slow = (SLOW * self.flow_hot / hot) ** 2 + (SLOW * self.flow_cold / cold) ** 2
        still = slow * (u.T_hot_in - u.T_cold_in)
        own, out = (p.noise_hot, p.noise_cold), []
        for k in range(2):
            from_hot = (by_hot[k] - here[k]) / STEP * (p.meter_hot / hot)
            from_cold = (by_cold[k] - here[k]) / STEP * (p.meter_cold / cold)
            out.append(sqrt(own[k] * own[k] + from_hot * from_hot + from_cold * from_cold + still * still))
        return {"T_hot_out": out[0], "T_cold_out": out[1]}


def steady_exchanger(
    equations: SteadyExchanger,
    options: Mapping[str, Any],
    quantities: tuple[tuple[Quantity, ...], tuple[Quantity, ...]],
    valid: Mapping[str, tuple[float, float]],
) -> ComponentModel:
    """The model of :func:`fdd.models.heat_exchanger.heat_exchanger` with ``dynamics="quasi-steady"``."""
    inputs, outputs = quantities
    return ComponentModel(
        name="heat_exchanger",
        version="1",
        title="Plate heat exchanger",
        states=(State("w", "1", "logarithm of what the transfer is off the law of films", 0.05),),
        inputs=inputs,
        outputs=outputs,
        parameters=_parameters(),
        drift=equations.drift,
        diffusion=equations.diffusion,
        observe=equations.observe,
        noise=equations.noise,
        start=lambda y, u, p: {"w": 0.0},
        options=options,
        valid=valid,
        faults=FAULTS,
        references=("VDI Heat Atlas, 2nd edition (2010), section C1: heat exchangers by transfer units.",),
        plausible=(
            Plausible(
                "heat of the cold side over that of the hot side",
                lambda p: p["balance"],
                "1",
                1.0,
                1.15,
                "compare both flow meters (pulse value, unit, fluid) and see that no sensor stands for another",
            ),
            Plausible(
                "transfer units at the usual flows",
                lambda p: p["UA"] / min(c * m for c, m in zip(equations.cp, equations.usual, strict=True)),
                "1",
                2.0,
                6.0,
                "an outlet that has all but its inlet's temperature on the other side does not tell the transfer; see "
                "that the sensors sit where the model has them",
            ),
        ),
    )


def _power(share: Any, y: Any) -> Any:
    return exp(y * log(share))


def _at_least(flow: Any, least: float) -> Any:
    return sqrt(flow * flow + least * least)


def _parameters() -> tuple[Parameter, ...]:
    table = [
        Parameter("UA", "W/K", "heat transfer at the usual flows", 4e3, 10.0, 1e7, ATLAS),
        Parameter("balance", "1", "heat of the cold side over that of the hot side", 1.0, 0.5, 2.0, ATLAS),
    ]
    noise: list[tuple[str, str, str, float, float, float]] = [
        ("memory", "s", "time constant of the transfer's wander", 2e4, 3600.0, 86400.0),
        ("wander", "1", "standard deviation of the transfer's wander", 0.03, 1e-4, 0.3),
        ("meter_hot", "kg/s", "resolution of the hot flow", 1e-3, 1e-7, 10.0),
        ("meter_cold", "kg/s", "resolution of the cold flow", 1e-3, 1e-7, 10.0),
        ("noise_hot", "K", "measurement noise of the hot outlet", 0.05, 1e-3, 5.0),
        ("noise_cold", "K", "measurement noise of the cold outlet", 0.05, 1e-3, 5.0),
    ]
    table += [Parameter(*row, ATLAS, kind="noise") for row in noise]
    return tuple(table)


FAULTS = (
    Fault(
        "fouling",
        "deposits on the plates: less heat passes at the same flows",
        {"UA": -1, "innovation:T_hot_out": 1, "innovation:T_cold_out": -1},
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
        {"balance": 0},
        (
            "compare the heat given off by the hot side with that taken up by the cold side",
            "check the meter's pulse value",
        ),
    ),
)
