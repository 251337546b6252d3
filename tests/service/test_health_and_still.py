"""Alarms of the model apart from the plant's, and frozen readings named as such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdd.records import NANOSECONDS, AlarmState, Baseline
from fdd.service.alarms import AlarmBook, Command, Ring, alarm_to_document, kind_of
from fdd.service.checkpoint import decode, encode
from fdd.service.engine import Engine
from fdd.service.health_charts import KINDS, _Reach, window_of, window_statistics
from fdd.service.history import read_history
from fdd.service.identify import healthy_steps, innovation_statistics, score_diagnostics
from fdd.service.still_charts import still_statistics
from fdd.service.window import avoided
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
            diagnostics={"still": still_statistics(c, steps), **score_diagnostics(p, c, steps)},
        )
    return found


@pytest.fixture(scope="module")
def long() -> Truth:
    return simulate((LEARNING + 9) * DAY, seed=12)


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
    assert alarm.evidence["points"] == ["south.T"]
    assert 0 < alarm.raised - int(long.time[onset]) <= 3600 * NANOSECONDS
    assert alarm.causes[0]["name"] == "frozen"
    assert "south.T is frozen" in alarm.summary


def test_frozen_input_is_the_alarm_of_its_point_and_its_reader_is_not_accused(
    long: Truth, known: dict[str, Baseline]
) -> None:
    outside, onset = long.points["outside"].copy(), (LEARNING + 2) * DAY
    outside[onset:] = outside[onset]
    e = run(Truth(long.time, {**long.points, "outside": outside}), known)
    raised = [a for a in e.alarms.open if a.state is AlarmState.RAISED]
    assert [a.evidence["points"][0] for a in raised] == ["outside"]


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
    assert (kind_of(alarm), alarm.component, alarm.state) == ("model", "south", AlarmState.RAISED)
    assert alarm.key.startswith("south:model@")
    assert "no longer describes" in alarm.summary
    assert "re-identify" in alarm.summary
    # It is no reason to keep its days from a new baseline.
    assert avoided([alarm_to_document(alarm)], plan().components[0]) == []


def test_colour_that_the_baseline_had_does_not_ring(long: Truth, known: dict[str, Baseline]) -> None:
    truth = with_south(long, coloured(long, 0))
    assert run(truth, watched(truth)).alarms.open == ()


def test_new_baseline_ends_the_alarm_of_the_model(long: Truth, known: dict[str, Baseline]) -> None:
    truth, p = with_south(long, coloured(long, (LEARNING + 1) * DAY)), plan()
    e = run(truth, known, (LEARNING + 7) * DAY)
    (alarm,) = e.alarms.open
    assert alarm.state is AlarmState.RAISED
    history, _ = read_history(p, [truth.batch((LEARNING + 1) * DAY, (LEARNING + 7) * DAY)])
    bare = replace(known["south"], innovation={}, version=2)
    steps = healthy_steps(p, p.components[0], bare, history)
    new = replace(bare, innovation=innovation_statistics(p.components[0], steps, p.step))
    assert new.innovation["T_in"]["windows"] == {}  # too short a stretch to judge days by: nothing is charted
    e.rebase({"south": new})
    e.step(truth.batch((LEARNING + 7) * DAY))
    assert [a.state for a in e.alarms.open] == [AlarmState.RETURNED]


def test_rate_of_the_health_charts_on_baselines_with_and_without_colour() -> None:
    """Windows beyond the limits of other, short baselines: as often as promised, averaged over the baselines."""
    rng, chance, (window, block) = np.random.default_rng(5), 0.01, window_of(FRAME)
    assert block == 1
    for rho in (0.0, 0.15):
        over = dict.fromkeys(KINDS, 0)
        for _ in range(40):
            noise = rng.standard_normal((21 + 50) * window)
            for t in range(1, len(noise)) if rho else ():
                noise[t] += rho * noise[t - 1]
            own = window_statistics(noise[: 21 * window], window)
            for kind in KINDS:
                r = _Reach.of([own[kind]], np.array([chance]), np.array([-np.inf]))
                for w in noise[21 * window :].reshape(50, window):
                    # Six equal windows have the mean of one.
                    x = window_statistics(np.tile(w, 6), window)[kind][0]
                    over[kind] += x > r.limit[0]
        for kind, count in over.items():
            # 20 are promised of 2000; five standard errors, as the days of one baseline go together. None: blind.
            assert 1 <= count <= 20 + 5 * np.sqrt(20), (rho, kind, count)


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
            r = _Reach.of([own[kind]], np.array([1e-3]), np.array([-np.inf]))
            x = window_statistics(day.ravel(), window, block)[kind][0]
            assert (x > r.limit[0]) == over, (kind, x, r.limit)


def test_alarm_of_the_model_is_suppressed_by_one_of_the_plant_in_either_order_and_goes_with_it() -> None:
    for order in (("plant", "model"), ("model", "plant")):
        book = AlarmBook({"hx": frozenset()})
        for i, kind in enumerate(order):
            book.ring(i + 1, [Ring("hx", f"hx/T:{kind}", None, 0, {}, kind)])
        plant, model = book.of("hx"), book.of("hx", "model")
        assert plant is not None
        assert model is not None
        assert (plant.state, model.state) == (AlarmState.RAISED, AlarmState.SUPPRESSED)
        cleared = book.command(Command(plant.key, "clear", "anna", 5), 5)
        assert [a.state for a in cleared] == [AlarmState.CLEARED, AlarmState.CLEARED]
        assert book.open == ()


def test_alarm_of_a_model_explains_nobody_elses() -> None:
    book = AlarmBook({"hx": frozenset(), "radiator": frozenset()}, {"radiator": frozenset({"hx"})})
    book.ring(1, [Ring("hx", "hx/T:autocorrelation", None, 0, {}, "model")])
    book.ring(2, [Ring("radiator", "r/T:cusum", "T", 0, {})])
    assert {a.state for a in book.open} == {AlarmState.RAISED}


def test_state_survives_with_both_kinds_of_alarm(long: Truth, known: dict[str, Baseline]) -> None:
    e = run(with_south(long, coloured(long, (LEARNING + 2) * DAY)), known)
    again = Engine(plan(), known)
    again.restore_state(decode(encode(e.export_state())))
    assert again.alarms.open == e.alarms.open
    assert len(e.alarms.open) == 1
