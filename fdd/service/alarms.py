"""The life of alarms, in the words of ISA-18.2 / IEC 62682.

One fault is one alarm: all charts of a component that ring while it has an open alarm join that alarm. An alarm stands
until an operator clears it; clearing resets the component's charts, so that a fault that is still there rings again.

=====================  =====================================================================================
state                  meaning
=====================  =====================================================================================
raised                 a chart passed its limit; nobody has said that they saw it
acknowledged           somebody has
shelved                hidden until an end that was given; then it is raised again
suppressed by design   a consequence of another open alarm: the measurement it shares with it is the suspect
returned to normal     the evidence is gone, the alarm waits to be cleared
cleared                closed by an operator
=====================  =====================================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Any, Literal

from fdd.records import NANOSECONDS, Alarm, AlarmState, JsonObject

Action = Literal["acknowledge", "shelve", "unshelve", "clear"]
ACTIONS: tuple[Action, ...] = ("acknowledge", "shelve", "unshelve", "clear")


class AlarmError(ValueError):
    """An action that the alarm's state does not allow, or an alarm that is not there."""


@dataclass(frozen=True, slots=True)
class Command:
    """What an operator asks of an alarm; ``time`` is the operator's, ``until`` the end of shelving [ns]."""

    alarm: str
    action: Action
    actor: str
    time: int
    comment: str = ""
    until: int | None = None


@dataclass(frozen=True, slots=True)
class Ring:
    """A chart that has just passed its limit.

    ``point`` is the measurement the chart predicts, ``since`` the estimated onset [ns], ``evidence`` plain numbers.
    """

    component: str
    chart: str
    point: str | None
    since: int
    evidence: JsonObject


def iso(time: int) -> str:
    """Event time as ISO 8601 in UTC, to the second."""
    return datetime.fromtimestamp(time / NANOSECONDS, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class AlarmBook:
    """All open alarms of a site, and the rules of their life.

    ``reads`` maps each component to the points its filter takes as inputs: an alarm whose component reads a point that
    another open alarm suspects is that alarm's consequence. ``upstream`` maps a component to those whose alarms explain
    its own.
    """

    def __init__(
        self, reads: Mapping[str, frozenset[str]], upstream: Mapping[str, frozenset[str]] | None = None
    ) -> None:
        self._reads, self._upstream = reads, upstream or {}
        self._open: dict[str, Alarm] = {}

    @property
    def open(self) -> tuple[Alarm, ...]:
        """Alarms that are not cleared, oldest first."""
        return tuple(self._open.values())

    def of(self, component: str) -> Alarm | None:
        """The open alarm of a component."""
        return self._open.get(component)

    def ring(self, time: int, rings: Sequence[Ring]) -> list[Alarm]:
        """Take in the charts that passed their limits at ``time``; return the alarms that changed."""
        changed = {r.component: self._join(time, r) for r in rings}
        for component in tuple(changed):
            self._suppress(time, component, changed)
        return [self._open[c] for c in changed]

    def normal(self, time: int, components: Iterable[str]) -> list[Alarm]:
        """The evidence against these components is gone."""
        return [
            self._move(alarm, AlarmState.RETURNED, time, "service", "the evidence is gone")
            for c in components
            if (alarm := self._open.get(c)) and alarm.state in (AlarmState.RAISED, AlarmState.ACKNOWLEDGED)
        ]

    def tick(self, time: int) -> list[Alarm]:
        """End the shelving that has run out."""
        return [
            self._move(alarm, AlarmState.RAISED, time, "service", "shelving ended")
            for alarm in tuple(self._open.values())
            if alarm.state is AlarmState.SHELVED and alarm.evidence.get("shelved_until", time + 1) <= time
        ]

    def command(self, command: Command, time: int) -> list[Alarm]:
        """Carry out an operator's command; return every alarm that it changed, the one it names first.

        Raises
        ------
        AlarmError
            No open alarm has that key, or its state does not allow the action.
        """
        alarm = next((a for a in self._open.values() if a.key == command.alarm), None)
        if alarm is None:
            known = ", ".join(a.key for a in self._open.values()) or "none"
            raise AlarmError(f"no open alarm {command.alarm!r}; open alarms: {known}")
        match command.action:
            case "acknowledge":
                if alarm.state is not AlarmState.RAISED:
                    raise AlarmError(f"alarm {alarm.key} is {alarm.state}; only a raised alarm can be acknowledged")
                return [self._move(alarm, AlarmState.ACKNOWLEDGED, time, command.actor, command.comment)]
            case "shelve":
                if command.until is None or command.until <= time:
                    raise AlarmError(f"shelving {alarm.key} needs an end after {iso(time)}; give --until or --for")
                alarm = replace(alarm, evidence={**alarm.evidence, "shelved_until": command.until})
                return [self._move(alarm, AlarmState.SHELVED, time, command.actor, command.comment)]
            case "unshelve":
                if alarm.state is not AlarmState.SHELVED:
                    raise AlarmError(f"alarm {alarm.key} is {alarm.state}, not shelved")
                return [self._move(alarm, AlarmState.RAISED, time, command.actor, command.comment)]
            case "clear":
                return self._clear(alarm, time, command)

    def _clear(self, alarm: Alarm, time: int, command: Command) -> list[Alarm]:
        cleared = self._move(alarm, AlarmState.CLEARED, time, command.actor, command.comment)
        del self._open[alarm.component]
        released = [
            self._move(a, AlarmState.RAISED, time, "service", f"{alarm.key} was cleared")
            for a in tuple(self._open.values())
            if a.state is AlarmState.SUPPRESSED and a.evidence.get("caused_by") == alarm.key
        ]
        return [cleared, *released]

    def _join(self, time: int, ring: Ring) -> Alarm:
        alarm = self._open.get(ring.component)
        if alarm is None:
            alarm = Alarm(
                key=f"{ring.component}@{iso(time)}",
                component=ring.component,
                state=AlarmState.RAISED,
                since=ring.since,
                raised=time,
                updated=time,
                charts=(),
                summary="",
                evidence={"charts": {}, "points": []},
                history=(_entry(time, AlarmState.RAISED, "service", f"chart {ring.chart} passed its limit"),),
            )
        elif alarm.state is AlarmState.RETURNED:
            alarm = self._move(alarm, AlarmState.RAISED, time, "service", f"chart {ring.chart} passed its limit again")
        points = list(alarm.evidence["points"])
        if ring.point and ring.point not in points:
            points.append(ring.point)
        charts = {**alarm.evidence["charts"], ring.chart: {**ring.evidence, "since": ring.since, "raised": time}}
        joined = alarm.charts if ring.chart in alarm.charts else (*alarm.charts, ring.chart)
        alarm = replace(
            alarm,
            since=min(alarm.since, ring.since),
            updated=time,
            charts=joined,
            evidence={**alarm.evidence, "charts": charts, "points": points},
        )
        self._open[ring.component] = alarm
        return alarm

    def _suppress(self, time: int, component: str, changed: dict[str, Alarm]) -> None:
        """Mark consequences: those of the alarm of ``component``, and it itself where it is one."""
        for source in tuple(self._open.values()):
            for victim in tuple(self._open.values()):
                if component not in (source.component, victim.component) or source.component == victim.component:
                    continue
                why = self._explains(source, victim)
                if not why or victim.state is not AlarmState.RAISED or source.state is AlarmState.SUPPRESSED:
                    continue
                victim = replace(victim, evidence={**victim.evidence, "caused_by": source.key})
                changed[victim.component] = self._move(victim, AlarmState.SUPPRESSED, time, "service", why)

    def _explains(self, source: Alarm, victim: Alarm) -> str:
        """Why one alarm may be the consequence of another; empty where it is not."""
        shared = self._reads.get(victim.component, frozenset()) & set(source.evidence["points"])
        if shared:
            return f"it reads {', '.join(sorted(shared))}, which alarm {source.key} suspects"
        if source.component in self._upstream.get(victim.component, ()):
            return f"{source.component} is upstream and has alarm {source.key}"
        return ""

    def _move(self, alarm: Alarm, state: AlarmState, time: int, actor: str, comment: str) -> Alarm:
        entry = _entry(time, state, actor, comment)
        moved = replace(alarm, state=state, updated=time, history=(*alarm.history, entry))
        self._open[alarm.component] = moved
        return moved

    def annotate(self, alarm: Alarm) -> None:
        """Replace an open alarm by the same alarm with diagnosis added."""
        self._open[alarm.component] = alarm

    def export_state(self) -> JsonObject:
        """Open alarms as plain data."""
        return {"open": [alarm_to_document(a) for a in self._open.values()]}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._open = {d["component"]: alarm_from_document(d) for d in state["open"]}


def _entry(time: int, state: AlarmState, actor: str, comment: str) -> JsonObject:
    return {"time": time, "state": str(state), "actor": actor, "comment": comment}


def alarm_to_document(alarm: Alarm) -> JsonObject:
    """An alarm as the store keeps it."""
    document: dict[str, Any] = asdict(alarm)
    document["state"] = str(alarm.state)
    for name in ("charts", "causes", "checks", "history"):
        document[name] = list(document[name])
    return document


def alarm_from_document(document: JsonObject) -> Alarm:
    """The alarm that :func:`alarm_to_document` wrote."""
    lists = {name: tuple(document[name]) for name in ("charts", "causes", "checks", "history")}
    return Alarm(**{**document, **lists, "state": AlarmState(document["state"])})
