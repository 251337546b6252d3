"""Alarms of the model apart from the plant's, and frozen readings named as such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from fdd.evidence import AlarmKind, ChartEvidence, ChartKind
from fdd.records import NANOSECONDS, AlarmState, Baseline
from fdd.report.telling import Speaker
from fdd.residual_monitors.autocorrelation import Autocorrelation
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.dispersion import Dispersion
from fdd.residual_monitors.periodogram import Periodogram
from fdd.residual_monitors.whiten import Whitener
from fdd.service.alarms.book import AlarmBook, Command, Ring
from fdd.service.baselines.history import read_history
from fdd.service.baselines.identify import healthy_steps, honest_spread, innovation_statistics, score_diagnostics
from fdd.service.baselines.window import avoided
from fdd.service.daemon.checkpoint import decode, encode
from fdd.service.engine.engine import Engine
from fdd.service.filtering.filters import FilterGroup
from fdd.service.monitoring.flatline_charts import flatline_statistics
from fdd.service.monitoring.health_charts import KINDS, STEADY, HealthCharts, _Reach, window_of, window_statistics
from tests.service.conftest import STEP, Truth, baselines, plan, simulate

DAY = 288
LEARNING = 10
FRAME = STEP * NANOSECONDS


def watched(truth: Truth) -> dict[str, Baseline]:
    """The true parameters, with what the first weeks say of innovations and readings."""
    p, found = plan(), {}
    history, _ = read_history(p, [truth.batch(0, LEARNING * DAY)])
    for c in p.components:
        bare = replace(baselines()[c.name], innovation={})
        steps = healthy_steps(p, c, bare, history)
        found[c.name] = replace(
            bare,
            innovation=innovation_statistics(c, steps, p.step),
            diagnostics={"flatline": flatline_statistics(c, steps), **score_diagnostics(p, c, steps)},
        )
    return found


@pytest.fixture(scope="module")
def long() -> Truth:
    return simulate((LEARNING + 14) * DAY, seed=12)


@pytest.fixture(scope="module")
def known(long: Truth) -> dict[str, Baseline]:
    return watched(long)


def run(truth: Truth, known: dict[str, Baseline], stop: int | None = None) -> Engine:
    e = Engine(plan(), known)
    e.step(truth.batch(LEARNING * DAY, stop))
    return e


def with_south(truth: Truth, south: np.ndarray) -> Truth:
    return Truth(truth.time, {**truth.points, "south.T": south})


def test_frozen_sensor_is_found_within_an_hour_and_named(long: Truth, known: dict[str, Baseline]) -> None:
    south, onset = long.points["south.T"].copy(), (LEARNING + 2) * DAY
    south[onset:] = south[onset]
    e = run(with_south(long, south), known)
    (alarm,) = [a for a in e.alarms.open if a.state is AlarmState.RAISED]
    assert alarm.component == "south"
    assert alarm.evidence.points == ("south.T",)
    assert 0 < alarm.raised - int(long.time[onset]) <= 3600 * NANOSECONDS
    assert alarm.causes[0].name == "frozen"
    assert "south.T is frozen" in Speaker().line(alarm)


def test_frozen_input_is_the_alarm_of_its_point_and_its_reader_is_not_accused(
    long: Truth, known: dict[str, Baseline]
) -> None:
    outside, onset = long.points["outside"].copy(), (LEARNING + 2) * DAY
    outside[onset:] = outside[onset]
    e = run(Truth(long.time, {**long.points, "outside": outside}), known)
    raised = [a for a in e.alarms.open if a.state is AlarmState.RAISED]
    assert [a.evidence.points[0] for a in raised] == ["outside"]


def test_sun_at_night_and_steps_of_heat_are_no_frozen_readings(long: Truth, known: dict[str, Baseline]) -> None:
    assert run(long, known).alarms.open == ()


def coloured(truth: Truth, onset: int, seed: int = 4) -> np.ndarray:
    """From the onset on the room swings by some hundredths of a kelvin, as under a hunting valve."""
    south = truth.points["south.T"].copy()
    t = np.arange(len(south) - onset)
    south[onset:] += 0.05 * np.sin(2 * np.pi * t / 4 + seed)
    return south


def test_colour_that_comes_later_is_an_alarm_of_the_model_and_not_of_the_plant(
    long: Truth, known: dict[str, Baseline]
) -> None:
    e = run(with_south(long, coloured(long, (LEARNING + 2) * DAY)), known)
    (alarm,) = e.alarms.open
    assert (alarm.evidence.kind, alarm.component, alarm.state) == ("model", "south", AlarmState.RAISED)
    assert alarm.key.startswith("south:model@")
    assert "no longer describes" in Speaker().line(alarm)
    assert "re-identify" in Speaker().line(alarm)
    # It is no reason to keep its days from a new baseline.
    assert avoided([alarm.document()], plan().components[0]) == []


def test_model_whose_parameters_are_still_being_learned_is_not_judged(long: Truth, known: dict[str, Baseline]) -> None:
    p = plan()
    group = FilterGroup(p.components, known, p.columns, hold=0, max_gap=p.max_gap)
    charts = HealthCharts(p, [group], dict.fromkeys(known, 1e6))
    group.error = np.stack(
        [np.eye(3) * error for error in (1.0, 1e-8)]
    )  # the south room's parameters are anybody's guess
    for time, row in zip(long.time[: DAY + 9], np.stack([long.points[n] for n in p.points], axis=1), strict=False):
        said = charts.update([group.step(int(time), row)])
    south = np.array([s.component == "south" for s in charts.streams])
    assert (said.phase[south] == Phase.LEARNING).all()
    assert (said.phase[~south] == Phase.QUIET).all()


def test_colour_that_the_baseline_had_does_not_ring(long: Truth, known: dict[str, Baseline]) -> None:
    truth = with_south(long, coloured(long, 0))
    assert run(truth, watched(truth)).alarms.open == ()


def test_model_asks_once_for_a_new_baseline_and_again_only_of_the_next(long: Truth, known: dict[str, Baseline]) -> None:
    """The room swings for good; cleared without a new baseline, its model's charts rest, also after a restart."""
    truth = with_south(long, coloured(long, (LEARNING + 2) * DAY))
    e = run(truth, known, (LEARNING + 5) * DAY)
    (alarm,) = e.alarms.open
    e.command(Command(alarm.key, "clear", "anna", 0))
    again = Engine(plan(), known)
    again.restore_state(e.export_state())
    for engine in (e, again):
        assert engine.step(truth.batch((LEARNING + 5) * DAY, (LEARNING + 7) * DAY)).alarms == []
    e.rebase({"south": replace(known["south"], version=2)})
    e.step(truth.batch((LEARNING + 7) * DAY))
    assert [a.evidence.kind for a in e.alarms.open] == [AlarmKind.MODEL]


def test_new_baseline_ends_the_alarm_of_the_model(long: Truth, known: dict[str, Baseline]) -> None:
    truth, p = with_south(long, coloured(long, (LEARNING + 1) * DAY)), plan()
    e = run(truth, known, (LEARNING + 7) * DAY)
    (alarm,) = e.alarms.open
    assert alarm.state is AlarmState.RAISED
    history, _ = read_history(p, [truth.batch((LEARNING + 1) * DAY, (LEARNING + 7) * DAY)])
    bare = replace(known["south"], innovation={}, version=2)
    steps = healthy_steps(p, p.components[0], bare, history)
    new = replace(bare, innovation=innovation_statistics(p.components[0], steps, p.step))
    assert new.innovation["T_room"]["windows"] == {}  # too short a stretch to judge days by: nothing is charted
    e.rebase({"south": new})
    e.step(truth.batch((LEARNING + 7) * DAY))
    assert [a.state for a in e.alarms.open] == [AlarmState.RETURNED]


def test_health_charts_ring_as_often_as_they_promise_after_four_weeks_of_coloured_innovations() -> None:
    """Innovations with memory, whitened and scaled by their own baseline as in the engine; fifty later days of 600."""
    rng, chance, streams, learning = np.random.default_rng(5), 0.01, 600, 28 * DAY
    x = lfilter([1.0], [1.0, -0.3], rng.standard_normal((learning + 50 * DAY, streams)), axis=0)
    whitener = Whitener.fit(x[:learning], 2, centre=True)
    whitener.scale[:] = 1.0
    white = np.array([whitener.update(row) for row in x])[2:].T
    passed: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for values in white:
        own, later = np.split(values / honest_spread(values[: learning - 2]), [learning - 2])
        known = window_statistics(own, DAY)
        # Days as unsteady as charts grant that healthy ones are.
        days = later.reshape(50, DAY) * np.sqrt(1 + STEADY * rng.standard_normal((50, 1)))
        for kind, statistics in scaled(days).items():
            r = _Reach.of(kind, [known[kind]], np.array([chance / 2 if kind == "dispersion" else chance]), DAY)
            far = np.abs(statistics - r.centre) if kind == "dispersion" else statistics - r.centre
            passed[kind].append(float(np.mean(far > r.reach)) / chance)
    for kind, ratios in passed.items():
        # Between baselines, whose errors the limits are averaged over.
        error = np.std(ratios) / np.sqrt(streams)
        assert error < 0.1
        assert abs(np.mean(ratios) - 1) < 0.1 + 2 * error, (kind, np.mean(ratios), error)


def scaled(windows: np.ndarray) -> dict[str, np.ndarray]:
    """What a chart makes of each window, on the scale of the baseline's statistics."""
    length = windows.shape[1]
    memory, colour, spread = (
        Autocorrelation([1.0], window=length), Periodogram([1.0], window=length), Dispersion([1.0], window=length),
    )  # fmt: skip
    return {
        "autocorrelation": np.cbrt(memory.statistics(windows)),
        "periodogram": colour.straightened(colour.statistics(windows)),
        "dispersion": spread.scores(windows),
    }


def test_baseline_whose_days_are_told_on_an_older_scale_is_not_judged_by(
    long: Truth, known: dict[str, Baseline]
) -> None:
    def older(b: Baseline) -> Baseline:
        innovation = {q: {**s, "windows": {**s["windows"], "scale": 1}} for q, s in b.innovation.items()}
        return replace(b, innovation=innovation)

    e = run(with_south(long, coloured(long, (LEARNING + 2) * DAY)), {n: older(b) for n, b in known.items()})
    assert not [a for a in e.alarms.open if a.evidence.kind is AlarmKind.MODEL]


def test_colour_that_is_slower_than_a_block_is_found_at_one_value_a_second() -> None:
    """Days of 86 400 values in windows of 288: white days are passed, an hour's memory is not."""
    rng = np.random.default_rng(8)
    window, block = window_of(NANOSECONDS)
    assert window * block == 86_400
    noise = rng.standard_normal((16, 86_400))
    own = window_statistics(noise[:10].ravel(), window, block)
    later = noise[10:].copy()
    slow = np.repeat(rng.standard_normal((6, 24)), 3600, axis=1)
    for day in later, later + 0.2 * slow:
        for kind, over in (("periodogram", day is not later), ("autocorrelation", day is not later)):
            r = _Reach.of(kind, [own[kind]], np.array([1e-3]), window)
            x = window_statistics(day.ravel(), window, block)[kind][0]  # the mean of six days
            assert (x > r.limit[0]) == over, (kind, x, r.limit)


def test_alarm_of_the_model_is_suppressed_by_one_of_the_plant_in_either_order_and_goes_with_it() -> None:
    for order in ((AlarmKind.PLANT, AlarmKind.MODEL), (AlarmKind.MODEL, AlarmKind.PLANT)):
        book = AlarmBook({"hx": frozenset()})
        for i, kind in enumerate(order):
            book.ring(i + 1, [Ring("hx", "hx/T:cusum", None, 0, ChartEvidence("T", ChartKind.CUSUM), kind)])
        plant, model = book.of("hx"), book.of("hx:model")
        assert plant is not None
        assert model is not None
        assert (plant.state, model.state) == (AlarmState.RAISED, AlarmState.SUPPRESSED)
        cleared = book.command(Command(plant.key, "clear", "anna", 5), 5)
        assert [a.state for a in cleared] == [AlarmState.CLEARED, AlarmState.CLEARED]
        assert book.open == ()


def test_alarm_of_a_model_explains_nobody_elses() -> None:
    book = AlarmBook({"hx": frozenset(), "radiator": frozenset()}, {"radiator": frozenset({"hx"})})
    name = "hx/T:autocorrelation"
    book.ring(1, [Ring("hx", name, None, 0, ChartEvidence.read(name, {}), AlarmKind.MODEL)])
    book.ring(2, [Ring("radiator", "r/T:cusum", "T", 0, ChartEvidence("T", ChartKind.CUSUM))])
    assert {a.state for a in book.open} == {AlarmState.RAISED}


def test_state_survives_with_both_kinds_of_alarm(long: Truth, known: dict[str, Baseline]) -> None:
    e = run(with_south(long, coloured(long, (LEARNING + 2) * DAY)), known)
    again = Engine(plan(), known)
    again.restore_state(decode(encode(e.export_state())))
    assert again.alarms.open == e.alarms.open
    assert len(e.alarms.open) == 1
