"""Simulated plant-years under the whole service: engine, alarms and weekly re-identification with its gates.

Rooms that have nothing to do with each other run in one engine, each with a budget of its own: a frame of forty rooms
costs little more than that of one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.drifting_room import DAY, POINTS, START, STEP, Course, plan, simulate
from fdd.config.schema import Reidentify
from fdd.diagnosis.gates import Outcome, Policy
from fdd.evidence import AlarmKind
from fdd.records import NANOSECONDS, Alarm, Baseline, Batch
from fdd.service.baselines.candidate import Candidate, consider
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.baselines.window import avoided, without
from fdd.service.engine.engine import Engine
from fdd.service.site.plan import Plan

LEARNING, EVERY, SPAN = 21, 7, 28
FRAMES_A_DAY = DAY // STEP
# Of the fault's change: what a baseline in force may have taken up of it and still not have learned it.
LEARNED = 0.25
# A room by itself: where baselines are fitted. Charts leave to re-identification what they do by default.
ONE = replace(plan(), deadband=float(Reidentify.model_fields["deadband"].default))


@dataclass(frozen=True)
class Case:
    """One run: how the room's heat loss changes, and the seed of its weather and noise."""

    course: Course
    seed: int


@dataclass
class Room:
    """One case on its way: what was measured, its baselines, its alarms, and what became of every candidate."""

    case: Case
    name: str
    history: History
    line: list[Baseline]
    alarms: dict[str, Alarm] = field(default_factory=dict)
    found: list[Candidate] = field(default_factory=list)
    suspected: bool = False

    @classmethod
    def of(cls, case: Case, name: str) -> Room:
        """A room with the baseline of its first weeks."""
        history = simulate(case.course, case.seed)
        return cls(case, name, history, [identify(ONE, ONE.components[0], _days(history, 0, LEARNING))[0]])

    @property
    def baseline(self) -> Baseline:
        """What is in force."""
        return replace(self.line[-1], component=self.name)

    def reidentify(self, end: int) -> bool:
        """The job of a week, days up to ``end``; whether there is a new baseline."""
        only = ONE.components[0]
        documents = [{**a.document(), "component": only.name} for a in self.alarms.values()]
        healthy = without(_days(self.history, max(0, end - SPAN), end), avoided(documents, only))
        found = consider(ONE, only, healthy, self.line, Policy(), suspected=self.suspected)
        self.found.append(found)
        accepted = found.outcome is Outcome.ACCEPTED and found.baseline is not None
        if accepted and found.baseline:
            self.line.append(replace(found.baseline, version=self.line[-1].version + 1))
        healthy_again = any(g.name == "no fault" and g.passed for g in found.gates)
        self.suspected = found.outcome is Outcome.SUSPECTED or (self.suspected and not healthy_again)
        return accepted


def live(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Learn for three weeks, then watch and re-identify every week; what was accepted, alarmed and learned.

    Parameters
    ----------
    cases : of one length
    """
    rooms = [Room.of(case, f"room{i}") for i, case in enumerate(cases)]
    for _ in weeks(rooms):
        pass
    return [judged(r) for r in rooms]


def gates_alone(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Weekly re-identification with no alarm to keep faulty days from it: what the gates stop by themselves."""
    rooms = [Room.of(case, f"room{i}") for i, case in enumerate(cases)]
    for room in rooms:
        for end in range(LEARNING + EVERY, room.case.course.days + 1, EVERY):
            room.reidentify(end)
    return [judged(r) for r in rooms]


def weeks(rooms: Sequence[Room]) -> Iterator[int]:
    """Run rooms side by side; gives the day at which every week ended, after its jobs."""
    (days,) = {r.case.course.days for r in rooms}
    engine = Engine(_plant(rooms), {r.name: r.baseline for r in rooms})
    of = {r.name: r for r in rooms}
    for day in range(LEARNING, days, EVERY):
        end = min(day + EVERY, days)
        for alarm in engine.step(_batch(rooms, day, end)).alarms:
            of[alarm.component].alarms[alarm.key] = alarm
        if day + EVERY <= days:
            engine.rebase({r.name: r.baseline for r in rooms if r.reidentify(end)})
        yield end


def _plant(rooms: Sequence[Room]) -> Plan:
    """All rooms in one plan, each with the whole budget of one."""
    (only,) = ONE.components

    def named(room: Room, points: Sequence[str]) -> tuple[str, ...]:
        return tuple(f"{room.name}.{p}" for p in points)

    components = tuple(
        replace(only, name=r.name, inputs=named(r, only.inputs), outputs=named(r, only.outputs)) for r in rooms
    )
    points = tuple(p for r in rooms for p in named(r, POINTS))
    return replace(
        ONE, false_alarms_per_year=ONE.false_alarms_per_year * len(rooms), points=points, components=components
    )


def _batch(rooms: Sequence[Room], start: int, end: int) -> Batch:
    parts = [_days(r.history, start, end) for r in rooms]
    values = np.concatenate([p.values for p in parts], axis=1)
    names = tuple(f"{r.name}.{p}" for r in rooms for p in r.history.columns)
    return Batch.of_table(names, parts[0].time, values)


def judged(room: Room) -> dict[str, Any]:
    """What became of a room, against what was done to it."""
    course, alarms = room.case.course, list(room.alarms.values())
    first, last = (b.parameters["R_ia"] for b in (room.line[0], room.line[-1]))
    truth = course.resistance()
    onset = int(course.onset * FRAMES_A_DAY)
    faulty = bool(course.growth or course.step)
    raised = [(a.raised - START) / NANOSECONDS / DAY for a in alarms]
    change = float(np.log(truth[-1] / truth[onset - 1])) if faulty else 0.0
    taken = float(np.log(last / first)) / change if faulty else 0.0
    outcomes = [str(c.outcome) for c in room.found]
    return {
        "learned": faulty and taken > LEARNED,
        "taken": taken,
        "alarmed": faulty and any(r >= course.onset for r in raised),
        "false_alarms": sum(r < course.onset for r in raised) if faulty else len(raised),
        "false_model_alarms": sum(
            a.evidence.kind is not AlarmKind.PLANT
            for a, r in zip(alarms, raised, strict=True)
            if not faulty or r < course.onset
        ),
        "error": float(last / truth[-1] - 1),
        "accepted": outcomes.count("accepted"),
        "suspected": outcomes.count("suspected fault"),
        "days": course.days,
    }


def _days(history: History, start: int, end: int) -> History:
    rows = slice(start * FRAMES_A_DAY, end * FRAMES_A_DAY)
    return History(history.columns, history.time[rows], history.values[rows])
