"""``fdd alarms``: what operators read of alarms and say of them."""

from __future__ import annotations

import time as clock
from pathlib import Path

from fdd.records import AlarmState, JsonObject
from fdd.service.alarms.book import Action, Command
from fdd.service.daemon.commands import DONE, submit
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.status import SILENT_SECONDS
from fdd.store.store import Store
from fdd.units import seconds

# A daemon that is up and gets samples has seen a command by then.
PATIENCE_SECONDS = 4.0


def read_alarms(site_file: Path, *, every: bool = False) -> list[JsonObject]:
    """Alarms of a site as documents, oldest first, with times in the site's zone beside them."""
    context = open_site(site_file)
    return [a for a in stored_alarms(context) if every or a["state"] != AlarmState.CLEARED]


def stored_alarms(context: SiteContext) -> list[JsonObject]:
    """Every alarm in the store, oldest first."""
    store = context.store(read_only=True)
    found = sorted(store.list("alarm"), key=lambda a: int(a["raised"]))
    store.close()
    return [{**a, "since_local": context.local(a["since"]), "raised_local": context.local(a["raised"])} for a in found]


def command(site_file: Path, key: str, action: Action, by: str, comment: str = "", *, span: str | None = None) -> str:
    """Leave a command for the daemon, and say what became of it or that the daemon has yet to see it.

    Raises
    ------
    UsageError : no open alarm has that key, or the daemon refused the command
    """
    context = open_site(site_file)
    alarms = {a["key"]: a for a in stored_alarms(context) if a["state"] != AlarmState.CLEARED}
    if key not in alarms:
        raise UsageError(f"no open alarm {key!r}; open alarms: {', '.join(alarms) or 'none'}")
    wanted = Command(key, action, by, clock.time_ns(), comment, None, "cli", None if span is None else seconds(span))
    store = context.store()
    try:
        outcome = _outcome(store, submit(store, wanted))
    finally:
        store.close()
    if outcome is None:
        return f"{action} {key}: left for the daemon, which carries it out within a second of its next sample"
    if outcome != DONE:
        raise UsageError(f"{action} {key}: {outcome}")
    return f"{action} {key}: {DONE}"


def _outcome(store: Store, command: str) -> str | None:
    """What a running daemon made of a command, waiting for it a little; None: it has not said."""
    status = store.get("run", "daemon")
    if status is None or clock.time() - float(status["wall"]) > SILENT_SECONDS:
        return None
    for _ in range(round(PATIENCE_SECONDS / 0.1)):
        document = store.get("command", command)
        if document and "outcome" in document:
            return str(document["outcome"])
        clock.sleep(0.1)
    return None
