"""Energy balances of the thermal models: stored heat less heat in and out, as a share of the throughput."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.records import FloatArray

CP = 4186.0
Energy = Callable[[FloatArray, Any], tuple[float, float, float]]
"""Heat stored [J], net heat flow in and throughput [W] of a state; or all three in another unit of heat"""


@dataclass(frozen=True)
class Balance:
    """A model with constant inputs and a start state, run for ``end`` seconds."""

    model: ComponentModel
    u: Mapping[str, float]
    x0: tuple[float, ...]
    end: float
    energy: Energy


def balances() -> dict[str, float]:
    """Closure of every balance over minutes to a day of exact integration."""
    return {name: closure(b) for name, b in BALANCES.items()}


def closure(b: Balance) -> float:
    """Share of the throughput that is missing at the end."""
    p = SimpleNamespace(**{q.symbol: q.typical for q in b.model.parameters})
    names = [s.symbol for s in b.model.states]

    def rates(_: float, z: FloatArray) -> FloatArray:
        x = SimpleNamespace(**dict(zip(names, map(float, z), strict=False)))
        d = b.model.drift(x, SimpleNamespace(**b.u), p)
        _, net, through = b.energy(z[: len(names)], p)
        return np.array([*(d[s] for s in names), net, through])

    start = [*b.x0, 0.0, 0.0]
    done = solve_ivp(rates, (0.0, b.end), start, method="DOP853", rtol=1e-12, atol=1e-11).y[:, -1]
    change = b.energy(done[: len(names)], p)[0] - b.energy(np.array(b.x0), p)[0]
    return float(abs(change - done[-2]) / done[-1])


def _hx(x: FloatArray, p: Any) -> tuple[float, float, float]:
    stored = CP / 3 * (p.M_hot * x[:3].sum() + p.M_cold * x[3:6].sum())
    if len(x) > 6:
        stored += p.C_wall / 3 * x[6:].sum()
    return stored, CP * (0.4 * (75 - x[2]) + 0.5 * (35 - x[5])), CP * 0.4 * 40


def _radiator(x: FloatArray, p: Any) -> tuple[float, float, float]:
    share = 0.02 + 0.96 / (1 + np.exp(-x[3]))
    stored = p.C * (share * x[0] + (1 - share) * x[1]) + p.C_air * x[2]
    return stored, CP * 0.05 * (60 - x[1]) - p.B_air * (x[2] - 20), CP * 0.05 * 40


def _building(x: FloatArray, p: Any) -> tuple[float, float, float]:
    stored = p.C_air_south * x[0] + p.C_floor_south * x[1] + p.C_air_north * x[2] + p.C_floor_north * x[3]
    gains = 1850.0 + p.A_south * 300 + p.A_north * 50
    return stored, gains - p.B_out_south * (x[0] + 3) - p.B_out_north * (x[2] + 3), gains


def _zone(x: FloatArray, p: Any) -> tuple[float, float, float]:
    gains = 2000.0 + p.A_w * 200
    return p.C_i * x[0] + p.C_e * x[1] + p.C_h * x[2], gains - (x[1] + 3) / p.R_ea, gains


def _pipe(x: FloatArray, p: Any) -> tuple[float, float, float]:
    return p.C / 12 * x.sum(), CP * 0.5 * (60 - x[-1]) - p.UA / 12 * (x - 15).sum(), CP * 0.5 * 45


def _walled_pipe(x: FloatArray, p: Any) -> tuple[float, float, float]:
    water, wall = x[:6], x[6:]
    stored = p.C / 6 * water.sum() + p.C_wall / 6 * wall.sum()
    return stored, CP * 0.5 * (60 - water[-1]) - p.UA / 6 * (wall - 15).sum(), CP * 0.5 * 45


def _heating_coil(x: FloatArray, p: Any) -> tuple[float, float, float]:
    """In units of the coil's heat capacity: water gives, air takes up from its section to behind the coil."""
    valve = p.leak_heat + (1 - p.leak_heat) * ((0.5 + 1e-4) ** p.gamma_heat - 1e-4**p.gamma_heat)
    behind = x[0] + p.e_heat * (x[1] - x[0])
    given = p.g * valve * (p.T_hot - x[1])
    return x[1], given - p.r * 0.8 * (behind - x[0]) - p.k_0 * (x[1] - x[0]), given


def _cooling_coil(x: FloatArray, p: Any) -> tuple[float, float, float]:
    """In units of the air's heat capacity flow at full speed: mixing box, coils, fan and supply section.

    What the cold water takes is reckoned on the coil's surface: transfer units times the logarithmic mean temperature
    difference to the water, which says nothing of an effectiveness.
    """
    speed, outdoor, back, valve, damper = 0.8, 32.0, 24.0, 0.7, 0.4
    opening = p.leak_cool + (1 - p.leak_cool) * ((valve + 1e-4) ** p.gamma_cool - 1e-4**p.gamma_cool)
    units = 1 / (1 / (p.n_cool * opening * np.exp(x[3])) + (speed + 0.01) ** 0.5 / p.n_air)
    heated = x[0] + p.e_heat * (x[1] - x[0])
    on, off = heated - p.T_cold, (heated - p.T_cold) * np.exp(-units)
    taken = speed * units * (on - off) / np.log(on / off)
    share = p.s_min + (p.s_max - p.s_min) / (1 + np.exp(-(damper - p.d_mid) / p.d_width))
    fresh, around = back + share * (outdoor - back), back + p.b_off
    lost = p.tau_m * ((x[0] - around - p.s_off * (outdoor - back)) / p.tau_mx + p.k_h * (x[0] - x[1]))
    lost += p.tau_m * p.k_s * (x[0] - x[2]) + p.tau_s * (x[2] - around) / p.tau_sy
    gained = speed * (p.e_heat * (x[1] - x[0]) + p.f_fan * speed**2)
    return p.tau_m * x[0] + p.tau_s * x[2], speed * (fresh - x[2]) + gained - taken - lost, taken


_AIR = {"T_out": 0.0, "T_return": 22.0, "damper": 0.4, "fan": 0.8, "cool": 0.0, "heat": 0.5}
_SUMMER = {"T_out": 32.0, "T_return": 24.0, "damper": 0.4, "fan": 0.8, "cool": 0.7, "heat": 0.0}
_EXCHANGER = {"m_flow_hot": 0.4, "m_flow_cold": 0.5, "T_hot_in": 75.0, "T_cold_in": 35.0}
_HOUSE = {"T_out": -3.0, "I_south": 300.0, "I_north": 50.0, "P_heat_south": 900.0, "P_heat_north": 700.0,
          "P_gain_south": 100.0, "P_gain_north": 150.0}  # fmt: skip
_ROOM = {"T_supply": 60.0, "T_room": 20.0, "m_flow": 0.05}
_PIPE = {"T_in": 60.0, "m_flow": 0.5, "T_around": 15.0}
_PLATES = (70.0, 60.0, 50.0, 38.0, 45.0, 50.0)

BALANCES = {
    "heat exchanger": Balance(get_model("heat_exchanger"), _EXCHANGER, _PLATES, 120.0, _hx),
    "heat exchanger, parallel flow, metal": Balance(
        get_model("heat_exchanger", flow="parallel", metal=True), _EXCHANGER, (*_PLATES, 55.0, 52.0, 50.0), 120.0, _hx
    ),
    "radiator": Balance(get_model("radiator"), _ROOM, (55.0, 40.0, 25.0, -0.5), 3600.0, _radiator),
    "building": Balance(get_model("building"), _HOUSE, (19.0, 17.0, 21.0, 20.0), 86400.0, _building),
    "zone": Balance(
        get_model("zone"), {"T_out": -3.0, "I_solar": 200.0, "P_heat": 2000.0}, (20.0, 12.0, 35.0), 86400.0, _zone
    ),
    "heating coil": Balance(get_model("air_handler"), _AIR, (15.0, 25.0, 18.0, 0.0), 1800.0, _heating_coil),
    "cooling coil": Balance(get_model("air_handler"), _SUMMER, (25.0, 25.0, 14.0, 0.2), 1800.0, _cooling_coil),
    "pipe": Balance(get_model("pipe_thermal"), _PIPE, (30.0,) * 12, 600.0, _pipe),
    "pipe with wall": Balance(
        get_model("pipe_thermal", compartments=6, wall=True), _PIPE, (30.0,) * 6 + (28.0,) * 6, 600.0, _walled_pipe
    ),
}
