"""``fdd alarms``: what operators read of alarms and say of them."""

from __future__ import annotations

import os
import pwd
import time as clock
from pathlib import Path

from fdd.records import AlarmState, JsonObject
from fdd.service.alarms.authority import LOCAL, Authority, CommandError
from fdd.service.alarms.book import Action, Command
from fdd.service.daemon.commands import DONE, submit, submit_turn_back
from fdd.service.daemon.trail import Head, TrailError, read, verify
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
    length = None if span is None else seconds(span)
    wanted = Command(key, action, by, clock.time_ns(), comment, None, f"{LOCAL}, account {account()}", length)
    try:
        Authority.of(context.site).check(wanted)
    except CommandError as error:
        raise UsageError(f"{action} {key}: {error}") from None
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


def account() -> str:
    """The account of the operating system that runs this process."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a container may run under a number without a name
        return str(os.getuid())


def history(site_file: Path, alarm: str | None = None) -> list[JsonObject]:
    """What people asked of alarms and of the service, and what became of it, oldest first.

    Raises
    ------
    UsageError : there is no audit trail yet, or it was tampered with
    """
    path = open_site(site_file).trail_path
    if not path.exists():
        return []
    try:
        return [line for line in read(path) if alarm is None or line.get("alarm") == alarm]
    except TrailError as error:
        raise UsageError(f"{error}; fdd alarms verify says more") from None


def verify_history(site_file: Path) -> str:
    """Check the audit trail against its seals and against what the daemon last said of it.

    Raises
    ------
    UsageError : changed, damaged, or cut short
    """
    context = open_site(site_file)
    store = context.store(read_only=True)
    try:
        told = (store.get("run", "daemon") or {}).get("trail", {})
    finally:
        store.close()
    known = Head(int(told["lines"]), str(told["seal"])) if "seal" in told else None
    if not context.trail_path.exists() and not (known and known.lines):
        return "no audit trail yet: nobody has asked anything of this service"
    try:
        head = verify(context.trail_path, known)
    except TrailError as error:
        raise UsageError(str(error)) from None
    return f"{head.lines} lines, every seal fits; the last is {head.seal}"


def turn_back(site_file: Path, to: str, by: str) -> str:
    """Ask the daemon to set event time back, after a clock was wrong.

    Raises
    ------
    UsageError : no time, or a time in the future
    """
    context = open_site(site_file)
    now = clock.time_ns()
    time = now if to == "now" else context.nanoseconds(to)
    if time is None or time > now:
        raise UsageError(f"{to!r} is in the future; event time is set back, to 'now' at most")
    store = context.store()
    try:
        outcome = _outcome(store, submit_turn_back(store, time, by, now))
    finally:
        store.close()
    if outcome is None:
        return "left for the daemon, which carries it out within a second"
    return f"event time set back to {context.local(time)}: {outcome}"


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
