"""Causes of a departure, ranked by likelihood, with what speaks for and against each and how to tell them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fdd.diagnosis.advice import advice
from fdd.diagnosis.departure import Departure
from fdd.diagnosis.hypotheses import hypotheses, table
from fdd.diagnosis.likelihood import Judged, Vector, judge, shares
from fdd.evidence import Cause, Message, Size
from fdd.models.declare import ComponentModel

SHOWN = 0.005
"""Causes less likely than this are told only while there are few."""
FEWEST = 3
PLAIN = 3.0
"""An element of the evidence speaks from so many standard deviations on."""
MODEL = Cause("model", Message.of("unknown_cause"), checks=(Message.of("unknown_ask"),), kind="model")


def measured_causes(model: ComponentModel, departure: Departure) -> tuple[Cause, ...]:
    """Causes in order of likelihood; empty where no signature of the model was measured or nothing has been seen."""
    if model.name not in table() or not departure.count.any():
        return ()
    vector = Vector.of(departure)
    judged = [judge(h, vector) for h in hypotheses(model, departure.symbols)]
    if not any(j.hypothesis.measured for j in judged):
        return ()
    share, unknown = shares(judged, vector)
    rows = [_cause(j, float(s), departure, vector) for j, s in zip(judged, share, strict=True)]
    rows.append(replace(MODEL, likelihood=unknown, speaks_for=_jumps(departure)))
    rows.sort(key=_descending)
    kept = [c for i, c in enumerate(rows) if i < FEWEST or (c.likelihood or 0.0) >= SHOWN]
    return tuple(replace(c, likelihood=round(c.likelihood or 0.0, 3)) for c in kept)


def _descending(cause: Cause) -> float:
    return -(cause.likelihood or 0.0)


def _cause(j: Judged, share: float, d: Departure, vector: Vector) -> Cause:
    h = j.hypothesis
    supports, objects = _speaks(j, d, vector)
    size = j.extent * h.size
    return Cause(
        name=h.name,
        where=h.where,
        meaning=h.meaning,
        kind=h.kind,
        likelihood=share,
        speaks_for=supports,
        speaks_against=objects,
        size=Size(float(f"{size:.2g}"), h.unit),
        checks=advice(h, size),
    )


def _speaks(j: Judged, d: Departure, vector: Vector) -> tuple[tuple[Message, ...], tuple[Message, ...]]:
    """Elements of the evidence that the cause foretells, and those that it does not."""
    noise = np.sqrt(np.diagonal(vector.covariance))
    supports, objects = [], []
    for i, (what, symbol, seen, expected) in enumerate(_elements(j, d, vector)):
        told = abs(expected) > PLAIN * noise[i]
        moved = abs(seen) > PLAIN * noise[i]
        off = abs(seen - expected) > PLAIN * j.sd[i]
        if moved and told and seen * expected > 0 and not off:
            supports.append(seen_at(what, symbol, seen))
        elif moved and (not told or seen * expected < 0):
            objects.append(Message.of("unexplained", what=seen_at(what, symbol, seen)))
        elif told and off:
            objects.append(Message.of("would_show", what=seen_at(what, symbol, expected)))
    return tuple(supports[:3]), tuple(objects[:3])


def seen_at(what: str, symbol: str, side: float) -> Message:
    """That a parameter or an output is above or below what is expected, or that it jumped."""
    code = what if what == "jumped" else f"{what}_{'above' if side > 0 else 'below'}"
    return Message.of(code, symbol=symbol)


def _elements(j: Judged, d: Departure, vector: Vector) -> Sequence[tuple[str, str, float, float]]:
    what = ["parameter"] * len(d.symbols) + ["output"] * len(d.outputs) + ["jumped"] * len(d.outputs)
    symbols = (*d.symbols, *d.outputs, *d.outputs)
    return list(zip(what, symbols, vector.x.tolist(), j.expected.tolist(), strict=True))


def _jumps(d: Departure) -> tuple[Message, ...]:
    jumps = zip(d.outputs, d.jump.tolist(), strict=True)
    return tuple(seen_at("jumped", s, v) for s, v in jumps if abs(v) > 8.0)
