"""Versioned baselines in the store: every one that was ever kept, and which is in force.

A baseline is kept once and never changed, but for who approved it. ``fdd fit`` and approvals are a person's word; what
a job put in force is marked ``automatic`` in its diagnostics and says which version it ``follows``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from fdd.models.former import present
from fdd.records import Baseline, JsonObject
from fdd.store.store import Store


class BaselineError(LookupError):
    """A version that is not there."""


def _key(component: str, version: int) -> str:
    return f"{component}/{version:06d}"


def accept(store: Store, baseline: Baseline) -> Baseline:
    """Keep a baseline under the next free version and put it in force; returns it with its version."""
    baseline = replace(baseline, version=_next(store, baseline.component))
    with store.transaction():
        store.put("baseline", _key(baseline.component, baseline.version), asdict(baseline))
        _point(store, baseline)
    return baseline


def propose(store: Store, baseline: Baseline) -> Baseline:
    """Keep a baseline under the next free version for a person to approve; what is in force stays."""
    diagnostics = {**baseline.diagnostics, "proposed": True}
    baseline = replace(baseline, version=_next(store, baseline.component), diagnostics=diagnostics)
    store.put("baseline", _key(baseline.component, baseline.version), asdict(baseline))
    return baseline


def approve(store: Store, component: str, version: int, by: str) -> Baseline:
    """Put a version in force on a person's word; later re-identification is measured against it.

    Raises
    ------
    BaselineError
        There is no such version.
    """
    kept = _kept(store, component, version)
    diagnostics = {k: v for k, v in kept.diagnostics.items() if k not in ("proposed", "automatic")}
    kept = replace(kept, diagnostics={**diagnostics, "approved_by": by})
    with store.transaction():
        store.put("baseline", _key(component, version), asdict(kept))
        _point(store, kept)
    return kept


def roll_back(store: Store, component: str, version: int) -> Baseline:
    """Put an earlier version in force again.

    Raises
    ------
    BaselineError
        There is no such version.
    """
    kept = _kept(store, component, version)
    _point(store, kept)
    return kept


def keep_again(store: Store, baselines: Iterable[Baseline]) -> None:
    """Put baselines that are in force into a store that has lost them, under the versions that they have."""
    with store.transaction():
        for baseline in baselines:
            if store.get("baseline", _key(baseline.component, baseline.version)) is None:
                store.put("baseline", _key(baseline.component, baseline.version), asdict(baseline))
                _point(store, baseline)


def versions(store: Store, component: str) -> list[Baseline]:
    """Every baseline kept of a component, oldest first."""
    found = [_modern(d) for d in store.list("baseline") if d["component"] == component]
    return sorted(found, key=lambda b: b.version)


def chain(kept: Sequence[Baseline], current: Baseline) -> list[Baseline]:
    """From the last baseline that a person vouched for, by what follows what, to the one in force."""
    by_version = {b.version: b for b in kept}
    found = [current]
    while found[0].diagnostics.get("automatic"):
        before = by_version.get(int(found[0].diagnostics["follows"]))
        if before is None or before.version >= found[0].version:
            break
        found.insert(0, before)
    return found


def in_force(store: Store, components: Sequence[str]) -> dict[str, Baseline]:
    """The baselines that filters run on; components that have none are left out."""
    pointers = versions_in_force(store)
    found = {}
    for component in components:
        if component in pointers:
            document = store.get("baseline", _key(component, pointers[component]))
            if document:
                found[component] = _modern(document)
    return found


def versions_in_force(store: Store) -> dict[str, int]:
    """The version in force of every component that has one."""
    pointers = [d for key, d in store.items("state").items() if key.startswith("baseline/")]
    return {str(d["component"]): int(d["version"]) for d in pointers}


def _next(store: Store, component: str) -> int:
    return 1 + max((b.version for b in versions(store, component)), default=0)


def _kept(store: Store, component: str, version: int) -> Baseline:
    document = store.get("baseline", _key(component, version))
    if document is None:
        known = ", ".join(str(b.version) for b in versions(store, component)) or "none"
        raise BaselineError(f"{component} has no baseline version {version}; versions kept: {known}")
    return _modern(document)


def _point(store: Store, baseline: Baseline) -> None:
    pointer = {"component": baseline.component, "version": baseline.version}
    store.put("state", f"baseline/{baseline.component}", pointer)


# What diagnostics were called in the version before.
_FORMER = {"still": "flatline", "score_together": "effective_share"}


def _modern(document: JsonObject) -> Baseline:
    """A stored baseline in today's words; one that the version before kept goes on being used."""
    b = Baseline(**document)

    def now(table: Mapping[str, Any]) -> dict[str, Any]:
        return {present(b.model, key): value for key, value in table.items()}

    diagnostics = {_FORMER.get(key, key): value for key, value in b.diagnostics.items()}
    for key in ("flatline", "score_spread"):
        if isinstance(diagnostics.get(key), dict):
            diagnostics[key] = now(diagnostics[key])
    return replace(
        b,
        parameters=now(b.parameters),
        standard_errors=now(b.standard_errors),
        innovation=now(b.innovation),
        diagnostics=diagnostics,
    )
