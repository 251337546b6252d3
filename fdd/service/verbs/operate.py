"""``fdd alarms``: what operators read of alarms and say of them."""

from __future__ import annotations

import os
import pwd
import time as clock
from pathlib import Path

from fdd.records import Alarm, AlarmState, JsonObject
from fdd.service.alarms.authority import LOCAL, Authority, CommandError
from fdd.service.alarms.book import Action, Command
from fdd.service.alarms.handles import handles, key_of
from fdd.service.baselines.versions import in_force
from fdd.service.daemon.checkpoint import Checkpoint
from fdd.service.daemon.commands import DONE, submit, submit_turn_back
from fdd.service.daemon.daemon import Daemon
from fdd.service.daemon.lock import StateLock
from fdd.service.daemon.ready import ready_engine
from fdd.service.daemon.trail import Head, Trail, TrailError, read, verify
from fdd.service.site.errors import UsageError
from fdd.service.site.naming import speaker_of
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.status import state_of
from fdd.store.store import Store
from fdd.units import seconds

# A daemon that is up and gets samples has seen a command by then.
PATIENCE_SECONDS = 4.0


def read_alarms(site_file: Path, *, every: bool = False) -> list[JsonObject]:
    """Alarms of a site as documents, oldest first, with times in the site's zone beside them."""
    context = open_site(site_file)
    found = stored_alarms(context)
    names = handles(found)
    return [{"handle": names[a["key"]], **a} for a in found if every or a["state"] != AlarmState.CLEARED]


def stored_alarms(context: SiteContext) -> list[JsonObject]:
    """Every alarm in the store in words, oldest first."""
    store = context.store(read_only=True)
    try:
        alarms = sorted((Alarm.read(d) for d in store.list("alarm")), key=lambda a: a.raised)
        plan = context.plan.following(in_force(store, [c.name for c in context.plan.components]))
    finally:
        store.close()
    speaker = speaker_of(plan, context.site)
    found = [speaker.told(a) for a in alarms]
    return [{**a, "since_local": context.local(a["since"]), "raised_local": context.local(a["raised"])} for a in found]


def command(site_file: Path, said: str, action: Action, by: str, comment: str = "", *, span: str | None = None) -> str:
    """Have an alarm's command carried out, by the daemon where it runs and here where none does.

    Parameters
    ----------
    said : the alarm's key or handle, or its component where that has one open alarm

    Raises
    ------
    UsageError : no such open alarm, or the command is refused
    """
    context = open_site(site_file)
    every = stored_alarms(context)
    open_ = [a for a in every if a["state"] != AlarmState.CLEARED]
    key = key_of(said, every, among=open_)
    length = None if span is None else seconds(span)
    wanted = Command(key, action, by, clock.time_ns(), comment, None, f"{LOCAL}, account {account()}", length)
    try:
        Authority.of(context.site).check(wanted)
    except CommandError as error:
        raise UsageError(f"{action} {key}: {error}") from None
    store = context.store()
    try:
        left = submit(store, wanted)
        outcome = _outcome(store, left)
        if outcome is None and context.checkpoint_path.exists():
            outcome = _carried_out(context, store, left)
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
    context = open_site(site_file)
    path = context.trail_path
    if not path.exists():
        return []
    alarm = alarm and key_of(alarm, stored_alarms(context))
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


def _carried_out(context: SiteContext, store: Store, left: str) -> str | None:
    """The outcome of a command on the state that the last run has left; None where that has no such state."""
    try:
        lock = StateLock(context.checkpoint_path)
    except UsageError:  # a daemon holds it, and will see the command
        return None
    checkpoint, trail = Checkpoint(context.checkpoint_path), Trail(context.trail_path)
    try:
        engine, authority = ready_engine(context), Authority.of(context.site)
        speaker = speaker_of(engine.plan, context.site)
        daemon = Daemon(engine, store, checkpoint, authority=authority, trail=trail, speaker=speaker)
        daemon.batch = bool((store.get("run", "daemon") or {}).get("batch"))
        daemon.recover()
        daemon.carry_out()
    finally:
        trail.close()
        checkpoint.close()
        lock.close()
    document = store.get("command", left) or {}
    return str(document["outcome"]) if "outcome" in document else None


def _outcome(store: Store, command: str) -> str | None:
    """What a running daemon made of a command, waiting for it a little; None: it has not said."""
    status = store.get("run", "daemon")
    if status is None or "wall" not in status or state_of(status) != "running":
        return None
    for _ in range(round(PATIENCE_SECONDS / 0.1)):
        document = store.get("command", command)
        if document and "outcome" in document:
            return str(document["outcome"])
        clock.sleep(0.1)
    return None
