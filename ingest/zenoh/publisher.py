"""Publishes batches of samples: the simulated plant's way into the daemon, and a pattern for gateways."""

from __future__ import annotations

import time
import uuid
from pathlib import Path
from typing import Any

import numpy as np

from fdd.records import Batch
from ingest.history import History
from ingest.message import encode
from ingest.zenoh.options import ZenohOptions
from ingest.zenoh.session import declare_publisher, open_session

# What a message holds at most: well below the bounds of a reader, in samples and in bytes.
_SAMPLES = 50_000
_NOTHING = Batch((), np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint8))


class ZenohPublisher:
    """Sends batches in order, each a message with its sequence number.

    The cache serves subscribers that come late or come back: whoever was away for longer than it holds misses the
    older messages, and counts them. Stay open until the readers have what they need: closing forgets the cache.
    """

    def __init__(self, options: ZenohOptions, key: str, *, publisher: str = "plant", cache: int = 10_000) -> None:
        """Open the session.

        Parameters
        ----------
        options : where to listen or connect; ``options.key`` is not used
        key : what to publish on, without wild cards
        publisher : name of this publisher
        cache : messages kept for those who come late

        Raises
        ------
        NotReady : the endpoint is taken or cannot be reached.
        """
        self.publisher, self.run = publisher, uuid.uuid4().hex[:12]
        self.sent = 0
        self._history = History(f"{publisher}/{self.run}", cache)
        self._session: Any = open_session(options, Path.cwd())
        self._declared = declare_publisher(self._session, key, f"{publisher}-{self.run}", self._history.answer)

    def wait_for_subscriber(self, timeout_seconds: float) -> bool:
        """Whether somebody listens, waiting so long at most."""
        deadline = time.monotonic() + timeout_seconds
        while not self._declared[0].matching_status.matching:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    def publish(self, batch: Batch) -> None:
        """Send a batch, in as many messages as it needs; waits while the reader is behind."""
        for start in range(0, max(len(batch), 1), _SAMPLES):
            self._send(batch.slice(start, start + _SAMPLES), end=False)

    def end(self) -> None:
        """Say that the stream is over."""
        self._send(_NOTHING, end=True)

    def _send(self, batch: Batch, end: bool) -> None:
        self.sent += 1
        message = encode(batch, publisher=self.publisher, run=self.run, seq=self.sent, end=end)
        self._history.keep(message)
        self._declared[0].put(message)

    def close(self) -> None:
        """Close the session and forget the cache."""
        if self._session is not None:
            for declared in self._declared:
                declared.undeclare()
            self._session.close()
            self._session = None

    def __enter__(self) -> ZenohPublisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
