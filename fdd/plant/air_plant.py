"""A simulated air handler: mixing box, coils and fan under weather, a schedule and a sequencing controller.

    outdoor and return air -> damper -> mixed air -> heating coil -> fan -> cooling coil -> supply air

The controller keeps the supply temperature by heating, free cooling and cooling in turn while the fan runs. The filter
sees what a building's control system has: temperatures, the schedule and *commands*; whether a damper or a valve obeys
is for the diagnosis to find out. The climate is a warm and restless one: a fortnight of spring has hours of each kind.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fdd.models.declare import ComponentModel, Quantity
from fdd.models.functions import maximum, minimum, where
from fdd.models.registry import get_model
from fdd.plant.blocks import Result, actuator
from fdd.plant.network import Block, Network, Setting, measured
from fdd.plant.weather import DAY, Climate, weather
from fdd.records import NANOSECONDS, FloatArray, IntArray

# What plates, drawings and the water's own sensors tell; the rest is fitted to a healthy month. ``c``, which stands for
# unmeasured humidity and water temperatures, has nothing to stand for here.
KNOWN = {
    "T_cold": 7.0, "T_hot": 60.0, "gamma_cool": 1.0, "gamma_heat": 2.0, "n_air": 2.0, "e_heat": 0.4, "r": 0.02,
    "k_0": 7e-4, "k_h": 1e-4, "s_off": 0.1, "f_fan": 1.3, "tau_c": 7200.0, "sigma_c": 1e-4,
    "bias_mixed": 0.0, "bias_supply": 0.0,
}  # fmt: skip
AIR_HANDLER: dict[str, Any] = {"fixed": KNOWN}
# Seats leak a little when new (IEC 60534-4: class II half a per cent, class III a tenth).
AIR_TRUTH = {"tau_m": 150.0, "tau_s": 120.0, "leak_heat": 2e-3, "leak_cool": 2e-3, "sigma_m_on": 0.02,
             "sigma_s_on": 0.015, "sigma_m": 5e-3, "sigma_s": 5e-3, "sigma_h": 5e-3, "sigma_h_on": 0.02,
             "noise_mixed": 0.05, "noise_supply": 0.05}  # fmt: skip
# Model input or output to point.
AIR_POINTS = {
    "T_out": "weather.T_out", "T_return": "room.T_return", "damper": "ahu.damper", "fan": "schedule.fan",
    "cool": "ahu.cool", "heat": "ahu.heat", "T_mixed": "ahu.T_mixed", "T_supply": "ahu.T_supply",
}  # fmt: skip
AIR_STEP = 120.0
"""Sampling interval [s]"""


def air_handler_model() -> ComponentModel:
    """How the filter sees the air handler; also what it is made of."""
    return get_model("air_handler", **AIR_HANDLER)


def air_controller() -> Block:
    """Heating, free cooling and cooling in turn by one proportional-integral signal; at rest while the fan stands."""

    def step(m: Any, u: Any, p: Any) -> Result:
        on = where(u.fan > 0.05, 1.0, 0.0)
        error = u.T_supply - p.T_set
        integral = on * minimum(maximum(m.integral + p.gain * error, -1.0), 2.0)
        signal = minimum(maximum(integral + p.band * error, -1.0), 2.0)
        free = where(u.T_out < u.T_return - p.useful, 1.0, 0.0)
        damper = maximum(p.d_lowest, free * minimum(maximum(signal, 0.0), 1.0))
        wanted = {"damper": damper, "cool": maximum(signal - 1.0, 0.0), "heat": maximum(-signal, 0.0)}
        return {symbol: on * value for symbol, value in wanted.items()}, {"integral": integral}

    return Block(
        "air handler's controller",
        (
            Quantity("T_supply", "degC", "supply air temperature"),
            Quantity("T_out", "degC", "outdoor air temperature"),
            Quantity("T_return", "degC", "return air temperature"),
            Quantity("fan", "1", "fan speed"),
        ),
        (
            Quantity("damper", "1", "damper position wanted"),
            Quantity("cool", "1", "cooling valve position wanted"),
            Quantity("heat", "1", "heating valve position wanted"),
        ),
        step,
        (
            Setting("T_set", "degC", 18.0, "set point of the supply temperature"),
            Setting("gain", "1/K", 0.01, "change of the signal per kelvin and step"),
            Setting("band", "1/K", 0.05, "proportional part"),
            Setting("d_lowest", "1", 0.5, "least opening of the damper while the fan runs"),
            Setting("useful", "K", 1.0, "free cooling where it is so much colder outside than in the return air"),
        ),
        (Setting("integral", "1", 0.5, "integral part"),),
    )


def air_plant() -> Network:
    """The wired plant; blocks ``control`` and ``damper``, component ``ahu``."""
    plant = Network()
    for name, unit in (("weather.T_out", "degC"), ("room.T_return", "degC"), ("schedule.fan", "1")):
        plant.signal(name, unit)
    plant.add("ahu", air_handler_model(), initial={"T_m": 20.0, "T_h": 22.0, "T_s": 18.0}, **AIR_TRUTH)
    plant.control("control", air_controller())
    plant.control("damper", actuator(), leak=0.0)
    for source in ("weather.T_out", "room.T_return", "schedule.fan"):
        plant.connect(source, f"ahu.{source.partition('.')[2]}")
    plant.connect("control.damper", "damper.opening")
    plant.connect("damper.opening", "ahu.damper")
    plant.connect("control.cool", "ahu.cool")
    plant.connect("control.heat", "ahu.heat")
    for port, noise in (
        ("ahu.T_mixed", 0.05),
        ("ahu.T_supply", 0.05),
        ("weather.T_out", 0.05),
        ("room.T_return", 0.03),
    ):
        plant.sensor(port, noise=noise)
    plant.sensor("schedule.fan")
    for symbol in ("damper", "cool", "heat"):
        plant.sensor(f"control.{symbol}", point=f"ahu.{symbol}")
    for symbol, point in (("T_supply", "ahu.T_supply"), ("T_out", "weather.T_out"), ("T_return", "room.T_return")):
        plant.connect(measured(point), f"control.{symbol}")
    plant.connect("schedule.fan", "control.fan")
    return plant


def air_outside(time: IntArray, rng: np.random.Generator) -> Mapping[str, FloatArray]:
    """Weather, return air and the fan's schedule, each (n,), at event times [ns]."""
    w = weather(time, rng, Climate(mean=14.0, daily=6.0, anomaly=4.0))
    hours = time / NANOSECONDS / 3600.0
    weekday = (np.floor(time / NANOSECONDS / DAY) + 3.0) % 7.0 < 5.0
    running = weekday & (hours % 24.0 >= 6.0) & (hours % 24.0 < 20.0)
    speed = 0.7 + 0.2 * np.clip((w.T_out - 12.0) / 10.0, -1.0, 1.0)
    warm = 22.5 + 1.0 * np.sin(2.0 * np.pi * (hours - 10.0) / 24.0) + 0.05 * (w.T_out - 14.0)
    return {"weather.T_out": w.T_out, "room.T_return": warm, "schedule.fan": np.where(running, speed, 0.0)}
