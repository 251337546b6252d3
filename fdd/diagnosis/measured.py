"""Causes of a departure, ranked by likelihood, with what speaks for and against each and how to tell them apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.diagnosis.advice import advice
from fdd.diagnosis.departure import Departure
from fdd.diagnosis.hypotheses import hypotheses, table
from fdd.diagnosis.likelihood import Judged, Vector, judge, shares
from fdd.models.declare import ComponentModel
from fdd.records import JsonObject

SHOWN = 0.005
"""Causes less likely than this are told only while there are few."""
FEWEST = 3
PLAIN = 3.0
"""An element of the evidence speaks from so many standard deviations on."""
MODEL: JsonObject = {
    "name": "model",
    "meaning": "something that no known fault of this equipment explains, such as a change of use or a repair",
    "kind": "model",
    "checks": [
        "Ask what was changed, repaired or switched over about the onset: nothing, if the equipment is at fault; "
        "if something was, fit a new baseline"
    ],
}


def measured_causes(model: ComponentModel, departure: Departure) -> tuple[JsonObject, ...]:
    """Causes in order of likelihood; empty where no signature of the model was measured or nothing has been seen."""
    if model.name not in table() or not departure.count.any():
        return ()
    vector = Vector.of(departure)
    judged = [judge(h, vector) for h in hypotheses(model, departure.symbols)]
    if not any(j.hypothesis.measured for j in judged):
        return ()
    share, unknown = shares(judged, vector)
    rows = [_cause(j, float(s), departure, vector) for j, s in zip(judged, share, strict=True)]
    rows.append({**MODEL, "likelihood": unknown, "for": _jumps(departure), "against": []})
    rows.sort(key=lambda c: -float(c["likelihood"]))
    kept = [c for i, c in enumerate(rows) if i < FEWEST or c["likelihood"] >= SHOWN]
    return tuple({**c, "likelihood": round(float(c["likelihood"]), 3)} for c in kept)


def _cause(j: Judged, share: float, d: Departure, vector: Vector) -> JsonObject:
    h = j.hypothesis
    supports, objects = _speaks(j, d, vector)
    size = j.extent * h.size
    return {
        "name": h.name,
        "where": h.where,
        "meaning": h.meaning,
        "kind": h.kind,
        "likelihood": share,
        "for": supports,
        "against": objects,
        "size": {"value": float(f"{size:.2g}"), "unit": h.unit},
        "checks": list(advice(h, size)),
    }


def _speaks(j: Judged, d: Departure, vector: Vector) -> tuple[list[str], list[str]]:
    """Elements of the evidence that the cause foretells, and those that it does not."""
    noise = np.sqrt(np.diagonal(vector.covariance))
    supports, objects = [], []
    for i, (word, seen, expected) in enumerate(_elements(j, d, vector)):
        told = abs(expected) > PLAIN * noise[i]
        moved = abs(seen) > PLAIN * noise[i]
        off = abs(seen - expected) > PLAIN * j.sd[i]
        side = "above" if seen > 0 else "below"
        if moved and told and seen * expected > 0 and not off:
            supports.append(word.format(side=side))
        elif moved and (not told or seen * expected < 0):
            objects.append(f"it does not explain that {word.format(side=side)}")
        elif told and off:
            objects.append(f"it would show that {word.format(side='above' if expected > 0 else 'below')}")
    return supports[:3], objects[:3]


def _elements(j: Judged, d: Departure, vector: Vector) -> Sequence[tuple[str, float, float]]:
    words = [f"{s} is {{side}} its baseline" for s in d.symbols]
    words += [f"{s} is {{side}} what the model expects" for s in d.outputs]
    words += [f"{s} jumped at the onset" for s in d.outputs]
    return list(zip(words, vector.x.tolist(), j.expected.tolist(), strict=True))


def _jumps(d: Departure) -> list[str]:
    return [f"{s} jumped at the onset" for s, v in zip(d.outputs, d.jump.tolist(), strict=True) if abs(v) > 8.0]
