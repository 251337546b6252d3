"""A site's sources as one stream of batches in SI, with one position for all of them."""

from __future__ import annotations

import queue
import threading
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import replace

import structlog

from fdd.config import Site
from fdd.records import Batch, JsonObject
from ingest.csv.files import joined
from ingest.mapping import PointMap
from ingest.source import Context, NotReady, Source, make_source

log = structlog.get_logger()

FILES = ("csv", "excel", "parquet")
RETRY_SECONDS = 5.0
SLICE = 20_000


class Feed:
    """Every source of a site, configured; nothing is touched before :meth:`open`."""

    def __init__(self, site: Site) -> None:
        self._labels = [s.label for s in site.sources]
        self._maps = {s.label: PointMap(site.points_of(s)) for s in site.sources}
        self._sources: dict[str, Source] = {
            s.label: make_source(s, Context(site.zone, self._maps[s.label].columns, site.folder)) for s in site.sources
        }
        self._files = all(s.kind in FILES for s in site.sources)
        self._position: JsonObject = {}
        self._stopped = threading.Event()
        self._live = {s.label for s in site.sources if s.kind not in FILES}
        self.heard: dict[str, float] = {}
        """Live sources, and the wall clock [s] at which each last gave a sample."""

    def open(
        self, position: JsonObject | None = None, *, patient: bool = False, sleep: Callable[[float], None] = clock.sleep
    ) -> None:
        """Open every source after its position; ``patient`` tries again while one is not ready.

        Raises
        ------
        NotReady, Refused
        """
        self._position = dict(position or {})
        for label, source in self._sources.items():
            while True:
                try:
                    source.open(self._position.get(label))
                    if label in self._live:
                        self.heard[label] = clock.time()
                    break
                except NotReady as reason:
                    if not patient or self._stopped.is_set():
                        raise
                    log.warning("source not ready, trying again", source=label, reason=str(reason))
                    sleep(RETRY_SECONDS)

    def batches(self) -> Iterator[Batch]:
        """Batches in SI; files of several sources are merged by event time, live sources as they come."""
        if len(self._sources) == 1:
            (label,) = self._labels
            for batch in self._sources[label].batches():
                yield self._mapped(label, batch)
        elif self._files:
            yield from self._merged()
        else:
            yield from self._together()

    def _mapped(self, label: str, batch: Batch) -> Batch:
        if len(batch) and label in self._live:
            self.heard[label] = clock.time()
        self._position = {**self._position, label: batch.position}
        return replace(self._maps[label](batch), position=self._position)

    def _merged(self) -> Iterator[Batch]:
        whole = joined(self._mapped(label, b) for label in self._labels for b in self._sources[label].batches())
        merged = replace(whole, position=self._position)
        for start in range(0, len(merged), SLICE):
            yield merged.slice(start, start + SLICE)

    def _together(self) -> Iterator[Batch]:
        waiting: queue.Queue[tuple[str, Batch | Exception | None]] = queue.Queue(maxsize=64)

        def pump(label: str) -> None:
            try:
                for batch in self._sources[label].batches():
                    waiting.put((label, batch))
                waiting.put((label, None))
            except Exception as error:  # handed to the reader, who raises it
                waiting.put((label, error))

        for label in self._labels:
            threading.Thread(target=pump, args=(label,), daemon=True, name=f"source {label}").start()
        running = len(self._labels)
        while running:
            label, item = waiting.get()
            if item is None:
                running -= 1
            elif isinstance(item, Exception):
                raise item
            else:
                yield self._mapped(label, item)

    def counters(self) -> dict[str, int]:
        """What was rejected or odd, by reason, over all sources."""
        total: dict[str, int] = {}
        for label in self._labels:
            for reason, n in (*self._sources[label].counters().items(), *self._maps[label].totals().items()):
                total[reason] = total.get(reason, 0) + n
        return total

    def notes(self) -> list[str]:
        """The first rejections of each source in words."""
        return [note for label in self._labels for note in self._sources[label].notes()]

    @property
    def stopped(self) -> bool:
        """Whether somebody asked to stop."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """End :meth:`batches` soon."""
        self._stopped.set()
        for source in self._sources.values():
            source.stop()

    def close(self) -> None:
        """Give up the sources."""
        for source in self._sources.values():
            source.close()
