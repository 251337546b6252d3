"""``fdd explain``: the evidence behind one alarm, in words, and what its data say when they are looked at again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fdd.diagnosis.single_parameter import Alone, alone, frames_before, moved
from fdd.evidence import AlarmKind, kind_of
from fdd.greybox.likelihood import Likelihood
from fdd.records import Baseline, JsonObject
from fdd.report.words import likely
from fdd.service.alarms.handles import key_of
from fdd.service.baselines.history import History, runs, stored_history
from fdd.service.baselines.versions import in_force
from fdd.service.baselines.window import record
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Component, Plan
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.operate import stored_alarms

SHOWN = 3
"""Parameters told of, the one that explains most first."""
ONSETS = 3
"""Times that the onset is looked for."""
SURE = 9.0
"""A gain of less than three standard errors squared is not worth a word."""


def explain(site_file: Path, said: str) -> JsonObject:
    """One alarm as it stands in the store, by its key, its handle, or its component where that has one.

    Raises
    ------
    UsageError : there is no such alarm
    """
    alarms = stored_alarms(open_site(site_file))
    if not alarms:
        raise UsageError("no alarm is kept; a replay keeps its alarms with --store, fdd study and fdd run always do")
    key = key_of(said, alarms)
    return next(a for a in alarms if a["key"] == key)


def explained_by(plan: Plan, component: Component, history: History, baseline: Baseline) -> list[Alone]:
    """What each parameter, refitted alone to these frames, explains of them, the best first; empty without data.

    The sums of scores that an alarm was raised on are linear in the change; where it is large they can take one
    parameter for another. What was healthy yet is left out, and so are parameters that the baseline left open: they
    have no value to depart from.
    """
    values = np.array([baseline.parameters[p.symbol] for p in component.model.parameters])
    left = {*baseline.diagnostics.get("unidentifiable", ()), *baseline.diagnostics.get("at_bound", ())}
    found: list[Alone] = []
    for _ in range(ONSETS):
        parts = runs(plan, component, history)
        if not parts:
            break
        likelihood = Likelihood(component.model, [record(r) for r in parts])
        found = alone(component.model, likelihood, values, left)
        if not found:
            break
        before = frames_before(likelihood, values, moved(component.model, values, found[0]))
        if not before:
            break
        history = history.between(int(np.concatenate([r.time for r in parts])[before]), None)
    return found


def looked_at_again(context: SiteContext, alarm: JsonObject) -> list[Alone]:
    """The same for an alarm of the plant, over what the store has of its time; empty where nothing can be said."""
    components = {c.name: c for c in context.plan.components}
    if alarm["component"] not in components or kind_of(alarm["evidence"])[0] is not AlarmKind.PLANT:
        return []
    component = components[alarm["component"]]
    store = context.store(read_only=True)
    try:
        baseline = in_force(store, [component.name]).get(component.name)
        history = stored_history(context.plan, store, int(alarm["since"]), int(alarm["updated"]) + 1)
    finally:
        store.close()
    # A baseline that was fitted to the fault itself knows no departure.
    if baseline is None or baseline.end > int(alarm["since"]):
        return []
    return explained_by(context.plan, component.following(baseline), history, baseline)


def story(site_file: Path, alarm: JsonObject) -> str:
    """The alarm for people: what rang, what may be wrong and why, what to check, what happened since."""
    context = open_site(site_file)
    lines = [alarm["summary"], f"{alarm['state']}; since {alarm['since_local']}, raised {alarm['raised_local']}", ""]
    lines += ["What rang:", *(_chart(context, name, c) for name, c in alarm["evidence"]["charts"].items()), ""]
    lines.append("What may be wrong:")
    for cause in alarm["causes"]:
        lines.append(f"  {_share(cause)}  {cause['meaning']}")
        lines += [f"        for: {reason}" for reason in cause["for"]]
        lines += [f"        against: {reason}" for reason in cause["against"]]
    lines += _again(looked_at_again(context, alarm), _running(context, alarm["component"]))
    lines += _cost(alarm["evidence"].get("cost_per_day"))
    lines += ["", "What to check, in this order:"]
    lines += [f"  {i}. {check}" for i, check in enumerate(alarm["checks"], 1)]
    lines += ["", "History:"]
    lines += [f"  {context.local(h['time'])}  {h['state']}  {h['actor']}: {h['comment']}" for h in alarm["history"]]
    return "\n".join(lines)


def _share(cause: JsonObject) -> str:
    return likely(float(cause["likelihood"])) if cause.get("likelihood") is not None else "not weighed"


def _running(context: SiteContext, name: str) -> Component | None:
    """A component with the variant of its model that runs; None for what is no component."""
    store = context.store(read_only=True)
    try:
        followed = context.plan.following(in_force(store, [name]))
    finally:
        store.close()
    return {c.name: c for c in followed.components}.get(name)


def _again(found: list[Alone], component: Component | None) -> list[str]:
    """Which parameters, refitted alone, explain the alarm's data, and by how much."""
    told = [a for a in found if a.gain > SURE][:SHOWN]
    if not told or component is None:
        return []
    of = {p.symbol: p for p in component.model.parameters}
    lines = ["", "Refitted alone to the data since then, explains most:"]
    for a in told:
        size = f"{100 * np.expm1(a.change):+.2g} %" if of[a.symbol].transform == "log" else f"{a.change:+.3g}"
        lines.append(
            f"  {a.symbol}  {of[a.symbol].meaning}: {size}, log-likelihood {a.gain / 2:.0f} above the baseline's"
        )
    return lines


def _cost(cost: JsonObject | None) -> list[str]:
    """What it costs a day, or why that cannot be said."""
    if cost is None:
        return []
    words = [str(cost[k]) for k in ("why", "basis") if cost.get(k)]
    if cost.get("value") is not None:
        span = f"{cost['lower']:.2f} to {cost['upper']:.2f}"
        words = [f"{cost['value']:.2f} {cost['currency']} (95 %: {span})", *words]
    return ["", "What it costs a day:", f"  {'; '.join(words)}"]


def _chart(context: SiteContext, name: str, chart: JsonObject) -> str:
    text = f"  {name}: {chart['statistic']:.1f} against a limit of {chart['limit']:.1f}"
    if "change" in chart:
        share = chart["scale"] == "relative"
        size, error = (f"{100 * chart[k]:.2g} %" if share else f"{chart[k]:.3g}" for k in ("change", "standard_error"))
        text += f", change {size} (standard error {error})"
    return f"{text}, passed at {context.local(chart['raised'])}"
