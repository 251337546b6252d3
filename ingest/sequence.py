"""Nothing lost unseen, nothing twice: a ledger of the last message taken from every stream.

Transports deliver at least once and in order within a stream; what a restart makes them deliver again is dropped here,
against the resume position, and what never came is counted.
"""

from __future__ import annotations

from fdd.records import JsonObject
from ingest.message import Message

_STREAMS_KEPT = 1000


class Ledger:
    """Last sequence number by stream (publisher and run)."""

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self.repeated = 0
        self.lost = 0

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
        return message.seq is not None and message.seq > self._last.get(message.stream, 0) + 1

    def take(self, message: Message) -> bool:
        """Whether the message is new; its sequence number is then the last one taken."""
        if message.seq is None:
            return True
        last = self._last.pop(message.stream, 0)
        self._last[message.stream] = max(last, message.seq)  # at the end: the longest silent stream is forgotten first
        if len(self._last) > _STREAMS_KEPT:
            del self._last[next(iter(self._last))]
        if message.seq <= last:
            self.repeated += 1
            return False
        self.lost += message.seq - last - 1
        return True
