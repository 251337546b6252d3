"""First baselines of equipment that has none, from what the daemon has recorded, as soon as there is enough of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fdd.records import NANOSECONDS, JsonObject
from fdd.service.baselines.fitting import Fitted, Watched, fit_history, watched_of
from fdd.service.baselines.history import History, runs, stored_history
from fdd.service.baselines.versions import versions_in_force
from fdd.service.site.plan import Chiller, Component, Plan, RowEquipment
from fdd.service.site.site_context import SiteContext, open_site
from fdd.store.store import Store

DAY = 86400 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Learned:
    """How far one piece of equipment is: usable days recorded of those that it needs, and what came of a fit."""

    component: str
    days: float
    needed: float
    outcome: str = ""

    @property
    def words(self) -> str:
        """For people."""
        said = f"{self.component}: {self.days:.1f} of {self.needed:g} usable days recorded"
        return f"{said}; {self.outcome}" if self.outcome else said

    def document(self) -> JsonObject:
        """For machines and for the store."""
        return {"component": self.component, "days": self.days, "needed": self.needed, "outcome": self.outcome}


def without_baseline(context: SiteContext, store: Store) -> list[Component | Chiller]:
    """Equipment that is fitted and has no baseline in force."""
    known = versions_in_force(store)
    fitted = [w for w in watched_of(context) if not isinstance(w, RowEquipment)]
    return [w for w in fitted if w.name not in known]


def learn_site(site_file: Path, *, until: str | None = None) -> list[Learned]:
    """Fit what has no baseline and has recorded enough; what is not plausible stays out of force, with the reason.

    How far each is stands in the store as well, for ``fdd status``.
    """
    context = open_site(site_file)
    store = context.store()
    try:
        waiting = without_baseline(context, store)
        history = stored_history(context.plan, store, None, context.nanoseconds(until)) if waiting else None
        found = [_learned(context, w, history) for w in waiting if history is not None]
        for learned in found:
            store.put("state", f"learning/{learned.component}", learned.document())
    finally:
        store.close()
    return found


def _learned(context: SiteContext, watched: Component | Chiller, history: History) -> Learned:
    needed = context.site.first_fit / 86400.0
    days = usable_days(context.plan, watched, history)
    if days < needed:
        return Learned(watched.name, days, needed)
    chosen: list[Watched] = [watched]
    fitted, failures = fit_history(context, chosen, history, tell=lambda name, done: None)
    if watched.name in failures:
        return Learned(watched.name, days, needed, f"not fitted: {failures[watched.name]}")
    against = fitted[0].against if isinstance(fitted[0], Fitted) else ()
    outcome = f"fitted, not in force: {'; '.join(against)}" if against else "fitted, in force"
    return Learned(watched.name, days, needed, outcome)


def usable_days(plan: Plan, watched: Component | Chiller, history: History) -> float:
    """Days of frames from which a component could be identified; of a chiller, those in which it was measured."""
    if len(history) == 0:
        return 0.0
    if isinstance(watched, Chiller):
        frames = int(np.isfinite(history.of(tuple(watched.inputs.values()))).all(axis=1).sum())
    else:
        frames = sum(len(r.time) for r in runs(plan, watched, history))
    return frames * plan.step / DAY
