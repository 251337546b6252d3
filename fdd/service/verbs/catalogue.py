"""The component models as tables, for people and machines."""

from __future__ import annotations

import inspect
from dataclasses import asdict

from fdd.config.schema import CHILLER
from fdd.models.declare import Quantity
from fdd.models.registry import MODELS, get_model
from fdd.records import JsonObject

WAYS = {1: "up", -1: "down", 0: "either way"}


def catalogue() -> list[JsonObject]:
    """One row a model, with its options and their defaults."""
    filters = [
        {
            "name": name,
            "title": get_model(name).title,
            "options": ", ".join(f"{p.name}={p.default}" for p in inspect.signature(factory).parameters.values()),
            "inputs": list(get_model(name).symbols["inputs"]),
            "outputs": list(get_model(name).symbols["outputs"]),
        }
        for name, factory in sorted(MODELS.items())
    ]
    return [*filters, _chiller_row()]


def _chiller_row() -> JsonObject:
    from fdd.config.chiller import ROLES

    return {
        "name": CHILLER,
        "title": "Chiller (Gordon-Ng), by regression and not by a filter",
        "options": "docs/chiller.md",
        "inputs": [q.symbol for q in ROLES],
        "outputs": [],
    }


def _describe_chiller() -> JsonObject:
    from fdd.config.chiller import ROLES

    parameters = (
        Quantity("dS", "W/K", "internal entropy production"),
        Quantity("Q_leak", "W", "heat leak"),
        Quantity("R", "K/W", "heat-exchanger resistance"),
    )
    return {
        "name": CHILLER,
        "version": "1",
        "title": "Chiller (Gordon-Ng)",
        "states": [],
        "inputs": [asdict(q) for q in ROLES],
        "outputs": [],
        "parameters": [asdict(q) for q in parameters],
        "faults": [],
        "references": ["J.M. Gordon and K.C. Ng, Cool Thermodynamics (2000); options: docs/chiller.md"],
    }


def describe(name: str) -> JsonObject:
    """A model's tables: states, inputs, outputs, parameters, faults, references."""
    if name == CHILLER:
        return _describe_chiller()
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
