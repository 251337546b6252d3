"""Subscribes to samples; a restarted daemon gets what it missed, and nothing twice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import structlog

from fdd.limits import STREAMS
from fdd.records import Batch, JsonObject
from fdd.tables import SourceOptions
from ingest.live import Inbox, Letter
from ingest.source import Context
from ingest.trust import Trust
from ingest.zenoh.options import ZenohOptions
from ingest.zenoh.session import ask_history, covers, declare_subscriber, open_session

log = structlog.get_logger()


class ZenohSource:
    """Messages of :mod:`ingest.message` from every publisher under a key expression."""

    options: ClassVar[type[SourceOptions]] = ZenohOptions

    def __init__(self) -> None:
        self._session: Any = None
        self._declared: tuple[Any, ...] = ()
        self._publishers: set[str] = set()

    def configure(self, options: ZenohOptions, context: Context) -> None:
        """Keep the options."""
        self._options, self._context = options, context
        self._inbox = Inbox(options.queue, options.until_end, self._ask, Trust(options, covers))

    def open(self, position: JsonObject | None = None) -> None:
        """Open the session and subscribe; publishers may come before or after.

        Raises
        ------
        NotReady : the endpoint is taken, or a router cannot be reached.
        """
        self._inbox.restore(position)
        self._session = open_session(self._options, self._context.folder)
        self._declared = declare_subscriber(self._session, self._options.key, self._receive, self._present)

    def _ask(self, have: Mapping[str, int]) -> list[tuple[str, bytes]]:
        return ask_history(self._session, self._options.key, have)

    def _receive(self, key: str, payload: bytes) -> None:
        self._inbox.receive(Letter(payload, key=key))

    def _present(self, publisher: str, here: bool) -> None:
        if here and len(self._publishers) < STREAMS:
            self._publishers.add(publisher)
        else:
            self._publishers.discard(publisher)
        log.info("publisher here" if here else "publisher gone", publisher=publisher)

    def batches(self) -> Iterator[Batch]:
        """Batches as they come."""
        return self._inbox.batches()

    def position(self) -> JsonObject:
        """Last message taken of every publisher's run."""
        return self._inbox.position()

    def counters(self) -> dict[str, int]:
        """Messages by outcome, and the publishers that are here now."""
        return {**self._inbox.counters(), "publishers present": len(self._publishers)}

    def notes(self) -> list[str]:
        """The first messages that were malformed or lost."""
        return list(self._inbox.notes)

    def stop(self) -> None:
        """End :meth:`batches` soon."""
        self._inbox.stop()

    def close(self) -> None:
        """Close the session."""
        self._inbox.stop()  # lets go of a transport thread that waits for room
        if self._session is not None:
            for declared in self._declared:
                declared.undeclare()
            self._session.close()
            self._session = None
