"""Scores of cases small enough to be counted by hand."""

from __future__ import annotations

import pytest
from statsmodels.stats.proportion import proportion_confint

from fdd.diagnosis.score import Label, Standing, score, standing, wilson
from fdd.evidence import Cause, Message
from fdd.records import NANOSECONDS, Alarm, AlarmState

DAY = 86400 * NANOSECONDS
DAYS = [(k * DAY, (k + 1) * DAY) for k in range(10)]


def at(days: float) -> int:
    return round(days * DAY)


def stood(component: str, start: float, end: float, *named: tuple[float, str]) -> Standing:
    return Standing(component, at(start), at(end), tuple((at(t), name) for t, name in named))


def change(time: float, state: AlarmState, cause: str = "fouling", key: str = "hx@1") -> Alarm:
    causes = (Cause(cause, Message("declared")),) if cause else ()
    return Alarm(key, "hx", state, at(time), at(time), at(time), (), causes=causes)


@pytest.mark.parametrize(("count", "of"), [(0, 7), (1, 7), (8, 10), (10, 10), (37, 480)])
def test_wilson_agrees_with_statsmodels(count: int, of: int) -> None:
    assert wilson(count, of) == pytest.approx(proportion_confint(count, of, method="wilson"), abs=1e-12)


def test_wilson_of_nothing_says_nothing() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="no share"):
        wilson(3, 2)


def test_days_of_a_fault_found_on_its_third_day() -> None:
    # hx: days 0-3 healthy, 4-7 faulty (alarm from 6.5), 8-9 healthy but the alarm stands to 8.2; pump: one false day.
    labels = [Label("hx", "fouling", at(4), at(8), 0.2)]
    alarms = [stood("pump", 2.1, 2.9, (2.1, "wear")), stood("hx", 6.5, 8.2, (6.5, "bias"), (7.1, "fouling"))]
    days = score(labels, alarms, ["hx", "pump"], DAYS).days
    assert (days.true_positive, days.false_negative, days.false_positive, days.true_negative) == (2, 2, 2, 14)
    assert (days.wrong, days.correct, days.undiagnosed) == (1, 1, 0)
    assert days.rates["true positive"].value == pytest.approx(0.5)
    assert days.rates["false positive"].value == pytest.approx(2 / 16)


def test_settling_after_a_fault_is_not_counted() -> None:
    labels = [Label("hx", "fouling", at(4), at(8), 0.2)]
    days = score(labels, [stood("hx", 6.5, 9.5, (6.5, "fouling"))], ["hx"], DAYS, settle=at(1)).days
    assert (days.true_positive, days.false_negative, days.false_positive, days.true_negative) == (2, 2, 1, 4)


def test_cases_found_missed_masked_and_wrongly_named() -> None:
    labels = [
        Label("hx", "fouling", at(1), at(3), 0.1),
        Label("hx", "fouling", at(5), at(6), 0.1),
        Label("hx", "bias", at(8), at(9), 0.2),
        Label("pump", "wear", at(2), at(4), 0.3),
    ]
    alarms = [
        stood("hx", 2.5, 4.0, (2.5, ""), (2.6, "fouling")),
        stood("hx", 7.5, 9.5, (7.5, "fouling")),
        stood("pump", 2.25, 3.0, (2.25, "cavitation")),
    ]
    found = score(labels, alarms, ["hx", "pump"], DAYS)
    assert [c.outcome for c in found.cases] == ["found", "missed", "masked", "found"]
    assert found.cases[0].delay == pytest.approx(1.5 * 86400)
    assert (found.cases[0].diagnosis, found.cases[3].diagnosis) == ("correct", "wrong")
    assert [a.start for a in found.false] == [at(7.5)]
    overall = found.overall
    assert (overall.found.count, overall.found.of, overall.correct.count, overall.masked) == (2, 3, 1, 1)
    assert overall.delay == pytest.approx(1.5 * 86400)
    small = found.by_severity()[("fouling", 0.1)]
    assert (small.found.count, small.found.of) == (1, 2)
    assert small.delay is None


def test_false_alarm_rate_counts_healthy_plant_years() -> None:
    # 20 component-days, 4 of them faulty: 16 healthy ones of 2 components are 8 plant-days.
    labels = [Label("hx", "fouling", at(4), at(8))]
    rate = score(labels, [stood("pump", 2.1, 2.9)], ["hx", "pump"], DAYS).false_alarms
    assert rate.count == 1
    assert rate.value == pytest.approx(365.25 / 8)
    low, high = rate.interval
    assert low == pytest.approx(0.0253178 * 365.25 / 8, rel=1e-4)  # Garwood's limits for one event
    assert high == pytest.approx(5.5716434 * 365.25 / 8, rel=1e-4)


def test_label_of_what_is_not_watched_is_missed() -> None:
    found = score([Label("chiller", "leak", at(1), at(2))], [], ["hx"], DAYS)
    assert found.cases[0].outcome == "missed"
    assert found.days.true_negative == 10


def test_standing_ends_when_the_evidence_is_gone_and_begins_again_when_it_is_back() -> None:
    changes = [
        change(1, AlarmState.RAISED, ""),
        change(2, AlarmState.ACKNOWLEDGED),
        change(3, AlarmState.RETURNED),
        change(5, AlarmState.RAISED, "bias"),
    ]
    first, second = standing(changes, at(9))
    assert (first.start, first.end) == (at(1), at(3))
    assert first.cause_before(at(2)) is None
    assert first.cause_before(at(2.5)) == "fouling"
    assert (second.start, second.end, second.cause_before(at(9))) == (at(5), at(9), "bias")


def test_suppressed_alarm_does_not_stand() -> None:
    changes = [change(1, AlarmState.SUPPRESSED), change(4, AlarmState.RAISED)]
    assert [(s.start, s.end) for s in standing(changes, at(6))] == [(at(4), at(6))]


def test_label_that_ends_before_it_starts_is_refused() -> None:
    with pytest.raises(ValueError, match="not after its start"):
        score([Label("hx", "fouling", at(2), at(2))], [], ["hx"], DAYS)


def test_a_day_without_data_is_no_sample() -> None:
    """An alarm that stands through a week of silence is one false day, not eight."""
    alarm = stood("hx", 2.5, 9.5, (2.5, "fouling"))
    every = score([], [alarm], ["hx"], DAYS).days
    there = score([], [alarm], ["hx"], DAYS, seen=lambda component, start, end: start < at(3)).days
    assert every.false_positive == 8
    assert (there.false_positive, there.true_negative) == (1, 2)
