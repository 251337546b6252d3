"""The life of alarms against ISA-18.2: every state and event, flaps, consequences, and what is over."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from fdd.evidence import AlarmKind, ChartEvidence, ChartKind, Message
from fdd.records import NANOSECONDS, Alarm, AlarmState
from fdd.report.telling import Speaker
from fdd.service.alarms.book import ACTIONS, AlarmBook, AlarmError, Command, Ring
from fdd.service.alarms.life import FLAPPING, LIFE, QUIET, QUIET_MOST, Event

HOUR = 3600 * NANOSECONDS
GRACE = 24 * HOUR  # docs/alarms.md: an alarm explains others until its evidence has been gone for a day
R, A, H = AlarmState.RAISED, AlarmState.ACKNOWLEDGED, AlarmState.SHELVED
S, N, C = AlarmState.SUPPRESSED, AlarmState.RETURNED, AlarmState.CLEARED


CHART = "radiator/T_radiator:cusum"


class Plant:
    """A book of a cause ``hx`` and its consequence ``radiator``, and the frames that go by."""

    def __init__(self) -> None:
        self.book = AlarmBook({"radiator": frozenset({"T_supply"})}, {"house": frozenset({"radiator"})})
        self.time = 0

    def ring(self, component: str = "radiator", kind: str = "plant") -> list[Alarm]:
        self.time += HOUR
        point = "T_supply" if component == "hx" else f"T_{component}"
        return self.book.ring(
            self.time, [Ring(component, CHART, point, 0, ChartEvidence.read(CHART, {}), AlarmKind(kind))]
        )

    def frame(self, *quiet: str, after: int = HOUR) -> list[Alarm]:
        self.time += after
        return self.book.review(self.time, quiet)

    def say(self, action: str, component: str = "radiator", kind: str = "plant", **more: object) -> list[Alarm]:
        alarm = self.book.of(component if kind == "plant" else f"{component}:{kind}")
        assert alarm is not None
        command = Command(alarm.key, action, "anna", self.time, **more)  # type: ignore[arg-type]
        return self.book.command(command, self.time)

    def state(self, component: str = "radiator", kind: str = "plant") -> AlarmState | None:
        alarm = self.book.of(component if kind == "plant" else f"{component}:{kind}")
        return alarm.state if alarm else None


def raised() -> Plant:
    plant = Plant()
    plant.ring()
    return plant


def acknowledged() -> Plant:
    plant = raised()
    plant.say("acknowledge")
    return plant


def shelved() -> Plant:
    plant = raised()
    plant.say("shelve", span=3600.0)
    return plant


def suppressed() -> Plant:
    plant = raised()
    plant.ring("hx")
    return plant


def returned() -> Plant:
    plant = raised()
    plant.frame("radiator")
    return plant


def cleared() -> Plant:
    plant = raised()
    plant.say("clear")
    return plant


STATES: dict[AlarmState, Callable[[], Plant]] = {
    R: raised, A: acknowledged, H: shelved, S: suppressed, N: returned, C: cleared,
}  # fmt: skip
EVENTS: dict[str, Callable[[Plant], object]] = {
    "its chart rings": lambda p: p.ring(),
    "its evidence is gone": lambda p: p.frame("radiator", after=60 * NANOSECONDS),
    "its cause rings": lambda p: p.ring("hx"),
    "its cause is cleared": lambda p: p.say("clear", "hx"),
    "its cause is over": lambda p: (p.frame("hx"), p.frame("hx", after=GRACE)),
    "its shelving ends": lambda p: p.frame(after=2 * HOUR),
    "acknowledge": lambda p: p.say("acknowledge"),
    "shelve": lambda p: p.say("shelve", span=3600.0),
    "unshelve": lambda p: p.say("unshelve"),
    "clear": lambda p: p.say("clear"),
}
REFUSED = None
# ISA-18.2-2016, figure 5, with a latch: "returned to normal" is left by clearing. None: an operator is refused.
TABLE: dict[str, dict[AlarmState, AlarmState | None]] = {
    "its chart rings":      {R: R, A: A, H: H, S: S, N: R, C: R},
    "its evidence is gone": {R: N, A: N, H: H, S: S, N: N, C: C},
    "its cause rings":      {R: S, A: A, H: H, S: S, N: N, C: C},
    "its cause is cleared": {S: R},
    "its cause is over":    {S: R},
    "its shelving ends":    {R: R, A: A, H: R, S: S, N: N, C: C},
    "acknowledge":          {R: A, A: REFUSED, H: REFUSED, S: REFUSED, N: REFUSED, C: REFUSED},
    "shelve":               {R: H, A: H, H: H, S: H, N: H, C: REFUSED},
    "unshelve":             {R: REFUSED, A: REFUSED, H: R, S: REFUSED, N: REFUSED, C: REFUSED},
    "clear":                {R: C, A: C, H: C, S: C, N: C, C: REFUSED},
}  # fmt: skip
CASES = [(event, state, after) for event, row in TABLE.items() for state, after in row.items()]


@pytest.mark.parametrize(("event", "state", "after"), CASES, ids=lambda v: str(v))
def test_event_leads_from_state_to_state(event: str, state: AlarmState, after: AlarmState | None) -> None:
    plant = STATES[state]()
    alarm = plant.book.of("radiator")
    key = alarm.key if alarm else "radiator@gone"
    if after is REFUSED:
        before = plant.book.export_state()
        with pytest.raises(AlarmError):
            plant.book.command(Command(key, event, "anna", 0, span=3600.0), plant.time)  # type: ignore[arg-type]
        assert plant.book.export_state() == before
        return
    EVENTS[event](plant)
    assert plant.state() == (None if after is C else after)


def test_every_state_has_a_way_to_be_cleared_and_every_command_is_an_event() -> None:
    assert all(LIFE[state][Event.CLEAR] is C for state in AlarmState if state is not C)
    assert {Event(action) for action in ACTIONS} == set(list(Event)[-4:])


def test_every_step_of_a_life_is_in_its_history() -> None:
    plant = raised()
    plant.say("acknowledge", comment="seen", through="zenoh")
    plant.frame("radiator")
    plant.ring()
    plant.say("shelve", span=1800.0, comment="parts ordered")
    plant.frame()
    (closed,) = plant.say("clear", comment="bled")
    told = [(e.state, e.actor, e.comment or Speaker().say(e.reason, "radiator"), e.through) for e in closed.history]
    assert told == [
        ("raised", "service", "the drift chart (CUSUM) of T_radiator passed its limit", ""),
        ("acknowledged", "anna", "seen", "zenoh"),
        ("returned to normal", "service", "the evidence is gone", ""),
        ("raised", "service", "the drift chart (CUSUM) of T_radiator passed its limit again", ""),
        ("shelved", "anna", "parts ordered", ""),
        ("raised", "service", "shelving ended", ""),
        ("cleared", "anna", "bled", ""),
    ]
    times = [e.time for e in closed.history]
    assert times == sorted(times)


def test_shelving_that_ends_without_evidence_is_no_new_alarm() -> None:
    plant = shelved()
    (back,) = plant.frame("radiator", after=2 * HOUR)
    assert back.state is N


def test_shelving_that_ends_under_a_cause_is_a_consequence() -> None:
    plant = shelved()
    plant.ring("hx")
    plant.frame(after=2 * HOUR)
    assert plant.state() is S


def test_flapping_alarm_must_be_quiet_for_longer_each_time() -> None:
    plant = raised()
    assert plant.frame("radiator")[0].state is N
    for wanted in (QUIET, 2 * QUIET, 4 * QUIET):
        plant.ring()
        assert plant.frame("radiator") == []
        assert plant.frame("radiator", after=wanted - HOUR) == []
        assert plant.frame("radiator")[0].state is N
    # An interruption begins the wait anew.
    plant.ring()
    plant.frame("radiator", after=7 * QUIET)
    plant.frame()
    assert plant.frame("radiator", after=2 * QUIET) == []
    assert plant.state() is R


def test_flaps_are_bounded_and_forgotten() -> None:
    plant = raised()
    returns = 0
    for _ in range(30 * 24):
        returns += any(a.state is N for a in plant.frame("radiator", after=HOUR // 2))
        plant.ring() if plant.state() is N else None
    assert returns <= 15  # of 720 times that the evidence went and came
    plant.frame("radiator", after=QUIET_MOST)
    plant.frame("radiator", after=QUIET_MOST)
    plant.ring()
    plant.frame(after=FLAPPING + HOUR)
    assert plant.frame("radiator")[0].state is N


def test_many_rings_are_one_alarm() -> None:
    plant = raised()
    first = plant.book.of("radiator")
    for _ in range(100):
        plant.ring()
    again = plant.book.of("radiator")
    assert first is not None
    assert again is not None
    assert (again.key, len(again.history), len(plant.book.open)) == (first.key, 1, 1)


def test_consequence_of_a_consequence_has_the_root_as_its_cause() -> None:
    plant = Plant()
    plant.ring("hx")
    plant.ring("radiator")
    plant.ring("house")  # declared downstream of the radiator only
    root = plant.book.of("hx")
    assert root is not None
    assert [plant.state(c) for c in ("hx", "radiator", "house")] == [R, S, S]
    for name in ("radiator", "house"):
        alarm = plant.book.of(name)
        assert alarm is not None
        assert alarm.evidence.caused_by == root.key
    plant.say("clear", "hx")
    # The radiator stands by itself now, and explains the house.
    assert [plant.state(c) for c in ("radiator", "house")] == [R, S]


def test_of_two_that_explain_each_other_the_older_is_the_cause() -> None:
    book = AlarmBook({"a": frozenset({"T_b"}), "b": frozenset({"T_a"})})
    book.ring(HOUR, [Ring("a", "a/T:cusum", "T_a", 0, ChartEvidence("T", ChartKind.CUSUM))])
    book.ring(2 * HOUR, [Ring("b", "b/T:cusum", "T_b", 0, ChartEvidence("T", ChartKind.CUSUM))])
    assert [a.state for a in book.open] == [R, S]


def test_plant_alarm_that_is_over_explains_its_models_no_longer() -> None:
    plant = raised()
    plant.ring("radiator", "model")
    assert plant.state(kind="model") is S
    plant.frame("radiator")
    assert plant.state() is N
    plant.frame("radiator", after=GRACE - 2 * HOUR)
    assert plant.state(kind="model") is S  # windows of a day still hold the fault
    plant.frame("radiator", after=2 * HOUR)
    assert plant.state(kind="model") is R
    alarm, root = plant.book.of("radiator:model"), plant.book.of("radiator")
    assert root is not None
    assert alarm is not None
    assert not alarm.evidence.caused_by
    assert alarm.history[-1].reason == Message.of("cause_normal", alarm=root.key)
    # Nor does it explain one that comes later, until it rings again.
    plant.say("clear", kind="model")
    plant.ring("radiator", "model")
    assert plant.state(kind="model") is R
    plant.ring("radiator")
    assert plant.state(kind="model") is S


def test_life_goes_on_after_a_restart() -> None:
    for make in (raised, shelved, suppressed, returned):
        plant, again = make(), make()
        plant.frame("hx")
        again.frame("hx")
        kept = json.loads(json.dumps(again.book.export_state()))
        again.book = AlarmBook({"radiator": frozenset({"T_supply"})}, {"house": frozenset({"radiator"})})
        again.book.restore_state(kept)
        for p in (plant, again):
            p.frame("hx", after=GRACE)
            p.frame("radiator", "hx")
        assert again.book.export_state() == plant.book.export_state()
