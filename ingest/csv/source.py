"""CSV files, wide or long, plain or gzipped, in any of the ways building management systems write them."""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, TextIO, cast

import numpy as np
import pandas as pd

from fdd.config.base import SourceOptions
from fdd.records import Batch, IntArray, Quality
from ingest.csv.files import FileSource
from ingest.csv.nature import REMEDIES, nature
from ingest.csv.options import CsvOptions
from ingest.csv.table import NO_VALUE, Table, table_options
from ingest.source import Refused

_DELIMITERS = (",", ";", "\t", "|")


class CsvSource(FileSource):
    """Replays CSV files. A field may be quoted, but may not hold a line break."""

    options: ClassVar[type[SourceOptions]] = CsvOptions

    @property
    def _csv(self) -> CsvOptions:
        return cast(CsvOptions, self._options)

    def _open_text(self, path: Path, errors: str) -> TextIO:
        encoding = "utf-8-sig" if self._csv.encoding.lower() in {"utf-8", "utf8"} else self._csv.encoding
        opener = gzip.open if path.suffix == ".gz" else open
        return cast(TextIO, opener(path, "rt", encoding=encoding, errors=errors, newline=None))

    def _check(self, path: Path) -> None:
        self._require_text(path)
        try:
            with self._open_text(path, "strict") as file:
                self._head(file, path)
        except (UnicodeDecodeError, LookupError) as error:
            raise Refused(
                f"{path.name} is not {self._csv.encoding} ({error}); set encoding, for example latin-1"
            ) from None
        except (OSError, EOFError) as error:
            raise Refused(f"{path.name} cannot be read ({error})") from None

    def _require_text(self, path: Path) -> None:
        found, zipped = nature(path), path.suffix == ".gz"
        if found == ("gzip" if zipped else "text") or found == self._csv.encoding.lower():
            return
        if zipped:
            raise Refused(f"{path.name} is not compressed, though its name says so; rename it")
        raise Refused(f"{path.name} is no CSV: {REMEDIES[found]}")

    def _head(self, file: TextIO, path: Path) -> tuple[Table, str, int]:
        """The table, its delimiter, and how many lines stand before the data."""
        lines = 0
        for _ in range(self._csv.skip_rows):
            file.readline()
            lines += 1
        if not self._csv.header:
            return self._table(list(self._csv.columns), path), self._csv.delimiter or ",", lines
        while True:
            line = file.readline()
            lines += 1
            if not line:
                raise Refused(f"{path.name} has no header line; is it empty? Otherwise set skip_rows or header: false")
            if line.strip() and not self._is_comment(line):
                break
        delimiter = self._csv.delimiter or max(_DELIMITERS, key=line.count)
        header = [h.strip() for h in next(csv.reader([line], delimiter=delimiter))]
        return self._table(distinct(header), path), delimiter, lines

    def _is_comment(self, line: str) -> bool:
        return self._csv.comment is not None and line.lstrip().startswith(self._csv.comment)

    def _read(self, path: Path) -> Iterator[Batch]:
        with self._open_text(path, "replace") as file:
            table, delimiter, lines = self._head(file, path)
            done, row = int(self._position["line"]), int(self._position["row"])
            if done > lines:
                for _ in islice(file, done - lines):
                    pass
                lines = done
            whole = True
            while whole:
                block, whole = self._block(file, path, lines)
                good, rows, cut = self._fitting(block, delimiter, len(table.header), path, lines)
                lines += len(block)
                if not good:
                    continue
                frame = self._frame(good, table, delimiter)
                after = row + int(rows[-1]) + 1
                batch = replace(table.batch(frame, self._numbered(row + rows)), position=self._after(lines, after))
                if cut and len(batch) and not self._csv.long:
                    # Nothing says that the last number of a file without a last line end is whole.
                    batch.quality[-len(table.value_columns) :] = Quality.UNCERTAIN
                row = after
                yield batch

    def _block(self, file: TextIO, path: Path, before: int) -> tuple[list[str], bool]:
        """The next lines, and whether there may be more."""
        block: list[str] = []
        try:
            block.extend(islice(file, self._options.batch_rows))
        except (EOFError, OSError, zlib.error) as error:
            note = f"{path.name}: cut short after line {before + len(block)} ({error})"
            self._count("file cut short", 1, note)
            return block, False
        return block, bool(block)

    def _fitting(
        self, block: list[str], delimiter: str, width: int, path: Path, before: int
    ) -> tuple[list[str], IntArray, bool]:
        """Lines with the right number of fields, the others counted.

        Also the number of each among the rows of the block, rejected ones counted too, and whether the last one lacks
        its line end.
        """
        good, rows, row = [], [], 0
        for i, line in enumerate(block):
            if not line.strip() or self._is_comment(line):
                continue
            row += 1
            if line.count(delimiter) + 1 == width and '"' not in line:
                fields = width
            else:
                fields = len(next(csv.reader([line], delimiter=delimiter)))
            if fields == width:
                good.append(line)
                rows.append(row - 1)
                continue
            cut = i == len(block) - 1 and not line.endswith("\n")
            reason = "last line cut short" if cut else "line has the wrong number of fields"
            number = before + i + 1
            self._count(reason, 1, f"{path.name}, line {number}: {reason} ({fields} instead of {width})")
        return good, np.array(rows, dtype=np.int64), bool(good) and not good[-1].endswith("\n")

    def _frame(self, lines: list[str], table: Table, delimiter: str) -> pd.DataFrame:
        options = self._csv
        texts = [*table.time_columns, *(table.value_columns[:1] if options.long else [])]
        frame = pd.read_csv(
            io.StringIO("".join(lines)),
            sep=delimiter,
            decimal=options.decimal,
            thousands=options.thousands,
            na_values=cast(Any, {c: [*NO_VALUE, *options.missing] for c in table.value_columns}),
            dtype=dict.fromkeys(texts, "str"),
            skipinitialspace=True,
            skip_blank_lines=False,
            **table_options(table.needed),
        )
        return cast(pd.DataFrame, frame)


def distinct(header: list[str]) -> list[str]:
    """Repeated names get .1, .2 as elsewhere in the pandas world."""
    seen: dict[str, int] = {}
    out = []
    for name in header:
        n = seen.get(name, 0)
        seen[name] = n + 1
        out.append(f"{name}.{n}" if n else name)
    return out
