"""What every chart promises, checked for each of the folder."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chart_harness import KINDS, OPTIONS, build, draw, fault, push, run
from numpy.random import default_rng

from benchmarks import chart_kinds
from fdd.residual_monitors.chart import Chart, Phase, StateError

every_chart = pytest.mark.parametrize("kind", KINDS)
WEEK = 7 * 288
ROOT = Path(__file__).resolve().parents[3]


def assert_finite(chart: Chart) -> None:
    for name, value in chart.export_state().items():
        if isinstance(value, np.ndarray):
            assert np.all(np.isfinite(value)), name


def test_every_chart_of_the_folder_is_one_that_the_engine_runs() -> None:
    """Nothing stands in the folder that no family of the service feeds."""
    assert set(KINDS) == {"autocorrelation", "cusum", "daily", "dispersion", "flatline", "periodogram", "score"}
    with pytest.raises(ValueError, match=r"there is no chart 'cosum'; there are .*cusum"):
        chart_kinds.make("cosum", [100.0])


@every_chart
def test_false_alarms_come_at_the_designed_rate(kind: str) -> None:
    assert_rate(kind, missing=0.0)


@every_chart
def test_false_alarms_come_at_the_designed_rate_with_missing_values(kind: str) -> None:
    assert_rate(kind, missing=0.3)


@every_chart
@pytest.mark.slow
def test_false_alarms_come_at_the_designed_rate_where_budgets_live(kind: str) -> None:
    """A chart of three months between false alarms at 5 min, with the settings it ships with."""
    units = 700 if kind == "flatline" else 500  # readings that rest are not judged: more of them for as many alarms
    assert_rate(kind, missing=0.1, units=units, arl=26_000.0, steps=52_000, options={})


def assert_rate(
    kind: str,
    missing: float,
    units: int = 600,
    arl: float = 1000.0,
    steps: int = 2000,
    options: dict[str, Any] | None = None,
) -> None:
    """First alarms over time seen, against the design; a run length is geometric but for its first updates."""
    rng = default_rng(7)
    chart = build(kind, units, arl, options)
    alive = np.ones(chart.n, dtype=bool)
    seen, alarms = 0.0, 0
    for _ in range(steps):
        x = draw(rng, kind, 1, units)[0]
        gone = rng.uniform(size=units) < missing
        x[gone] = np.nan
        there = np.repeat(~gone, chart.n // units)
        alarm = push(chart, x).phase == Phase.ALARM
        seen += np.count_nonzero(alive & there)
        alarms += np.count_nonzero(alive & alarm)
        alive &= ~alarm
    assert alarms > 400  # enough for the error below to be small
    # Four standard errors, and 4 % for the opening, in which no alarm can come yet.
    assert alarms / seen * arl == pytest.approx(1.0, abs=4 / np.sqrt(alarms) + 0.04)


@every_chart
def test_standing_fault_stays_alarmed_for_weeks(kind: str) -> None:
    rng, units = default_rng(8), 3
    chart = build(kind, units)
    said = run(chart, fault(rng, kind, 3 * WEEK, units))
    phase = said[:, 0]
    first = [int(np.argmax(p == Phase.ALARM)) for p in phase.T]
    assert np.all(phase[-1] == Phase.ALARM)
    assert max(first) < 300
    for stream, at in enumerate(first):
        assert np.all(phase[at:, stream] == Phase.ALARM)
        age = said[at:, 4, stream]
        np.testing.assert_array_equal(np.diff(age), 1)  # the onset is dated once
        assert np.unique(said[at:, 3, stream]).size == 1
    assert_finite(chart)


@every_chart
def test_alarm_stands_when_the_fault_has_gone_and_through_gaps(kind: str) -> None:
    rng, units = default_rng(9), 2
    chart = build(kind, units)
    run(chart, fault(rng, kind, 600, units))
    after = run(chart, draw(rng, kind, 1500, units))
    gap = run(chart, np.full_like(draw(rng, kind, 50, units), np.nan))
    assert np.all(after[:, 0] == Phase.ALARM)
    assert np.all(gap[:, 0] == Phase.ALARM)
    # What raised it can be seen to have gone: the statistic is back below the limit.
    assert np.mean(after[500:, 1] < after[500:, 2]) > 0.95


@every_chart
def test_reset_clears_the_streams_it_names_and_no_other(kind: str) -> None:
    rng, units = default_rng(10), 4
    chart = build(kind, units, 1e6)
    run(chart, fault(rng, kind, 600, units))
    which = np.zeros(chart.n, dtype=bool)
    which[: chart.n // units] = True
    chart.reset(which)
    phase = run(chart, draw(rng, kind, 100, units))[:, 0]
    assert not np.any(phase[:, which] == Phase.ALARM)
    assert np.all(phase[:, ~which] == Phase.ALARM)
    with pytest.raises(ValueError, match="mask of shape"):
        chart.reset(np.ones(chart.n + 1, dtype=bool))
    chart.reset(relearn=True)
    assert not np.any(run(chart, draw(rng, kind, 5, units))[:, 0] == Phase.ALARM)


@every_chart
def test_reset_chart_is_as_new(kind: str) -> None:
    rng, units = default_rng(11), 3
    used, new = build(kind, units), build(kind, units)
    run(used, fault(rng, kind, 333, units))
    used.reset(relearn=True)
    values = draw(rng, kind, 400, units)
    np.testing.assert_array_equal(run(used, values), run(new, values))


@every_chart
def test_nothing_seen_is_no_data_and_never_silences(kind: str) -> None:
    rng, units = default_rng(12), 3
    chart = build(kind, units)
    nothing = np.full_like(draw(rng, kind, 500, units), np.nan)
    assert np.all(run(chart, nothing)[:, 0] == Phase.NO_DATA)
    run(chart, draw(rng, kind, 200, units))
    before = run(chart, draw(rng, kind, 1, units))[0]
    held = run(chart, nothing)
    np.testing.assert_array_equal(held[:, 1], np.tile(before[1], (500, 1)))
    assert np.all(run(chart, fault(rng, kind, 600, units))[-1, 0] == Phase.ALARM)


@every_chart
def test_quiet_or_learning_while_all_is_well(kind: str) -> None:
    rng, units = default_rng(13), 3
    said = run(build(kind, units, 1e6), draw(rng, kind, 500, units))
    assert set(np.unique(said[:, 0])) <= {float(Phase.QUIET), float(Phase.LEARNING)}
    assert np.all(said[-1, 0] == Phase.QUIET)
    assert np.all(said[:, 1] <= said[:, 2])


@every_chart
def test_constant_and_saturated_values_leave_a_sound_chart(kind: str) -> None:
    rng, units = default_rng(14), 2
    chart = build(kind, units)
    for value in (0.0, 1e300, -1e300, np.inf, -np.inf):
        run(chart, np.full_like(draw(rng, kind, 150, units), value))
        assert_finite(chart)
    chart.reset()
    assert np.all(run(chart, fault(rng, kind, 600, units))[-1, 0] == Phase.ALARM)


@every_chart
def test_stuck_at_zero_is_no_alarm_but_to_the_charts_of_spread_and_stillness(kind: str) -> None:
    chart = build(kind, 2)
    said = run(chart, np.zeros_like(draw(default_rng(0), kind, 500, 2)))
    assert np.all((said[-1, 0] == Phase.ALARM) == (kind in ("dispersion", "flatline")))


@every_chart
def test_restart_in_the_middle_changes_no_byte(kind: str) -> None:
    rng, units = default_rng(15), 5
    values = np.concatenate([draw(rng, kind, 333, units), fault(rng, kind, 334, units)])
    values[rng.uniform(size=values.shape[:2]) < 0.1] = np.nan
    whole = run(build(kind, units), values)
    for stop in (1, 100, 340, 500):
        first, second = build(kind, units), build(kind, units)
        before = run(first, values[:stop])
        second.restore_state(first.export_state())
        assert np.concatenate([before, run(second, values[stop:])]).tobytes() == whole.tobytes()


@every_chart
def test_state_survives_json(kind: str) -> None:
    rng, units = default_rng(16), 3
    values = draw(rng, kind, 300, units)
    first, second = build(kind, units), build(kind, units)
    run(first, values[:150])
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in first.export_state().items()}
    second.restore_state(json.loads(json.dumps(plain)))
    assert run(first, values[150:]).tobytes() == run(second, values[150:]).tobytes()


@every_chart
def test_exported_state_is_a_copy(kind: str) -> None:
    rng, units = default_rng(17), 2
    chart = build(kind, units)
    run(chart, draw(rng, kind, 50, units))
    state = chart.export_state()
    kept = {k: np.copy(v) for k, v in state.items()}
    run(chart, fault(rng, kind, 50, units))
    for name, value in kept.items():
        np.testing.assert_array_equal(state[name], value)


@every_chart
@pytest.mark.parametrize("change", [{"schema": 0}, {"kind": "?"}, {"n": 99}], ids=str)
def test_foreign_state_is_refused(kind: str, change: dict[str, Any]) -> None:
    chart = build(kind, 2)
    with pytest.raises(StateError, match=r"needs .*start the chart anew"):
        chart.restore_state({**chart.export_state(), **change})


@every_chart
def test_many_streams_say_what_each_says_alone(kind: str) -> None:
    rng, units = default_rng(18), 9
    values = np.concatenate([draw(rng, kind, 200, units), fault(rng, kind, 100, units)])
    values[rng.uniform(size=values.shape[:2]) < 0.1] = np.nan
    together = run(build(kind, units), values)
    per = together.shape[2] // units
    for unit in range(units):
        alone = run(build(kind, 1), values[:, unit : unit + 1])
        assert alone.tobytes() == np.ascontiguousarray(together[:, :, unit * per : (unit + 1) * per]).tobytes()


@every_chart
def test_verdicts_and_inputs_are_not_shared_with_the_chart(kind: str) -> None:
    rng, units = default_rng(19), 3
    chart, other = build(kind, units), build(kind, units)
    values = draw(rng, kind, 150, units)
    kept = values.copy()
    for x in values:
        said = push(chart, x)
        push(other, x.copy())
        for name in ("phase", "statistic", "direction", "onset_age"):
            getattr(said, name)[:] = 0
        with pytest.raises(ValueError, match="read-only"):
            said.limit[:] = 0
    np.testing.assert_array_equal(values, kept)
    more = draw(rng, kind, 100, units)
    np.testing.assert_array_equal(run(chart, more), run(other, more))


@every_chart
def test_streams_may_have_limits_of_their_own(kind: str) -> None:
    units = 2
    per = build(kind, units).n // units
    arl = np.repeat([500.0, 50_000.0], per)
    limits = chart_kinds.make(kind, arl, **OPTIONS.get(kind, {})).limit
    assert np.all(limits[:per] < limits[per:])


@every_chart
def test_chart_is_documented(kind: str) -> None:
    cls = chart_kinds.charts()[kind]
    text = inspect.getdoc(cls) or ""
    assert "Parameters" in text
    assert "``" in text  # names its siblings
    assert f"`{kind}`" in (ROOT / "docs" / "charts.md").read_text(), f"docs/charts.md does not speak of {kind}"


@every_chart
def test_machine_that_is_off_most_of_the_day_is_judged_while_it_is_on(kind: str) -> None:
    """Eight hours on, sixteen off: no alarm for nothing, no data while off, and a fault is still found."""
    rng, units = default_rng(20), 3
    chart = build(kind, units, 1e7)
    on = np.arange(12 * 288) % 288 < 96
    values = draw(rng, kind, len(on), units)
    values[~on] = np.nan
    phase = run(chart, values)[:, 0]
    assert not np.any(phase == Phase.ALARM)
    assert np.all(phase[~on] == Phase.NO_DATA)
    broken = fault(rng, kind, len(on), units)
    broken[~on] = np.nan
    said = run(chart, broken)
    assert np.all(said[-1, 0] == Phase.ALARM)
    first = np.argmax(said[:, 0] == Phase.ALARM, axis=0)
    assert np.all(on[first])
