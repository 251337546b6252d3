"""A simulated chiller at work: steady states as a plant imposes them, read by sensors with slow and random errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fdd.plant.chiller_cycle import Condition, CycleError, Fault, Machine, random_machine, steady_state

FloatArray = NDArray[np.float64]

SLOW: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("T_cdi", "T_cdo", "T_chi", "T_cho"), (0.035, 0.0)),
    **dict.fromkeys(("T_sat_cd", "T_sat_ev", "T_liquid"), (0.10, 0.0)),
    "T_discharge": (0.4, 0.0),
    "T_oil": (0.5, 0.0),
    **dict.fromkeys(("flow_ch", "flow_cd", "power"), (0.0, 0.007)),
}
"""Slow error of each sensor, one sigma: absolute, and as a share of the reading. Drawn once for a span of weeks."""
RANDOM = 0.4
"""Random error of a state's mean, as a share of the slow one."""
REFRIGERANT = ("T_sat_cd", "T_sat_ev", "T_liquid", "T_discharge", "T_oil")


@dataclass(frozen=True)
class Sensors:
    """What every sensor is off by over a span of weeks: added, and as a share of the reading."""

    added: Mapping[str, float] = field(default_factory=dict)
    share: Mapping[str, float] = field(default_factory=dict)

    def biased(self, added: Mapping[str, float] | None = None, share: Mapping[str, float] | None = None) -> Sensors:
        """The same with biases put on top."""
        more = {k: self.added.get(k, 0.0) + v for k, v in (added or {}).items()}
        scaled = {k: self.share.get(k, 0.0) + v for k, v in (share or {}).items()}
        return Sensors({**self.added, **more}, {**self.share, **scaled})

    def read(self, truth: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
        """Readings of one steady state, with its random errors."""
        found = {}
        for k, v in truth.items():
            absolute, share = SLOW[k]
            own = v * (1 + self.share.get(k, 0.0) + RANDOM * share * rng.standard_normal())
            found[k] = float(own + self.added.get(k, 0.0) + RANDOM * absolute * rng.standard_normal())
        return found


def sensors(rng: np.random.Generator) -> Sensors:
    """Sensors as they are found, each with a slow error of its own."""
    return Sensors(
        {k: a * float(rng.standard_normal()) for k, (a, _) in SLOW.items() if a},
        {k: s * float(rng.standard_normal()) for k, (_, s) in SLOW.items() if s},
    )


def conditions(rng: np.random.Generator, states: int) -> list[Condition]:
    """Loads of 40 to 100 %, condenser water of 20 to 30 degC and set points of 5.5 to 8 degC."""
    return [
        Condition(load=float(rng.uniform(0.4, 1.0)), T_cdi=float(rng.uniform(20, 30)), T_cho=float(rng.uniform(5.5, 8)))
        for _ in range(states)
    ]


def readings(
    machine: Machine, states: list[Condition], own: Sensors, rng: np.random.Generator, fault: Fault | None = None
) -> dict[str, FloatArray]:
    """What sensors read in these states, shape (states,) by quantity."""
    rows = [own.read(steady_state(machine, c, fault), rng) for c in states]
    return {k: np.array([r[k] for r in rows]) for k in rows[0]}


def running_machine(rng: np.random.Generator, *, wide: float = 1.0) -> Machine:
    """A random machine that runs at every state of :func:`conditions`, with gas too."""
    while True:
        machine = random_machine(rng, wide=wide)
        try:
            for load in (0.4, 1.0):
                for T_cdi in (20.0, 30.0):
                    steady_state(machine, Condition(load, T_cdi, 6.0), Fault(gas=0.03))
        except CycleError:
            continue
        return machine


def record(values: Mapping[str, FloatArray], rng: np.random.Generator, hold: int, rise: int) -> dict[str, FloatArray]:
    """States one after the other as a trend shows them: each held for so many samples after so many of transition."""
    found = {}
    for k, v in values.items():
        before = np.concatenate([v[:1], v[:-1]])
        way = np.concatenate([np.linspace(0, 1, rise, endpoint=False), np.ones(hold)])
        clean = (before[:, None] + (v - before)[:, None] * way).ravel()
        absolute, share = SLOW[k]
        found[k] = clean + np.hypot(absolute, share * clean) * 0.5 * rng.standard_normal(len(clean))
    return found
