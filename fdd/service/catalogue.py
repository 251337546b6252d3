"""The component models as tables, for people and machines."""

from __future__ import annotations

import inspect
from dataclasses import asdict

from fdd.models.registry import MODELS, get_model
from fdd.records import JsonObject


WAYS = {1: "up", -1: "down", 0: "either way"}


def catalogue() -> list[JsonObject]:
    """One row a model, with its options and their defaults."""
    return [
        {
            "name": name,
            "title": get_model(name).title,
            "options": ", ".join(f"{p.name}={p.default}" for p in inspect.signature(factory).parameters.values()),
            "inputs": list(get_model(name).symbols["inputs"]),
            "outputs": list(get_model(name).symbols["outputs"]),
        }
        for name, factory in sorted(MODELS.items())
    ]


def describe(name: str) -> JsonObject:
    """A model's tables: states, inputs, outputs, parameters, faults, references."""
    model = get_model(name)
    tables = {t: [asdict(q) for q in getattr(model, t)] for t in ("states", "inputs", "outputs", "parameters")}
    faults = [
        {
            "name": f.name,
            "meaning": f.meaning,
            "shows": ", ".join(f"{k} {WAYS[v]}" for k, v in f.shows.items()),
        }
        for f in model.faults
    ]
    return {
        "name": model.name,
        "version": model.version,
        "title": model.title,
        **tables,
        "faults": faults,
        "references": list(model.references),
    }
