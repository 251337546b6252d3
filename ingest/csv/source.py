"""CSV files, wide or long, plain or gzipped, in any of the ways building management systems write them."""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, TextIO, cast

import numpy as np
import pandas as pd

from fdd.limits import BLOCK_CHARACTERS, HEADER_COLUMNS, LINE_CHARACTERS
from fdd.records import Batch, IntArray, Quality
from fdd.tables import SourceOptions
from ingest.csv.files import FileSource
from ingest.csv.nature import REMEDIES, nature
from ingest.csv.options import CsvOptions
from ingest.csv.table import NO_VALUE, Table, table_options
from ingest.source import Refused

_DELIMITERS = (",", ";", "\t", "|")
_DAMAGED = (OSError, EOFError, zlib.error)


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
        except (UnicodeError, LookupError) as error:
            raise Refused(
                f"{path.name} is not {self._csv.encoding} ({error}); set encoding, for example latin-1"
            ) from None
        except _DAMAGED as error:
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
            self._line(file, path, lines)
            lines += 1
        if not self._csv.header:
            return self._table(list(self._csv.columns), path), self._csv.delimiter or ",", lines
        while True:
            line = self._line(file, path, lines)
            lines += 1
            if not line:
                raise Refused(f"{path.name} has no header line; is it empty? Otherwise set skip_rows or header: false")
            if line.strip() and not self._is_comment(line):
                break
        delimiter = self._csv.delimiter or max(_DELIMITERS, key=line.count)
        header = [h.strip() for h in _fields(line, delimiter)]
        if not 0 < len(header) <= HEADER_COLUMNS:
            raise Refused(f"{path.name}, line {lines}: a header of {len(header)} columns; {HEADER_COLUMNS} are read")
        return self._table(distinct(header), path), delimiter, lines

    def _is_comment(self, line: str) -> bool:
        return self._csv.comment is not None and line.lstrip().startswith(self._csv.comment)

    @staticmethod
    def _line(file: TextIO, path: Path, before: int) -> str:
        """The next line; empty at the end of the file.

        Raises
        ------
        Refused : it is longer than any line of samples.
        """
        line = file.readline(LINE_CHARACTERS)
        if len(line) == LINE_CHARACTERS and not line.endswith("\n"):
            raise Refused(
                f"{path.name}, line {before + 1}: longer than {LINE_CHARACTERS} characters; is this a file of samples?"
            )
        return line

    def _read(self, path: Path) -> Iterator[Batch]:
        try:
            yield from self._whole(path)
        except _DAMAGED as error:
            self._count("file cut short", 1, f"{path.name}: cannot be read on ({error})")

    def _whole(self, path: Path) -> Iterator[Batch]:
        with self._open_text(path, "replace") as file:
            table, delimiter, lines = self._head(file, path)
            done, row = int(self._position["line"]), int(self._position["row"])
            while lines < done and self._line(file, path, lines):
                lines += 1
            unpacked, whole = 0, True
            while whole:
                block, whole = self._block(file, path, lines)
                unpacked += sum(map(len, block))
                self.require_plausible(path, unpacked)
                good, rows, cut = self._fitting(block, delimiter, len(table.header), path, lines)
                lines += len(block)
                if not good:
                    continue
                frame = self._frame(good, table, delimiter, path)
                after = row + int(rows[-1]) + 1
                batch = replace(self._samples(table, frame, row + rows, path), position=self._after(lines, after))
                if cut and len(batch) and not self._csv.long:
                    # Nothing says that the last number of a file without a last line end is whole.
                    batch.quality[-len(table.value_columns) :] = Quality.UNCERTAIN
                row = after
                yield batch

    def _block(self, file: TextIO, path: Path, before: int) -> tuple[list[str], bool]:
        """The next lines, and whether there may be more."""
        block: list[str] = []
        size = 0
        try:
            while len(block) < self._options.batch_rows and size < BLOCK_CHARACTERS:
                line = self._line(file, path, before + len(block))
                if not line:
                    break
                block.append(line)
                size += len(line)
        except (*_DAMAGED, Refused) as error:
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
            plain = line.count(delimiter) + 1 == width and '"' not in line
            fields = width if plain else len(_fields(line, delimiter))
            if fields == width:
                good.append(line)
                rows.append(row - 1)
                continue
            cut = i == len(block) - 1 and not line.endswith("\n")
            reason = "last line cut short" if cut else "line has the wrong number of fields"
            number = before + i + 1
            self._count(reason, 1, f"{path.name}, line {number}: {reason} ({fields} instead of {width})")
        return good, np.array(rows, dtype=np.int64), bool(good) and not good[-1].endswith("\n")

    def _frame(self, lines: list[str], table: Table, delimiter: str, path: Path) -> pd.DataFrame:
        """Lines as columns; of lines that pandas refuses, those that it takes one half at a time."""
        try:
            return self._parsed(lines, table, delimiter)
        except (ValueError, OverflowError, MemoryError) as error:  # pandas' ParserError is a ValueError
            if len(lines) > 1:
                half = len(lines) // 2
                halves = [self._frame(part, table, delimiter, path) for part in (lines[:half], lines[half:])]
                return pd.concat(halves, ignore_index=True)
            self._count("row cannot be read", 1, f"{path.name}: {lines[0]!r:.80}: {error!s:.200}")
            return self._parsed([delimiter * (len(table.header) - 1) + "\n"], table, delimiter)

    def _parsed(self, lines: list[str], table: Table, delimiter: str) -> pd.DataFrame:
        options = self._csv
        texts = [*table.time_columns, *(table.value_columns[:-1] if options.long else [])]
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
        if len(frame) != len(lines):  # a quotation mark that is never closed swallows the lines after it
            raise ValueError(f"{len(lines)} lines were read as {len(frame)} rows")
        return cast(pd.DataFrame, frame)


def _fields(line: str, delimiter: str) -> list[str]:
    """The fields of a line; none where quotation marks or zeros make it no line of CSV."""
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []


def distinct(header: list[str]) -> list[str]:
    """Repeated names get .1, .2 as elsewhere in the pandas world."""
    seen: dict[str, int] = {}
    out = []
    for name in header:
        n = seen.get(name, 0)
        seen[name] = n + 1
        out.append(f"{name}.{n}" if n else name)
    return out
