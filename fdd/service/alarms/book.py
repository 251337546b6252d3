"""The life of alarms, in the words of ISA-18.2 / IEC 62682.

One fault is one alarm: all charts of a component that ring while it has an open alarm join that alarm. An alarm stands
until an operator clears it; clearing resets the component's charts, so that a fault that is still there rings again.

Charts of the model's health have an alarm of their own (its kind is ``model``): it says that the model no
longer describes the component. While the component has an alarm of the plant, that explains it, and it is suppressed;
when that is cleared, so is the model's, for what it saw was the fault.

=====================  =====================================================================================
state                  meaning
=====================  =====================================================================================
raised                 a chart passed its limit; nobody has said that they saw it
acknowledged           somebody has
shelved                hidden until an end that was given; then it is what its evidence says
suppressed by design   a consequence of another open alarm: of one upstream, of a measurement that is suspect, or
                       (of the model's) of the plant's own
returned to normal     the evidence is gone, the alarm waits to be cleared
cleared                closed by an operator
=====================  =====================================================================================

Which event leads from which state to which is a table, :data:`fdd.service.alarms.life.LIFE`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal

from fdd.evidence import AlarmKind, ChartEvidence, Entry, Evidence, Message
from fdd.records import NANOSECONDS, Alarm, AlarmState, JsonObject
from fdd.service.alarms.life import GRACE, Event, quiet_wanted, what_then
from fdd.service.alarms.realised_rate import Tally

Action = Literal["acknowledge", "shelve", "unshelve", "clear"]
SERVICE = "service"
"""The actor of what the service does by itself."""
ACTIONS: tuple[Action, ...] = ("acknowledge", "shelve", "unshelve", "clear")


class AlarmError(ValueError):
    """An action that the alarm's state does not allow, or an alarm that is not there."""


@dataclass(frozen=True, slots=True)
class Command:
    """What an operator asks of an alarm; ``time`` is the operator's.

    Shelving ends at ``until`` [ns], or ``span`` [s] after the event time at which it is carried out. ``through`` says
    by which way the command came: ``cli``, ``zenoh``.
    """

    alarm: str
    action: Action
    actor: str
    time: int
    comment: str = ""
    until: int | None = None
    through: str = ""
    span: float | None = None


@dataclass(frozen=True, slots=True)
class Ring:
    """A chart that has just passed its limit.

    ``point`` is the measurement the chart predicts, ``since`` the estimated onset [ns], ``evidence`` its numbers,
    ``kind`` what the chart speaks of: the plant, its model, or a ``place`` of equipment that is watched by rows.
    """

    component: str
    chart: str
    point: str | None
    since: int
    evidence: ChartEvidence
    kind: AlarmKind = AlarmKind.PLANT
    place: str = ""


def subject(component: str, kind: AlarmKind = AlarmKind.PLANT, place: str = "") -> str:
    """What has one open alarm at most: a component, its model, or a place of it."""
    return component if kind is AlarmKind.PLANT else f"{component}:{place or kind}"


def subject_of(alarm: Alarm) -> str:
    """The subject of an alarm."""
    return subject(alarm.component, alarm.evidence.kind, alarm.evidence.place)


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
        self.tally = Tally()
        # Since when the evidence of an open alarm has been gone without a break, by subject.
        self._quiet: dict[str, int] = {}

    @property
    def open(self) -> tuple[Alarm, ...]:
        """Alarms that are not cleared, oldest first."""
        return tuple(self._open.values())

    def of(self, subject: str) -> Alarm | None:
        """The open alarm of a subject: of a component, its model, or a place of it."""
        return self._open.get(subject)

    def ring(self, time: int, rings: Sequence[Ring]) -> list[Alarm]:
        """Take in the charts that passed their limits at ``time``; return the alarms that changed."""
        changed = [subject(r.component, r.kind, r.place) for r in rings]
        for r in rings:
            self._join(time, r)
        changed += [subject_of(a) for a in self._suppress(time)]
        return [self._open[key] for key in dict.fromkeys(changed)]

    def review(self, time: int, quiet: Iterable[str]) -> list[Alarm]:
        """Once a frame: what time and evidence make of the open alarms; return those that changed.

        Parameters
        ----------
        quiet : subjects (components, or their models) whose charts all say that what raised the alarm is gone
        """
        still = set(quiet)
        self._quiet = {key: self._quiet.get(key, time) for key in self._open if key in still}
        changed = []
        for alarm in self.open:
            until = alarm.evidence.shelved_until
            if alarm.state is AlarmState.SHELVED and until is not None and until <= time:
                changed.append(self._judge(alarm, Event.UNSHELVE, _by_service(time, "shelving_ended")))
            elif alarm.state is AlarmState.SUPPRESSED and (why := self._released(alarm, time)):
                changed.append(self._judge(alarm, Event.RELEASE, _Why(time, SERVICE, reason=why)))
            elif alarm.state in (AlarmState.RAISED, AlarmState.ACKNOWLEDGED) and self._is_over(alarm, time):
                changed.append(self._move(alarm, Event.NORMAL, _by_service(time, "evidence_gone")))
        return changed

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
        event = Event(command.action)
        if what_then(alarm.state, event) is None:
            may = [e for e in ACTIONS if what_then(alarm.state, Event(e)) is not None]
            raise AlarmError(f"alarm {alarm.key} is {alarm.state}; it cannot be {_PAST[command.action]}, "
                             f"but {', '.join(_PAST[e] for e in may)}")  # fmt: skip
        match command.action:
            case "shelve":
                until = _end(command, time)
                alarm = replace(alarm, evidence=replace(alarm.evidence, shelved_until=until))
            case "unshelve":
                return [self._judge(alarm, event, _said(command, time))]
            case "clear":
                return self._clear(alarm, _said(command, time))
        return [self._move(alarm, event, _said(command, time))]

    def _clear(self, alarm: Alarm, why: _Why) -> list[Alarm]:
        cleared = self._close(alarm, why)
        freed = [
            a
            for a in tuple(self._open.values())
            if a.state is AlarmState.SUPPRESSED and a.evidence.caused_by == alarm.key
        ]
        return [cleared, *(self._free(a, alarm, why.time) for a in freed)]

    def _close(self, alarm: Alarm, why: _Why) -> Alarm:
        cleared = self._move(alarm, Event.CLEAR, why)
        del self._open[subject_of(alarm)]
        self._quiet.pop(subject_of(alarm), None)
        self.tally.close(cleared)
        return cleared

    def _free(self, victim: Alarm, source: Alarm, time: int) -> Alarm:
        """A consequence whose cause was cleared: it stands by itself; what a model made of a fault goes with it."""
        why = _by_service(time, "cause_cleared", alarm=source.key)
        if victim.evidence.kind is AlarmKind.PLANT:
            return self._judge(victim, Event.RELEASE, why)
        return self._close(victim, why)

    def _is_over(self, alarm: Alarm, time: int) -> bool:
        """Whether the evidence has been gone for as long as the alarm's past asks for."""
        since = self._quiet.get(subject_of(alarm))
        return since is not None and time - since >= quiet_wanted(alarm.history, time)

    def _explaining(self, source: Alarm, time: int) -> bool:
        """Whether an alarm may still explain others: not once its own evidence has been gone for long."""
        since = self._quiet.get(subject_of(source))
        return since is None or time - since < GRACE

    def _released(self, victim: Alarm, time: int) -> Message | None:
        """Why a consequence is one no longer; None while it is."""
        source = self._cause(victim)
        if source is None:
            return Message.of("cause_gone")
        return None if self._explaining(source, time) else Message.of("cause_normal", alarm=source.key)

    def _judge(self, alarm: Alarm, event: Event, why: _Why) -> Alarm:
        """An alarm that comes out of shelving or suppression is what its evidence says."""
        own = replace(alarm.evidence, caused_by="", shelved_until=None)
        moved = self._move(replace(alarm, evidence=own), event, why)
        if self._is_over(moved, why.time):
            return self._move(moved, Event.NORMAL, _by_service(why.time, "evidence_gone"))
        return self._suppress_one(moved, why.time) or moved

    def _join(self, time: int, ring: Ring) -> None:
        name = subject(ring.component, ring.kind, ring.place)
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
                evidence=Evidence(kind=ring.kind, place=ring.place),
                history=(_by_service(time, "rang", chart=ring.chart).entry(AlarmState.RAISED),),
            )
        elif alarm.state is AlarmState.RETURNED:
            alarm = self._move(alarm, Event.RING, _by_service(time, "rang_again", chart=ring.chart))
        points = alarm.evidence.points
        if ring.point and ring.point not in points:
            points = (*points, ring.point)
        charts = {**alarm.evidence.charts, ring.chart: replace(ring.evidence, since=ring.since, raised=time)}
        joined = alarm.charts if ring.chart in alarm.charts else (*alarm.charts, ring.chart)
        alarm = replace(
            alarm,
            since=min(alarm.since, ring.since),
            updated=time,
            charts=joined,
            evidence=replace(alarm.evidence, charts=charts, points=points),
        )
        self._open[name] = alarm
        self._quiet.pop(name, None)

    def _suppress(self, time: int) -> list[Alarm]:
        """Mark consequences among the raised alarms; of two that explain each other, the newer is the consequence."""
        raised = [a for a in reversed(self._open.values()) if a.state is AlarmState.RAISED]
        return [a for victim in raised if (a := self._suppress_one(victim, time))]

    def _suppress_one(self, victim: Alarm, time: int) -> Alarm | None:
        for source in tuple(self._open.values()):
            if source is victim or not (why := self._explains(source, victim)):
                continue
            root = self._root(source)
            if root is None or root.key == victim.key or not self._explaining(root, time):
                continue
            victim = replace(victim, evidence=replace(victim.evidence, caused_by=root.key))
            return self._move(victim, Event.EXPLAIN, _Why(time, SERVICE, reason=why))
        return None

    def _root(self, source: Alarm) -> Alarm | None:
        """What a consequence is a consequence of; an alarm that is none is its own."""
        return source if source.state is not AlarmState.SUPPRESSED else self._cause(source)

    def _cause(self, victim: Alarm) -> Alarm | None:
        """The open alarm that explains a consequence."""
        return next((a for a in self._open.values() if a.key == victim.evidence.caused_by), None)

    def _explains(self, source: Alarm, victim: Alarm) -> Message | None:
        """Why one alarm may be the consequence of another; None where it is not."""
        if source.evidence.kind is AlarmKind.MODEL:
            return None
        if source.component == victim.component:
            same = victim.evidence.kind is not AlarmKind.PLACE
            return Message.of("own_alarm", component=source.component, alarm=source.key) if same else None
        shared = self._reads.get(victim.component, frozenset()) & set(source.evidence.points)
        if shared:
            return Message.of("reads_suspect", points=tuple(sorted(shared)), alarm=source.key)
        if source.component in self._upstream.get(victim.component, ()):
            return Message.of("upstream_alarm", component=source.component, alarm=source.key)
        return None

    def _move(self, alarm: Alarm, event: Event, why: _Why) -> Alarm:
        state = what_then(alarm.state, event)
        assert state is not None, (alarm.key, alarm.state, event)
        moved = replace(alarm, state=state, updated=why.time, history=(*alarm.history, why.entry(state)))
        self._open[subject_of(alarm)] = moved
        return moved

    def annotate(self, alarm: Alarm) -> None:
        """Replace an open alarm by the same alarm with diagnosis added."""
        self._open[subject_of(alarm)] = alarm

    def export_state(self) -> JsonObject:
        """Open alarms as plain data."""
        return {
            "open": [a.document() for a in self._open.values()],
            "quiet": dict(self._quiet),
            "tally": self.tally.export_state(),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._open = {subject_of(a): a for a in map(Alarm.read, state["open"])}
        self._quiet = dict(state["quiet"])
        self.tally.restore_state(state["tally"])


_PAST: dict[Action, str] = {
    "acknowledge": "acknowledged", "shelve": "shelved", "unshelve": "unshelved", "clear": "cleared"
}  # fmt: skip


def _end(command: Command, time: int) -> int:
    """When shelving ends [ns]."""
    until = command.until
    if command.span is not None:
        until = time + round(command.span * NANOSECONDS)
    if until is None or until <= time:
        given = "no end" if until is None else f"{iso(until)}"
        raise AlarmError(f"shelving {command.alarm} needs an end after {iso(time)}, not {given}; say for how long")
    return until


@dataclass(frozen=True, slots=True)
class _Why:
    """When an alarm moves, by whom, and why: a person's comment, or the service's reason."""

    time: int
    actor: str
    comment: str = ""
    reason: Message | None = None
    through: str = ""

    def entry(self, state: AlarmState) -> Entry:
        """As the history keeps it."""
        return Entry(self.time, str(state), self.actor, self.comment, self.reason, self.through)


def _said(command: Command, time: int) -> _Why:
    return _Why(time, command.actor, command.comment, through=command.through)


def _by_service(time: int, code: str, **arguments: str) -> _Why:
    return _Why(time, SERVICE, reason=Message.of(code, **arguments))
