"""Parquet files, wide or long."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
import pandas as pd
import pyarrow.parquet

from fdd.limits import HEADER_COLUMNS, PARQUET_TEXT_BYTES
from fdd.records import Batch
from fdd.tables import SourceOptions
from ingest.csv.files import FileSource
from ingest.csv.options import ParquetOptions
from ingest.csv.table import Table
from ingest.source import Refused

# Arrow's own errors are of these kinds, and so are those of the texts and times inside.
_DAMAGED = (OSError, ValueError, TypeError, MemoryError, NotImplementedError, pyarrow.ArrowException)


class ParquetSource(FileSource):
    """Replays Parquet files."""

    options: ClassVar[type[SourceOptions]] = ParquetOptions

    def _check(self, path: Path) -> None:
        self._head(path)

    def _head(self, path: Path) -> tuple[Table, pyarrow.parquet.ParquetFile]:
        try:
            file = pyarrow.parquet.ParquetFile(
                path,
                thrift_string_size_limit=PARQUET_TEXT_BYTES,
                thrift_container_size_limit=HEADER_COLUMNS * 50,
                page_checksum_verification=True,
            )
            names = [str(name) for name in file.schema_arrow.names]
        except _DAMAGED as error:
            raise Refused(f"{path.name} is no Parquet file ({error!s:.200})") from None
        if not 0 < len(names) <= HEADER_COLUMNS:
            raise Refused(f"{path.name} has {len(names)} columns; {HEADER_COLUMNS} are read")
        table = self._table(names, path)
        self.require_plausible(path, file.metadata.num_rows * 8 * len(table.needed))
        return table, file

    def _read(self, path: Path) -> Iterator[Batch]:
        table, file = self._head(path)
        done, row = int(self._position["row"]), 0
        names = [table.header[i] for i in table.needed]
        for chunk in self._chunks(file, names, path):
            skip = min(max(done - row, 0), chunk.num_rows)
            row += chunk.num_rows
            self.require_plausible(path, row * 8 * len(names))  # what the file says of itself may be wrong
            if skip == chunk.num_rows:
                continue
            frame = self._frame(chunk.slice(skip), names, path)
            if frame is None:
                continue
            frame = frame[names].set_axis(table.needed, axis=1)
            rows = np.arange(row - len(frame), row, dtype=np.int64)
            yield replace(self._samples(table, frame, rows, path), position=self._after(row, row))

    def _chunks(self, file: pyarrow.parquet.ParquetFile, names: list[str], path: Path) -> Iterator[pyarrow.RecordBatch]:
        try:
            yield from file.iter_batches(batch_size=self._options.batch_rows, columns=names)
        except _DAMAGED as error:
            self._count("file cut short", 1, f"{path.name}: cannot be read on ({error!s:.200})")

    def _frame(self, chunk: pyarrow.RecordBatch, names: list[str], path: Path) -> pd.DataFrame | None:
        try:
            return cast(pd.DataFrame, chunk.to_pandas(ignore_metadata=True)[names])
        except (*_DAMAGED, KeyError) as error:
            self._count("row cannot be read", chunk.num_rows, f"{path.name}: {type(error).__name__}: {error!s:.200}")
            return None
