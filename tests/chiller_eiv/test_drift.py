"""Weekly charts: quiet while healthy, the right parameter when not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fdd.chiller_eiv.drift import WEEK, DriftMonitor, DriftOptions, DriftVerdict, fit_baseline, isolate, limit_of
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.simulate import LAB_CHILLER, LAB_SIGMA, healthy, operate

COV = np.diag((2 * LAB_SIGMA) ** 2)
HOURS = 168


def monitor_and_weeks(seed: int, weeks: int, fault=healthy, base: int = 52):  # type: ignore[no-untyped-def]
    o = operate(7 * (base + weeks), seed, noise=2.0, fault=fault, first_day=seed * 37 % 365)
    week = np.arange(len(o.x)) // HOURS
    b = fit_baseline(o.x[week < base], COV, week[week < base], {"Q_leak": LAB_CHILLER.Q_leak})
    return DriftMonitor(b), [o.x[week == w] for w in range(base, base + weeks)]


def run(monitor: DriftMonitor, weeks: list[np.ndarray]) -> list[DriftVerdict]:
    return [monitor.update((i + 1) * WEEK, x, COV) for i, x in enumerate(weeks)]


def fault(day: np.ndarray, kind: str = "R") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    one, on = np.ones_like(day), (day >= 364).astype(float)
    if kind == "R":
        return one, 1 + 0.15 * on, 0 * one
    return (1 + 0.1 * on, one, 0 * one) if kind == "dS" else (one, one, 1500 * on)


def test_ten_healthy_years_ring_at_most_a_few_times() -> None:
    # The wanted rate is 0.15 a year; eight alarms in ten years would have a probability below 1e-4.
    alarms = sum(run(*monitor_and_weeks(seed, 52))[-1].alarm for seed in range(10))
    assert alarms <= 5


@pytest.mark.parametrize(("kind", "parameter"), [("R", "R"), ("dS", "dS"), ("leak", "dS")])
def test_a_fault_is_found_and_named(kind: str, parameter: str) -> None:
    verdicts = run(*monitor_and_weeks(3, 14, partial(fault, kind=kind)))
    assert verdicts[-1].alarm
    isolation = verdicts[-1].isolation
    assert isolation is not None
    assert isolation.parameter == parameter
    assert isolation.probability > 0.9
    first = next(i for i, v in enumerate(verdicts) if v.alarm)
    assert first <= 8


def test_the_size_of_a_resistance_fault_is_told_with_its_interval() -> None:
    verdicts = run(*monitor_and_weeks(4, 12, fault))
    i = verdicts[-1].isolation
    assert i is not None
    assert i.low < 0.15 < i.high
    assert i.high - i.low < 0.1
    assert verdicts[-1].onset is not None
    assert abs(verdicts[-1].onset) <= 4 * WEEK


def test_an_alarm_stands_until_reset() -> None:
    monitor, weeks = monitor_and_weeks(5, 12, fault)
    assert run(monitor, weeks)[-1].alarm
    empty = monitor.update(20 * WEEK, np.zeros((0, 4)), COV)
    assert empty.alarm
    assert np.isnan(empty.z).all()
    monitor.reset()
    assert not monitor.update(21 * WEEK, np.zeros((0, 4)), COV).alarm


def test_state_restores_to_the_same_verdicts() -> None:
    monitor, weeks = monitor_and_weeks(6, 12, fault)
    run(monitor, weeks[:6])
    state = monitor.export_state()
    other = DriftMonitor(monitor.baseline)
    other.restore_state(state)
    for i, x in enumerate(weeks[6:]):
        a, b = monitor.update((7 + i) * WEEK, x, COV), other.update((7 + i) * WEEK, x, COV)
        np.testing.assert_array_equal(a.statistic, b.statistic)
        assert a.isolation == b.isolation


def test_a_short_baseline_widens_the_limit_and_a_shorter_one_is_refused() -> None:
    o = DriftOptions()
    assert limit_of(o, 2, 12) > limit_of(o, 2, 26) > limit_of(o, 2, 52) > 5
    x = operate(28, 1).x
    with pytest.raises(ChillerError, match="8 are needed"):
        fit_baseline(x, COV, np.arange(len(x)) // HOURS, {"Q_leak": 2723.0})


def test_isolation_takes_the_single_change_that_fits() -> None:
    monitor, _ = monitor_and_weeks(7, 1)
    b = monitor.baseline
    d = 0.02 * b.estimate
    cov = np.outer(d, d) * np.array([[1.0, -0.6], [-0.6, 1.0]])
    i = isolate(b, np.array([0.0, 0.2 * b.estimate[1]]), cov, 4)
    assert i.parameter == "R"
    assert i.change == pytest.approx(0.2)
    assert i.probability > 0.999


def test_isolation_allows_for_what_the_baseline_itself_does_not_know() -> None:
    """A baseline that knows a parameter worse widens the interval of its change by the root of the sum of variances."""
    verdicts, widths = {}, {}
    for factor in (1.0, 100.0):
        monitor, weeks = monitor_and_weeks(4, 12, fault)
        b = monitor.baseline
        known = replace(b, covariance=b.covariance * factor)
        i = run(DriftMonitor(known), weeks)[-1].isolation
        assert i is not None
        verdicts[factor], widths[factor] = i, i.high - i.low
    assert widths[100.0] > 1.5 * widths[1.0]
