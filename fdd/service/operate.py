"""``fdd alarms``: what operators read of alarms and say of them."""

from __future__ import annotations

import time as clock
from pathlib import Path

from fdd.records import NANOSECONDS, AlarmState, JsonObject
from fdd.service.alarms import Action, Command
from fdd.service.daemon import submit
from fdd.service.errors import UsageError
from fdd.service.opened import Opened, open_site
from fdd.units import seconds


def read_alarms(site_file: Path, *, every: bool = False) -> list[JsonObject]:
    """Alarms of a site as documents, oldest first, with times in the site's zone beside them."""
    opened = open_site(site_file)
    return [a for a in stored_alarms(opened) if every or a["state"] != AlarmState.CLEARED]


def stored_alarms(opened: Opened) -> list[JsonObject]:
    """Every alarm in the store, oldest first."""
    store = opened.store(read_only=True)
    found = sorted(store.list("alarm"), key=lambda a: int(a["raised"]))
    store.close()
    return [{**a, "since_local": opened.local(a["since"]), "raised_local": opened.local(a["raised"])} for a in found]


def command(site_file: Path, key: str, action: Action, by: str, comment: str = "", *, span: str | None = None) -> str:
    """Leave a command for the daemon and say so.

    Raises
    ------
    UsageError : no open alarm has that key
    """
    opened = open_site(site_file)
    alarms = {a["key"]: a for a in stored_alarms(opened) if a["state"] != AlarmState.CLEARED}
    if key not in alarms:
        raise UsageError(f"no open alarm {key!r}; open alarms: {', '.join(alarms) or 'none'}")
    until = None if span is None else int(alarms[key]["updated"]) + round(seconds(span) * NANOSECONDS)
    store = opened.store()
    submit(store, Command(key, action, by, clock.time_ns(), comment, until))
    store.close()
    return f"{action} {key}: left for the daemon, which carries it out within a second of its next sample"
