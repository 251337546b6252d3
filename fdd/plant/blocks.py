"""Control blocks and ideal elements of a plant: mixing, heating curve, controllers, valves, thermostats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fdd.models.declare import Quantity
from fdd.models.functions import absolute, maximum, minimum, where
from fdd.plant.network import Block, Setting

Result = tuple[Mapping[str, Any], Mapping[str, Any]]


def mixer(count: int) -> Block:
    """Water of ``count`` streams joins: total flow and mixed temperature."""
    streams = range(1, count + 1)

    def step(m: Any, u: Any, p: Any) -> Result:
        total = sum(getattr(u, f"m_flow_{i}") for i in streams)
        heat = sum((getattr(u, f"m_flow_{i}") + 1e-9) * getattr(u, f"T_{i}") for i in streams)
        return {"m_flow": total, "T": heat / (total + count * 1e-9)}, {}

    inputs = [Quantity(f"m_flow_{i}", "kg/s", f"flow {i}") for i in streams]
    inputs += [Quantity(f"T_{i}", "degC", f"temperature {i}") for i in streams]
    outputs = (Quantity("m_flow", "kg/s", "total flow"), Quantity("T", "degC", "mixed temperature"))
    return Block("mixer", tuple(inputs), outputs, step)


def heating_curve() -> Block:
    """Supply temperature set point falls as it gets warmer outside."""

    def step(m: Any, u: Any, p: Any) -> Result:
        slow = m.T_out + p.smoothing * (u.T_out - m.T_out)
        set_point = p.T_base + p.slope * (p.T_limit - slow)
        return {"T_set": minimum(maximum(set_point, p.T_base), p.T_highest)}, {"T_out": slow}

    return Block(
        "heating curve",
        (Quantity("T_out", "degC", "outdoor temperature"),),
        (Quantity("T_set", "degC", "set point of the supply temperature"),),
        step,
        (
            Setting("T_base", "degC", 28.0, "set point at and above the heating limit"),
            Setting("slope", "1", 1.5, "rise of the set point per kelvin below the limit"),
            Setting("T_limit", "degC", 18.0, "heating limit"),
            Setting("T_highest", "degC", 70.0, "highest set point"),
            Setting("smoothing", "1", 0.02, "share of a new outdoor value taken in each step"),
        ),
        (Setting("T_out", "degC", 5.0, "smoothed outdoor temperature"),),
    )


def supply_controller() -> Block:
    """Primary flow of a heat exchanger: heat balance as feed-forward, trimmed by an integral term."""

    def step(m: Any, u: Any, p: Any) -> Result:
        error = u.T_set - u.T_supply
        needed = u.m_flow * maximum(u.T_set - u.T_return, 0.0) / maximum(u.T_hot_in - u.T_hot_out, p.smallest)
        wanted = m.trim * needed
        flow = minimum(maximum(wanted, p.m_lowest), p.m_highest)
        saturated = absolute(flow - wanted)
        trim = m.trim * (1.0 + where(saturated > 0.0, 0.0, p.gain) * error)
        return {"m_flow": flow}, {"trim": minimum(maximum(trim, 0.5), 2.0)}

    return Block(
        "supply controller",
        (
            Quantity("T_set", "degC", "set point"),
            Quantity("T_supply", "degC", "secondary supply"),
            Quantity("T_return", "degC", "secondary return"),
            Quantity("m_flow", "kg/s", "secondary flow"),
            Quantity("T_hot_in", "degC", "primary supply"),
            Quantity("T_hot_out", "degC", "primary return"),
        ),
        (Quantity("m_flow", "kg/s", "flow wanted on the primary side"),),
        step,
        (
            Setting("gain", "1/K", 0.01, "change of the trim per kelvin of error and step"),
            Setting("smallest", "K", 5.0, "least primary temperature drop reckoned with"),
            Setting("m_lowest", "kg/s", 0.002, "flow of the closed valve"),
            Setting("m_highest", "kg/s", 2.0, "flow of the open valve"),
        ),
        (Setting("trim", "1", 1.0, "correction of the feed-forward"),),
    )


def thermostat() -> Block:
    """Thermostatic radiator valve: proportional, slow, with a seat that leaks a little."""

    def step(m: Any, u: Any, p: Any) -> Result:
        sensed = m.T + p.smoothing * (u.T_room - m.T)
        opening = minimum(maximum(0.5 + (u.T_set - sensed) / p.band, 0.0), 1.0)
        return {"opening": opening}, {"T": sensed}

    return Block(
        "thermostat",
        (Quantity("T_room", "degC", "room temperature"), Quantity("T_set", "degC", "set point")),
        (Quantity("opening", "1", "opening wanted"),),
        step,
        (
            Setting("band", "K", 3.0, "proportional band"),
            Setting("smoothing", "1", 0.3, "share of a new value taken in each step"),
        ),
        (Setting("T", "degC", 20.0, "temperature of the sensing head"),),
    )


def actuator() -> Block:
    """What a valve or damper makes of the wanted opening: stiction, stuck, a leaking seat, then flow by opening."""

    def step(m: Any, u: Any, p: Any) -> Result:
        # Stiction as play: the stem follows only when the wanted opening has moved farther than half the play.
        low, high = u.opening - 0.5 * p.play, u.opening + 0.5 * p.play
        moved = minimum(maximum(m.opening, low), high)
        opening = where(p.stuck > 0.5, m.opening, minimum(maximum(moved, 0.0), 1.0))
        share = p.leak + (1.0 - p.leak) * opening
        return {"m_flow": p.m_full * share, "opening": opening}, {"opening": opening}

    return Block(
        "actuator",
        (Quantity("opening", "1", "opening wanted"),),
        (Quantity("m_flow", "kg/s", "flow"), Quantity("opening", "1", "true opening")),
        step,
        (
            Setting("m_full", "kg/s", 0.2, "flow of the open valve"),
            Setting("leak", "1", 0.01, "share of the flow when closed"),
            Setting("play", "1", 0.0, "opening lost between the directions of travel"),
            Setting("stuck", "1", 0.0, "1 while the stem does not move"),
        ),
        (Setting("opening", "1", 0.3, "true opening"),),
    )
