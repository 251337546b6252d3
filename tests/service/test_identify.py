"""What a baseline says of its innovations' spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import whole_engine
from fdd.records import NANOSECONDS
from fdd.service.baselines.history import read_history, runs
from fdd.service.baselines.identify import honest_spread, identify
from tests.service.conftest import Truth, plan, simulate

WEEK = 2016


def test_spread_of_white_innovations_is_not_widened_by_chance() -> None:
    """The largest of three unbiased estimates is 1.3 % too large from a week: a fifth of a CUSUM's false alarms."""
    rng = np.random.default_rng(1)
    found = [honest_spread(rng.standard_normal(WEEK)) for _ in range(300)]
    # Three standard errors of the mean, whose standard deviation from a week is 1.6 to 1.9 %.
    assert np.mean(found) == pytest.approx(1.0, abs=3 * 0.019 / np.sqrt(len(found)))


def test_spread_is_that_of_the_bad_hours_and_of_the_shoulders() -> None:
    rng = np.random.default_rng(2)
    bad = np.repeat(np.where(rng.random(80) < 0.3, 1.5, 1.0), 100)
    values = bad * rng.standard_normal(bad.size)
    assert values.std() < 1.25
    assert 1.3 < honest_spread(values) < 1.6
    uniform = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), 4 * WEEK)
    assert honest_spread(uniform) == pytest.approx(np.sqrt(3.0) / 1.349, rel=0.03)


def test_outputs_beside_a_guessed_input_count_as_missing() -> None:
    truth = simulate(3 * 288, seed=8)
    heat, lost = truth.points["south.heat"].copy(), np.array([40, 41, 300])
    heat[lost] = np.nan
    p = plan()
    history, _ = read_history(p, [Truth(truth.time, {**truth.points, "south.heat": heat}).batch()])
    (run,) = runs(p, p.components[0], history)
    gone = truth.time[[40, 41, 42, 300, 301]]  # with the steps over them; the second of two is not bridged at all
    np.testing.assert_array_equal(run.time[np.isnan(run.y).any(axis=1)], np.intersect1d(gone, run.time))
    held = replace(p, hold=3600 * NANOSECONDS)  # whoever holds values says that they are as good as seen
    history, _ = read_history(held, [Truth(truth.time, {**truth.points, "south.heat": heat}).batch()])
    assert np.isfinite(runs(held, p.components[0], history)[0].y).all()


def test_flows_that_jump_while_they_are_lost_are_not_taken_for_sensor_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """A heat exchanger's outlets follow its flows at once: bridged ones made noise up to three times too large."""
    noise = {}
    for share in (0.0, 0.02):
        monkeypatch.setattr(whole_engine, "LOST", share)
        fleet = whole_engine.simulated(1, 28.0, seed=5)
        exchanger = next(c for c in fleet.plan.components if c.name == "hx")
        fitted, _ = identify(fleet.plan, exchanger, fleet.history(0))
        noise[share] = np.array([fitted.parameters[s] for s in ("noise_hot", "noise_cold")])
    # Standard errors of the noise are 0.8 %; from samples that are partly others.
    np.testing.assert_allclose(noise[0.02], noise[0.0], rtol=0.04)
