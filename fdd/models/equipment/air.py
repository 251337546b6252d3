"""What units that condition air have in common: operating states, coils, mixing, and the rows that follow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from fdd.models.expectation import BoolArray, Day, Residual, Values
from fdd.records import FloatArray

G36 = "ASHRAE Guideline 36-2021, 5.16.14"
SHUT, OPEN = 0.02, 0.95
"""A signal below or above these is taken for the end of its travel."""
SETTLED = 900.0
"""How long a state must have held before it is judged [s]."""
SEQUENCED = 3600.0
"""How long a control may take to move from one part of its sequence to the next [s]."""
STOPPED = 300.0
"""How long a fan must stand before its section is judged [s]."""
COILS_COLD = 3600.0
"""How long valves must have been shut before a section that stands shows no heat left in a coil [s]."""


def running(v: Day) -> BoolArray:
    """The supply fan runs."""
    on = v["fan"] > 0.05
    return on & (v["fan_status"] > 0.5) if "fan_status" in v else on


def standing(v: Day) -> BoolArray:
    """The supply fan stands."""
    off = v["fan"] <= 0.05
    return off | (v["fan_status"] <= 0.5) if "fan_status" in v else off


def only(mask: BoolArray, value: FloatArray) -> FloatArray:
    """A quantity where a condition holds, NaN elsewhere."""
    return np.where(mask, value, np.nan)


def shut(v: Day, valve: str, seconds: float = SETTLED) -> BoolArray:
    """A valve has been commanded shut for so long; one that is not there is shut."""
    if valve not in v:
        return np.ones(len(v.time), dtype=np.bool_)
    return v.held(v[valve] <= SHUT, seconds)


def opened(v: Day, valve: str) -> BoolArray:
    """A valve has been commanded fully open."""
    return v.held(v[valve] >= OPEN, SETTLED)


def fan_factor(v: Day) -> FloatArray:
    """How much of its full-speed heat the fan gives to the air: with the square of the speed (affinity laws)."""
    return np.clip(v["fan"], 0.2, 1.2) ** 2


def supply_above_set_point(v: Day) -> Residual:
    """Cooling is fully open and the supply air is warmer than asked for."""
    asked = v.held(running(v), SETTLED) & opened(v, "cool")
    return only(asked, v["T_supply"] - v["T_supply_set"]), {"T_supply": 1.0}


def supply_below_set_point(v: Day) -> Residual:
    """Heating is fully open and the supply air is colder than asked for."""
    asked = v.held(running(v), SETTLED) & opened(v, "heat")
    return only(asked, v["T_supply_set"] - v["T_supply"]), {"T_supply": 1.0}


def coils_shut(v: Day) -> Residual:
    """With both valves shut the air is warmed by the fan alone."""
    idle = v.held(running(v), SETTLED) & shut(v, "cool") & shut(v, "heat")
    rise = fan_factor(v)
    return only(idle, v["T_supply"] - v["T_mixed"] - FAN * rise), {"T_supply": 1.0, "T_mixed": 1.0, "fan": rise}


FAN, FAN_SD = 1.0, 0.6
"""Heat of a supply fan at full speed, and what is not known of it [K]: 2 degF in Guideline 36."""


def supply_outside(side: int) -> Callable[[Day], Residual]:
    """A row's residual: with both valves shut the supply air, less the fan's heat, beyond return and outdoor air."""

    def residual(v: Day) -> Residual:
        idle = v.held(running(v), SETTLED) & shut(v, "cool") & shut(v, "heat")
        rise = fan_factor(v)
        bound = np.maximum(side * v["T_return"], side * v["T_out"])
        beyond = side * (v["T_supply"] - FAN * rise) - bound
        return only(idle, beyond), {"T_supply": 1.0, "T_return": 0.7, "T_out": 0.7, "fan": -side * rise}

    return residual


def cooling_only(v: Day) -> Residual:
    """A cooling coil does not warm the air."""
    busy = v.held(running(v), SETTLED) & shut(v, "heat") & (v["cool"] > SHUT)
    rise = fan_factor(v)
    return only(busy, v["T_supply"] - v["T_mixed"] - FAN * rise), {"T_supply": 1.0, "T_mixed": 1.0, "fan": rise}


def heating_only(v: Day) -> Residual:
    """A heating coil does not cool the air."""
    busy = v.held(running(v), SETTLED) & shut(v, "cool") & (v["heat"] > SHUT)
    rise = fan_factor(v)
    return only(busy, v["T_mixed"] + FAN * rise - v["T_supply"]), {"T_supply": 1.0, "T_mixed": 1.0, "fan": rise}


def mixed_outside(v: Day) -> Residual:
    """Mixed air lies between return and outdoor air."""
    on = v.held(running(v), SETTLED)
    high, low = np.fmax(v["T_return"], v["T_out"]), np.fmin(v["T_return"], v["T_out"])
    beyond = np.maximum(v["T_mixed"] - high, low - v["T_mixed"])
    known = np.isfinite(v["T_return"]) & np.isfinite(v["T_out"])
    return only(on & known, beyond), {"T_mixed": 1.0, "T_return": 0.7, "T_out": 0.7}


def outdoor_share(low: float, high: float, share: float) -> Callable[[Day], Residual]:
    """A row's residual: more outdoor air than the damper, commanded between two positions, lets in [K]."""

    def residual(v: Day) -> Residual:
        d = v["damper"]
        here = v.held(running(v) & (d >= low) & (d <= high), SETTLED)
        apart = v["T_out"] - v["T_return"]
        sign = np.sign(apart)
        more = (v["T_mixed"] - v["T_return"] - share * apart) * sign
        weight = np.abs(apart)
        own = share_factor(d, low, high)
        return only(here & (weight > 1.0), more), {
            "T_mixed": sign,
            "T_return": -(1 - share) * sign,
            "T_out": -share * sign,
            "share": weight * own,
        }

    return residual


def share_factor(damper: FloatArray, low: float, high: float) -> FloatArray:
    """Ends of travel are known better than what lies between."""
    return np.full(len(damper), 1.0) if high - low < 0.1 else np.clip(4 * damper * (1 - damper), 0.3, 1.0)


def stands(section: str, side: int) -> Callable[[Day], Residual]:
    """A row's residual: a section that stands with valves shut, hotter (or colder) than anything around it since.

    The maximum principle of heat conduction: without a source inside, an extreme lies at the start or at the boundary.
    """

    def residual(v: Day) -> Residual:
        still = standing(v)
        # A coil may still hold the heat, or the cold, that its open valve gave it.
        calm = v.held(still, STOPPED) & shut(v, "heat" if side > 0 else "cool", COILS_COLD)
        which: Literal["highest", "lowest"] = "highest" if side > 0 else "lowest"
        extreme = np.fmax if side > 0 else np.fmin
        bound = v.since(still, v[section], "first")
        for other in ("T_mixed", "T_supply"):
            if other in v:
                bound = extreme(bound, v.since(still, v[other], "first"))
        for around in ("T_out", "T_return", "T_room"):
            if around in v:
                bound = extreme(bound, v.since(still, v[around], which))
        beyond = side * (v[section] - bound)
        return only(calm & np.isfinite(v.get("T_return", np.nan) + v.get("T_out", np.nan)), beyond), {
            section: 1.0,
            "around": 1.0,
        }

    return residual


def both_coils(v: Day) -> Residual:
    """Heating and cooling are not commanded together."""
    on = v.held(running(v), SETTLED)
    return only(on, np.minimum(v["heat"], v["cool"]) - 0.05), {}


def too_warm_outside(v: Day) -> Residual:
    """Outdoor air cools without the coil only while it is colder than the set point, less the fan's heat."""
    least = np.nanmin(np.where(running(v), v["damper"], np.nan), initial=np.inf)
    free = running(v) & (v["damper"] > least + 0.05) & (v["damper"] < 0.98)
    alone = v.held(free, SEQUENCED) & shut(v, "cool", SEQUENCED) & shut(v, "heat")
    rise = fan_factor(v)
    return only(alone, v["T_out"] + FAN * rise - v["T_supply_set"]), {"T_out": 1.0, "T_supply": 1.0, "fan": rise}


def too_cold_outside(v: Day) -> Residual:
    """With the damper fully open the coil has nothing to do where outdoor air is colder than the set point."""
    cooled = v.held(running(v) & (v["damper"] >= 0.98) & (v["cool"] > 0.05), SEQUENCED) & shut(v, "heat")
    rise = fan_factor(v)
    return only(cooled, v["T_supply_set"] - FAN * rise - v["T_out"]), {"T_out": 1.0, "T_supply": 1.0, "fan": rise}


def hunting(v: Day) -> Residual:
    """Changes between heating, free cooling and cooling in an hour, beyond seven."""
    on = v.held(running(v), SETTLED)
    state = (v["heat"] > SHUT) + 2 * (v["cool"] > SHUT) + 4 * (v.get("damper", 0.0) >= 0.98)
    changed = np.concatenate([[False], np.diff(state) != 0]) & on
    hour = np.floor(v.time / 3600.0)
    _, inverse = np.unique(hour, return_inverse=True)
    changes = np.asarray(np.bincount(inverse, weights=changed)[inverse] - 7.0, dtype=np.float64)
    return only(on, changes), {}


def pressure_short(v: Day) -> Residual:
    """At full speed the fan keeps the duct's set pressure; as a share of it."""
    full = v.held(running(v) & (v["fan"] >= OPEN), SETTLED)
    return only(full, 1.0 - v["p_static"] / np.maximum(v["p_static_set"], 1.0)), {"pressure": 1.0}


def flow_standing(v: Day) -> Residual:
    """A fan that stands moves no air; as a share of the day's largest flow."""
    off = v.held(standing(v), STOPPED)
    largest = np.nanmax(v["flow"], initial=0.0)
    return only(off, v["flow"] / max(largest, 1e-6)), {"flow_zero": 1.0}


def effectiveness(position: FloatArray, water: FloatArray, air: FloatArray, curve: FloatArray) -> FloatArray:
    """Of a coil at full air flow: water and air side in series, 1/N = 1/(n_w v^gamma) + 1/n_a; 0 with the valve shut.

    Source: Incropera et al. (2007), Eq. 11.35; Wetter (1999), LBNL-42355.
    """
    v = np.clip(position, 0.0, 1.0) ** curve
    return 1.0 - np.exp(-1.0 / (1.0 / (water * v + 1e-9) + 1.0 / air))


def passing(position: FloatArray, leak: FloatArray) -> FloatArray:
    """What a valve passes that leaks."""
    return leak + (1.0 - leak) * position


def with_value(table: Values, **changed: FloatArray) -> Values:
    """A copy with some entries changed."""
    return {**table, **changed}
