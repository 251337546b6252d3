"""The demonstration plant: a district-heated house of two wings.

    district network -> plate heat exchanger -> supply -> a radiator circuit in each wing -> the wing's rooms

The supply temperature follows the outdoor temperature (heating curve, controller on the primary valve), thermostats
throttle the radiator circuits, sun and occupants disturb the rooms. Sizes: 40 kW at -12 degC outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.plant.blocks import actuator, heating_curve, mixer, supply_controller, thermostat
from fdd.plant.network import Network, measured
from fdd.plant.weather import DAY, Climate, weather
from fdd.records import NANOSECONDS, FloatArray, IntArray

WINGS = ("south", "north")

# How the filters see the plant; also what it is made of. The water content is the nameplate's: exchanger and sensors
# settle within one sample, which says nothing about it.
EXCHANGER: dict[str, Any] = {
    "compartments": 3,
    "transfer": "flow-symmetric",
    "fixed": {"M_hot": 4.3, "M_cold": 4.3, "sigma_hot": 0.005, "sigma_cold": 0.005},
}
RADIATOR: dict[str, Any] = {"sections": 2, "surroundings": False}
BUILDING: dict[str, Any] = {"rooms": list(WINGS), "heating": "water"}

TRUTH: dict[str, dict[str, float]] = {
    "hx": {"C": 8.5e3, "y": 0.72},
    "radiator-south": {"C": 9.0e5, "H": 140.0, "sigma_T": 4e-3},
    "radiator-north": {"C": 1.1e6, "H": 170.0, "sigma_T": 4e-3},
    "building": {
        "B_out_south": 480.0,
        "B_out_north": 590.0,
        "B_floor_south": 4500.0,
        "B_floor_north": 5200.0,
        "C_air_south": 1.2e7,
        "C_air_north": 1.4e7,
        "C_floor_south": 9e7,
        "C_floor_north": 1.1e8,
        "A_south": 9.0,
        "A_north": 6.0,
        "B_south_north": 250.0,
        "sigma_air_south": 8e-4,
        "sigma_air_north": 8e-4,
        "sigma_floor_south": 2e-4,
        "sigma_floor_north": 2e-4,
    },
}

# Standard deviations of the sensors' errors: absolute in the point's unit, and relative.
SENSORS: dict[str, tuple[float, float]] = {
    "weather.T_out": (0.05, 0.0),
    "weather.I_south": (0.5, 0.005),
    "weather.I_north": (0.5, 0.005),
    "occupancy.P_south": (5.0, 0.0),
    "occupancy.P_north": (5.0, 0.0),
    "hx.T_hot_in": (0.02, 0.0),
    "hx.T_hot_out": (0.05, 0.0),
    "hx.T_cold_in": (0.02, 0.0),
    "hx.T_cold_out": (0.05, 0.0),
    "hx.m_flow_hot": (0.0, 0.001),
    "hx.m_flow_cold": (0.0, 0.001),
    "radiator-south.m_flow": (0.0, 0.001),
    "radiator-south.T_return": (0.05, 0.0),
    "radiator-north.m_flow": (0.0, 0.001),
    "radiator-north.T_return": (0.05, 0.0),
    "building.T_south": (0.03, 0.0),
    "building.T_north": (0.03, 0.0),
}


def models() -> dict[str, ComponentModel]:
    """The models of the monitored components, by component name."""
    return {name: get_model(kind, **options) for name, (kind, options) in EQUIPMENT.items()}


EQUIPMENT: dict[str, tuple[str, dict[str, Any]]] = {
    "hx": ("heat_exchanger", EXCHANGER),
    "radiator-south": ("radiator", RADIATOR),
    "radiator-north": ("radiator", RADIATOR),
    "building": ("building", BUILDING),
}

# Model input or output to point, by component.
POINTS: dict[str, dict[str, str]] = {
    "hx": {s: f"hx.{s}" for s in ("m_flow_hot", "m_flow_cold", "T_hot_in", "T_cold_in", "T_hot_out", "T_cold_out")},
    **{
        f"radiator-{w}": {
            "T_supply": "hx.T_cold_out",
            "T_room": f"building.T_{w}",
            "m_flow": f"radiator-{w}.m_flow",
            "T_return": f"radiator-{w}.T_return",
        }
        for w in WINGS
    },
    "building": {
        "T_out": "weather.T_out",
        "T_supply": "hx.T_cold_out",
        **{f"I_{w}": f"weather.I_{w}" for w in WINGS},
        **{f"T_return_{w}": f"radiator-{w}.T_return" for w in WINGS},
        **{f"m_flow_{w}": f"radiator-{w}.m_flow" for w in WINGS},
        **{f"P_gain_{w}": f"occupancy.P_{w}" for w in WINGS},
        **{f"T_{w}": f"building.T_{w}" for w in WINGS},
    },
}


def district_plant() -> Network:
    """The wired plant."""
    plant = Network()
    for name in ("weather.T_out", "district.T_supply"):
        plant.signal(name, "degC")
    for w in WINGS:
        plant.signal(f"weather.I_{w}", "W/m^2")
        plant.signal(f"occupancy.P_{w}", "W")
        plant.signal(f"schedule.T_{w}", "degC")
    made = models()
    warm = {"T_hot_1": 60.0, "T_hot_2": 50.0, "T_hot_3": 42.0, "T_cold_1": 40.0, "T_cold_2": 45.0, "T_cold_3": 50.0}
    plant.add("hx", made["hx"], initial=warm, **TRUTH["hx"])
    for w in WINGS:
        plant.add(f"radiator-{w}", made[f"radiator-{w}"], initial={"T_1": 42.0, "T_2": 36.0}, **TRUTH[f"radiator-{w}"])
    rooms = {f"T_{zone}_{w}": 20.5 for zone in ("air", "floor") for w in WINGS}
    plant.add("building", made["building"], initial=rooms, **TRUTH["building"])
    plant.control("mixer", mixer(2))
    plant.control("curve", heating_curve())
    plant.control("controller", supply_controller())
    for w, full in zip(WINGS, (0.28, 0.34), strict=True):
        plant.control(f"thermostat-{w}", thermostat())
        plant.control(f"valve-{w}", actuator(), m_full=full)
    _wire(plant)
    return plant


def _wire(plant: Network) -> None:
    supply = ["building.T_supply", *(f"radiator-{w}.T_supply" for w in WINGS)]
    plant.connect("hx.T_cold_out", *supply)
    plant.connect("weather.T_out", "building.T_out")
    plant.connect("district.T_supply", "hx.T_hot_in")
    plant.connect("mixer.T", "hx.T_cold_in")
    plant.connect("mixer.m_flow", "hx.m_flow_cold")
    plant.connect("controller.m_flow", "hx.m_flow_hot")
    for i, w in enumerate(WINGS, start=1):
        plant.connect(f"weather.I_{w}", f"building.I_{w}")
        plant.connect(f"occupancy.P_{w}", f"building.P_gain_{w}")
        plant.connect(f"building.T_{w}", f"radiator-{w}.T_room")
        plant.connect(f"valve-{w}.m_flow", f"radiator-{w}.m_flow", f"building.m_flow_{w}", f"mixer.m_flow_{i}")
        plant.connect(f"radiator-{w}.T_return", f"building.T_return_{w}", f"mixer.T_{i}")
    for port, (noise, relative) in SENSORS.items():
        plant.sensor(port, noise=noise, relative=relative)
    # Controllers see what their sensors say.
    plant.connect(measured("weather.T_out"), "curve.T_out")
    plant.connect("curve.T_set", "controller.T_set")
    for symbol, point in {
        "T_supply": "hx.T_cold_out",
        "T_return": "hx.T_cold_in",
        "m_flow": "hx.m_flow_cold",
        "T_hot_in": "hx.T_hot_in",
        "T_hot_out": "hx.T_hot_out",
    }.items():
        plant.connect(measured(point), f"controller.{symbol}")
    for w in WINGS:
        plant.connect(measured(f"building.T_{w}"), f"thermostat-{w}.T_room")
        plant.connect(f"schedule.T_{w}", f"thermostat-{w}.T_set")
        plant.connect(f"thermostat-{w}.opening", f"valve-{w}.opening")


def outside(time: IntArray, rng: np.random.Generator, climate: Climate | None = None) -> Mapping[str, FloatArray]:
    """Weather, district supply temperature, occupants' heat and set points, each (n,), at event times [ns]."""
    w = weather(time, rng, climate)
    signals = {"weather.T_out": w.T_out, "weather.I_south": w.I_south, "weather.I_north": w.I_north}
    slow = np.convolve(np.concatenate([np.full(143, w.T_out[0]), w.T_out]), np.full(144, 1 / 144), mode="valid")
    signals["district.T_supply"] = np.clip(72.0 + 1.0 * (8.0 - slow), 70.0, 92.0) + _steps(rng, len(time), 18, 0.8)
    hours = time / NANOSECONDS / 3600.0 + 1.0
    weekday = (np.floor(time / NANOSECONDS / DAY) + 3.0) % 7.0 < 5.0
    present = weekday & (hours % 24.0 >= 7.5) & (hours % 24.0 < 17.0)
    for wing, full in (("south", 2200.0), ("north", 2800.0)):
        level = 400.0 + full * present * (1.0 + 0.25 * _steps(rng, len(time), 12, 1.0))
        signals[f"occupancy.P_{wing}"] = np.maximum(level, 100.0)
    # Offices in the south are cooler at night, meeting rooms in the north from Friday evening to Monday morning.
    night = (hours % 24.0 < 5.0) | (hours % 24.0 >= 21.0)
    signals["schedule.T_south"] = np.where(night, 20.0, 21.5)
    signals["schedule.T_north"] = np.where(weekday, 21.0, 19.0)
    return signals


def _steps(rng: np.random.Generator, n: int, length: int, size: float) -> FloatArray:
    """A level that changes at random after ``length`` samples on average; standard deviation ``size``."""
    jumps = rng.random(n) < 1.0 / length
    levels = size * np.clip(rng.standard_normal(n), -2.0, 2.0)
    last = np.maximum.accumulate(np.where(jumps, np.arange(n), 0))
    return np.asarray(levels[last])
