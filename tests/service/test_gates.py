"""Each gate by itself: what it lets pass, what it stops, at which number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from statsmodels.stats.diagnostic import acorr_ljungbox

from fdd.diagnosis import gates as g
from fdd.diagnosis.gates import MONTH, Estimate, Gate, Outcome, Policy

POLICY = Policy()
SYMBOLS = ("R", "C")


def estimate(months: float, r: float, error: float = 0.005, *, vouched: bool = False) -> Estimate:
    return Estimate(f"at {months}", np.array([np.log(r), 0.0]), np.array([error, error]), int(months * MONTH), vouched)


def test_ljung_box_agrees_with_statsmodels_and_forgives_gaps() -> None:
    z = np.random.default_rng(3).standard_normal(500)
    z[1:] += 0.3 * z[:-1]
    expected = float(acorr_ljungbox(z, lags=[20])["lb_stat"].iloc[0])
    assert g.ljung_box(z, 20)[0] == pytest.approx(expected, rel=1e-10)
    gaps = z.copy()
    gaps[::50] = np.nan
    assert g.ljung_box(gaps, 20)[1] == 490
    assert g.ljung_box(gaps, 20)[0] == pytest.approx(expected, rel=0.3)


def test_slow_ageing_passes_and_the_same_change_at_once_does_not() -> None:
    start = estimate(0, 1.0, vouched=True)
    assert g.no_fault(SYMBOLS, estimate(3, 1.10), [start], POLICY).passed
    stopped = g.no_fault(SYMBOLS, estimate(0.5, 1.10), [start], POLICY)
    assert not stopped.passed
    assert "R +9.5%" in stopped.remark


def test_daily_steps_that_are_each_within_their_error_are_seen_from_the_month_before() -> None:
    months = np.arange(0, 2.5, 1 / 30)
    line = [estimate(float(m), float(np.exp(0.10 * m)), 0.01, vouched=m == 0) for m in months]
    assert g.no_fault(SYMBOLS, line[1], line[:1], POLICY).passed
    verdicts = [g.no_fault(SYMBOLS, new, line[:i], POLICY).passed for i, new in enumerate(line) if i]
    first = verdicts.index(False) / 30
    assert 0.3 < first < 0.8
    assert not any(verdicts[verdicts.index(False) :])


def test_what_a_person_vouched_for_holds_change_to_its_most() -> None:
    line = [estimate(0, 1.0, vouched=True), estimate(6, 1.17), estimate(12, 1.20)]
    assert g.no_fault(SYMBOLS, estimate(13, 1.21), line, POLICY).passed
    assert not g.no_fault(SYMBOLS, estimate(13, 1.24), line, POLICY).passed


def test_a_suspicion_does_not_age_into_health() -> None:
    start, later = estimate(0, 1.0, vouched=True), estimate(3, 1.10)
    assert g.no_fault(SYMBOLS, later, [start], POLICY).passed
    assert not g.no_fault(SYMBOLS, later, [start], POLICY, suspected=True).passed
    assert g.no_fault(SYMBOLS, estimate(3, 1.01), [start], POLICY, suspected=True).passed


def test_a_vague_change_is_chance_and_an_open_parameter_says_nothing() -> None:
    start = estimate(0, 1.0, vouched=True)
    assert g.no_fault(SYMBOLS, estimate(0.1, 1.10, 0.04), [start], POLICY).passed
    open_ = replace(estimate(0.1, 2.0), error=np.array([np.nan, 0.01]))
    assert g.no_fault(SYMBOLS, open_, [start], POLICY).passed


def test_a_step_inside_the_window_is_not_steady() -> None:
    assert g.steady(SYMBOLS, [(estimate(0, 1.0), estimate(0.5, 1.02))], POLICY).passed
    assert not g.steady(SYMBOLS, [(estimate(0, 1.0), estimate(0.5, 1.08))], POLICY).passed


def test_a_lost_or_much_vaguer_parameter_is_not_identifiable() -> None:
    old = estimate(0, 1.0, 0.02)
    assert g.identifiable(SYMBOLS, estimate(1, 1.0, 0.039), old, POLICY).passed
    assert not g.identifiable(SYMBOLS, estimate(1, 1.0, 0.041), old, POLICY).passed
    lost = replace(old, error=np.array([0.02, np.nan]))
    assert "C" in g.identifiable(SYMBOLS, lost, old, POLICY).remark
    assert not g.identifiable(SYMBOLS, lost, old, POLICY).passed


def test_bounds_stop_what_lies_on_one() -> None:
    low, high = np.array([0.0, 1.0]), np.array([2.0, 1.0])
    assert g.inside(SYMBOLS, np.array([1.0, 1.0]), low, high).passed
    assert not g.inside(SYMBOLS, np.array([2.0, 1.0]), low, high).passed


def test_whiteness_is_asked_relative_to_the_baseline_in_force() -> None:
    rng = np.random.default_rng(5)
    plain = rng.standard_normal((2000, 1))
    coloured = plain.copy()
    coloured[1:] += 0.4 * plain[:-1]
    assert g.white(("T",), plain, plain, POLICY).passed
    assert not g.white(("T",), coloured, plain, POLICY).passed
    assert g.white(("T",), coloured, coloured, POLICY).passed


def test_better_wants_evidence_on_most_days() -> None:
    assert g.better(np.array([2.0, 1.0, 1.0]), POLICY).passed
    assert not g.better(np.array([1.0, 0.5, 0.5]), POLICY).passed
    assert not g.better(np.array([30.0, -1.0, -1.0]), POLICY).passed
    assert not g.better(np.array([]), POLICY).passed


@pytest.mark.parametrize(
    ("failed", "outcome"),
    [
        ((), Outcome.ACCEPTED),
        (("better",), Outcome.REFUSED),
        (("no fault",), Outcome.SUSPECTED),
        (("better", "steady"), Outcome.SUSPECTED),
        (("converged", "no fault"), Outcome.REFUSED),
    ],
)
def test_a_fault_is_suspected_only_where_the_fit_can_be_believed(failed: tuple[str, ...], outcome: Outcome) -> None:
    names = ("converged", "identifiable", "bounds", "white", "better", "steady", "no fault")
    assert g.decide([Gate(n, n not in failed, 0.0, 0.0, "") for n in names]) is outcome
