"""Operators' commands: from the store, where anybody may leave one, and over Zenoh, where they are answered.

A command in the store stays until it has been carried out; then its document says what became of it (``outcome``). One
that cannot be a command (no such fields, no such action, texts without end) is answered there, too, and goes no
further: nothing is journaled before it was checked. Whoever may write the store holds the data, and is trusted there.
"""

from __future__ import annotations

import json
import queue
import time as clock
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import structlog

from fdd.config import Site
from fdd.limits import COMMAND_BYTES, NAME_CHARACTERS, LimitError, json_within
from fdd.records import JsonObject
from fdd.service.alarms.authority import Authority, CommandError
from fdd.service.alarms.book import ACTIONS, Command
from fdd.service.daemon.codec import TurnBack
from fdd.store.store import Store
from fdd.units import UnitError, seconds

if TYPE_CHECKING:
    from ingest.zenoh.session import Question

log = structlog.get_logger()

DONE, TURN_BACK = "done", "turn back"
_FIELDS = tuple(f.name for f in fields(Command))
# Questions that wait, those answered in one turn of the loop, and those of one person in a minute.
WAITING, A_TURN, A_MINUTE = 200, 20, 60


def command_key(command: Command) -> str:
    """Commands in order of time; two of the same nanosecond by what they ask of which alarm."""
    return f"{command.time:020d}/{command.alarm}/{command.action}"


def submit(store: Store, command: Command) -> str:
    """Leave a command for the daemon; returns the key under which its outcome can be read."""
    key = command_key(command)
    store.put("command", key, {**asdict(command), "key": key})
    return key


def submit_turn_back(store: Store, time: int, by: str, now: int) -> str:
    """Ask the daemon to set event time back to ``time`` [ns]; returns the key of the outcome."""
    key = f"{now:020d}/{TURN_BACK}"
    store.put("command", key, {"action": TURN_BACK, "time": time, "actor": by, "key": key})
    return key


class StoredCommands:
    """Commands in the store that nobody has carried out yet, whatever their time says.

    A clock that is behind, or a command that took long to arrive, loses nothing.
    """

    def __init__(self) -> None:
        # Carried out, and the store has not yet been seen to know.
        self._carried_out: set[str] = set()

    def new(self, store: Store, authority: Authority) -> list[Command | TurnBack]:
        """What is to be carried out, in order of time; what is no command is refused where it lies."""
        found: list[Command | TurnBack] = []
        for key, document in sorted(store.items("command").items()):
            if "outcome" in document:
                self._carried_out.discard(key)
            elif key not in self._carried_out:
                try:
                    found.append(_from_document(key, document, authority))
                except CommandError as error:
                    self._refuse(store, key, str(error))
        return found

    def _refuse(self, store: Store, key: str, why: str) -> None:
        log.warning("command refused", key=key[:200], reason=why)
        self._carried_out.add(key)
        # What it held is not repeated: that is what was wrong with it.
        store.put("command", key, {"key": key, "outcome": f"refused: {why}"})

    def close(self, store: Store, command: Command | TurnBack, outcome: str) -> None:
        """Say in the store what became of a command."""
        key = command.key if isinstance(command, TurnBack) else command_key(command)
        if key:
            self._carried_out.add(key)
            store.put("command", key, {**asdict(command), "key": key, "outcome": outcome})

    def export_state(self) -> list[str]:
        """Plain data."""
        return sorted(self._carried_out)

    def restore_state(self, state: list[str]) -> None:
        """Continue where :meth:`export_state` stood."""
        self._carried_out = set(state)


def _from_document(key: str, document: JsonObject, authority: Authority) -> Command | TurnBack:
    """What a document asks for.

    Raises
    ------
    CommandError : nothing that anybody may ask for.
    """
    if document.get("action") == TURN_BACK:
        time, by = document.get("time"), document.get("actor")
        if type(time) is not int or not 0 < time < 2**62 or not isinstance(by, str) or len(by) > NAME_CHARACTERS:
            raise CommandError("it says no time to go back to, or not who asks")
        return TurnBack(time, by, key)
    try:
        command = Command(**{k: v for k, v in document.items() if k in _FIELDS})
    except TypeError as error:
        raise CommandError(f"it is no command ({error})") from None
    authority.check(command)
    if command_key(command) != key:
        raise CommandError("its key is not that of the command")
    return command


class QuestionError(ValueError):
    """A question over Zenoh that cannot be understood; the text says what to write."""


class Desk:
    """Answers operators over Zenoh, from the thread that calls :meth:`serve`.

    A query of ``KEY`` is answered with the open alarms, with ``?all=true`` with every one in the store. A query of
    ``KEY/as/NAME`` with a payload (JSON: ``action``, ``alarm``, and as wanted ``comment`` and ``for``) is a command of
    that person, and is answered with what became of it: who may use that key is what Zenoh's access control says.
    """

    def __init__(self, site: Site, authority: Authority) -> None:
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
        self._site, self._authority = site.name, authority
        self._asked: queue.Queue[Question] = queue.Queue(WAITING)
        self._recent: dict[str, deque[float]] = {}
        self.dropped = 0
        self._session = open_session(options, Path(site.folder), self.key)
        self._declared = declare_questions(self._session, self.key, self._take)

    def _take(self, question: Question) -> None:
        try:
            self._asked.put_nowait(question)
        except queue.Full:
            self.dropped += 1  # who asks gets no answer, and asks again

    def serve(
        self,
        now: int,
        alarms: Callable[[bool], list[JsonObject]],
        obey: Callable[[Command], tuple[str, JsonObject | None]],
        refused: Callable[[str, str], None] = lambda _who, _why: None,
    ) -> None:
        """Answer the questions that wait, a bounded number of them: the samples go on.

        Parameters
        ----------
        now : wall clock [ns], the time of commands
        alarms : documents of open alarms, or of all
        obey : carries a command out; gives the outcome and the alarm as it then stands
        refused : is told who asked what they may not
        """
        for _ in range(min(self._asked.qsize(), A_TURN)):
            question = self._asked.get()
            person = question.person[:100]
            try:
                self._require_calm(person)
                answer = self._answered(question, now, alarms, obey)
            except (QuestionError, UnitError, CommandError, LimitError) as error:
                answer = {"site": self._site, "outcome": f"refused: {error}"}
                if question.payload:
                    refused(person, str(error)[:500])
            question.answer(json.dumps(answer).encode())

    def _require_calm(self, person: str) -> None:
        """Refuse who asks more often than a person does."""
        asked, now = self._recent.setdefault(person, deque(maxlen=A_MINUTE)), clock.monotonic()
        if len(asked) == A_MINUTE and now - asked[0] < 60.0:
            raise QuestionError(f"more than {A_MINUTE} questions in a minute; ask again later")
        asked.append(now)
        if len(self._recent) > WAITING:
            del self._recent[next(iter(self._recent))]

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
        command = self._authority.check(command_of(question.payload, question.person, now))
        self._authority.permit(command.actor, command.action)
        outcome, alarm = obey(command)
        return {"site": self._site, "outcome": outcome, "alarm": alarm}

    def close(self) -> None:
        """Close the session."""
        for declared in self._declared:
            declared.undeclare()
        self._session.close()


def key_of(site: Site) -> str:
    """The default key of a site's questions; what Zenoh does not allow in a name becomes a hyphen."""
    return f"fdd/{''.join(c if c.isalnum() or c in '-_.' else '-' for c in site.name)}/alarms"


def command_of(payload: bytes, person: str, now: int) -> Command:
    """The command in a question's payload, of the person whose key was used, at wall clock ``now`` [ns].

    Raises
    ------
    QuestionError, UnitError : it cannot be understood.
    """
    example = '{"action": "acknowledge", "alarm": "KEY"}'
    if not person:
        raise QuestionError("commands are taken at KEY/as/NAME, where NAME is who asks")
    try:
        asked: Any = json_within(payload, COMMAND_BYTES)
    except LimitError as error:
        raise QuestionError(f"the payload is {error}; write {example}") from None
    if not isinstance(asked, dict) or not all(isinstance(v, str) for v in asked.values()):
        raise QuestionError(f"the payload is no table of texts; write {example}")
    unknown = sorted(set(asked) - {"action", "alarm", "by", "comment", "for"})
    missing = [k for k in ("action", "alarm") if not asked.get(k)]
    if unknown or missing:
        what = f"unknown {', '.join(unknown)[:200]}" if unknown else f"{', '.join(missing)} missing"
        raise QuestionError(f'{what}; write {example}, and for shelving "for": "8 h"')
    if asked.get("by", person) != person:
        raise QuestionError(f"this key is {person!r}'s, the command says by {asked['by']!r:.100}; leave 'by' out")
    action = next((a for a in ACTIONS if a == asked["action"]), None)
    if action is None:
        raise QuestionError(f"there is no action {asked['action']!r:.60}; there are {', '.join(ACTIONS)}")
    span = seconds(asked["for"]) if "for" in asked else None
    return Command(asked["alarm"], action, person, now, asked.get("comment", ""), None, "zenoh", span)
