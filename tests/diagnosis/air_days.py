"""Days of an air handler made apart from the project's own form: an equal-percentage valve and a bypass coil.

A proportional control keeps the supply air at its set point by heating, damper and cooling in sequence; what the plant
does with its commands may be faulty. Sensors have errors of their own for good.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fdd.models.expectation import Day

STEP = 300.0
HOT, COLD, SET = 62.0, 6.5, 14.0


@dataclass(frozen=True)
class Plant:
    """What is wrong with it, and what its sensors are off by [K]."""

    heat: float | None = None
    cool: float | None = None
    damper: float | None = None
    heat_leak: float = 0.0
    cool_leak: float = 0.0
    bias: dict[str, float] = field(default_factory=dict)


def valve(command: np.ndarray, stuck: float | None, leak: float) -> np.ndarray:
    """Share of the full water flow: equal percentage, rangeability 30."""
    position = command if stuck is None else np.full_like(command, stuck)
    flow = np.where(position <= 0.005, 0.0, 30.0 ** (position - 1.0))
    return leak + (1 - leak) * flow


def air_day(plant: Plant, outside: float, seed: int = 0) -> Day:
    """A day that runs from 06:00 to 18:00, outdoor air about ``outside`` [degC]."""
    rng = np.random.default_rng(seed)
    n = int(86400 / STEP)
    hour = np.arange(n) * STEP / 3600
    out = outside + 4 * np.sin((hour - 9) / 24 * 2 * np.pi)
    back = 22.0 + 0.5 * np.sin((hour - 11) / 24 * 2 * np.pi)
    on = (hour >= 6) & (hour < 18)
    mixed, supply = np.empty(n), np.empty(n)
    commands = {name: np.zeros(n) for name in ("heat", "damper", "cool")}
    seen, integral = SET, 0.0
    mixed_now = supply_now = 22.0
    for k in range(n):
        if on[k]:
            error = seen + plant.bias.get("T_supply", 0.0) - SET
            integral = float(np.clip(integral + 0.02 * error, -1.1, 2.1))
            demand = float(np.clip(integral + 0.02 * error, -1.0, 2.0))
            heat, cool = max(0.0, -demand), max(0.0, demand - 1.0)
            free = 0.35 + 0.65 * float(np.clip(demand, 0.0, 1.0)) if out[k] < back[k] else 0.35
        else:
            heat = cool = free = 0.0
        commands["heat"][k], commands["cool"][k], commands["damper"][k] = heat, cool, free
        share = (free if plant.damper is None or not on[k] else plant.damper) ** 1.2
        hot = valve(np.array([heat]), plant.heat, plant.heat_leak)[0]
        cold = valve(np.array([cool]), plant.cool, plant.cool_leak)[0]
        if on[k]:
            mixed_now = back[k] + share * (out[k] - back[k])
            warmed = mixed_now + 0.35 * hot / (0.4 + 0.6 * hot) * (HOT - mixed_now) + 0.9
            supply_now = warmed - 0.8 * cold / (0.35 + 0.65 * cold) * (warmed - COLD)
        else:
            # Water that passes a closed valve warms (cools) still air; without it sections drift to the room.
            room = 22.0 + hot * 25.0 - cold * 12.0
            mixed_now += (room - mixed_now) * 0.05
            supply_now += (room - supply_now) * 0.05
        mixed[k], supply[k], seen = mixed_now, supply_now, supply_now
    truth = {"T_supply": supply, "T_mixed": mixed, "T_return": back, "T_out": out}
    readings = {
        r: x + plant.bias.get(r, 0.0) + 0.1 * rng.standard_normal(n) + 0.2 * rng.standard_normal()
        for r, x in truth.items()
    }
    fan = np.where(on, 0.8, 0.0)
    return Day(np.arange(n) * STEP, {**readings, **commands, "fan": fan, "T_supply_set": np.full(n, SET)}, STEP)
