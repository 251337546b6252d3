"""What may be wrong with a component, and how each fault shows: measured signatures first, declared signs otherwise.

A signature says, for a fault of one size, how far each physical parameter seems to move (estimation scale), how far the
mean of each standardised innovation shifts, and how far it jumps when the fault comes at once; each with its scatter
over simulated plants. ``signatures.yaml`` holds what ``python -m benchmarks.diagnosis --write`` measured through the
service's own engine, ``signatures-zone.yaml`` what ``benchmarks.diagnosis_room`` and ``signatures-air_handler.yaml``
what ``benchmarks.air_plant`` did. A fault that no plant was simulated with is told by the signs its model declares.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np

from fdd.evidence import Message
from fdd.models.declare import ComponentModel, Fault, Parameter
from fdd.records import FloatArray

Kind = Literal["component", "sensor", "upstream", "model"]

PRIOR: dict[Kind, float] = {"component": 1.0, "sensor": 0.5, "upstream": 0.25, "model": 0.1}
"""Odds before anything was measured: plant fails more often than the instrument, the instrument upstream less."""
RARE = {"covered": 0.5, "stuck": 0.5}
"""Odds of single faults against others of their kind."""
DECLARED_SHIFT, DECLARED_MEAN = 0.2, 0.5
"""What a declared sign is taken for: a parameter's relative change, an innovation's mean in standard deviations."""
LOOSE = 1.0
"""Relative scatter of a declared signature: it knows signs, not sizes."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One thing that may be wrong, and how it shows for a fault of ``size``.

    Attributes
    ----------
    name, where : the fault of the model's table, and the symbol it sits at, if one
    meaning, quantity : what it is, and what the instrument measures that it is about, for people
    kind : the component itself, its own sensor, an instrument it is fed from
    shift, shift_sd : (n_p,), of the physical parameters on the estimation scale
    mean, mean_sd : (n_y,), of the standardised innovations
    jump, jump_sd : (n_y,), of their largest single value at the onset
    size, unit : what the signature was measured with; the sign says to which side
    signed : it can only go to one side (fouling never cleans)
    measured : from simulated plants, not from declared signs
    checks : of the model's table
    """

    name: str
    where: str
    meaning: Message
    kind: Kind
    shift: FloatArray
    shift_sd: FloatArray
    mean: FloatArray
    mean_sd: FloatArray
    jump: FloatArray
    jump_sd: FloatArray
    size: float
    unit: str
    signed: bool
    measured: bool
    checks: tuple[str, ...] = ()
    quantity: Message | None = None

    @property
    def prior(self) -> float:
        """Odds before the evidence."""
        return PRIOR[self.kind] * RARE.get(self.name, 1.0)


@cache
def table() -> dict[str, Any]:
    """The measured signatures by model name, of every plant that was simulated."""
    found: dict[str, Any] = {}
    for file in sorted(resources.files("fdd.diagnosis").iterdir(), key=lambda f: f.name):
        if file.name.startswith("signatures") and file.name.endswith(".yaml"):
            # Written as JSON, which is YAML, too; a parser of YAML takes 0.1 s in the engine's first alarm.
            found |= json.loads(file.read_text(encoding="utf-8"))["models"]
    return found


def hypotheses(model: ComponentModel, physical: tuple[str, ...]) -> list[Hypothesis]:
    """All that may be wrong with a component, the measured first.

    Parameters
    ----------
    model : its declaration
    physical : physical parameters in the order of the evidence
    """
    faults = {f.name: f for f in model.faults}
    found = [
        _measured(model, physical, entry, faults)
        for written in table().get(model.name, ())
        if (entry := _renamed(written, model)) is not None and _fits(entry, model)
    ]
    known = {h.name for h in found}
    return found + [_declared(model, physical, f) for f in model.faults if f.name not in known]


def _renamed(entry: Mapping[str, Any], model: ComponentModel) -> dict[str, Any] | None:
    """Rooms are numbered in the table and named in the site."""
    rooms = list(model.options.get("rooms", ()))
    text = json.dumps(entry)
    if "#" not in text:
        return dict(entry)
    if len(rooms) != 2:
        return None
    renamed: dict[str, Any] = json.loads(text.replace("#0", str(rooms[0])).replace("#1", str(rooms[1])))
    return renamed


def _fits(entry: Mapping[str, Any], model: ComponentModel) -> bool:
    """Whether a signature was measured on this form of the model: its options, its symbols."""
    symbols = model.symbols
    if any(model.options.get(k) != v for k, v in entry.get("options", {}).items()):
        return False
    return set(entry["shift"]) <= set(symbols["parameters"]) and set(entry["mean"]) == set(symbols["outputs"])


def _measured(
    model: ComponentModel, physical: tuple[str, ...], entry: Mapping[str, Any], faults: Mapping[str, Fault]
) -> Hypothesis:
    def columns(part: str, order: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        pairs = np.array([entry[part].get(s, (0.0, 0.0)) for s in order], dtype=np.float64).reshape(len(order), 2)
        return pairs[:, 0], pairs[:, 1]

    outputs = model.symbols["outputs"]
    fault = faults.get(entry["name"])
    own = fault is not None and not entry["where"]
    what = _quantity(model, entry["where"])
    return Hypothesis(
        entry["name"],
        entry["where"],
        Message.declared(fault.meaning) if own and fault else instrument(what, entry["unit"]),
        entry["kind"],
        *columns("shift", physical),
        *columns("mean", outputs),
        *columns("jump", outputs),
        float(entry["size"]),
        entry["unit"],
        signed=bool(entry["signed"]),
        measured=True,
        checks=fault.checks if own and fault else (),
        quantity=what,
    )


def _quantity(model: ComponentModel, symbol: str) -> Message:
    """What a symbol among inputs and outputs means."""
    quantities = {q.symbol: q.meaning for q in (*model.inputs, *model.outputs)}
    return Message.declared(quantities.get(symbol, symbol))


def instrument(what: Message, unit: str) -> Message:
    """What is wrong with the instrument of a quantity."""
    codes = {"frozen": "sensor_keeps", "share": "meter_share"}
    return Message.of(codes.get(unit, "sensor_constant"), what=what)


def _declared(model: ComponentModel, physical: tuple[str, ...], fault: Fault) -> Hypothesis:
    parameters = {p.symbol: p for p in model.parameters}
    shift = np.array([fault.shows.get(s, 0) * _slope(parameters[s]) * DECLARED_SHIFT for s in physical])
    either = np.array([s in fault.shows and fault.shows[s] == 0 for s in physical])
    shown = {t.removeprefix("innovation:"): sign for t, sign in fault.shows.items() if t.startswith("innovation:")}
    outputs = model.symbols["outputs"]
    mean = np.array([shown.get(s, 0) * DECLARED_MEAN for s in outputs])
    open_ = np.array([s in shown and shown[s] == 0 for s in outputs])
    instrumental = fault.name.startswith(("bias", "stuck", "scaling")) or "sensor" in fault.name
    none = np.zeros(len(outputs))
    return Hypothesis(
        fault.name,
        "",
        Message.declared(fault.meaning),
        "sensor" if instrumental else "component",
        shift,
        LOOSE * np.abs(shift) + np.where(either, DECLARED_SHIFT, 0.0),
        mean,
        LOOSE * np.abs(mean) + np.where(open_, DECLARED_MEAN, 0.0),
        # An instrument may fail at once; how large the jump is, nobody has measured.
        none,
        np.where((mean != 0) | open_, 20.0, 0.0) if instrumental else none,
        1.0,
        "",
        signed=not instrumental,
        measured=False,
        checks=fault.checks,
    )


def _slope(parameter: Parameter) -> float:
    """What a small relative change is on the estimation scale, at the typical value."""
    match parameter.transform:
        case "log":
            return 1.0
        case "logit":
            low, high, v = parameter.lower, parameter.upper, parameter.typical
            return abs(v) * (high - low) / max((v - low) * (high - v), 1e-6 * (high - low) ** 2)
        case _:
            return max(abs(parameter.typical), 1e-3 * (parameter.upper - parameter.lower))
