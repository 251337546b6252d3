"""Nothing lost unseen, nothing twice: a ledger of the last message taken from every stream.

Transports deliver at least once and in order within a stream; what a restart makes them deliver again is dropped here,
against the resume position, and what never came is counted.

A number far from the last one says little: it may be a mistake, a forgery, or a publisher that was away for long. Its
samples are taken, for time and place in a frame decide what they are worth; but the stream is counted from there on
only once the numbers after it have come one by one. So one wrong number never makes what follows "repeated".
"""

from __future__ import annotations

from fdd.limits import STREAMS
from fdd.records import JsonObject
from ingest.message import Message

# Ten times what a publisher's history holds by default.
NEAR = 100_000
CONFIRMATIONS = 5


class Ledger:
    """Last sequence number by stream (publisher and run)."""

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self._far: dict[str, tuple[int, int]] = {}  # the last far number of a stream, and how many came in a row
        self.repeated = 0
        self.lost = 0
        self.far = 0

    def restore(self, position: JsonObject) -> None:
        """Continue from a saved position."""
        self._last = {str(k): int(v) for k, v in position.get("streams", {}).items()}

    def position(self) -> JsonObject:
        """Plain data to continue from."""
        return {"streams": dict(self._last)}

    @property
    def last(self) -> dict[str, int]:
        """Number of the last message taken, by stream."""
        return dict(self._last)

    def skips(self, message: Message) -> bool:
        """Whether messages before this one have not come."""
        last = self._last.get(message.stream, 0)
        return message.seq is not None and last + 1 < message.seq <= last + NEAR

    def take(self, message: Message) -> bool:
        """Whether the message is new; its sequence number is then the last one taken."""
        if message.seq is None:
            return True
        known = message.stream in self._last
        last = self._last.pop(message.stream, 0)
        # A stream that is heard for the first time may stand at any number.
        if known and abs(message.seq - last) > NEAR and not self._confirmed(message.stream, message.seq):
            self._keep(message.stream, last)
            self.far += 1
            return True
        self._far.pop(message.stream, None)
        far = abs(message.seq - last) > NEAR
        self._keep(message.stream, message.seq if far else max(last, message.seq))
        if far:
            self.lost += max(message.seq - last - CONFIRMATIONS, 0) if known else message.seq - 1
            return True
        if message.seq <= last:
            self.repeated += 1
            return False
        self.lost += message.seq - last - 1
        return True

    def _confirmed(self, stream: str, number: int) -> bool:
        before, count = self._far.pop(stream, (number - 1, 0))
        count = count + 1 if number == before + 1 else 1
        if count >= CONFIRMATIONS:
            return True
        self._far[stream] = (number, count)
        if len(self._far) > STREAMS:
            del self._far[next(iter(self._far))]
        return False

    def _keep(self, stream: str, number: int) -> None:
        self._last[stream] = number  # at the end: the longest silent stream is forgotten first
        if len(self._last) > STREAMS:
            del self._last[next(iter(self._last))]
