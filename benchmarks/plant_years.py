"""Simulated plant-years under the whole service: engine, alarms and weekly re-identification with its gates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.drifting_room import DAY, START, STEP, Course, plan, simulate
from fdd.diagnosis.gates import Outcome, Policy
from fdd.records import NANOSECONDS, Alarm, Batch, Quality
from fdd.service.alarms import alarm_to_document
from fdd.service.candidate import consider
from fdd.service.engine import Engine
from fdd.service.history import History
from fdd.service.identify import identify
from fdd.service.window import avoided, without

LEARNING, EVERY, SPAN = 21, 7, 28
FRAMES_A_DAY = DAY // STEP
# Of the fault's change: what a baseline in force may have taken up of it and still not have learned it.
LEARNED = 0.25


@dataclass(frozen=True)
class Case:
    """One run: how the room's heat loss changes, and the seed of its weather and noise."""

    course: Course
    seed: int


def live(case: Case) -> dict[str, Any]:
    """Learn for three weeks, then watch and re-identify every week; what was accepted, alarmed and learned."""
    p, course = plan(), case.course
    room, history = p.components[0], simulate(course, case.seed)
    first = identify(p, room, _days(history, 0, LEARNING))[0]
    engine, line, suspected = Engine(p, {"room": first}), [first], False
    alarms: dict[str, Alarm] = {}
    outcomes: list[str] = []
    for day in range(LEARNING, course.days, EVERY):
        _watch(engine, _days(history, day, min(day + EVERY, course.days)), alarms)
        end = day + EVERY
        if end > course.days:
            break
        documents = [alarm_to_document(a) for a in alarms.values()]
        healthy = without(_days(history, max(0, end - SPAN), end), avoided(documents, room))
        found = consider(p, room, healthy, line, Policy(), suspected=suspected)
        outcomes.append(str(found.outcome))
        if found.outcome is Outcome.ACCEPTED and found.baseline:
            line.append(replace(found.baseline, version=line[-1].version + 1))
            engine.rebase({"room": line[-1]})
        healthy_again = any(g.name == "no fault" and g.passed for g in found.gates)
        suspected = found.outcome is Outcome.SUSPECTED or (suspected and not healthy_again)
    return {**_judged(course, first.parameters["R_ia"], line[-1].parameters["R_ia"], list(alarms.values())),
            "accepted": outcomes.count("accepted"), "suspected": outcomes.count("suspected fault"),
            "days": course.days}  # fmt: skip


def _judged(course: Course, first: float, last: float, alarms: list[Alarm]) -> dict[str, Any]:
    truth = course.resistance()
    onset = int(course.onset * FRAMES_A_DAY)
    faulty = course.growth or course.step
    raised = [(a.raised - START) / NANOSECONDS / DAY for a in alarms]
    change = float(np.log(truth[-1] / truth[onset - 1])) if faulty else 0.0
    taken = float(np.log(last / first)) / change if faulty else 0.0
    return {
        "learned": bool(faulty and taken > LEARNED),
        "taken": taken,
        "alarmed": bool(faulty and any(r >= course.onset for r in raised)),
        "false_alarms": sum(r < course.onset for r in raised) if faulty else len(raised),
        "error": float(last / truth[-1] - 1),
    }


def _days(history: History, start: int, end: int) -> History:
    rows = slice(start * FRAMES_A_DAY, end * FRAMES_A_DAY)
    return History(history.columns, history.time[rows], history.values[rows])


def _watch(engine: Engine, part: History, alarms: dict[str, Alarm]) -> None:
    n, p = part.values.shape
    batch = Batch(
        part.columns,
        np.tile(np.arange(p, dtype=np.int32), n),
        np.repeat(part.time, p),
        part.values.ravel(),
        np.full(n * p, Quality.GOOD, dtype=np.uint8),
    )
    alarms |= {a.key: a for a in engine.step(batch).alarms}
