"""What live message sources share: a bounded queue between the transport's thread and the reader."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from queue import Empty, Full, Queue

import numpy as np
import structlog

from fdd.records import Batch, JsonObject
from ingest.message import MalformedMessage, Message, decode
from ingest.sequence import Ledger

log = structlog.get_logger()

IDLE_SECONDS = 1.0
_POLL_SECONDS = 0.1
_TOGETHER = 64
_NOTES = 20


@dataclass(frozen=True, slots=True)
class Letter:
    """A payload as it came; ``done`` is called once its samples are safe with the reader."""

    payload: bytes
    decode: Callable[[bytes], Message] = decode
    done: Callable[[], None] | None = None


class Inbox:
    """Payloads in, batches out: decoding, order, counters, resume position.

    The transport's thread calls :meth:`receive`; it is held back while ``size`` messages wait. A message is done with
    when the reader asks for the batch after it, for by then a daemon has journaled it.
    """

    def __init__(self, size: int, until_end: bool) -> None:
        self._queue: Queue[Letter] = Queue(size)
        self._until_end = until_end
        self._ledger = Ledger()
        self._ended = False
        self._stopped = False
        self._malformed = 0
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
        }
        return {k: v for k, v in counts.items() if v}

    def stop(self) -> None:
        """End :meth:`batches` within a tenth of a second."""
        self._stopped = True

    def batches(self) -> Iterator[Batch]:
        """Batches as messages come; an empty one after a second of silence; ends after the end of the stream."""
        idle = 0.0
        while not self._stopped and not (self._ended and self._until_end):
            try:
                letters = [self._queue.get(timeout=_POLL_SECONDS)]
            except Empty:
                idle += _POLL_SECONDS
                if idle >= IDLE_SECONDS:
                    idle = 0.0
                    yield _join([], self.position())
                continue
            idle = 0.0
            while len(letters) < _TOGETHER:
                try:
                    letters.append(self._queue.get_nowait())
                except Empty:
                    break
            yield from self._batches(letters)
            for letter in letters:
                if letter.done:
                    letter.done()

    def _batches(self, letters: list[Letter]) -> Iterator[Batch]:
        """One batch for each run of messages that name the same points."""
        together: list[Batch] = []
        for letter in letters:
            position = self.position()
            message = self._accept(letter)
            if message is None:
                continue
            if together and together[0].names != message.batch.names:
                yield _join(together, position)
                together = []
            if len(message.batch):
                together.append(message.batch)
        # Also when all were repeated or ended: the position has moved.
        yield _join(together, self.position())

    def _accept(self, letter: Letter) -> Message | None:
        self.received += 1
        try:
            message = letter.decode(letter.payload)
        except MalformedMessage as error:
            self._malformed += 1
            self._note(f"malformed message: {error}; it starts {letter.payload[:80]!r}")
            return None
        self._ended |= message.end
        lost = self._ledger.lost
        new = self._ledger.take(message)
        if self._ledger.lost > lost:
            self._note(
                f"{self._ledger.lost - lost} messages of {message.stream} before number {message.seq} never came"
            )
        return message if new else None

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
