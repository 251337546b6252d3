"""The engine grades an alarm by size, certainty and cost, and grades it anew as days go by."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.drifting_room import DAY, POINTS, START, Course, plan, simulate
from fdd.records import NANOSECONDS, Alarm, Batch, Sample
from fdd.service.baselines.identify import identify
from fdd.service.engine.engine import Engine

LEARNING, DAYS = 14, 26
ORDER = ("low", "medium", "high")


def run(heat_price: float | None) -> Alarm:
    """The room loses a third more heat from day 16 on; its alarm as it stands on the last day."""
    history = simulate(Course(DAYS, step=0.35, onset=16.0), 4)
    site = replace(plan(), tariffs={"currency": "EUR", "heat": heat_price, "dear": 10.0, "cheap": 0.5})
    end = START + LEARNING * DAY * NANOSECONDS
    first = identify(site, site.components[0], history.between(None, end))[0]
    engine = Engine(site, {"room": first})
    days = history.between(end, None)
    rows = zip(days.time.tolist(), days.values.tolist(), strict=True)
    engine.step(Batch.of(Sample(p, t, v) for t, row in rows for p, v in zip(POINTS, row, strict=True)))
    alarm = engine.alarms.of("room")
    assert alarm is not None
    return alarm


def test_the_same_fault_is_graded_by_what_it_costs() -> None:
    free, cheap, dear = (run(price) for price in (None, 1e-3, 10.0))
    assert free.evidence.cost.value is None
    assert cheap.evidence.cost.upper < 0.5
    assert dear.evidence.cost.value > 10.0
    grade = ORDER.index(free.severity)
    assert ORDER.index(cheap.severity) == max(grade - 1, 0)
    assert ORDER.index(dear.severity) == min(grade + 1, 2)
    assert cheap.severity != dear.severity
