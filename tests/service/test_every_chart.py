"""What arrives twice, late, out of order or from a machine that is off: for every chart that the engine carries.

A chart sees one value a frame, so that these are kept from it by what stands before it; here it is checked at the
charts, for each that introspection of the engine finds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdd.records import NANOSECONDS, Baseline, Batch
from fdd.residual_monitors.chart import Phase
from fdd.service.engine.engine import Engine, Outputs
from fdd.service.monitoring.charting import FAMILIES
from fdd.service.site.plan import Derived, Plan
from tests.service.conftest import Truth, plan, simulate
from tests.service.test_health_and_flatline import watched

DAY = 288
LEARNING, DAYS = 10, 15
LATENESS = 1800 * NANOSECONDS
OFF = (LEARNING + 2, LEARNING + 3)  # the south room's machine is off for this day


@pytest.fixture(scope="module")
def long() -> Truth:
    return simulate(DAYS * DAY, seed=12)


@pytest.fixture(scope="module")
def known(long: Truth) -> dict[str, Baseline]:
    return watched(long)


def run(batch: Batch, known: dict[str, Baseline], site: Plan | None = None) -> tuple[Engine, Outputs]:
    engine = Engine(site or replace(plan(), lateness=LATENESS), known)
    return engine, engine.step(batch)


def charted(outputs: Outputs) -> dict[str, dict[str, np.ndarray]]:
    """All that every chart said, by stream: statistic, limit and phase by frame."""
    (rows,) = [r for r in outputs.rows if r.measurement == "charts"]
    return {
        name: {k: np.asarray(v)[rows.series == i] for k, v in rows.fields.items()} for i, name in enumerate(rows.names)
    }


def same(a: Outputs, b: Outputs) -> None:
    """Every chart said the same, to the byte."""
    one, two = charted(a), charted(b)
    assert list(one) == list(two)
    for stream in one:
        for field in ("statistic", "limit", "phase"):
            assert one[stream][field].tobytes() == two[stream][field].tobytes(), (stream, field)
    assert [x.key for x in a.alarms] == [x.key for x in b.alarms]


def test_engine_under_test_carries_a_chart_of_every_family(long: Truth, known: dict[str, Baseline]) -> None:
    """A family that is added to the engine is under these checks, or this fails."""
    engine, outputs = run(long.batch(LEARNING * DAY, LEARNING * DAY + 12), known)
    groups, site = engine._groups, engine.plan
    for family in FAMILIES:
        assert any(family.carried(g, c) for g in groups for c in g.components), family
    kinds = {name.rpartition(":")[2] for name in charted(outputs)}
    assert kinds == {"day", "cusum", "score", "flatline", "autocorrelation", "periodogram", "dispersion"}
    assert len(site.components) == 2


def test_duplicates_change_no_chart(long: Truth, known: dict[str, Baseline]) -> None:
    """Every sample comes twice, and a third time with another value."""
    once = long.batch(LEARNING * DAY)
    n = len(once)
    thrice = replace(
        once,
        point=np.repeat(once.point, 3),
        time=np.repeat(once.time, 3),
        value=np.repeat(once.value, 3) + np.tile([0.0, 0.0, 50.0], n),
        quality=np.repeat(once.quality, 3),
    )
    _, plain = run(once, known)
    engine, doubled = run(thrice, known)
    same(plain, doubled)
    assert engine.counts["duplicate"] == 2 * n


def test_order_within_the_lateness_changes_no_chart_and_what_is_later_is_dropped(
    long: Truth, known: dict[str, Baseline]
) -> None:
    once = long.batch(LEARNING * DAY)
    rng = np.random.default_rng(3)
    arrival = once.time + rng.integers(0, LATENESS, len(once))
    order = np.argsort(arrival, kind="stable")
    shuffled = _take(once, order)
    assert np.any(np.diff(shuffled.time) < 0)
    _, plain = run(once, known)
    engine, mixed = run(shuffled, known)
    same(plain, mixed)
    assert engine.counts["late"] == 0
    # Old samples with wild values, hours late, in the middle of the stream.
    late = np.flatnonzero(rng.random(len(once)) < 0.05)
    late = late[once.time[late] + 7200 * NANOSECONDS < once.time[-1]]
    where = np.searchsorted(once.time, once.time[late] + 7200 * NANOSECONDS, side="right")
    both = replace(
        once,
        point=np.insert(once.point, where, once.point[late]),
        time=np.insert(once.time, where, once.time[late]),
        value=np.insert(once.value, where, 1e6),
        quality=np.insert(once.quality, where, once.quality[late]),
    )
    engine, disturbed = run(both, known)
    same(plain, disturbed)
    assert engine.counts["late"] == len(late) > 100


def _take(batch: Batch, order: np.ndarray) -> Batch:
    return replace(
        batch,
        point=batch.point[order],
        time=batch.time[order],
        value=batch.value[order],
        quality=batch.quality[order],
    )


def gated(long: Truth) -> tuple[Plan, Truth]:
    """The site with a gate on the south room, and what it measures with nonsense while the machine is off."""
    running = np.ones(len(long.time))
    running[OFF[0] * DAY : OFF[1] * DAY] = 0.0
    nonsense = np.random.default_rng(5).uniform(-40.0, 90.0, len(running))
    south = np.where(running > 0, long.points["south.T"], nonsense)
    site = plan()
    rooms = tuple(
        replace(c, when="south/when", start_up=3600 * NANOSECONDS) if c.name == "south" else c for c in site.components
    )
    derived = (Derived("south/when", lambda columns: columns["fan"]),)
    site = replace(site, points=(*site.points, "fan"), derived=derived, components=rooms)
    return site, Truth(long.time, {**long.points, "south.T": south, "fan": running})


def test_machine_that_is_off_is_no_data_to_every_chart_of_it_and_to_no_other(
    long: Truth, known: dict[str, Baseline]
) -> None:
    site, truth = gated(long)
    engine, outputs = run(truth.batch(LEARNING * DAY), known, site)
    _, plain = run(long.batch(LEARNING * DAY), known, plan())
    assert [a.key for a in engine.alarms.open] == []
    off = slice((OFF[0] - LEARNING) * DAY, (OFF[1] - LEARNING) * DAY)
    there = charted(plain)
    for stream, said in charted(outputs).items():
        if stream.startswith("south/"):
            assert np.all(said["phase"][off] == Phase.NO_DATA), stream
            # Nothing is added to what was known, and nothing of it is lost.
            held = said["statistic"][off]
            assert np.all(held == held[0]), stream
            assert np.any(said["phase"][off.stop :] > Phase.NO_DATA), stream
        elif stream in there:
            assert said["statistic"].tobytes() == there[stream]["statistic"].tobytes(), stream


def test_alarm_stands_while_its_machine_is_off(long: Truth, known: dict[str, Baseline]) -> None:
    site, truth = gated(long)
    south = truth.points["south.T"].copy()
    south[LEARNING * DAY + DAY // 2 :] += 4.0  # the sensor reads too much from noon of the first day on
    engine, outputs = run(Truth(truth.time, {**truth.points, "south.T": south}).batch(LEARNING * DAY), known, site)
    rang = {s: said["phase"] for s, said in charted(outputs).items() if np.any(said["phase"] == Phase.ALARM)}
    assert rang
    assert all(s.startswith("south/") for s in rang)
    before = (OFF[0] - LEARNING) * DAY
    standing = [s for s, phase in rang.items() if np.any(phase[:before] == Phase.ALARM)]
    assert standing
    for stream in standing:
        first = int(np.argmax(rang[stream] == Phase.ALARM))
        assert np.all(rang[stream][first:] == Phase.ALARM), stream
    assert engine.alarms.of("south") is not None
