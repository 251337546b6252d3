"""Operators' commands: from the store, where anybody may leave one, and over Zenoh, where they are answered.

A command in the store stays until it has been carried out; then its document says what became of it (``outcome``).
"""

from __future__ import annotations

import json
import queue
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import structlog

from fdd.config import Site
from fdd.records import JsonObject
from fdd.service.alarms.book import ACTIONS, Command
from fdd.store.store import Store
from fdd.units import UnitError, seconds

if TYPE_CHECKING:
    from ingest.zenoh.session import Question

log = structlog.get_logger()

DONE = "done"
_FIELDS = tuple(f.name for f in fields(Command))


def command_key(command: Command) -> str:
    """Commands in order of time; two of the same nanosecond by what they ask of which alarm."""
    return f"{command.time:020d}/{command.alarm}/{command.action}"


def submit(store: Store, command: Command) -> str:
    """Leave a command for the daemon; returns the key under which its outcome can be read."""
    key = command_key(command)
    store.put("command", key, {**asdict(command), "key": key})
    return key


class StoredCommands:
    """Commands in the store that nobody has carried out yet, whatever their time says.

    A clock that is behind, or a command that took long to arrive, loses nothing.
    """

    def __init__(self) -> None:
        # Carried out, and the store has not yet been seen to know.
        self._carried_out: set[str] = set()

    def new(self, store: Store) -> list[Command]:
        """What is to be carried out, in order of time."""
        found = []
        for document in sorted(store.list("command"), key=lambda d: str(d["key"])):
            key = str(document["key"])
            if "outcome" in document:
                self._carried_out.discard(key)
            elif key not in self._carried_out:
                found.append(Command(**{k: v for k, v in document.items() if k in _FIELDS}))
        return found

    def close(self, store: Store, command: Command, outcome: str) -> None:
        """Say in the store what became of a command."""
        key = command_key(command)
        self._carried_out.add(key)
        store.put("command", key, {**asdict(command), "key": key, "outcome": outcome})

    def export_state(self) -> list[str]:
        """Plain data."""
        return sorted(self._carried_out)

    def restore_state(self, state: list[str]) -> None:
        """Continue where :meth:`export_state` stood."""
        self._carried_out = set(state)


class QuestionError(ValueError):
    """A question over Zenoh that cannot be understood; the text says what to write."""


class Desk:
    """Answers operators over Zenoh, from the thread that calls :meth:`serve`.

    A query without payload is answered with the open alarms, with ``?all=true`` with every one in the store. One with
    a payload (JSON: ``action``, ``alarm``, ``by``, and as wanted ``comment`` and ``for``) is a command, and is answered
    with what became of it.
    """

    def __init__(self, site: Site) -> None:
        """Open the session.

        Raises
        ------
        NotReady : the endpoint is taken or cannot be reached.
        Refused : the password is not there.
        """
        from ingest.zenoh.options import OperatorOptions
        from ingest.zenoh.session import declare_questions, open_session

        options = cast(OperatorOptions, site.operator)
        self.key = options.key or key_of(site)
        self._site = site.name
        self._asked: queue.SimpleQueue[Question] = queue.SimpleQueue()
        self._session = open_session(options, Path(site.folder))
        self._declared = declare_questions(self._session, self.key, self._asked.put)

    def serve(
        self,
        now: int,
        alarms: Callable[[bool], list[JsonObject]],
        obey: Callable[[Command], tuple[str, JsonObject | None]],
    ) -> None:
        """Answer every question that waits.

        Parameters
        ----------
        now : wall clock [ns], the time of commands
        alarms : documents of open alarms, or of all
        obey : carries a command out; gives the outcome and the alarm as it then stands
        """
        while not self._asked.empty():
            question = self._asked.get()
            try:
                answer = self._answered(question, now, alarms, obey)
            except (QuestionError, UnitError) as error:
                answer = {"site": self._site, "outcome": f"refused: {error}"}
            question.answer(json.dumps(answer).encode())

    def _answered(
        self,
        question: Question,
        now: int,
        alarms: Callable[[bool], list[JsonObject]],
        obey: Callable[[Command], tuple[str, JsonObject | None]],
    ) -> JsonObject:
        if not question.payload:
            every = question.parameters.get("all", "false").lower() in ("true", "1", "yes")
            return {"site": self._site, "alarms": alarms(every)}
        outcome, alarm = obey(_command(question.payload, now))
        return {"site": self._site, "outcome": outcome, "alarm": alarm}

    def close(self) -> None:
        """Close the session."""
        self._declared.undeclare()
        self._session.close()


def key_of(site: Site) -> str:
    """The default key of a site's questions; what Zenoh does not allow in a name becomes a hyphen."""
    return f"fdd/{''.join(c if c.isalnum() or c in '-_.' else '-' for c in site.name)}/alarms"


def _command(payload: bytes, now: int) -> Command:
    example = '{"action": "acknowledge", "alarm": "KEY", "by": "NAME"}'
    try:
        asked: Any = json.loads(payload)
    except ValueError as error:
        raise QuestionError(f"the payload is no JSON ({error}); write {example}") from None
    if not isinstance(asked, dict) or not all(isinstance(v, str) for v in asked.values()):
        raise QuestionError(f"the payload is no table of texts; write {example}")
    unknown = sorted(set(asked) - {"action", "alarm", "by", "comment", "for"})
    missing = [k for k in ("action", "alarm", "by") if not asked.get(k)]
    if unknown or missing:
        what = f"unknown {', '.join(unknown)}" if unknown else f"{', '.join(missing)} missing"
        raise QuestionError(f'{what}; write {example}, and for shelving "for": "8 h"')
    action = next((a for a in ACTIONS if a == asked["action"]), None)
    if action is None:
        raise QuestionError(f"there is no action {asked['action']!r}; there are {', '.join(ACTIONS)}")
    span = seconds(asked["for"]) if "for" in asked else None
    return Command(asked["alarm"], action, asked["by"], now, asked.get("comment", ""), None, "zenoh", span)
