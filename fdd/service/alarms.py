"""The life of alarms, in the words of ISA-18.2 / IEC 62682.

One fault is one alarm: all charts of a component that ring while it has an open alarm join that alarm. An alarm stands
until an operator clears it; clearing resets the component's charts, so that a fault that is still there rings again.

Charts of the model's health have an alarm of their own (``evidence["kind"]`` is ``model``): it says that the model no
longer describes the component. While the component has an alarm of the plant, that explains it, and it is suppressed;
when that is cleared, so is the model's, for what it saw was the fault.

=====================  =====================================================================================
state                  meaning
=====================  =====================================================================================
raised                 a chart passed its limit; nobody has said that they saw it
acknowledged           somebody has
shelved                hidden until an end that was given; then it is raised again
suppressed by design   a consequence of another open alarm: of one upstream, of a measurement that is suspect, or
                       (of the model's) of the plant's own
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
PLANT, MODEL = "plant", "model"
ACTIONS: tuple[Action, ...] = ("acknowledge", "shelve", "unshelve", "clear")


class AlarmError(ValueError):
    """An action that the alarm's state does not allow, or an alarm that is not there."""


@dataclass(frozen=True, slots=True)
class Command:
    """What an operator asks of an alarm; ``time`` is the operator's, ``until`` the end of shelving [ns].

    ``through`` says by which way the command came: ``cli``, ``zenoh``.
    """

    alarm: str
    action: Action
    actor: str
    time: int
    comment: str = ""
    until: int | None = None
    through: str = ""


@dataclass(frozen=True, slots=True)
class Ring:
    """A chart that has just passed its limit.

    ``point`` is the measurement the chart predicts, ``since`` the estimated onset [ns], ``evidence`` plain numbers,
    ``kind`` what the chart speaks of: the plant, or its model.
    """

    component: str
    chart: str
    point: str | None
    since: int
    evidence: JsonObject
    kind: str = PLANT


def kind_of(alarm: Alarm) -> str:
    """What an alarm speaks of: ``plant`` or ``model``."""
    return str(alarm.evidence.get("kind", PLANT))


def subject(component: str, kind: str = PLANT) -> str:
    """What has one open alarm at most: a component, or its model."""
    return component if kind == PLANT else f"{component}:{kind}"


def subject_of(alarm: Alarm) -> str:
    """The subject of an alarm."""
    return subject(alarm.component, kind_of(alarm))


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

    def of(self, component: str, kind: str = PLANT) -> Alarm | None:
        """The open alarm of a component, or of its model."""
        return self._open.get(subject(component, kind))

    def ring(self, time: int, rings: Sequence[Ring]) -> list[Alarm]:
        """Take in the charts that passed their limits at ``time``; return the alarms that changed."""
        changed = {subject(r.component, r.kind): self._join(time, r) for r in rings}
        for key in tuple(changed):
            self._suppress(time, key, changed)
        return [self._open[key] for key in changed]

    def normal(self, time: int, subjects: Iterable[str]) -> list[Alarm]:
        """The evidence against these subjects (components, or their models) is gone."""
        return [
            self._move(alarm, AlarmState.RETURNED, time, "service", "the evidence is gone")
            for key in subjects
            if (alarm := self._open.get(key)) and alarm.state in (AlarmState.RAISED, AlarmState.ACKNOWLEDGED)
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
                return [self._move(alarm, AlarmState.ACKNOWLEDGED, time, *_said(command))]
            case "shelve":
                if command.until is None or command.until <= time:
                    raise AlarmError(f"shelving {alarm.key} needs an end after {iso(time)}; give --until or --for")
                alarm = replace(alarm, evidence={**alarm.evidence, "shelved_until": command.until})
                return [self._move(alarm, AlarmState.SHELVED, time, *_said(command))]
            case "unshelve":
                if alarm.state is not AlarmState.SHELVED:
                    raise AlarmError(f"alarm {alarm.key} is {alarm.state}, not shelved")
                return [self._move(alarm, AlarmState.RAISED, time, *_said(command))]
            case "clear":
                return self._clear(alarm, time, command)

    def _clear(self, alarm: Alarm, time: int, command: Command) -> list[Alarm]:
        cleared = self._move(alarm, AlarmState.CLEARED, time, *_said(command))
        del self._open[subject_of(alarm)]
        freed = [
            a
            for a in tuple(self._open.values())
            if a.state is AlarmState.SUPPRESSED and a.evidence.get("caused_by") == alarm.key
        ]
        return [cleared, *(self._free(a, alarm, time) for a in freed)]

    def _free(self, victim: Alarm, source: Alarm, time: int) -> Alarm:
        """A consequence whose cause was cleared: it stands by itself; what a model made of a fault goes with it."""
        why = f"{source.key} was cleared"
        if kind_of(victim) == PLANT:
            return self._move(victim, AlarmState.RAISED, time, "service", why)
        cleared = self._move(victim, AlarmState.CLEARED, time, "service", why)
        del self._open[subject_of(victim)]
        return cleared

    def _join(self, time: int, ring: Ring) -> Alarm:
        name = subject(ring.component, ring.kind)
        alarm = self._open.get(name)
        if alarm is None:
            alarm = Alarm(
                key=f"{name}@{iso(time)}",
                component=ring.component,
                state=AlarmState.RAISED,
                since=ring.since,
                raised=time,
                updated=time,
                charts=(),
                summary="",
                evidence={"charts": {}, "points": []} | ({} if ring.kind == PLANT else {"kind": ring.kind}),
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
        self._open[name] = alarm
        return alarm

    def _suppress(self, time: int, key: str, changed: dict[str, Alarm]) -> None:
        """Mark consequences: those of the alarm of this subject, and it itself where it is one."""
        for source in tuple(self._open.values()):
            for victim in tuple(self._open.values()):
                ends = (subject_of(source), subject_of(victim))
                if key not in ends or ends[0] == ends[1]:
                    continue
                why = self._explains(source, victim)
                if not why or victim.state is not AlarmState.RAISED or source.state is AlarmState.SUPPRESSED:
                    continue
                victim = replace(victim, evidence={**victim.evidence, "caused_by": source.key})
                changed[ends[1]] = self._move(victim, AlarmState.SUPPRESSED, time, "service", why)

    def _explains(self, source: Alarm, victim: Alarm) -> str:
        """Why one alarm may be the consequence of another; empty where it is not."""
        if kind_of(source) != PLANT:
            return ""
        if source.component == victim.component:
            return f"{source.component} has alarm {source.key}: a model of the healthy plant does not hold then"
        shared = self._reads.get(victim.component, frozenset()) & set(source.evidence["points"])
        if shared:
            return f"it reads {', '.join(sorted(shared))}, which alarm {source.key} suspects"
        if source.component in self._upstream.get(victim.component, ()):
            return f"{source.component} is upstream and has alarm {source.key}"
        return ""

    def _move(self, alarm: Alarm, state: AlarmState, time: int, actor: str, comment: str, through: str = "") -> Alarm:
        entry = _entry(time, state, actor, comment) | ({"through": through} if through else {})
        moved = replace(alarm, state=state, updated=time, history=(*alarm.history, entry))
        self._open[subject_of(alarm)] = moved
        return moved

    def annotate(self, alarm: Alarm) -> None:
        """Replace an open alarm by the same alarm with diagnosis added."""
        self._open[subject_of(alarm)] = alarm

    def export_state(self) -> JsonObject:
        """Open alarms as plain data."""
        return {"open": [alarm_to_document(a) for a in self._open.values()]}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._open = {subject_of(a): a for a in map(alarm_from_document, state["open"])}


def _said(command: Command) -> tuple[str, str, str]:
    return command.actor, command.comment, command.through


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
