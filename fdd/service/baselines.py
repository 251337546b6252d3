"""Versioned baselines in the store: every one that was ever accepted, and which is in force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

from fdd.records import Baseline
from fdd.store.store import Store


class BaselineError(LookupError):
    """A version that is not there."""


def _key(component: str, version: int) -> str:
    return f"{component}/{version:06d}"


def accept(store: Store, baseline: Baseline) -> Baseline:
    """Keep a baseline under the next free version and put it in force; returns it with its version."""
    version = 1 + max((b.version for b in versions(store, baseline.component)), default=0)
    baseline = replace(baseline, version=version)
    with store.transaction():
        store.put("baseline", _key(baseline.component, version), asdict(baseline))
        store.put("state", f"baseline/{baseline.component}", {"component": baseline.component, "version": version})
    return baseline


def versions(store: Store, component: str) -> list[Baseline]:
    """Every baseline kept of a component, oldest first."""
    found = [Baseline(**d) for d in store.list("baseline") if d["component"] == component]
    return sorted(found, key=lambda b: b.version)


def in_force(store: Store, components: Sequence[str]) -> dict[str, Baseline]:
    """The baselines that filters run on; components that have none are left out."""
    found = {}
    for component in components:
        pointer = store.get("state", f"baseline/{component}")
        if pointer:
            document = store.get("baseline", _key(component, int(pointer["version"])))
            if document:
                found[component] = Baseline(**document)
    return found


def roll_back(store: Store, component: str, version: int) -> Baseline:
    """Put an earlier version in force again.

    Raises
    ------
    BaselineError
        There is no such version.
    """
    document = store.get("baseline", _key(component, version))
    if document is None:
        known = ", ".join(str(b.version) for b in versions(store, component)) or "none"
        raise BaselineError(f"{component} has no baseline version {version}; versions kept: {known}")
    store.put("state", f"baseline/{component}", {"component": component, "version": version})
    return Baseline(**document)
