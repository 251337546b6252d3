"""The engine: the right component alarms, and nothing depends on how the stream was cut."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.records import NANOSECONDS, AlarmState, Batch, Rows
from fdd.report.telling import Speaker
from fdd.service.alarms.book import Command
from fdd.service.daemon.checkpoint import decode, encode
from fdd.service.engine.engine import Engine, EngineError, Outputs
from tests.service.conftest import START, STEP, Truth, baselines, plan, simulate

DAY = 288


def engine(false_alarms_per_year: float = 2.0) -> Engine:
    return Engine(plan(false_alarms_per_year), baselines())


def verdicts(outputs: list[Outputs]) -> bytes:
    """Everything that outputs say, as bytes, whatever batches they came in."""
    cells = []
    for o in outputs:
        for r in o.rows:
            columns = {k: np.asarray(v, dtype=float).tobytes().hex() for k, v in r.fields.items()}
            width = 16
            for i in range(len(r)):
                values = {k: c[width * i : width * (i + 1)] for k, c in columns.items()}
                cells.append((r.measurement, int(r.time[i]), r.names[r.series[i]], sorted(values.items())))
    alarms = [a.document() for o in outputs for a in o.alarms]
    return json.dumps([sorted(cells), alarms]).encode()


def rows_of(outputs: Outputs, measurement: str) -> Rows:
    (found,) = [r for r in outputs.rows if r.measurement == measurement]
    return found


def test_fault_is_alarmed_on_its_component_alone(faulty: Truth) -> None:
    e = engine()
    outputs = e.step(faulty.batch())
    assert {a.component for a in outputs.alarms} == {"south"}
    alarm = e.alarms.open[0]
    onset = START + 7 * DAY * STEP * NANOSECONDS
    assert onset < alarm.raised < onset + DAY * STEP * NANOSECONDS
    assert abs(alarm.since - onset) < 0.5 * DAY * STEP * NANOSECONDS
    assert alarm.evidence.charts["south/T_room:cusum"].direction == -1


def test_healthy_fortnight_raises_no_alarm_and_innovations_are_standard(healthy: Truth) -> None:
    outputs = engine().step(healthy.batch())
    assert outputs.alarms == []
    z = rows_of(outputs, "predictions").fields["innovation"]
    z = z[np.isfinite(z)]
    # Four standard errors of the mean and of the standard deviation of as many independent normal values.
    assert abs(z.mean()) < 4 / np.sqrt(len(z))
    assert abs(z.std() - 1) < 4 / np.sqrt(2 * len(z))


def test_alarm_stands_until_cleared_and_rings_again_while_the_fault_is_there(faulty: Truth) -> None:
    e = engine()
    e.step(faulty.batch(0, 10 * DAY))
    (alarm,) = e.alarms.open
    cleared = e.command(Command(alarm.key, "clear", "anna", alarm.raised))
    assert cleared.alarms[0].state is AlarmState.CLEARED
    assert e.alarms.open == ()
    again = e.step(faulty.batch(10 * DAY))
    assert {a.component for a in again.alarms} == {"south"}
    assert again.alarms[0].key != alarm.key


def test_missing_output_silences_its_chart_only_while_it_is_missing(faulty: Truth) -> None:
    points = {k: v.copy() for k, v in faulty.points.items()}
    points["south.T"][DAY : 2 * DAY] = np.nan
    e = engine()
    outputs = e.step(Truth(faulty.time, points).batch())
    charts = rows_of(outputs, "charts")
    south = charts.names.index("south/T_room:cusum")
    phase = charts.fields["phase"][charts.series == south]
    assert set(phase[DAY + 1 : 2 * DAY - 1]) == {0}
    assert {a.component for a in outputs.alarms} == {"south"}


def test_gap_restarts_the_filter_without_an_alarm(healthy: Truth) -> None:
    e = engine()
    e.step(healthy.batch(0, 3 * DAY))
    outputs = e.step(healthy.batch(6 * DAY))
    assert outputs.alarms == []


def test_infinite_and_absurd_values_neither_stop_the_engine_nor_reach_the_other_component(healthy: Truth) -> None:
    points = {k: v.copy() for k, v in healthy.points.items()}
    points["south.T"][500] = np.inf
    points["south.heat"][600] = 1e300
    outputs = engine().step(Truth(healthy.time, points).batch())
    predictions = rows_of(outputs, "predictions")
    north = predictions.series == predictions.names.index("north/T_room")
    clean = rows_of(engine().step(healthy.batch()), "predictions")
    assert (
        predictions.fields["predicted"][north].tobytes()
        == clean.fields["predicted"][clean.series == clean.names.index("north/T_room")].tobytes()
    )
    assert {a.component for a in outputs.alarms} <= {"south"}


@settings(deadline=None, max_examples=10)
@given(cuts=st.lists(st.integers(0, 3 * DAY * 6), min_size=0, max_size=8), restart=st.booleans())
def test_verdicts_are_the_same_bytes_in_any_batches_and_across_restarts(cuts: list[int], restart: bool) -> None:
    stream = _stream()
    one = engine()
    expected = verdicts([one.step(stream), one.flush()])
    many, got = engine(), []
    edges = [0, *sorted(cuts), len(stream)]
    for start, stop in pairwise(edges):
        got.append(many.step(stream.slice(start, stop)))
        if restart:
            again = engine()
            again.restore_state(decode(encode(many.export_state())))
            many = again
    got.append(many.flush())
    assert verdicts(got) == expected


def _stream() -> Batch:
    return simulate(3 * DAY, seed=5, loss=3000.0, onset=DAY).batch()


def test_state_of_another_site_is_refused_with_a_remedy() -> None:
    e = engine()
    state = e.export_state()
    other = Engine(plan(), {"south": baselines()["south"]})
    with pytest.raises(EngineError, match="start afresh"):
        other.restore_state(state)


def test_a_fault_that_comes_back_raises_its_alarm_again_and_makes_no_new_one(healthy: Truth) -> None:
    south = healthy.points["south.T"].copy()
    for start in (3 * DAY, 8 * DAY):
        south[start : start + 40] += np.where(np.arange(40) % 2 == 0, 2.0, 1.0)
    flapping = Truth(healthy.time, {**healthy.points, "south.T": south})
    e = engine()
    outputs = e.step(flapping.batch())
    assert len({a.key for a in outputs.alarms}) == 1
    states = [h.state for h in e.alarms.open[0].history]
    assert states[:3] == [AlarmState.RAISED, AlarmState.RETURNED, AlarmState.RAISED]
    again = [h.time for h in e.alarms.open[0].history if h.state == AlarmState.RAISED][1]
    assert abs(again - int(healthy.time[8 * DAY])) < 60 * STEP * NANOSECONDS


def test_step_over_lost_inputs_is_not_judged(healthy: Truth) -> None:
    points = {k: v.copy() for k, v in healthy.points.items()}
    rng = np.random.default_rng(3)
    for name in ("south.heat", "outside", "sun"):
        points[name][rng.random(len(healthy.time)) < 0.03] = np.nan
    lost = ~np.isfinite(np.stack([points[n] for n in ("south.heat", "outside", "sun")])).all(axis=0)
    outputs = engine().step(Truth(healthy.time, points).batch())
    predictions = rows_of(outputs, "predictions")
    south = predictions.series == predictions.names.index("south/T_room")
    after = healthy.time[1:][lost[:-1] & ~lost[1:]]
    judged = predictions.fields["innovation"][south][np.isin(predictions.time[south], after)]
    assert len(judged) > 100
    assert np.isnan(judged).all()


def test_innovations_are_standard_after_an_input_moved_unseen(healthy: Truth) -> None:
    """Heaters change by kilowatts every two hours: a filter that held the old one would be far off and sure of it."""
    points = {k: v.copy() for k, v in healthy.points.items()}
    heat, moved = points["south.heat"], np.flatnonzero(np.diff(points["south.heat"]) != 0) + 1
    heat[moved] = np.nan
    outputs = engine().step(Truth(healthy.time, points).batch())
    predictions = rows_of(outputs, "predictions")
    south = predictions.series == predictions.names.index("south/T_room")
    innovation = predictions.fields["innovation"][south]
    judged = [np.isin(predictions.time[south], healthy.time[moved[:-1] + later]) for later in (2, 3, 4)]
    for which in judged:
        squares = np.square(innovation[which])
        squares = squares[np.isfinite(squares)]
        assert squares.size > 100
        # A chi-square mean of as many: its standard error, three times.
        assert squares.mean() == pytest.approx(1.0, abs=3 * np.sqrt(2 / squares.size))


@pytest.mark.parametrize("seconds", [1, 60, 600])
def test_state_of_a_component_is_small_whatever_the_step(seconds: int) -> None:
    """Verdicts wait while a checkpoint is taken: of 2 000 components it has 40 MB at most."""
    p, known = plan(false_alarms_per_year=1000.0), baselines()
    rooms = tuple(replace(c, name=f"{c.name}{i}") for i in range(20) for c in p.components)
    p = replace(p, step=seconds * NANOSECONDS, components=rooms)
    e = Engine(p, {c.name: replace(known[c.name.rstrip("0123456789")], component=c.name) for c in rooms})
    assert len(encode(e.export_state())) / len(rooms) < 20_000


def test_a_diagnosis_that_fails_is_counted_and_loses_no_alarm(faulty: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    told = Engine(plan(), baselines()).step(faulty.batch()).alarms
    monkeypatch.setattr("fdd.service.engine.engine.diagnose", fails)
    engine = Engine(plan(), baselines())
    got = engine.step(faulty.batch()).alarms
    assert [(a.key, a.state, a.raised) for a in got] == [(a.key, a.state, a.raised) for a in told]
    assert "not diagnosed, because of LinAlgError: Matrix is not positive definite" in Speaker().line(got[-1])
    assert engine.counts["not diagnosed: south (LinAlgError)"] == len(got)
    again = Engine(plan(), baselines())
    again.restore_state(engine.export_state())
    assert again.counts == engine.counts
