"""How a table is laid out: signs, lines before the header, the columns of time, one value a line or one row a time."""

from __future__ import annotations

import csv
import gzip
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet

from fdd.onboarding import times
from fdd.onboarding.guess import ExportError, Guess
from fdd.onboarding.vocabulary import facets, words
from fdd.units import UnitError, conversion
from ingest.csv.excel import read_sheet, whole_times
from ingest.csv.nature import nature
from ingest.csv.source import distinct
from ingest.csv.table import NO_VALUE

_ENCODINGS = ("utf-8-sig", "cp1252")
_HEAD_LINES = 400
_LOOKED_AT = 4000
_POINT_NAMES = {"point", "tag", "name", "sensor", "variable", "channel", "messpunkt", "tagname", "pointname", "signal",
                "series", "id", "item", "register", "datapoint", "datenpunkt", "object", "metric", "field"}  # fmt: skip
_VALUE_NAMES = {"value", "reading", "wert", "messwert", "val", "valeur", "valor", "valore", "vaerdi", "presentvalue",
                "data"}  # fmt: skip
_NUMBER = re.compile(r"^[-+]?[\d.,\s]*\d[\d.,]*(?:[eE][-+]?\d+)?$")


@dataclass
class Layout:
    """How one file is read: keys of its source, its value columns, and what was guessed on the way."""

    path: Path
    kind: str
    options: dict[str, Any] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    zoned: bool = False

    @property
    def long(self) -> bool:
        """Whether each line holds one value."""
        return "long" in self.options


def layout_of(path: Path) -> Layout:
    """Look at one file.

    Raises
    ------
    ExportError : it is no table, or nothing in it looks like a time.
    """
    kind = nature(path)
    if kind == "parquet":
        return _of_parquet(path)
    if kind == "excel":
        return _of_workbook(path)
    if kind not in ("text", "gzip", "utf-16"):
        raise ExportError(f"{path}: a file of kind {kind} is no table; give CSV, a workbook or Parquet")
    return _of_text(path, kind)


def _of_parquet(path: Path) -> Layout:
    file = pyarrow.parquet.ParquetFile(path)
    frame: pd.DataFrame = next(file.iter_batches(batch_size=_LOOKED_AT)).to_pandas(ignore_metadata=True)
    cells = frame.set_axis([str(c) for c in frame.columns], axis=1)
    return _arranged(Layout(path, "parquet"), _texts(cells))


def _of_workbook(path: Path) -> Layout:
    cells = read_sheet(path, 0)
    rows = [["" if pd.isna(c) else str(c) for c in row] for row in cells.head(_HEAD_LINES).itertuples(index=False)]
    at = _header_row(rows)
    frame = cells.iloc[at + 1 :]
    frame = frame.set_axis(distinct([r.strip() for r in rows[at]]), axis=1).head(_LOOKED_AT)
    frame = frame.apply(whole_times)
    layout = Layout(path, "excel", {"skip_rows": at} if at else {})
    return _arranged(layout, _texts(_without_unit_row(layout, frame)))


def _texts(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.astype("str").where(frame.notna(), "").replace({"NaT": "", "nan": "", "None": ""})


def _of_text(path: Path, kind: str) -> Layout:
    encoding = "utf-16" if kind == "utf-16" else _encoding(path)
    lines = _lines(path, encoding)
    layout = Layout(path, "csv", {} if encoding == "utf-8-sig" else {"encoding": encoding})
    comment = _comment(lines)
    if comment:
        layout.options["comment"] = comment
    kept = [(i, line) for i, line in enumerate(lines) if line.strip() and not (comment and line.startswith(comment))]
    if len(kept) < 3:
        raise ExportError(f"{path}: it has {len(kept)} lines of data; give a table of at least three rows")
    delimiter = _delimiter([line for _, line in kept])
    rows = [next(csv.reader([line], delimiter=delimiter)) for _, line in kept]
    at = _header_row(rows)
    headed = not _is_data(rows[at])
    if headed:
        header = distinct([h.strip() for h in rows[at]])
        if at:
            layout.options["skip_rows"] = kept[at][0]
        # The source finds it from the header line, where that has more of it than of any other sign.
        if delimiter != max((",", ";", "\t", "|"), key=kept[at][1].count):
            layout.options["delimiter"] = delimiter
        body = rows[at + 1 :]
    else:
        header = [f"column {i}" for i in range(len(rows[at]))]
        layout.options |= {"header": False, "columns": header, "delimiter": delimiter, "skip_rows": kept[at][0]}
        layout.guesses.append(Guess("columns", ", ".join(header), "unsure", "the file has no header"))
        body = rows[at:]
    body = [r for r in body if len(r) == len(header)]
    frame = pd.DataFrame(body, columns=header)
    frame = _without_unit_row(layout, frame)
    if layout.units and headed:
        # The line of units is no data: the header is given and both lines are skipped.
        skip = kept[at + 1][0] + 1
        layout.options |= {"header": False, "columns": header, "delimiter": delimiter, "skip_rows": skip}
    _decimal(layout, frame, delimiter)
    return _arranged(layout, frame)


def _encoding(path: Path) -> str:
    opener = gzip.open if path.suffix == ".gz" else open
    for encoding in _ENCODINGS:
        try:
            with opener(path, "rt", encoding=encoding) as file:
                while file.read(1 << 20):
                    pass
            return encoding
        except UnicodeDecodeError:
            continue
        except (OSError, EOFError):
            break
    return "latin-1"


def _lines(path: Path, encoding: str) -> list[str]:
    """The first lines, and others from all over the file: dates of later months tell day from month."""
    opener = gzip.open if path.suffix == ".gz" else open
    try:
        with opener(path, "rt", encoding=encoding, errors="replace") as file:
            whole = file.read().splitlines()
    except (OSError, EOFError) as error:
        raise ExportError(f"{path}: it cannot be read to its end ({error}); export it again") from None
    every = max(1, (len(whole) - _HEAD_LINES) // (_LOOKED_AT - _HEAD_LINES))
    return whole[:_HEAD_LINES] + whole[_HEAD_LINES::every]


def _comment(lines: list[str]) -> str | None:
    for sign in ("#", "//", "%", "*"):
        if lines and lines[0].startswith(sign) and sum(line.startswith(sign) for line in lines) > 0:
            return sign
    return None


def _delimiter(lines: list[str]) -> str:
    """The sign that gives most lines the same number of fields, above one."""
    best = (0.0, 0, ",")
    for sign in (";", "\t", ",", "|"):
        counts = Counter(len(next(csv.reader([line], delimiter=sign))) for line in lines[:_HEAD_LINES])
        fields, times_seen = max(counts.items(), key=lambda c: (c[0] > 1, c[1]))
        if fields > 1:
            best = max(best, (times_seen / min(len(lines), _HEAD_LINES), fields, sign))
    if best[1] == 0:
        raise ExportError("no sign parts the lines into columns (tried ; tab , |); export with a delimiter")
    return best[2]


def _header_row(rows: list[list[str]]) -> int:
    """The last row of full width before the first row of data."""
    width = Counter(len(r) for r in rows).most_common(1)[0][0]
    first = next((i for i, r in enumerate(rows) if len(r) == width and _is_data(r)), 0)
    above = [i for i in range(first) if len(rows[i]) == width and sum(bool(c.strip()) for c in rows[i]) > width / 2]
    if not above:
        return first
    units = above[-1]
    return above[-2] if len(above) > 1 and _is_unit_row(rows[units]) else units


def _is_data(row: list[str]) -> bool:
    said = [c.strip() for c in row if c.strip()]
    return bool(said) and sum(bool(_NUMBER.match(c)) or times.is_time_text([c]) for c in said) >= max(
        1, 0.4 * len(said)
    )


def _is_unit_row(row: list[str]) -> bool:
    said = [c.strip() for c in row if c.strip()]
    return bool(said) and sum(unit_in(f"[{c}]") is not None for c in said) >= 0.5 * len(said)


def _without_unit_row(layout: Layout, frame: pd.DataFrame) -> pd.DataFrame:
    if len(frame) and _is_unit_row([str(c) for c in frame.iloc[0] if not pd.isna(c)]):
        first = frame.iloc[0]
        layout.units = {c: str(first[c]).strip() for c in _names(frame) if unit_in(f"[{first[c]}]")}
        return frame.iloc[1:]
    return frame


def _decimal(layout: Layout, frame: pd.DataFrame, delimiter: str) -> None:
    cells = [c.strip() for column in _names(frame) for c in frame[column].head(300) if _NUMBER.match(c.strip())]
    comma = sum(bool(re.fullmatch(r"[-+]?\d+,\d+", c)) for c in cells)
    point = sum(bool(re.fullmatch(r"[-+]?\d+\.\d+", c)) for c in cells)
    if delimiter != "," and comma > point:
        layout.options["decimal"] = ","
        layout.guesses.append(Guess("decimal", ",", "sure", f"{comma} numbers are written so"))
        if any(re.fullmatch(r"[-+]?\d{1,3}(\.\d{3})+,\d+", c) for c in cells):
            layout.options["thousands"] = "."


def _names(frame: pd.DataFrame) -> list[str]:
    return [str(c) for c in frame.columns]


def numbers(cells: pd.Series, options: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Numbers of a column of texts, by the file's own signs."""
    text = cells.astype("str").str.strip()
    if "thousands" in options:
        text = text.str.replace(options["thousands"], "", regex=False)
    if options.get("decimal") == ",":
        text = text.str.replace(",", ".", regex=False)
    return pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)


def _arranged(layout: Layout, frame: pd.DataFrame) -> Layout:
    """Find the time and tell long from wide."""
    taken = _time(layout, frame)
    rest = [c for c in _names(frame) if c not in taken]
    point = [c for c in rest if _is_point_column(c, frame[c])]
    value = [c for c in rest if "".join(words(c)) in _VALUE_NAMES] or [
        c for c in rest if c not in point and np.isfinite(numbers(frame[c], layout.options)).mean() > 0.5
    ]
    if point and value and len(rest) <= 5:
        layout.options["long"] = {"point": point[0], "value": value[0]}
        layout.columns = tuple(dict.fromkeys(frame[point[0]].str.strip()))
        layout.guesses.append(Guess("long", f"{point[0]}: {value[0]}", "sure", "one value a line"))
        return layout
    layout.columns = tuple(c for c in rest if c.strip())
    _sentinels(layout, frame[list(layout.columns)])
    return layout


def _is_point_column(name: str, cells: pd.Series) -> bool:
    seen = cells[cells.str.strip() != ""]
    if not len(seen) or seen.map(lambda c: bool(_NUMBER.match(c))).mean() > 0.1:
        return False
    named = bool({*words(name), "".join(words(name))} & _POINT_NAMES)
    return named and 1 < seen.nunique() <= max(2, len(seen) / 2) and seen.str.lower().nunique() > 1


def _time(layout: Layout, frame: pd.DataFrame) -> list[str]:
    """The columns of the time; their keys go into ``layout.options``."""
    dates = [c for c in _names(frame) if times.is_time_text(list(frame[c]))]
    clocks = [c for c in _names(frame) if times.is_clock_text(list(frame[c]))]
    named = [c for c in dates if times.is_time_name(c)] or dates
    if named and clocks and not any(":" in c for c in frame[named[0]].head(50)):
        cells = list(frame[named[0]] + " " + frame[clocks[0]])
        options, guesses = times.written(cells)
        where: dict[str, Any] = {"columns": [named[0], clocks[0]]}
        taken = [named[0], clocks[0]]
    elif named:
        cells = list(frame[named[0]])
        options, guesses = times.written(cells)
        where, taken = {"column": named[0]}, [named[0], *(c for c in dates if c != named[0])]
    else:
        return _count(layout, frame)
    layout.zoned = times.carries_offset(cells)
    layout.options["time"] = {**where, **options}
    layout.guesses += [Guess("time.column", ", ".join(taken), "sure", "dates stand there"), *guesses]
    return taken


def _count(layout: Layout, frame: pd.DataFrame) -> list[str]:
    for column in sorted(_names(frame), key=lambda c: not times.is_time_name(c)):
        found = times.counted(column, numbers(frame[column], layout.options))
        if found:
            options, guesses = found
            layout.options["time"] = {"column": column, **options}
            layout.zoned = "origin" not in options
            layout.guesses += [Guess("time.column", column, "likely", "numbers that rise"), *guesses]
            return [column]
    layout.options["time"] = {"start": "2000-01-01 00:00", "step": "5 min"}
    layout.guesses.append(Guess("time.start", "2000-01-01 00:00, every 5 min", "unsure", "no column holds a time"))
    return []


def _sentinels(layout: Layout, frame: pd.DataFrame) -> None:
    """Texts that repeat where numbers are expected mean that there is none."""
    texts: Counter[str] = Counter()
    for column in _names(frame):
        cells = frame[column].str.strip()
        number = np.isfinite(numbers(cells, layout.options))
        if number.mean() > 0.3:
            texts.update(c for c in cells[~number] if c and c not in NO_VALUE)
    found = sorted(t for t, n in texts.items() if n > 1)[:10]
    if found:
        layout.options["missing"] = found
        layout.guesses.append(Guess("missing", ", ".join(found), "likely", "texts among numbers"))


_BRACKETS = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]")


def unit_in(name: str) -> str | None:
    """A unit that a name says itself: in brackets, or as its last word (``Supply temp degC``, ``T_room_degF``)."""
    for text in reversed(_BRACKETS.findall(name)):
        known = _unit(text)
        if known:
            return known
    tail = re.split(r"[\s_,;]+", name.strip())[-1]
    return _unit(tail) if len(tail) > 1 and tail.lower() in _TAILS else None


_TAILS = {"degc", "degf", "°c", "°f", "kw", "kwh", "mwh", "mw", "gpm", "cfm", "l/s", "m3/h", "m³/h", "kg/s", "kpa",
          "pa", "psi", "bar", "inwc", "ppm", "lps", "w/m2", "w/m²", "percent", "pct", "%", "watts", "rpm", "hz",
          "lux"}  # fmt: skip


def _unit(text: str) -> str | None:
    text = {"watts": "W", "pct": "%", "deg c": "degC", "deg f": "degF"}.get(text.lower(), text.strip())
    text = text.replace("³", "3").replace("²", "2").replace("₂", "2")
    if not re.search(r"[A-Za-z%°]", text) or re.match(r"[-+.]?\d", text) or len(text) > 14:
        return None
    try:
        conversion(text)
    except UnitError:
        return None
    return text


def is_setpoint(name: str) -> bool:
    """Whether a point says what is wanted, or what somebody judged, not what is."""
    return bool(facets(name) & {"setpoint", "alarm", "limit"})
