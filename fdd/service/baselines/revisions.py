"""``fdd baselines``: what was kept, what is in force, and changing that by hand."""

from __future__ import annotations

from pathlib import Path

from fdd.records import Baseline, JsonObject
from fdd.service.baselines.reidentify import release
from fdd.service.baselines.versions import approve, in_force, roll_back, versions
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import SiteContext, open_site
from fdd.store.store import Store


def list_baselines(site_file: Path) -> list[JsonObject]:
    """Every baseline kept of a site's equipment, oldest first."""
    context = open_site(site_file)
    store = context.store(read_only=True)
    try:
        return baseline_rows(context, store)
    finally:
        store.close()


def change_baseline(
    site_file: Path, *, rollback: tuple[str, int] | None, approved: tuple[str, int] | None, by: str
) -> str:
    """Roll back to a version, or approve one; the daemon takes it up within seconds.

    Raises
    ------
    UsageError : both at once
    BaselineError : no such version
    """
    if rollback and approved:
        raise UsageError("give either --rollback or --approve, not both")
    context = open_site(site_file)
    store = context.store()
    try:
        if rollback:
            b = roll_back(store, *rollback)
        elif approved:
            b = approve(store, *approved, by)
        else:
            raise UsageError("nothing to change; give --rollback or --approve with equipment and version")
        release(store, b.component)
    finally:
        store.close()
    verb = "rolled back to" if rollback else "approved"
    return f"{b.component}: {verb} version {b.version}; a running daemon takes it up within seconds"


def baseline_rows(context: SiteContext, store: Store) -> list[JsonObject]:
    """Every baseline kept, with what is in force."""
    current = in_force(store, [c.name for c in context.plan.components])
    return [
        {
            "component": b.component,
            "version": b.version,
            "status": _status(b, current.get(component.name)),
            "from": context.local(b.start),
            "until": context.local(b.end),
            "samples": b.samples,
            "model": f"{b.model} {b.model_version}",
            "reason": b.reason,
        }
        for component in context.plan.components
        for b in versions(store, component.name)
    ]


def _status(b: Baseline, current: Baseline | None) -> str:
    if current is not None and b.version == current.version:
        return "in force"
    return "proposed" if b.diagnostics.get("proposed") else ""
