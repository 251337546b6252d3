"""Sheets of workbooks (.xlsx, .xls, .xlsb, .ods), wide or long."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
import pandas as pd

from fdd.records import Batch
from fdd.tables import SourceOptions
from ingest.csv.files import FileSource
from ingest.csv.options import ExcelOptions
from ingest.csv.source import distinct
from ingest.csv.table import Table
from ingest.source import Refused


class ExcelSource(FileSource):
    """Replays one sheet of each workbook."""

    options: ClassVar[type[SourceOptions]] = ExcelOptions

    @property
    def _excel(self) -> ExcelOptions:
        return cast(ExcelOptions, self._options)

    def _check(self, path: Path) -> None:
        self._head(path)

    def _head(self, path: Path) -> tuple[Table, pd.DataFrame]:
        rows = read_sheet(path, self._excel.sheet).iloc[self._excel.skip_rows :]
        if rows.empty:
            raise Refused(f"{path.name}, sheet {self._excel.sheet!r} has no header row; set sheet or skip_rows")
        header = ["" if pd.isna(h) else str(h).strip() for h in rows.iloc[0]]
        return self._table(distinct(header), path), rows.iloc[1:]

    def _read(self, path: Path) -> Iterator[Batch]:
        table, rows = self._head(path)
        for start in range(int(self._position["row"]), len(rows), self._options.batch_rows):
            frame = rows.iloc[start : start + self._options.batch_rows][table.needed].reset_index(drop=True)
            for column in table.time_columns:
                frame[column] = whole_times(frame[column])
            stop = start + len(frame)
            numbers = np.arange(start, stop, dtype=np.int64)
            yield replace(self._samples(table, frame, numbers, path), position=self._after(stop, stop))


def read_sheet(path: Path, sheet: str | int = 0, rows: int | None = None) -> pd.DataFrame:
    """Cells of a sheet as they are, columns by number; the first ``rows`` of them.

    Raises
    ------
    Refused : no workbook, or no such sheet.
    """
    try:
        _require_plausible(path)
        cells = pd.read_excel(path, sheet_name=sheet, header=None, dtype=object, engine="calamine", nrows=rows)
    except Refused:
        raise
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the reader raises its own kinds; what it calls a panic is no Exception
        raise Refused(f"{path.name}, sheet {sheet!r} cannot be read ({error}); check path and sheet") from None
    return cells


def _require_plausible(path: Path) -> None:
    """Refuse a workbook whose parts unpack to what no plant ever wrote.

    Raises
    ------
    Refused : as it says.
    """
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as parts:
        FileSource.require_plausible(path, sum(part.file_size for part in parts.infolist()))


def whole_times(column: pd.Series) -> pd.Series:
    """Cells that hold dates, good to the millisecond: workbooks count days in decimals."""
    dates = pd.to_datetime(column.where(column.map(_is_date)), errors="coerce")
    if not dates.notna().any():
        return column
    rounded = dates.dt.round("ms")
    if (dates.notna() | column.isna()).all():
        return rounded
    return cast(pd.Series, rounded.dt.strftime("%Y-%m-%d %H:%M:%S.%f").where(dates.notna(), column.astype("str")))


def _is_date(cell: Any) -> bool:
    return hasattr(cell, "year")
