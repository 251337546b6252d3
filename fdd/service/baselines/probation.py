"""Probation: weeks that a fit has not seen, run through the filter and its charts as the engine would run them.

A fit makes its own weeks look right; how wrong the model is, and how this moves with weather and load, only later data
can tell. ``fdd fit`` holds the last weeks of a long enough history back for that; where a history is too short for
both, the engine goes through the probation with the first days that it sees, by the same code.
"""

from __future__ import annotations

from dataclasses import replace

from fdd.evidence import AlarmKind
from fdd.records import Baseline
from fdd.service.baselines.history import History
from fdd.service.filtering.filters import FilterGroup
from fdd.service.monitoring.charting import Charts
from fdd.service.monitoring.day_charts import KIND as DAYS
from fdd.service.monitoring.day_charts import PROBATION
from fdd.service.site.plan import Component, Plan

DAY = 86400 * 10**9
# A fit has at least so many days to itself, before any are held back; fewer than the least of held days say nothing.
FITTED, LEAST = 28, 7
# The filter runs over so many days of the fit first, so that the states of heavy parts are settled.
SETTLE = 7


def split(history: History, probation: float = PROBATION) -> tuple[History, History]:
    """The part to fit and the part to hold back: the last weeks, where the fit keeps four; else none are."""
    if not len(history):
        return history, history
    first, end = int(history.time[0]), int(history.time[-1]) + 1
    held = min(probation, (end - first) / DAY - FITTED)
    if held < LEAST:
        return history, history.between(end, end)
    at = end - round(held * DAY)
    return history.between(None, at), history.between(at, None)


def on_probation(plan: Plan, component: Component, baseline: Baseline, history: History, since: int) -> Baseline:
    """The baseline with what the frames from ``since`` [ns] on have taught; those before only settle the filter.

    A gross departure in these weeks freezes what is learned, and is told as ``alarms``.
    """
    share = component.weight / sum(c.weight for c in plan.components)
    budget = plan.filters_per_year * share
    alone = replace(plan, components=(component,), chillers=(), false_alarms_per_year=budget, apart_per_year=0.0)
    group = FilterGroup([component], {component.name: baseline}, plan.columns, hold=plan.hold, max_gap=plan.max_gap)
    charts = Charts(alone, [group])
    run = history.between(since - SETTLE * DAY, None)
    rang: list[str] = []
    for time, row in zip(run.time.tolist(), run.values, strict=True):
        step = group.step(time, row)
        if time >= since:
            streams = [charts.streams[i] for i in charts.update([step]).rang]
            rang += [s.name for s in streams if s.alarm is AlarmKind.PLANT]
    held = run.between(since, None)
    about = {
        "start": since,
        "end": int(held.time[-1]) if len(held) else since,
        "alarms": sorted(set(rang)),
        "days": min((int(k["days"]) for k in charts.taught(component.name).get(DAYS, {}).values()), default=0),
        "foretold": [f.document() for f in charts.foretold().get(component.name, ())],
        **charts.taught(component.name),
    }
    return replace(baseline, diagnostics={**baseline.diagnostics, "probation": about})
