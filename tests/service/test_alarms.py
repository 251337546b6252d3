"""The life of an alarm."""

from __future__ import annotations

import json

import pytest

from fdd.evidence import ChartEvidence, Entry
from fdd.records import NANOSECONDS, Alarm, AlarmState
from fdd.service.alarms.book import AlarmBook, AlarmError, Command, Ring

HOUR = 3600 * NANOSECONDS


def book() -> AlarmBook:
    return AlarmBook({"radiator": frozenset({"T_supply"}), "hx": frozenset({"T_return"}), "house": frozenset()})


def ring(
    component: str = "hx", chart: str = "hx/T_supply:cusum", point: str | None = "T_supply", since: int = 0
) -> Ring:
    return Ring(component, chart, point, since, ChartEvidence.read(chart, {"statistic": 9.0}))


def test_second_chart_of_a_component_joins_its_open_alarm() -> None:
    b = book()
    b.ring(HOUR, [ring()])
    (alarm,) = b.ring(2 * HOUR, [ring(chart="hx/T_hot_out:cusum", point="T_hot_out")])
    assert len(b.open) == 1
    assert alarm.charts == ("hx/T_supply:cusum", "hx/T_hot_out:cusum")
    assert alarm.raised == HOUR


def test_alarm_that_reads_a_suspect_measurement_is_suppressed_in_either_order() -> None:
    for order in (["hx", "radiator"], ["radiator", "hx"]):
        b = book()
        for i, name in enumerate(order):
            point = "T_supply" if name == "hx" else "T_radiator"
            b.ring((i + 1) * HOUR, [ring(name, f"{name}:cusum", point)])
        states = {a.component: a.state for a in b.open}
        assert states == {"hx": AlarmState.RAISED, "radiator": AlarmState.SUPPRESSED}


def test_clearing_the_cause_raises_the_consequence_again() -> None:
    b = book()
    b.ring(HOUR, [ring("hx"), ring("radiator", "r:cusum", "T_radiator")])
    cause = b.of("hx")
    assert cause is not None
    cleared, released = b.command(Command(cause.key, "clear", "anna", HOUR), 2 * HOUR)
    assert cleared.state is AlarmState.CLEARED
    assert (released.component, released.state) == ("radiator", AlarmState.RAISED)


def test_shelving_ends_by_itself() -> None:
    b = book()
    (alarm,) = b.ring(HOUR, [ring()])
    b.command(Command(alarm.key, "shelve", "anna", HOUR, "waiting for parts", until=5 * HOUR), HOUR)
    assert b.review(4 * HOUR, []) == []
    assert [a.state for a in b.review(5 * HOUR, [])] == [AlarmState.RAISED]


def test_shelving_counts_from_the_event_time_at_which_it_is_carried_out() -> None:
    b = book()
    (alarm,) = b.ring(HOUR, [ring()])
    (shelved,) = b.command(Command(alarm.key, "shelve", "anna", 0, span=7200.0), 10 * HOUR)
    assert shelved.evidence.shelved_until == 12 * HOUR
    for wrong in ({}, {"until": 9 * HOUR}, {"span": -1.0}):
        with pytest.raises(AlarmError, match="needs an end after"):
            b.command(Command(alarm.key, "shelve", "anna", 0, **wrong), 10 * HOUR)


def test_alarm_rings_again_after_it_returned_to_normal() -> None:
    b = book()
    b.ring(HOUR, [ring()])
    assert b.review(2 * HOUR, ["hx"])[0].state is AlarmState.RETURNED
    assert b.ring(3 * HOUR, [ring()])[0].state is AlarmState.RAISED


def test_history_names_who_did_what_when() -> None:
    b = book()
    (alarm,) = b.ring(HOUR, [ring()])
    (acknowledged,) = b.command(Command(alarm.key, "acknowledge", "anna", HOUR, "on my way"), HOUR)
    entry = acknowledged.history[-1]
    assert entry == Entry(HOUR, "acknowledged", "anna", "on my way")


def test_impossible_actions_name_the_alarm_and_the_state() -> None:
    b = book()
    (alarm,) = b.ring(HOUR, [ring()])
    b.command(Command(alarm.key, "acknowledge", "anna", HOUR), HOUR)
    with pytest.raises(AlarmError, match="is acknowledged; it cannot be acknowledged, but shelved, cleared"):
        b.command(Command(alarm.key, "acknowledge", "anna", HOUR), HOUR)
    with pytest.raises(AlarmError, match="open alarms: hx@"):
        b.command(Command("hx@never", "clear", "anna", HOUR), HOUR)


def test_alarm_survives_as_a_document() -> None:
    b = book()
    (alarm,) = b.ring(HOUR, [ring()])
    assert Alarm.read(json.loads(json.dumps(alarm.document()))) == alarm
