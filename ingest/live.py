"""What live message sources share: a bounded queue between the transport's thread and the reader."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from queue import Empty, Full, Queue

import numpy as np
import structlog

from fdd.limits import STREAMS
from fdd.records import Batch, JsonObject
from ingest.history import read_answer
from ingest.message import MalformedMessage, Message, decode
from ingest.sequence import Ledger
from ingest.trust import Trust

log = structlog.get_logger()

IDLE_SECONDS = 1.0
_POLL_SECONDS = 0.1
_PATIENCE_SECONDS = 5.0
# Streams of which no history has answered yet share this much waiting: [s] in every minute.
_STRANGERS_SECONDS, _STRANGERS_EVERY = 5.0, 60.0
# Answers of two megabytes each that one turn of catching up reads.
_ROUNDS = 1000
_TOGETHER = 64
_NOTES = 20


@dataclass(frozen=True, slots=True)
class Letter:
    """A payload as it came, on which key; ``done`` is called once its samples are safe with the reader."""

    payload: bytes
    decode: Callable[[bytes], Message] = decode
    done: Callable[[], None] | None = None
    key: str = ""


Ask = Callable[[Mapping[str, int]], list[tuple[str, bytes]]]
"""Last number of every stream to the answers of histories, each with the key it was given on."""


class Inbox:
    """Payloads in, batches out: decoding, order, counters, resume position.

    The transport's thread calls :meth:`receive`; it is held back while ``size`` messages wait. A message is done with
    when the reader asks for the batch after it, for by then a daemon has journaled it.

    ``ask`` gets the last number of every stream and gives the answers of :mod:`ingest.history`; it is asked at the
    start, where a number is missing, and after a second of silence.
    """

    def __init__(self, size: int, until_end: bool, ask: Ask | None = None, trust: Trust | None = None) -> None:
        self._queue: Queue[Letter] = Queue(size)
        self._until_end = until_end
        self._ask, self._trust = ask, trust
        self._ledger = Ledger()
        self._ended = False
        self._stopped = False
        self._malformed = 0
        self._answered: set[str] = set()
        self._waited, self._waited_since = 0.0, clock.monotonic()
        self.received = 0
        self.notes: list[str] = []

    def restore(self, position: JsonObject | None) -> None:
        """Continue after a saved position."""
        self._ledger.restore(position or {})
        self._ended = bool(position and position.get("ended"))

    def receive(self, letter: Letter) -> None:
        """Take a message from the transport; waits while the queue is full, unless stopped."""
        while not self._stopped:
            try:
                self._queue.put(letter, timeout=_POLL_SECONDS)
            except Full:
                continue
            return

    def position(self) -> JsonObject:
        """Plain data to resume from."""
        return {**self._ledger.position(), "ended": self._ended}

    def counters(self) -> dict[str, int]:
        """Messages by outcome."""
        counts = {
            "messages received": self.received,
            "malformed message": self._malformed,
            "message repeated": self._ledger.repeated,
            "message lost": self._ledger.lost,
            "message far from the last number": self._ledger.far,
        }
        counts |= self._trust.counts if self._trust else {}
        return {k: v for k, v in counts.items() if v}

    def stop(self) -> None:
        """End :meth:`batches` within a tenth of a second."""
        self._stopped = True

    def batches(self) -> Iterator[Batch]:
        """Batches as messages come; an empty one after a second of silence; ends after the end of the stream."""
        if self._ask:
            yield from self._joined(self._missed(None))
        silent = clock.monotonic()
        while not self._stopped and not (self._ended and self._until_end):
            letters = self._waiting()
            if letters:
                yield from self._joined(m for letter in letters for m in self._accept(letter))
                for letter in letters:
                    if letter.done:
                        letter.done()
                silent = clock.monotonic()
            elif clock.monotonic() - silent >= IDLE_SECONDS:
                yield from self._joined(self._missed(None))
                silent = clock.monotonic()

    def _waiting(self) -> list[Letter]:
        letters: list[Letter] = []
        try:
            letters.append(self._queue.get(timeout=_POLL_SECONDS))
            while len(letters) < _TOGETHER:
                letters.append(self._queue.get_nowait())
        except Empty:
            pass
        return letters

    def _joined(self, messages: Iterator[Message]) -> Iterator[Batch]:
        """One batch for each run of messages that name the same points, and at least one: the position may move."""
        together: list[Batch] = []
        position = self.position()
        for message in messages:
            if together and (together[0].names != message.batch.names or len(together) >= _TOGETHER):
                yield _join(together, position)
                together = []
            if len(message.batch):
                together.append(message.batch)
            position = self.position()
        yield _join(together, self.position())

    def _accept(self, letter: Letter) -> Iterator[Message]:
        """The new message in a letter, after those before it that had not come."""
        message = self._decode(letter.payload, letter.decode, letter.key, live=True)
        if message is None:
            return
        if self._ledger.skips(message):
            yield from self._missed(message)
        yield from self._take(message)

    def _missed(self, before: Message | None) -> Iterator[Message]:
        """What the publishers' histories still hold; patient until the stream of ``before`` has answered."""
        begun = clock.monotonic()
        patience = 0.0 if before is None else self._patience(before.stream, begun)
        for _ in range(_ROUNDS):
            if self._ask is None or self._stopped:
                return
            known = self._ledger.last
            streams, payloads = self._answers()
            for key, payload in payloads:
                message = self._decode(payload, decode, key, live=False)
                if message is not None:
                    yield from self._take(message)
            if payloads and self._ledger.last != known:
                continue  # an answer is of bounded length: there may be more; one that repeats itself has no more
            if before is None or before.stream in streams or clock.monotonic() >= begun + patience:
                break
            clock.sleep(_POLL_SECONDS)
        if before is not None and before.stream not in self._answered:
            self._waited += clock.monotonic() - begun

    def _patience(self, stream: str, now: float) -> float:
        """How long a stream's history may take [s]: invented streams must not make the others wait."""
        if stream in self._answered:
            return _PATIENCE_SECONDS
        if now - self._waited_since > _STRANGERS_EVERY:
            self._waited, self._waited_since = 0.0, now
        return max(_STRANGERS_SECONDS - self._waited, 0.0)

    def _answers(self) -> tuple[set[str], list[tuple[str, bytes]]]:
        streams: set[str] = set()
        payloads: list[tuple[str, bytes]] = []
        for key, answer in self._ask(self._ledger.last) if self._ask else []:
            try:
                stream, messages = read_answer(answer)
            except MalformedMessage as error:
                self._malformed += 1
                self._note(f"malformed message: {error}")
                continue
            streams.add(stream)
            payloads += [(key, message) for message in messages]
        self._answered |= streams
        if len(self._answered) > STREAMS:
            self._answered = streams
        return streams, payloads

    def _decode(self, payload: bytes, how: Callable[[bytes], Message], key: str, *, live: bool) -> Message | None:
        self.received += 1
        try:
            message = how(payload)
            return self._trust.admit(message, key, live=live) if self._trust else message
        except MalformedMessage as error:
            self._malformed += 1
            self._note(f"malformed message: {error}; it starts {payload[:80]!r}")
            return None

    def _take(self, message: Message) -> Iterator[Message]:
        lost = self._ledger.lost
        new = self._ledger.take(message)
        self._ended |= message.end
        if self._ledger.lost > lost:
            self._note(
                f"{self._ledger.lost - lost} messages of {message.stream} before number {message.seq} never came"
            )
        if new:
            yield message

    def _note(self, text: str) -> None:
        if len(self.notes) < _NOTES:
            self.notes.append(text)
            log.warning("source", note=text)


def _join(batches: list[Batch], position: JsonObject) -> Batch:
    if not batches:
        nothing = np.empty(0)
        return Batch(
            (), nothing.astype(np.int32), nothing.astype(np.int64), nothing, nothing.astype(np.uint8), position
        )
    return Batch(
        batches[0].names,
        np.concatenate([b.point for b in batches]),
        np.concatenate([b.time for b in batches]),
        np.concatenate([b.value for b in batches]),
        np.concatenate([b.quality for b in batches]),
        position,
    )
