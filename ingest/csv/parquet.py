"""Parquet files, wide or long."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import pyarrow.parquet

from fdd.config.base import SourceOptions
from fdd.records import Batch
from ingest.csv.files import FileSource
from ingest.csv.options import ParquetOptions
from ingest.csv.table import Table
from ingest.source import Refused


class ParquetSource(FileSource):
    """Replays Parquet files."""

    options: ClassVar[type[SourceOptions]] = ParquetOptions

    def _check(self, path: Path) -> None:
        self._head(path)

    def _head(self, path: Path) -> tuple[Table, pyarrow.parquet.ParquetFile]:
        try:
            file = pyarrow.parquet.ParquetFile(path)
        except (OSError, pyarrow.ArrowInvalid) as error:
            raise Refused(f"{path.name} is no Parquet file ({error})") from None
        return self._table(list(file.schema_arrow.names), path), file

    def _read(self, path: Path) -> Iterator[Batch]:
        table, file = self._head(path)
        done, row = int(self._position["row"]), 0
        names = [table.header[i] for i in table.needed]
        for chunk in file.iter_batches(batch_size=self._options.batch_rows, columns=names):
            skip = min(max(done - row, 0), chunk.num_rows)
            row += chunk.num_rows
            if skip == chunk.num_rows:
                continue
            frame: pd.DataFrame = chunk.slice(skip).to_pandas(ignore_metadata=True)
            frame = frame[names].set_axis(table.needed, axis=1)
            rows = self._numbered(np.arange(row - len(frame), row, dtype=np.int64))
            yield replace(table.batch(frame, rows), position=self._after(row, row))
