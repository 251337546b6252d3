"""Keys of the ``csv``, ``excel`` and ``parquet`` sources."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from fdd.tables import Duration, SourceOptions, Strict, Zone, refusal


class TimeOptions(Strict):
    """Where time stands and how it is written. All keys left out: a column called time, timestamp, date ..., in ISO."""

    column: str | int | None = Field(default=None, description="name or number (from 0) of the time column")
    columns: tuple[str, ...] = Field(default=(), description="date column and time column, joined with a blank")
    format: str | None = Field(default=None, description="strptime format such as '%d.%m.%Y %H:%M'")
    day_first: bool | None = Field(default=None, description="05/02 is 5 February (true) or May 2nd (false)")
    zone: Zone | None = Field(default=None, description="zone of local times; defaults to the site's")
    unit: Literal["ns", "us", "ms", "s", "min", "h", "d"] | None = Field(
        default=None, description="the column counts this unit since 'origin'"
    )
    origin: str = Field(
        default="1970-01-01T00:00:00Z", description="time of a count of zero; local time unless it says otherwise"
    )
    start: str | None = Field(default=None, description="no time column: time of the first row")
    step: Duration | None = Field(default=None, description="no time column: time from row to row")
    ambiguous: Literal["by order", "earlier", "later", "reject"] = Field(
        default="by order", description="a local time that happens twice as clocks go back"
    )
    nonexistent: Literal["reject", "shift"] = Field(
        default="reject", description="a local time that clocks going forward leave out"
    )

    @model_validator(mode="after")
    def _one_way(self) -> TimeOptions:
        ways = {"column": self.column is not None, "columns": bool(self.columns), "start": self.start is not None}
        given = [k for k, v in ways.items() if v]
        if len(given) > 1:
            raise refusal(f"time is given by {' and by '.join(given)}", "Keep one of them.", given[1])
        if (self.start is None) != (self.step is None):
            raise refusal("'start' and 'step' go together", "Give both, or name the time column.", "start")
        if self.unit and (self.format or self.day_first is not None):
            raise refusal("a count since 'origin' has no format", "Leave out 'format' and 'day_first'.", "unit")
        return self


class LongOptions(Strict):
    """Files with one value a line: which column names the point, which holds the value."""

    point: str | None = Field(
        default=None, description="column that names the point; left out: the file's name does, without its ending"
    )
    value: str | int = Field(description="name or number (from 0) of the column that holds the value")


class FileOptions(SourceOptions):
    """What CSV and Parquet have in common."""

    path: Path | tuple[Path, ...] = Field(
        description="file, pattern such as 'data/*.csv', or a list, read in this order"
    )
    time: TimeOptions = Field(default=TimeOptions(), description="where time stands and how it is written")
    long: LongOptions | None = Field(default=None, description="for files with one value a line")
    missing: tuple[str, ...] = Field(default=(), description="texts that mean 'no value', such as 'N/A' or '-9999'")
    sorted: bool = Field(
        default=True, description="rows come in order of time; false: files are read whole and put in order first"
    )
    batch_rows: int = Field(default=20_000, gt=0, le=1_000_000, description="rows in a batch")

    @field_validator("missing", mode="before")
    @classmethod
    def _texts(cls, value: Any) -> Any:
        return tuple(str(v) for v in value) if isinstance(value, list | tuple) else value

    @property
    def in_order(self) -> bool:
        """Whether files can be read as they stand; one file a point cannot."""
        return self.sorted and (self.long is None or self.long.point is not None)

    @property
    def paths(self) -> tuple[Path, ...]:
        """Always a tuple."""
        return self.path if isinstance(self.path, tuple) else (self.path,)


class CsvOptions(FileOptions):
    """A CSV file, also gzipped (``.gz``)."""

    kind: Literal["csv"] = Field(description="csv")
    delimiter: str | None = Field(default=None, description="between columns; found from the header line when left out")
    decimal: Literal[".", ","] = Field(default=".", description="decimal sign")
    thousands: str | None = Field(default=None, description="sign between thousands")
    encoding: str = Field(default="utf-8", description="such as utf-8, latin-1, utf-16")
    skip_rows: int = Field(default=0, ge=0, description="lines before the header, or before the data if it has none")
    comment: str | None = Field(default=None, description="lines that start with this are skipped")
    header: bool = Field(default=True, description="whether a line names the columns")
    columns: tuple[str, ...] = Field(default=(), description="names of the columns where there is no header")

    @model_validator(mode="after")
    def _named(self) -> CsvOptions:
        if self.header == bool(self.columns):
            raise refusal(
                "'columns' are for files without a header", "Set 'header: false' and name every column.", "columns"
            )
        return self


class ParquetOptions(FileOptions):
    """A Parquet file."""

    kind: Literal["parquet"] = Field(description="parquet")


class ExcelOptions(FileOptions):
    """A sheet of a workbook: .xlsx, .xls, .xlsb or .ods."""

    kind: Literal["excel"] = Field(description="excel")
    sheet: str | int = Field(default=0, description="name or number (from 0) of the sheet")
    skip_rows: int = Field(default=0, ge=0, description="rows before the header")
