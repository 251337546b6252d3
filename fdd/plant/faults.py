"""Faults of a simulated plant: what, where, since when, how fast and how bad.

A fault changes true parameters of a component, settings of a control block, or what a sensor makes of the truth.
``course`` gives its extent from 0 (not there) to 1 (all of ``severity``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

import numpy as np

from fdd.plant.network import Network, PlantError
from fdd.plant.simulate import Change, SensorFault
from fdd.records import FloatArray

Shape = Literal["step", "ramp", "intermittent"]
DAY = 86400.0


@dataclass(frozen=True, slots=True)
class PlantFault:
    """One fault.

    Attributes
    ----------
    kind : one of :data:`KINDS`
    target : component, control block or measured point, by kind
    onset : when it begins, after the start of the simulation [s]
    severity : its final size; a share for physical faults, the point's unit for bias and drift
    shape : ``step``, ``ramp`` (grows over ``duration``), ``intermittent`` (there and not there for ``duration`` each)
    duration : see ``shape`` [s]
    """

    kind: str
    target: str
    onset: float
    severity: float
    shape: Shape = "step"
    duration: float = 7 * DAY


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of fault: its meaning, what ``severity`` measures, and what it does."""

    meaning: str
    severity: str
    act: Callable[[Network, PlantFault, FloatArray], list[Change | SensorFault]]


def course(fault: PlantFault, seconds: FloatArray) -> FloatArray:
    """Extent in [0, 1] at the given seconds after the start, (n,).

    Raises
    ------
    PlantError : unknown shape, or a duration that is not positive
    """
    since = seconds - fault.onset
    if fault.shape == "step":
        return np.asarray(since >= 0.0, dtype=np.float64)
    if fault.duration <= 0.0:
        raise PlantError(f"fault {fault.kind}: duration {fault.duration} s; a {fault.shape} needs one above zero")
    if fault.shape == "ramp":
        return np.clip(since / fault.duration, 0.0, 1.0)
    if fault.shape == "intermittent":
        return np.asarray((since >= 0.0) & (np.floor(since / fault.duration) % 2.0 == 0.0), dtype=np.float64)
    raise PlantError(f"fault {fault.kind}: shape {fault.shape!r} is unknown; use step, ramp or intermittent")


def effects(
    network: Network, faults: Sequence[PlantFault], seconds: FloatArray
) -> tuple[list[Change], list[SensorFault]]:
    """Changes of the plant and of its sensors for all faults; those on one parameter multiply.

    Raises
    ------
    PlantError : unknown kind or target, or a target the kind cannot act on
    """
    changes: dict[str, Change] = {}
    sensors: list[SensorFault] = []
    for fault in faults:
        if fault.kind not in KINDS:
            close = get_close_matches(fault.kind, KINDS, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(KINDS)}"
            raise PlantError(f"unknown kind of fault {fault.kind!r}{hint}")
        for effect in KINDS[fault.kind].act(network, fault, course(fault, seconds)):
            if isinstance(effect, SensorFault):
                sensors.append(effect)
            elif effect.target in changes:
                base = _value(network, effect.target)
                together = changes[effect.target].values * effect.values / base if base else effect.values
                changes[effect.target] = Change(effect.target, together)
            else:
                changes[effect.target] = effect
    return list(changes.values()), sensors


def _value(network: Network, target: str) -> float:
    owner, _, symbol = target.rpartition(".")
    if owner in network.components:
        return network.components[owner].parameters[symbol]
    return network.controllers[owner].settings[symbol]


def _less(*symbols: str) -> Callable[[Network, PlantFault, FloatArray], list[Change | SensorFault]]:
    """Those of the component's parameters that it has fall by the share ``severity``."""

    def act(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
        if not 0.0 <= fault.severity < 1.0:
            raise PlantError(f"fault {fault.kind}: severity {fault.severity} is a share; give it in [0, 1)")
        component = network.components.get(fault.target)
        has = [s for s in symbols if component and s in component.parameters]
        if component is None or not has:
            raise PlantError(
                f"fault {fault.kind} needs a component with one of the parameters {', '.join(symbols)}; "
                f"{fault.target!r} is none of {', '.join(network.components)} or has none of them"
            )
        return [Change(f"{fault.target}.{s}", component.parameters[s] * (1.0 - fault.severity * extent)) for s in has]

    return act


def _air(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
    """Less surface, and half as much less water."""
    effects = _less("H")(network, fault, extent)
    water = network.components[fault.target].parameters["C"]
    return [*effects, Change(f"{fault.target}.C", water * (1.0 - 0.5 * fault.severity * extent))]


def _sludge(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
    """Less flow by the whole severity, less surface by half of it."""
    half = PlantFault(fault.kind, fault.target, fault.onset, 0.5 * fault.severity, fault.shape, fault.duration)
    effects = _less("H")(network, half, extent)
    valve = network.wires.get(f"{fault.target}.m_flow", "").rpartition(".")[0]
    if valve in network.controllers and "m_full" in network.controllers[valve].settings:
        full = network.controllers[valve].settings["m_full"]
        effects.append(Change(f"{valve}.m_full", full * (1.0 - fault.severity * extent)))
    return effects


def _leak(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
    """A block's setting ``leak``, or a component's parameter named ``component.leak_...``."""
    owner, _, symbol = fault.target.rpartition(".")
    component = network.components.get(owner)
    if component is None or not symbol.startswith("leak") or symbol not in component.parameters:
        able = [f"{n}.{s}" for n, c in network.components.items() for s in c.parameters if s.startswith("leak")]
        return _setting("leak", _added, able)(network, fault, extent)
    return [Change(fault.target, _added(component.parameters[symbol], fault.severity, extent))]


def _setting(
    symbol: str, law: Callable[[float, float, FloatArray], FloatArray], others: Sequence[str] = ()
) -> Callable[[Network, PlantFault, FloatArray], list[Change | SensorFault]]:
    """A block's setting follows ``law(healthy value, severity, extent)``; ``others`` are further targets to name."""

    def act(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
        block = network.controllers.get(fault.target)
        if block is None or symbol not in block.settings:
            able = [n for n, c in network.controllers.items() if symbol in c.settings] + [*others]
            raise PlantError(
                f"fault {fault.kind} acts on {', '.join(able) or 'no block of this plant'}, not {fault.target!r}"
            )
        return [Change(f"{fault.target}.{symbol}", law(block.settings[symbol], fault.severity, extent))]

    return act


def _sensor(
    gain: float = 0.0, offset: float = 0.0, noise: float = 0.0, frozen: bool = False
) -> Callable[[Network, PlantFault, FloatArray], list[Change | SensorFault]]:
    def act(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
        if fault.target not in network.sensors:
            raise PlantError(f"fault {fault.kind} needs a measured point; known: {', '.join(network.sensors)}")
        size = fault.severity * extent
        return [
            SensorFault(
                point=fault.target,
                gain=1.0 + gain * size,
                offset=offset * size,
                noise=1.0 + noise * size,
                frozen=(extent > 0.0) & frozen,
            )
        ]

    return act


def _drift(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
    if fault.shape == "step":
        raise PlantError(
            "fault drift: shape 'step'; a drift grows: use shape ramp, or kind bias for an error that jumps"
        )
    return _sensor(offset=1.0)(network, fault, extent)


def _swap(network: Network, fault: PlantFault, extent: FloatArray) -> list[Change | SensorFault]:
    """Wrong installation: the points ``a | b`` are exchanged."""
    points = [p.strip() for p in fault.target.split("|")]
    if len(points) != 2 or any(p not in network.sensors for p in points):
        raise PlantError(f"fault swap needs two measured points 'a | b', not {fault.target!r}")
    a, b = (network.sensors[p] for p in points)
    if a.unit != b.unit:
        raise PlantError(f"fault swap: {a.point} [{a.unit}] and {b.point} [{b.unit}] measure different things")
    one, none = np.ones_like(extent), np.zeros_like(extent)
    return [SensorFault(a.point, one, none, one, extent < 0.0, swapped_with=b.point, swapped=extent > 0.0)]


def _on(healthy: float, severity: float, extent: FloatArray) -> FloatArray:
    return np.asarray(extent > 0.0, dtype=np.float64)


def _added(healthy: float, severity: float, extent: FloatArray) -> FloatArray:
    return healthy + severity * extent


def _raised(healthy: float, severity: float, extent: FloatArray) -> FloatArray:
    return healthy * (1.0 + severity * extent)


_TRANSFER = _less("C", "C_hot", "C_cold", "K_hot", "K_cold", "UA", "n_cool")
_READING = "the point's unit"

KINDS: dict[str, Kind] = {
    "fouling": Kind("deposits on a heat exchanger or coil", "share of the transfer lost", _TRANSFER),
    "air": Kind("air in a radiator", "share of the surface lost", _air),
    "sludge": Kind("deposits in a radiator", "share of the flow lost", _sludge),
    "wear": Kind("worn pump or fan", "share of the head lost", _less("head", "p_0")),
    "leak": Kind("valve seat leaks through", "share of the full flow when closed", _leak),
    "stick": Kind("valve stem sticks", "opening lost at a change of direction", _setting("play", _added)),
    "stuck": Kind("valve stem does not move", "any above zero", _setting("stuck", _on)),
    "hunting": Kind("controller swings", "factor on its gain, less one", _setting("gain", _raised)),
    "bias": Kind("sensor reads wrong by a constant", _READING, _sensor(offset=1.0)),
    "drift": Kind("sensor's error grows", f"{_READING}, at the end of the ramp", _drift),
    "noise": Kind("sensor is noisy", "factor on its noise, less one", _sensor(noise=1.0)),
    "scaling": Kind("sensor reads a wrong share", "share of the value", _sensor(gain=1.0)),
    "freeze": Kind("sensor keeps its last value", "any above zero", _sensor(frozen=True)),
    "swap": Kind("two sensors are exchanged", "any above zero", _swap),
}
