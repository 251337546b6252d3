"""Frozen readings: the limit from the baseline's own runs, and what is no freeze."""

import numpy as np
import pytest

from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.flatline import LEAST, Flatline, flat_runs


def say(chart, values):
    return np.array([[v.phase[0], v.statistic[0], v.onset_age[0]] for v in (chart.update([x]) for x in values)])


def repeating(rng, n, repeat, hold=0.0):
    """A reading stays with this probability; with chance ``hold`` a gateway repeats it ten to twenty times."""
    x = rng.standard_normal(n)
    t = 1
    while t < n:
        if rng.random() < hold:
            stop = min(n, t + int(rng.integers(10, 21)))
            x[t:stop] = x[t - 1]
            t = stop
        else:
            if rng.random() < repeat:
                x[t] = x[t - 1]
            t += 1
    return x


def test_runs_are_counted_by_hand():
    found = flat_runs([0.0, 2.0, 2.0, 2.0, 5.0, 5.0, np.nan, 5.0, 3.0, 1.0, 1.0, 9.0])
    # Runs inside the range 0 to 9: 2 (two more), 5 (two more, over the gap), 3 (none), 1 (one more).
    assert (found.runs, found.longest, found.readings) == (4, 2, 9)
    assert (found.low, found.high) == (0.0, 9.0)
    assert flat_runs([4.0, 4.0, 4.0]) is None
    assert flat_runs([4.0]) is None


def realised(repeat, hold, limit_of):
    """Runs beyond the limits of 40 baselines in fresh data of the same kind, and how many were promised."""
    rng, arl, length = np.random.default_rng(3), 4000.0, 20_000
    alarms = 0
    for _ in range(40):
        limit = limit_of(flat_runs(repeating(rng, 4000, repeat, hold)), arl)
        changes = np.flatnonzero(np.diff(repeating(rng, length, repeat, hold)) != 0)
        alarms += int((np.diff(changes) - 1 >= limit).sum())
    return alarms, 40 * length / arl


@pytest.mark.parametrize("repeat", [0.5, 0.9])
def test_limit_by_chance_keeps_the_promise_on_other_data(repeat):
    alarms, promised = realised(repeat, 0.0, lambda found, arl: found.by_chance(arl))
    assert alarms < promised + 4 * np.sqrt(promised)
    assert alarms > 0.2 * promised  # whole readings, and a baseline's error: rarer, but not blind


def test_what_a_limit_costs_is_what_it_was_chosen_for_and_nothing_where_readings_have_noise_in_every_digit():
    rng = np.random.default_rng(7)
    for repeat in (0.5, 0.9):
        found = flat_runs(repeating(rng, 4000, repeat))
        for arl in (1e4, 1e6):
            m = found.by_chance(arl)
            assert found.rate(m) * arl <= 1.0 < found.rate(m - 1) * arl
    noisy = flat_runs(rng.standard_normal(6000))
    assert 1e9 * noisy.rate(noisy.limit(1e9)) < 1e-9


def test_signal_that_a_gateway_sometimes_holds_is_covered_by_its_longest_run():
    alarms, promised = realised(0.2, 0.002, lambda found, arl: found.limit(arl))
    assert alarms < promised + 4 * np.sqrt(promised)


def test_limit_is_never_below_twice_the_longest_run_and_the_least():
    rng = np.random.default_rng(4)
    noisy = flat_runs(rng.standard_normal(6000))
    assert noisy.limit(1e7) == LEAST - 0.5
    held = rng.standard_normal(6000)
    held[1000:1015] = held[1000]
    assert flat_runs(held).limit(1e4) >= 2 * 14 - 0.5


def test_frozen_reading_is_found_and_dated():
    rng = np.random.default_rng(5)
    chart = Flatline.of([1e7], [flat_runs(rng.standard_normal(6000))])
    said = say(chart, [*rng.standard_normal(100), *np.full(20, 0.3)])
    first = int(np.argmax(said[:, 0] == Phase.ALARM))
    assert 100 + LEAST <= first <= 100 + LEAST + 1
    assert first - said[first, 2] == pytest.approx(100, abs=1)


def test_reading_at_the_end_of_its_range_rests_and_is_not_frozen():
    night_and_day = np.tile(np.concatenate([np.zeros(100), np.random.default_rng(6).uniform(1, 900, 100)]), 20)
    found = flat_runs(night_and_day)
    chart = Flatline.of([1e6], [found])
    assert set(say(chart, np.zeros(2000))[:, 0]) == {float(Phase.NO_DATA)}
    assert say(chart, np.full(50, 333.0))[-1, 0] == Phase.ALARM


def test_probability_outside_its_range_is_refused():
    with pytest.raises(ValueError, match=r"give a probability in \[0, 1\)"):
        Flatline.design([1000.0], repeat=1.0)
