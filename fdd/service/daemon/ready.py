"""An engine on the baselines that are in force."""

from __future__ import annotations

from fdd.service.baselines.versions import in_force
from fdd.service.engine.engine import Engine
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import SiteContext


def ready_engine(context: SiteContext, *, learning: bool = False) -> Engine:
    """The site's engine with the baselines in force; one that is ``learning`` may have none yet, and records.

    Raises
    ------
    UsageError : no component has a baseline, and not ``learning``
    """
    store = context.store()
    baselines = in_force(store, context.plan.baseline_names)
    store.close()
    if not baselines and not context.plan.equipment and not learning:
        raise UsageError(
            f"{context.site.name}: no component has a baseline; fit them to a healthy history first: fdd fit SITE DATA"
        )
    return Engine(context.plan, baselines)
