"""One publisher, however wrong its clock or its numbers, moves neither the plant's time nor another's points."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np
import pytest

from fdd.records import NANOSECONDS, Batch, Sample
from fdd.service.filtering.framing import Framer
from ingest.live import Inbox, Letter
from ingest.message import Message, encode
from ingest.trust import Trust, TrustOptions
from tests.doors.daemons import Feed, Site, pieces, simulate, watched

SECOND, HOUR = NANOSECONDS, 3600 * NANOSECONDS
NOW = 1_790_000_000 * NANOSECONDS
IN_2100 = 4_102_444_800 * NANOSECONDS


class Clocks:
    """A wall clock that may be set, and a steady one."""

    def __init__(self) -> None:
        self.wall, self.steady = NOW, 0.0

    def tick(self, seconds: float) -> None:
        self.wall += round(seconds * NANOSECONDS)
        self.steady += seconds


def trust(clocks: Clocks, **table: object) -> Trust:
    options = TrustOptions.model_validate(table)
    return Trust(options, lambda rule, key: fnmatchcase(key, rule), lambda: clocks.wall, lambda: clocks.steady)


def message(*samples: tuple[str, int, float], publisher: str = "a") -> Message:
    return Message(Batch.of([Sample(*s) for s in samples]), publisher, "r", None)


def framer() -> Framer:
    return Framer(("a", "b", "c", "d"), step=60 * SECOND, lateness=120 * SECOND, max_jump=7 * 24 * HOUR)


def frame(time: int) -> Batch:
    return Batch.of([Sample(p, time, 1.0) for p in "abcd"])


def test_samples_dated_2100_in_one_message_cost_no_honest_sample() -> None:
    """Without any wall clock: five of one point, and one of each of half the points, move nothing."""
    f = framer()
    for k in range(10):
        f.add(frame(NOW + k * 60 * SECOND))
    f.add(Batch.of([Sample("a", IN_2100 + i, 9.0) for i in range(5)]))
    f.add(Batch.of([Sample(p, IN_2100 + i, 9.0) for i, p in enumerate("abab" * 5)]))
    for k in range(10, 200):
        f.add(frame(NOW + k * 60 * SECOND))
    assert (f.counts["late"], f.counts["clock_jump"], f.counts["accepted"]) == (0, 25, 800)


def test_a_plant_that_was_off_for_long_goes_on_when_most_of_its_points_do() -> None:
    f = framer()
    f.add(frame(NOW))
    later = NOW + 30 * 24 * HOUR
    closed = sum(len(f.add(frame(later + k * 60 * SECOND))) for k in range(20))
    assert closed > 10
    assert f.counts["late"] == 0


def test_what_is_left_of_a_plant_goes_on_when_nobody_contradicts() -> None:
    f = framer()
    f.add(frame(NOW))
    later = NOW + 30 * 24 * HOUR
    closed = sum(len(f.add(Batch.of([Sample("a", later + k * 60 * SECOND, 1.0)]))) for k in range(40))
    assert closed > 20


@pytest.mark.parametrize("ahead", [IN_2100, NOW + HOUR])
def test_a_clock_that_is_ahead_loses_no_sample_and_moves_nothing(ahead: int) -> None:
    """A day an hour ahead, or dated 2100, then back: every sample is in a frame, and it is counted."""
    clocks, f = Clocks(), framer()
    judge = trust(clocks)
    offset = ahead - NOW
    for k in range(3 * 1440):
        clocks.tick(60.0)
        wrong = offset if 1440 <= k < 2880 else 0
        batch = Batch.of([Sample(p, clocks.wall + wrong, float(k)) for p in "abcd"])
        taken = judge.admit(Message(batch, "a", "r", None), "", live=True)
        assert taken is not None
        f.add(taken.batch)
    assert judge.counts == {"dated ahead of the clock": 4 * 1440}
    assert (f.counts["late"], f.counts["clock_jump"]) == (0, 0)
    assert f.counts["accepted"] + f.counts["duplicate"] == 4 * 3 * 1440
    assert f.counts["duplicate"] == 0


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_this_machines_clock_may_be_set_an_hour_either_way(step: float) -> None:
    clocks, f = Clocks(), framer()
    judge, true = trust(clocks), NOW
    for k in range(600):
        clocks.tick(60.0)
        true += 60 * SECOND
        clocks.wall += round(step * NANOSECONDS) if k == 300 else 0
        taken = judge.admit(Message(frame(true), "a", "r", None), "", live=True)
        assert taken is not None
        f.add(taken.batch)
    assert (f.counts["late"], f.counts["duplicate"], f.counts["accepted"]) == (0, 0, 4 * 600)


def test_a_clock_that_was_never_set_judges_nobody() -> None:
    clocks = Clocks()
    clocks.wall = 5 * SECOND
    judge, sent = trust(clocks), message(("a", NOW, 1.0))
    taken = judge.admit(sent, "", live=True)
    assert taken is not None
    assert taken.batch.time.tolist() == [NOW]


def test_a_simulated_plant_keeps_its_times() -> None:
    taken = trust(Clocks(), clock="simulated").admit(message(("a", IN_2100, 1.0)), "", live=True)
    assert taken is not None
    assert taken.batch.time.tolist() == [IN_2100]


def test_a_publisher_writes_its_own_points_from_its_own_key_at_its_own_rate() -> None:
    clocks = Clocks()
    rules = {"ahu": {"key": "fdd/ahu/*", "points": ["ahu.*"], "rate": 2.0}, "meters": {"points": ["m*"]}}
    judge = trust(clocks, publishers=rules)
    assert judge.admit(message(("ahu.T", NOW, 1.0), publisher="forged"), "fdd/ahu/x", live=True) is None
    assert judge.admit(message(("ahu.T", NOW, 1.0), publisher="ahu"), "fdd/meters/x", live=True) is None
    own = judge.admit(message(("ahu.T", NOW, 1.0), ("m1", NOW, 5.0), publisher="ahu"), "fdd/ahu/x", live=True)
    assert own is not None
    assert own.batch.value.tolist() == [1.0]
    sent = [message(("ahu.T", NOW, 1.0), publisher="ahu") for _ in range(500)]
    passed = sum(judge.admit(m, "fdd/ahu/x", live=True) is not None for m in sent)
    assert passed == 119
    clocks.tick(10.0)
    assert sum(judge.admit(m, "fdd/ahu/x", live=True) is not None for m in sent) == 20
    assert judge.admit(message(("m1", NOW, 1.0), publisher="meters"), "anything", live=True) is not None
    assert judge.counts["publisher not known"] == judge.counts["publisher on another key"] == 1
    assert judge.counts["point not allowed"] == 1


def test_forged_publishers_are_refused_from_a_history_too() -> None:
    judge = trust(Clocks(), publishers={"plant": {"key": "fdd/plant"}})
    lie = encode(Batch.of([Sample("T", NOW, 9.0)]), publisher="plant", run="r", seq=1)
    truth = encode(Batch.of([Sample("T", NOW + 1, 1.0)]), publisher="plant", run="r", seq=1, end=True)
    answers = [("fdd/other", b'{"stream": "plant/r", "newest": 1}\n' + lie)]
    box = Inbox(10, True, lambda _: answers, judge)
    box.receive(Letter(truth, key="fdd/plant"))
    assert [v for b in box.batches() for v in b.value.tolist()] == [1.0]


def test_event_time_can_be_set_back_and_the_plant_is_watched_on(tmp_path: object) -> None:
    from pathlib import Path

    from fdd.service.daemon.commands import submit_turn_back

    truth, site = simulate(400, seed=1), Site(Path(str(tmp_path)))
    daemon = site.start(save_every=50)
    daemon.run(Feed(pieces(truth, 0, 200)))  # type: ignore[arg-type]
    # Everything leaps ten years ahead, and the clock is right again afterwards.
    ahead = truth.batch(200, 260)
    leap = Batch(ahead.names, ahead.point, ahead.time + 10 * 365 * 24 * HOUR, ahead.value, ahead.quality)
    daemon.run(Feed([leap]))  # type: ignore[arg-type]
    daemon.run(Feed(pieces(truth, 200, 250)))  # type: ignore[arg-type]
    assert daemon.engine.counts["late"] > 0
    key = submit_turn_back(site.store, int(truth.time[200]), "anna", 5)
    daemon.run(Feed())  # type: ignore[arg-type]
    assert site.store.items("command")[key]["outcome"] == "done"
    late = daemon.engine.counts["late"]
    daemon.run(Feed(pieces(truth, 201, 300)))  # type: ignore[arg-type]
    daemon = site.restarted(save_every=50)
    daemon.run(Feed(pieces(truth, 300, 400)))  # type: ignore[arg-type]
    assert daemon.engine.counts["late"] == late
    table = site.store.read("charts", start=int(truth.time[250]), end=int(truth.time[399]))
    assert len(np.unique(table["time"])) == 149
    assert watched(site.store)
    assert any(line["what"] == "event time set back" for line in _trail(site))
    site.stop()


def _trail(site: Site) -> list[dict[str, object]]:
    from fdd.service.daemon.trail import read

    return list(read(site.trail.path))
