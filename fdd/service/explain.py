"""``fdd explain``: the evidence behind one alarm, in words."""

from __future__ import annotations

from pathlib import Path

from fdd.records import JsonObject
from fdd.report.words import likely
from fdd.service.errors import UsageError
from fdd.service.opened import Opened, open_site
from fdd.service.operate import stored_alarms


def explain(site_file: Path, key: str) -> JsonObject:
    """One alarm as it stands in the store.

    Raises
    ------
    UsageError : there is no such alarm
    """
    alarms = {a["key"]: a for a in stored_alarms(open_site(site_file))}
    if key not in alarms:
        raise UsageError(f"no alarm {key!r}; alarms kept: {', '.join(alarms) or 'none'}")
    return alarms[key]


def story(site_file: Path, alarm: JsonObject) -> str:
    """The alarm for people: what rang, what may be wrong and why, what to check, what happened since."""
    opened = open_site(site_file)
    lines = [alarm["summary"], f"{alarm['state']}; since {alarm['since_local']}, raised {alarm['raised_local']}", ""]
    lines += ["What rang:", *(_chart(opened, name, c) for name, c in alarm["evidence"]["charts"].items()), ""]
    lines.append("What may be wrong:")
    for cause in alarm["causes"]:
        lines.append(f"  {_share(cause)}  {cause['meaning']}")
        lines += [f"        for: {reason}" for reason in cause["for"]]
        lines += [f"        against: {reason}" for reason in cause["against"]]
    lines += _cost(alarm["evidence"].get("cost_per_day"))
    lines += ["", "What to check, in this order:"]
    lines += [f"  {i}. {check}" for i, check in enumerate(alarm["checks"], 1)]
    lines += ["", "History:"]
    lines += [f"  {opened.local(h['time'])}  {h['state']}  {h['actor']}: {h['comment']}" for h in alarm["history"]]
    return "\n".join(lines)


def _share(cause: JsonObject) -> str:
    return likely(float(cause["likelihood"])) if cause.get("likelihood") is not None else "not weighed"


def _cost(cost: JsonObject | None) -> list[str]:
    """What it costs a day, or why that cannot be said."""
    if cost is None:
        return []
    words = [str(cost[k]) for k in ("why", "basis") if cost.get(k)]
    if cost.get("value") is not None:
        span = f"{cost['lower']:.2f} to {cost['upper']:.2f}"
        words = [f"{cost['value']:.2f} {cost['currency']} (95 %: {span})", *words]
    return ["", "What it costs a day:", f"  {'; '.join(words)}"]


def _chart(opened: Opened, name: str, chart: JsonObject) -> str:
    text = f"  {name}: {chart['statistic']:.1f} against a limit of {chart['limit']:.1f}"
    if "change" in chart:
        share = chart["scale"] == "relative"
        size, error = (f"{100 * chart[k]:.2g} %" if share else f"{chart[k]:.3g}" for k in ("change", "standard_error"))
        text += f", change {size} (standard error {error})"
    return f"{text}, passed at {opened.local(chart['raised'])}"
