"""Rows of a table, wide or long, become a batch: shared by CSV and Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.records import Batch, FloatArray, IntArray, Quality
from ingest.csv.localtime import ALL, NOT_A_TIME, Clock
from ingest.csv.options import FileOptions
from ingest.source import Refused

_TIME_NAMES = (
    "time",
    "timestamp",
    "datetime",
    "date_time",
    "date/time",
    "date time",
    "date",
    "zeit",
    "datum",
    "ts",
    "",
)
_TRUTH = {
    **dict.fromkeys(("true", "on", "yes", "active", "running", "open", "occupied", "enabled"), 1.0),
    **dict.fromkeys(("false", "off", "no", "inactive", "stopped", "closed", "unoccupied", "disabled"), 0.0),
}
NO_VALUE = ("", "NaN", "nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "--", "---")


@dataclass
class Table:
    """Which columns of one file hold what, and how they become samples."""

    header: list[str]
    options: FileOptions
    clock: Clock
    wanted: tuple[str, ...]
    path: Path
    counts: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.time_columns = self._find_time()
        long = self.options.long
        if long:
            named = [] if long.point is None else [self._find(long.point, "long.point")]
            self.value_columns = [*named, self._find(long.value, "long.value")]
        elif self.wanted:
            self.value_columns = [self._find(name, "points") for name in self.wanted]
        else:
            self.value_columns = [i for i in range(len(self.header)) if i not in self.time_columns]

    @property
    def needed(self) -> list[int]:
        """Column numbers to read, ascending."""
        return sorted({*self.time_columns, *self.value_columns})

    def _find(self, name: str | int, key: str) -> int:
        if isinstance(name, int) and 0 <= name < len(self.header):
            return name
        if name in self.header:
            return self.header.index(str(name))
        close = get_close_matches(str(name), self.header, n=3, cutoff=0.5)
        near = f"Did you mean {' or '.join(repr(c) for c in close)}?" if close else ""
        columns = ", ".join(repr(c) for c in self.header[:40])
        raise Refused(
            f"{self.path.name}: there is no column {name!r} (asked for by {key}). {near or f'Columns: {columns}.'}"
        )

    def _find_time(self) -> list[int]:
        time = self.options.time
        if time.start is not None:
            return []
        if time.columns:
            return [self._find(c, "time.columns") for c in time.columns]
        if time.column is not None:
            return [self._find(time.column, "time.column")]
        lowered = [h.strip().lower() for h in self.header]
        for name in _TIME_NAMES:
            if name in lowered:
                return [lowered.index(name)]
        columns = ", ".join(repr(c) for c in self.header[:40])
        raise Refused(
            f"{self.path.name}: no column looks like the time (columns: {columns}). "
            "Say time: {column: NAME}, or time: {start: ..., step: ...} if the file has none."
        )

    def batch(self, frame: pd.DataFrame, rows: IntArray) -> Batch:
        """Samples of some rows; ``frame`` has the needed columns by number. Rows without a time are rejected.

        ``rows`` numbers them, shape (len(frame),), where there is no time column.
        """
        series = None
        if self.options.long and self.options.long.point is None:
            series = np.full(len(frame), stem(self.path), dtype=object)
        elif self.options.long:
            series = frame[self.value_columns[0]].astype("str").to_numpy(dtype=object)
        time = self._time(frame, rows, series)
        keep = time != NOT_A_TIME
        if self.options.long:
            return self._long(frame, time, keep, series)
        return self._wide(frame, time, keep)

    def _time(self, frame: pd.DataFrame, rows: IntArray, series: NDArray[np.object_] | None) -> IntArray:
        if not self.time_columns:
            return self.clock.stepped(rows)
        before = self.clock.previous.get(ALL)
        if self.options.time.unit:
            time = self.clock.counted(frame[self.time_columns[0]])
            good = time[time != NOT_A_TIME]
            if len(good):
                self.clock.previous[ALL] = int(good[-1])
        else:
            text = frame[self.time_columns[0]]
            for column in self.time_columns[1:]:
                text = text.astype("str") + " " + frame[column].astype("str")
            time = self.clock.written(text, series)
        if series is None:
            self._count_order(time[time != NOT_A_TIME], before)
        return time

    def _count_order(self, time: IntArray, before: int | None) -> None:
        steps = np.diff(time, prepend=time[:1] if before is None else np.array([before]))
        if before is None:
            steps[:1] = 1
        self.count("row's time runs backwards", int((steps < 0).sum()))
        self.count("row's time stands twice", int((steps == 0).sum()))

    def _wide(self, frame: pd.DataFrame, time: IntArray, keep: NDArray[np.bool_]) -> Batch:
        columns = self.value_columns
        value = np.column_stack([self.numbers(frame[c]) for c in columns]) if columns else np.empty((len(frame), 0))
        return Batch.of_table([self.header[c] for c in columns], time[keep], value[keep])

    def _long(
        self, frame: pd.DataFrame, time: IntArray, keep: NDArray[np.bool_], series: NDArray[np.object_] | None
    ) -> Batch:
        assert series is not None
        code, names = pd.factorize(series[keep])
        return Batch(
            names=tuple(str(n).strip() for n in names),
            point=code.astype(np.int32),
            time=time[keep],
            value=self.numbers(frame[self.value_columns[-1]])[keep],
            quality=np.full(int(keep.sum()), Quality.GOOD, dtype=np.uint8),
        )

    def numbers(self, column: pd.Series) -> FloatArray:
        """Values of a column; words for on and off count as 1 and 0, other texts as missing (counted)."""
        if pd.api.types.is_numeric_dtype(column.dtype):
            return column.to_numpy(dtype=np.float64, na_value=np.nan)
        number = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan).copy()
        odd = np.isnan(number) & column.notna().to_numpy()
        if odd.any():
            words = column[odd].astype("str").str.strip()
            known = words.str.lower().map(_TRUTH).to_numpy(dtype=np.float64)
            number[odd] = known
            blank = words.isin([*NO_VALUE, *self.options.missing]).to_numpy()
            self.count("value is no number", int((np.isnan(known) & ~blank).sum()))
        return number

    def count(self, reason: str, number: int) -> None:
        """Add to a counter."""
        if number:
            self.counts[reason] = self.counts.get(reason, 0) + number


def table_options(frame_columns: Sequence[int]) -> dict[str, Any]:
    """Arguments of ``read_csv`` that make columns numbers and keep texts as they are."""
    return {"header": None, "usecols": list(frame_columns), "keep_default_na": False, "low_memory": False}


def stem(path: Path) -> str:
    """A file's name without its endings: what it names where it holds one point."""
    return path.name.removesuffix(".gz").rpartition(".")[0] or path.name
