"""Whatever the transport drops, repeats or delivers late, every message is taken once and in order."""

from __future__ import annotations

import json
from collections.abc import Mapping

from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.records import Batch, Sample
from ingest.history import History, read_answer
from ingest.live import Inbox, Letter
from ingest.message import encode

STREAM = "plant/r"


def messages(count: int) -> list[bytes]:
    """Numbered from 1; the last one ends the stream."""
    return [
        encode(Batch.of([Sample("T", i, float(i))]), publisher="plant", run="r", seq=i, end=i == count)
        for i in range(1, count + 1)
    ]


def filled(count: int, size: int) -> History:
    history = History(STREAM, size)
    for message in messages(count):
        history.keep(message)
    return history


def inbox(history: History | None) -> Inbox:
    def ask(have: Mapping[str, int]) -> list[tuple[str, bytes]]:
        assert history is not None
        return [("", history.answer(json.dumps({"have": dict(have)}).encode()))]

    return Inbox(10_000, True, ask if history else None)


def values(batches: list[Batch]) -> list[float]:
    return [v for b in batches for v in b.value.tolist()]


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 40), st.lists(st.integers(0, 39), max_size=80), st.integers(0, 40))
def test_every_message_is_taken_once_and_in_order(count: int, delivered: list[int], had: int) -> None:
    sent = messages(count)
    box = inbox(filled(count, count))
    box.restore({"streams": {STREAM: min(had, count - 1)}, "ended": False})
    for i in delivered:
        box.receive(Letter(sent[i % count]))
    assert values(list(box.batches())) == [float(i) for i in range(min(had, count - 1) + 1, count + 1)]
    assert "message lost" not in box.counters()


@settings(deadline=None, max_examples=60)
@given(st.integers(2, 40), st.integers(1, 200))
def test_position_of_any_batch_resumes_exactly_after_it(count: int, stop_after: int) -> None:
    history = filled(count, count)
    first = inbox(history)
    begun = []
    for batch in first.batches():
        begun.append(batch)
        if len(begun) == stop_after:
            break
    second = inbox(history)
    second.restore(begun[-1].position)
    assert values([*begun, *second.batches()]) == [float(i) for i in range(1, count + 1)]


def test_without_a_history_a_gap_is_counted_as_lost() -> None:
    sent = messages(5)
    box = inbox(None)
    for i in (0, 3, 4):
        box.receive(Letter(sent[i]))
    assert values(list(box.batches())) == [1.0, 4.0, 5.0]
    assert box.counters()["message lost"] == 2
    assert "2 messages of plant/r before number 4 never came" in box.notes


def test_what_a_history_no_longer_holds_is_counted_as_lost() -> None:
    box = inbox(filled(50, 10))
    assert values(list(box.batches())) == [float(i) for i in range(41, 51)]
    assert box.counters()["message lost"] == 40


def test_long_history_comes_in_bounded_answers_and_is_whole() -> None:
    names = [f"point-{i}" for i in range(2000)]
    history = History(STREAM, 1000)
    for i in range(1, 201):
        batch = Batch.of([Sample(n, i, float(i)) for n in names])
        history.keep(encode(batch, publisher="plant", run="r", seq=i, end=i == 200))
    answer = history.answer(b'{"have": {}}')
    assert 0 < len(read_answer(answer)[1]) < 200
    assert len(answer) < 3_000_000
    got = list(inbox(history).batches())
    assert sum(len(b) for b in got) == 200 * 2000


def test_a_message_is_done_with_only_when_the_next_batch_is_asked_for() -> None:
    done: list[int] = []
    box = inbox(None)
    box.receive(Letter(messages(2)[0], done=lambda: done.append(1)))
    stream = box.batches()
    first = next(b for b in stream if len(b))
    assert values([first]) == [1.0]
    assert done == []
    box.receive(Letter(messages(2)[1]))
    next(b for b in stream if len(b))
    assert done == [1]
