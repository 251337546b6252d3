"""The component models as tables, for people and machines."""

from __future__ import annotations

import inspect
from dataclasses import asdict

from fdd.config.schema import CHILLER
from fdd.models.declare import Quantity
from fdd.models.equipment import KINDS
from fdd.models.expectation import EquipmentModel
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
        if name not in KINDS
    ]
    return [*filters, _chiller_row(), *(_kind_row(kind) for kind in KINDS.values())]


def _kind_row(kind: EquipmentModel) -> JsonObject:
    return {
        "name": kind.name,
        "title": f"{kind.title}, by rows of expectations from the first day",
        "options": "docs/equipment.md",
        "inputs": [r.symbol for r in kind.roles],
        "outputs": [],
    }


def _describe_kind(kind: EquipmentModel) -> JsonObject:
    """Roles with the names they may have in a site file, and what each fault shows through."""
    roles = [
        {
            "symbol": r.symbol,
            "unit": r.unit,
            "meaning": f"{r.meaning}{', required' if r.required else ''}; also {', '.join(r.names)}",
        }
        for r in kind.roles
    ]
    parameters = (
        [{"symbol": p.symbol, "unit": p.unit, "meaning": p.meaning} for p in kind.form.priors] if kind.form else []
    )
    faults = [
        {
            "name": f.name,
            "meaning": f.meaning,
            "shows": "; ".join(r.name for r in kind.rows if f.name in (*r.high_causes, *r.low_causes)),
        }
        for f in kind.faults
    ]
    return {
        "name": kind.name,
        "version": "rows 1",
        "title": kind.title,
        "states": [],
        "inputs": roles,
        "outputs": [],
        "parameters": parameters,
        "faults": faults,
        "references": [f"{r.name}: {r.source}" for r in kind.rows],
    }


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
    if name in KINDS:
        return _describe_kind(KINDS[name])
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
