"""Polls BACnet/IP devices. There is no history to resume from: what happens while the daemon is away is not seen."""

from __future__ import annotations

import asyncio
import threading
import time as clock
from collections.abc import Callable, Iterator
from typing import ClassVar

import structlog

from fdd.records import Batch, JsonObject
from fdd.tables import SourceOptions
from ingest.bacnet.options import BacnetOptions
from ingest.bacnet.poll import Poller
from ingest.live import Inbox, Letter
from ingest.message import Message
from ingest.source import Context, NotReady, Refused

log = structlog.get_logger()


class BacnetSource:
    """Present values of objects named ``device/analog-input,3`` in the points' ``column``."""

    options: ClassVar[type[SourceOptions]] = BacnetOptions
    needs: ClassVar[tuple[str, ...]] = ("bacpypes3",)

    def __init__(self, now: Callable[[], int] = clock.time_ns) -> None:
        """``now``: wall clock [ns]; BACnet values carry no time."""
        self._now = now
        self._thread: threading.Thread | None = None
        self._counts: dict[str, int] = {}
        self._failure: Exception | None = None
        self._ready = threading.Event()
        self._stopping = threading.Event()

    def configure(self, options: BacnetOptions, context: Context) -> None:
        """Sort the points' columns by device.

        Raises
        ------
        Refused : a column that is not ``device/object-type,number`` of a configured device.
        """
        self._options = options
        self._objects: dict[str, list[str]] = {}
        for column in context.columns:
            device, _, name = column.partition("/")
            if device not in options.devices or "," not in name:
                known = ", ".join(options.devices)
                raise Refused(f"column {column!r} is no DEVICE/OBJECT-TYPE,NUMBER with a device of: {known}")
            self._objects.setdefault(device, []).append(name)
        self._inbox = Inbox(100, until_end=False)

    def open(self, position: JsonObject | None = None) -> None:
        """Bind the own address and start polling.

        Raises
        ------
        NotReady : the address cannot be bound.
        Refused : the BACnet library is not installed, or an address that is none.
        """
        del position
        self._thread = threading.Thread(target=self._run, daemon=True, name="bacnet")
        self._thread.start()
        self._ready.wait()
        if isinstance(self._failure, OSError):
            raise NotReady(f"BACnet address {self._options.address} cannot be bound ({self._failure})")
        if isinstance(self._failure, ImportError):
            raise Refused("the BACnet library is not installed; install hvac-fdd[bacnet]")
        if self._failure is not None:
            raise Refused(f"BACnet address {self._options.address}: {self._failure}")

    def _run(self) -> None:
        asyncio.run(self._poll_forever())

    async def _poll_forever(self) -> None:
        try:
            poller = Poller(self._options, self._objects)
        except Exception as error:  # handed to open(), which knows what to say
            self._failure = error
            return
        finally:
            self._ready.set()
        try:
            while not self._stopping.is_set():
                began = clock.monotonic()
                batch = await poller.poll(self._now)
                self._counts = dict(poller.counts)
                await asyncio.to_thread(self._inbox.receive, Letter(b"", _already(batch)))
                await self._pause(began + self._options.interval)
        finally:
            poller.close()

    async def _pause(self, until: float) -> None:
        while not self._stopping.is_set() and (left := until - clock.monotonic()) > 0:
            await asyncio.sleep(min(left, 0.1))

    def batches(self) -> Iterator[Batch]:
        """One batch a poll."""
        return self._inbox.batches()

    def position(self) -> JsonObject:
        """Nothing to resume from."""
        return self._inbox.position()

    def counters(self) -> dict[str, int]:
        """Polls, and objects that gave no value."""
        polls = self._inbox.counters().get("messages received", 0)
        return {"polls": polls, **self._counts}

    def notes(self) -> list[str]:
        """Nothing beyond the counters."""
        return []

    def stop(self) -> None:
        """End :meth:`batches` soon."""
        self._stopping.set()
        self._inbox.stop()

    def close(self) -> None:
        """Stop polling and give the address back."""
        self.stop()
        if self._thread is not None:
            self._thread.join(self._options.timeout + 2.0)
            self._thread = None


def _already(batch: Batch) -> Callable[[bytes], Message]:
    """A poll needs no decoding, but shares the inbox."""
    return lambda _: Message(batch)
