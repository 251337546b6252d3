"""What a publisher may say: who it is by the key it uses, which points it may write, how much, and dated when.

A message says who sent it; that is believed only as far as the transport vouches for it. Zenoh's and MQTT's access
control bind a user or certificate to keys, and ``publishers`` in the site file binds keys to publishers and points.

=========================  =======================================================================================
count                      what happens
=========================  =======================================================================================
publisher not known        the message is dropped: ``publishers`` does not name its sender
publisher on another key   the message is dropped: it came on a key that is not its sender's
point not allowed          the sample is dropped: its sender may not write the point
over its rate              the message is dropped: its sender has used up the rate it was given
dated ahead of the clock   the sample is taken with the time of its arrival, the others of its message moved along
=========================  =======================================================================================
"""

from __future__ import annotations

import time as wall
from collections.abc import Callable
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np
from pydantic import Field

from fdd.limits import STREAMS
from fdd.records import NANOSECONDS, Batch
from fdd.tables import Duration, Strict
from ingest.message import Message

# A clock below this has never been set: 1 January 2025.
_SET = 1_735_689_600 * NANOSECONDS
_RATE_SECONDS = 60.0
Matches = Callable[[str, str], bool]


class Publisher(Strict):
    """What one publisher may do."""

    key: str = Field(default="", description="key expression or topic filter that it publishes on; any without it")
    points: tuple[str, ...] = Field(default=("*",), description="names that it may write; * stands for any text")
    rate: float | None = Field(default=None, gt=0, description="samples a second that it may send, over a minute")


class TrustOptions(Strict):
    """How far publishers are trusted."""

    publishers: dict[str, Publisher] = Field(
        default={}, description="publisher to what it may do; with any, others are refused"
    )
    clock: Literal["wall", "simulated"] = Field(
        default="wall", description="wall: samples cannot come from the future; simulated: their times are their own"
    )
    ahead: Duration = Field(
        default=600.0, description="how far ahead of this machine's clock a sample may be dated and keep its time"
    )


class Trust:
    """Judges messages as they come.

    Parameters
    ----------
    matches : whether a rule's key covers a message's
    now : wall clock [ns]
    steady : a clock that is never set, [s]
    """

    def __init__(
        self,
        options: TrustOptions,
        matches: Matches,
        now: Callable[[], int] = wall.time_ns,
        steady: Callable[[], float] = wall.monotonic,
    ) -> None:
        self._options, self._matches, self._now, self._steady = options, matches, now, steady
        self._clock, self._read = now(), steady()
        self._used: dict[str, tuple[float, float]] = {}
        self._allowed: dict[tuple[str, str], bool] = {}
        self.counts: dict[str, int] = {}

    def admit(self, message: Message, key: str, *, live: bool) -> Message | None:
        """The message as far as it is trusted; ``live`` is false for what a history still held."""
        rules = self._options.publishers
        if rules:
            name = message.publisher or next((n for n, p in rules.items() if self._on_key(p, key)), "")
            rule = rules.get(name)
            if rule is None:
                self._count("publisher not known", 1)
                return None
            if not self._on_key(rule, key):
                self._count("publisher on another key", 1)
                return None
            message = replace(message, batch=self._permitted(message.batch, name, rule))
            if live and rule.rate and not self._within(name, rule.rate, len(message.batch)):
                self._count("over its rate", 1)
                return None
        if self._options.clock == "wall" and len(message.batch):
            message = replace(message, batch=self._dated(message.batch))
        return message

    def _on_key(self, rule: Publisher, key: str) -> bool:
        return not rule.key or self._matches(rule.key, key)

    def _permitted(self, batch: Batch, publisher: str, rule: Publisher) -> Batch:
        allowed = np.array([self._may(publisher, rule, name) for name in batch.names], dtype=np.bool_)
        if allowed.all():
            return batch
        keep = allowed[batch.point]
        self._count("point not allowed", int((~keep).sum()))
        columns = {c: getattr(batch, c)[keep] for c in ("point", "time", "value", "quality")}
        return replace(batch, **columns)

    def _may(self, publisher: str, rule: Publisher, name: str) -> bool:
        pair = (publisher, name)
        if pair not in self._allowed:
            if len(self._allowed) > 100 * STREAMS:  # invented names must not fill the memory
                self._allowed.clear()
            self._allowed[pair] = any(fnmatchcase(name, pattern) for pattern in rule.points)
        return self._allowed[pair]

    def _within(self, publisher: str, rate: float, samples: int) -> bool:
        """Whether a minute's worth of samples, less what was sent since, still covers these."""
        left, at = self._used.get(publisher, (rate * _RATE_SECONDS, self._steady()))
        now = self._steady()
        left = min(left + (now - at) * rate, rate * _RATE_SECONDS)
        fits = samples <= left
        self._used[publisher] = (left - samples if fits else left, now)
        return fits

    def _dated(self, batch: Batch) -> Batch:
        now = self._wall()
        newest = int(batch.time.max())
        if newest <= now + round(self._options.ahead * NANOSECONDS) or now < _SET:
            return batch
        over = batch.time > now
        self._count("dated ahead of the clock", int(over.sum()))
        # Python's integers: the difference of two times may be more than 64 bits hold.
        moved = [
            max(t - (newest - now), 0) if o else t for t, o in zip(batch.time.tolist(), over.tolist(), strict=True)
        ]
        return replace(batch, time=np.array(moved, dtype=np.int64))

    def _wall(self) -> int:
        """The wall clock, which never goes back here: one that was set back would put honest samples in the future."""
        steady = self._steady()
        self._clock = max(self._now(), self._clock + round((steady - self._read) * NANOSECONDS))
        self._read = steady
        return self._clock

    def _count(self, reason: str, number: int) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + number
