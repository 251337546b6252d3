"""What replaying files has in common, whatever their format: paths, counters, positions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from fdd.limits import UNPACKED_BYTES, UNPACKED_RATIO
from fdd.records import Batch, IntArray, JsonObject
from ingest.csv.localtime import Clock
from ingest.csv.options import FileOptions
from ingest.csv.table import Table
from ingest.source import Context, Refused

NOTES = 20


class FileSource(ABC):
    """Reads files one after the other; subclasses read one file from a row on."""

    _options: FileOptions
    _context: Context

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._notes: list[str] = []
        self._position: JsonObject = {"file": 0, "line": 0, "row": 0, "before": 0, "previous": {}}
        self._paths: list[Path] = []
        self._stopped = False

    def configure(self, options: FileOptions, context: Context) -> None:
        """Keep the options; files are looked at in :meth:`open`."""
        self._options, self._context = options, context
        zone = options.time.zone or context.zone
        self._clock = Clock(options.time, zone, self._counts)
        self._clock.origin()
        if options.time.start is not None:
            self._clock.moment(options.time.start, "time.start")

    def open(self, position: JsonObject | None = None) -> None:
        """Find the files and check the first one's columns.

        Raises
        ------
        Refused : no such file, no such column, an encoding or a time that cannot be.
        """
        self._paths = [p for pattern in self._options.paths for p in self._expand(pattern)]
        self._stopped = False
        if position:
            self._position = {**self._position, **position}
        self._clock.previous = dict(self._position["previous"])
        if not self._options.in_order:
            self._check(self._paths[0])
        elif self._position["file"] < len(self._paths):
            self._check(self._paths[self._position["file"]])

    def _expand(self, pattern: Path) -> list[Path]:
        path = pattern if pattern.is_absolute() else self._context.folder / pattern
        if path.is_file():
            return [path]
        found = sorted(path.parent.glob(path.name)) if path.parent.is_dir() else []
        if not found:
            raise Refused(f"there is no file {path}; check 'path' (it starts at the site file's folder)")
        return found

    def batches(self) -> Iterator[Batch]:
        """Batches of ``batch_rows`` rows until the last file ends."""
        yield from self._as_written() if self._options.in_order else self._in_order()

    def _in_order(self) -> Iterator[Batch]:
        """Every file read whole, its samples in order of time; the position counts them."""
        done = int(self._position.get("samples", 0))
        self._position = {"file": 0, "line": 0, "row": 0, "before": 0, "previous": {}}
        self._clock.previous = {}
        whole = joined(self._as_written())
        size = self._options.batch_rows
        for start in range(done, len(whole), size):
            part = whole.slice(start, start + size)
            self._position = {**self._position, "samples": min(start + size, len(whole))}
            yield replace(part, position=self._position)
            if self._stopped:
                return

    def _as_written(self) -> Iterator[Batch]:
        while self._position["file"] < len(self._paths):
            for batch in self._read(self._paths[self._position["file"]]):
                self._position = batch.position
                yield batch
                if self._stopped:
                    return
            before = self._position["before"] + self._position["row"]
            self._position = {
                **self._position,
                "file": self._position["file"] + 1,
                "line": 0,
                "row": 0,
                "before": before,
            }

    @abstractmethod
    def _check(self, path: Path) -> None:
        """Refuse a file that cannot be read."""

    @abstractmethod
    def _read(self, path: Path) -> Iterator[Batch]:
        """Batches of one file."""

    def _table(self, header: list[str], path: Path) -> Table:
        return Table(header, self._options, self._clock, self._context.columns, path, self._counts)

    def _samples(self, table: Table, frame: pd.DataFrame, rows: IntArray, path: Path) -> Batch:
        """The samples of some rows; none, and a count, where a damaged file made them what no clock or number is.

        Raises
        ------
        Refused : what the site file says does not fit the file.
        """
        try:
            return table.batch(frame, self._numbered(rows))
        except Refused:
            raise
        except Exception as error:  # pandas and NumPy have many kinds for what they cannot convert
            where = f"{path.name}, rows {int(rows[0]) + 1} to {int(rows[-1]) + 1}"
            self._count("row cannot be read", len(frame), f"{where}: {type(error).__name__}: {error!s:.200}")
            return Batch.of([])

    @staticmethod
    def require_plausible(path: Path, unpacked: int) -> None:
        """Refuse a small file that unpacks to what no plant ever wrote.

        Raises
        ------
        Refused : beyond :data:`UNPACKED_BYTES` and :data:`UNPACKED_RATIO` times its size.
        """
        size = path.stat().st_size
        if unpacked > max(UNPACKED_BYTES, UNPACKED_RATIO * size):
            raise Refused(
                f"{path.name} has {size} bytes and unpacks to more than {unpacked}; {UNPACKED_RATIO} times its size is "
                "read. If it is genuine, unpack it first"
            )

    def _after(self, line: int, row: int) -> JsonObject:
        here = {"file": self._position["file"], "before": self._position["before"]}
        return {**here, "line": line, "row": row, "previous": dict(self._clock.previous)}

    def _numbered(self, rows: IntArray) -> IntArray:
        """Rows of the file at hand, numbered through all files: those without a time column follow one another."""
        return rows + int(self._position["before"])

    def _count(self, reason: str, number: int, note: str = "") -> None:
        if number:
            self._counts[reason] = self._counts.get(reason, 0) + number
            if note and len(self._notes) < NOTES:
                self._notes.append(note)

    def position(self) -> JsonObject:
        """File, line and row after the last batch."""
        return self._position

    def counters(self) -> dict[str, int]:
        """What was rejected or odd, by reason."""
        return dict(self._counts)

    def notes(self) -> list[str]:
        """The first rejections with their line numbers."""
        return list(self._notes)

    def stop(self) -> None:
        """End after the current batch."""
        self._stopped = True

    def close(self) -> None:  # noqa: B027 - files are closed after each batch, whatever their kind
        """Nothing is held between batches."""


def joined(batches: Iterable[Batch]) -> Batch:
    """One batch of all samples, in order of time; those of one time stay as they came."""
    whole = [b for b in batches if len(b)]
    names = tuple(dict.fromkeys(n for b in whole for n in b.names))
    column = {n: i for i, n in enumerate(names)}
    if not whole:
        return Batch.of([])
    point = np.concatenate([np.array([column[n] for n in b.names], dtype=np.int32)[b.point] for b in whole])
    time = np.concatenate([b.time for b in whole])
    order = np.argsort(time, kind="stable")
    value = np.concatenate([b.value for b in whole])
    quality = np.concatenate([b.quality for b in whole])
    return Batch(names, point[order], time[order], value[order], quality[order])
