"""How a fault's signature is made of what runs with it left behind, and written where diagnosis reads it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import fdd.diagnosis
from fdd.diagnosis.departure import Departure
from fdd.records import FloatArray

Signature = dict[str, Any]
Row = dict[str, dict[str, float]]
PARTS = ("shift", "mean", "jump")
RIDGE = 0.5
"""A parameter is not taken to have moved by more than about this where the data do not say [estimation scale]."""
CALM = 5.0
"""Largest innovations below this are no jumps."""


def signature(
    name: str,
    where: str,
    kind: str,
    unit: str,
    runs: Sequence[tuple[float, Departure]],
    *,
    signed: bool,
    options: Mapping[str, Any] | None = None,
) -> Signature:
    """A fault as it shows, with its scatter over runs of (size, what was seen); all counted for the largest size."""
    size = max(abs(s) for s, _ in runs)
    rows = [_row(d, size / s) for s, d in runs]
    entry: Signature = {"name": name, "where": where, "kind": kind}
    entry |= {"options": dict(options)} if options else {}
    entry |= {"size": size, "unit": unit, "signed": signed, "runs": len(rows)}
    return entry | {part: _spread([r[part] for r in rows], part) for part in PARTS}


def write(file: str, benchmark: str, models: Mapping[str, Sequence[Signature]]) -> None:
    """Replace a table of signatures by what ``python -m benchmarks.NAME --write`` has measured, by model."""
    found = {"made_by": f"python -m benchmarks.{benchmark} --write", "models": models}
    Path(fdd.diagnosis.__file__).with_name(file).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"written: {file}")


def numbered(text: str) -> str:
    """Rooms by number: another house names them otherwise."""
    return text.replace("south", "#0").replace("north", "#1")


def _row(d: Departure, unit: float) -> Row:
    precision = d.information + np.eye(len(d.symbols)) / RIDGE**2
    shift = np.asarray(np.linalg.solve(precision, d.score) * unit, dtype=np.float64)
    jump = np.where(np.abs(d.jump) > CALM, d.jump, 0.0) * unit

    def named(symbols: tuple[str, ...], values: FloatArray) -> dict[str, float]:
        return {numbered(s): float(v) for s, v in zip(symbols, values, strict=True)}

    return {"shift": named(d.symbols, shift), "mean": named(d.outputs, d.mean * unit), "jump": named(d.outputs, jump)}


def _spread(rows: list[dict[str, float]], part: str) -> dict[str, list[float]]:
    """Mean and scatter of each element; a fault may also come slowly, without a jump."""
    found = {}
    for symbol in rows[0]:
        values = np.array([r.get(symbol, 0.0) for r in rows])
        mean, sd = float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else abs(float(values[0]))
        sd = max(sd, abs(mean)) if part == "jump" else sd
        found[symbol] = [float(f"{mean:.3g}"), float(f"{sd:.3g}")]
    return found
