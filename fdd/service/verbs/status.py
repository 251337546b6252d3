"""``fdd status``: how the service of a site stands, from what it last said in the store."""

from __future__ import annotations

import os
import socket
import time as clock
from pathlib import Path

from rich.console import Console
from rich.table import Table

from fdd.records import AlarmState, JsonObject
from fdd.service.alarms.handles import handles
from fdd.service.baselines.learn import Learned
from fdd.service.monitoring.power import CHANCE, DAYS, Foretold
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.replay import trust_told
from fdd.store.store import StoreError

# The daemon says how it stands every ten seconds; after so long it is down, or hangs.
SILENT_SECONDS = 60.0
RECENT_JOBS = 5


def read_status(site_file: Path) -> JsonObject:
    """The daemon's last status with what is worth knowing beside it.

    ``state`` is running, ended, silent (killed or hanging) or never ran.
    """
    context = open_site(site_file)
    never: JsonObject = {"site": context.site.name, "state": "never ran", "alarms": [], "jobs": []}
    try:
        store = context.store(read_only=True)
    except StoreError as problem:
        return {**never, "problem": str(problem)}
    try:
        run, runs, alarms = store.get("run", "daemon"), store.list("run"), store.list("alarm")
        learning = [d for key, d in store.items("state").items() if key.startswith("learning/")]
    finally:
        store.close()
    if run is None or "wall" not in run:
        return never
    silent = clock.time() - float(run["wall"])
    return {
        **run,
        "site": context.site.name,
        "state": state_of(run),
        "silent_seconds": round(silent, 1),
        "time_local": None if run["time"] is None else context.local(run["time"]),
        "jobs_next": {k: context.local(v) for k, v in run["jobs_next"].items()},
        "alarms": _alarms(context, alarms),
        "learning": [d for d in learning if d["component"] not in run["baselines"]],
        "jobs": sorted((r for r in runs if "due" in r), key=lambda r: int(r["due"]))[-RECENT_JOBS:],
    }


def state_of(run: JsonObject) -> str:
    """What a daemon's last word says of it: running, ended, or silent (killed or hanging)."""
    if run.get("ended"):
        return "ended"
    here = run.get("host") == socket.gethostname()
    if clock.time() - float(run["wall"]) >= SILENT_SECONDS or (here and not _alive(int(run["pid"]))):
        return "silent"
    return "running"


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # somebody else's
        return True
    return True


def _alarms(context: SiteContext, alarms: list[JsonObject]) -> list[JsonObject]:
    """Open ones, oldest first."""
    keys = ("key", "component", "state", "severity", "summary")
    found = sorted((a for a in alarms if a["state"] != AlarmState.CLEARED), key=lambda a: int(a["raised"]))
    names = handles(alarms)
    return [
        {"handle": names[a["key"]], **{k: a[k] for k in keys}, "raised_local": context.local(a["raised"])}
        for a in found
    ]


def budget_told(budget: JsonObject) -> str:
    """What was kept of the budget, in words."""
    promised = f"{budget['promised_per_year']:g} false ones a year are promised"
    if "alarms" not in budget:
        return f"{promised}; nothing was watched yet"
    days = f"{budget['years'] * 365.25:.3g} days watched"
    parts = [
        f"{t['count']} {what}: {t['per_year']:.2g} a year ({t['low']:.2g} to {t['high']:.2g})"
        for what, t in (("in all", budget["alarms"]), ("judged false", budget["judged_false"]))
    ]
    return f"{'; '.join(parts)}, of {days}; {promised}"


def _lag(status: JsonObject) -> str:
    if status["state"] == "ended":
        return "none: it has ended"
    return "no frame yet" if status["lag_seconds"] is None else f"{status['lag_seconds']:.0f} s"


def print_status(status: JsonObject, console: Console) -> None:
    """For people."""
    console.print(f"{status['site']}: {status['state']}", highlight=False)
    if status["state"] == "never ran":
        console.print("Start it with: fdd run SITE")
        return
    table = Table(box=None, show_header=False)
    rows = {
        "last word": f"{status['silent_seconds']:.0f} s ago, process {status['pid']}",
        "samples": f"{status['samples']} taken, {status['samples_per_second']:g} a second",
        "frames": f"{status['frames']}, the last of {status['time_local']}",
        "lag": _lag(status),
        "alarms": budget_told(status["budget"]),
        "charts": ", ".join(f"{n} {phase}" for phase, n in status["phases"].items()),
        "baselines": ", ".join(f"{k} v{v}" for k, v in status["baselines"].items()),
        "spool": "none" if status["spool_bytes"] is None else f"{status['spool_bytes']} bytes wait",
        "memory": f"{status['rss_bytes'] / 1e6:.0f} MB",
        "next jobs": ", ".join(f"{k} at {v}" for k, v in status["jobs_next"].items()) or "none",
        "rejected or odd": ", ".join(f"{k} {n}" for k, n in status["counts"].items() if n and k != "accepted")
        or "none",
    }
    if status.get("problems"):
        rows = {"watching": "NO: " + "; ".join(f"{p['what']}: {p['detail']}" for p in status["problems"]), **rows}
    if status.get("buried"):
        last = status["dead"][-1]["reason"] if status["dead"] else "see the log"
        rows["set aside"] = f"{status['buried']} journal entries could not be replayed; the last: {last}"
    if status.get("mishaps"):
        rows["mishaps"] = "; ".join(status["mishaps"])
    if status.get("failures"):
        rows["failed"] = ", ".join(f"{k} {n} times" for k, n in status["failures"].items())
    if status.get("trail", {}).get("problem"):
        rows["audit trail"] = status["trail"]["problem"]
    if status["spool_problem"]:
        rows["store"] = status["spool_problem"]
    for name, value in rows.items():
        table.add_row(name, value)
    console.print(table, highlight=False, soft_wrap=True)
    _print_trust(status.get("trust", {}), console)
    _print_lists(status, console)


def _print_lists(status: JsonObject, console: Console) -> None:
    for each in status["learning"]:
        console.print(f"learning {Learned(**each).words}", highlight=False, markup=False, soft_wrap=True)
    for job in status["jobs"]:
        console.print(f"job {job['key']}: {job['state']}", highlight=False, markup=False)
    for alarm in status["alarms"]:
        told = f"alarm {alarm['handle']}: {alarm['state']}; {alarm['summary']}"
        console.print(told, highlight=False, markup=False, soft_wrap=True)
    if not status["alarms"]:
        console.print("No open alarms.")


def _print_trust(trust: JsonObject, console: Console) -> None:
    """How far each component can be believed, and what it will find."""
    lines = trust_told(trust)
    for name, t in trust.items():
        if t["foretold"] and t["state"] != "calibrating":
            lines.append(f"{name}: found within {DAYS} days in {CHANCE:.0%} of cases")
            lines += [f"  {Foretold(**row).words()}" for row in t["foretold"]]
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
