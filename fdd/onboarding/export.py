"""An export as it lies on the disk: its files put together into sources, and their columns read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fdd.onboarding.guess import ExportError, Guess
from fdd.onboarding.layout import Layout, layout_of, unit_in
from ingest.csv.files import joined
from ingest.csv.table import stem
from ingest.source import Context, Refused, make_source, options_type

TABLES = (".csv", ".txt", ".tsv", ".dat", ".xlsx", ".xls", ".xlsm", ".ods", ".parquet", ".pq", ".gz")
TAGS = (".json", ".zinc", ".ttl")


@dataclass
class ExportSource:
    """One source of the draft: the keys it is written with, and its columns as series over ``time`` (n,) [ns]."""

    keys: dict[str, Any]
    time: np.ndarray[Any, np.dtype[np.int64]]
    values: dict[str, np.ndarray[Any, np.dtype[np.float64]]]
    units: dict[str, str] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    zoned: bool = False
    rows: int = 0
    lost: dict[str, int] = field(default_factory=dict)


def files_of(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Tables and tag files among the paths, folders searched.

    Raises
    ------
    ExportError : a path is not there, or nothing that can be read lies in it.
    """
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise ExportError(f"{path} is not there; give a file or a folder of an export")
        found += sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    tags = [p for p in found if p.suffix.lower() in TAGS]
    tables = [p for p in found if p.suffix.lower() in TABLES or (p in paths and p not in tags)]
    if not tables and not tags:
        raise ExportError(
            f"nothing to read in {', '.join(map(str, paths))}: files end in {', '.join((*TABLES, *TAGS))}"
        )
    return tables, tags


def read(tables: Sequence[Path], zone: str, ask: Callable[[str, str, Sequence[str]], str] | None) -> list[ExportSource]:
    """Group the files of an export by how they are laid out, and read each group as the source that is written.

    Raises
    ------
    ExportError : no file could be read; the text says why of each.
    """
    layouts, refused = [], []
    for path in tables:
        try:
            layouts.append(layout_of(path))
        except (ExportError, Refused) as error:
            refused.append(str(error))
    if tables and not layouts:
        raise ExportError("no file of the export could be read\n  " + "\n  ".join(refused[:10]))
    if ask is not None:
        for layout in layouts:
            layout.options, layout.guesses = _settled(layout, ask)
    groups = list(_grouped(layouts))
    sources = [_read(group, zone, named=len(groups) > 1) for group in groups]
    sources = [_with_the_others(i, sources, group, zone) for i, group in enumerate(groups)]
    for text in refused:
        sources[0].guesses.append(Guess("file", "left out", "unsure", text))
    return sources


def _grouped(layouts: Sequence[Layout]) -> Iterator[list[Layout]]:
    """Files that are one source: laid out alike with the same columns, or one point each."""
    single = [la for la in layouts if not la.long and len(la.columns) == 1]
    if len(single) > 1 and not _one_after_another(single):
        alike: dict[str, list[Layout]] = {}
        for la in single:
            alike.setdefault(repr((la.kind, _form(la))), []).append(la)
        yield from alike.values()
        layouts = [la for la in layouts if la not in single]
    wide: dict[str, list[Layout]] = {}
    for la in layouts:
        key = repr((la.kind, _form(la), () if la.long else la.columns))
        wide.setdefault(key, []).append(la)
    yield from wide.values()


def _form(layout: Layout) -> dict[str, Any]:
    """What two files of a source must have in common: all but the sentinels and, one a point, the columns' names."""
    own = {k: v for k, v in layout.options.items() if k not in ("missing", "columns")}
    time = dict(own.get("time", {}))
    # A file of the first days of a month cannot say which comes first; its sisters can.
    time.pop("day_first", None)
    return {**own, "time": time}


def _one_after_another(single: Sequence[Layout]) -> bool:
    """Whether files of one column are parts of one record: the same column, and names that count or date."""
    same = len({la.columns for la in single}) == 1
    return same and len({re.sub(r"\d+", "", la.path.name) for la in single}) == 1


def _read(group: list[Layout], zone: str, *, named: bool) -> ExportSource:
    first = _most_telling(group)
    keys: dict[str, Any] = {"kind": first.kind}
    if named:
        keys["name"] = re.sub(r"\W+", "-", stem(group[0].path)).strip("-").lower() or "export"
    keys["path"] = str(first.path) if len(group) == 1 else [str(la.path) for la in group]
    keys |= {k: v for k, v in first.options.items() if k != "missing"}
    missing = sorted({m for la in group for m in la.options.get("missing", ())})
    if missing:
        keys["missing"] = missing
    point_each = len(group) > 1 and not first.long and len(first.columns) == 1 and not _one_after_another(group)
    if point_each:
        time_columns = keys.get("time", {})
        keys["long"] = {"value": 2 if "columns" in time_columns else 0 if "start" in time_columns else 1}
    units = {k: v for la in group for k, v in la.units.items()}
    if point_each:
        units |= {stem(la.path): u for la in group for u in la.units.values()}
        units |= {stem(la.path): u for la in group if (u := _own_unit(la))}
    guesses = list(first.guesses)
    if point_each:
        guesses.append(Guess("long", "one file a point", "sure", f"{len(group)} files of one column"))
    source = ExportSource(keys, np.empty(0, np.int64), {}, units, guesses, first.zoned)
    _fill(source, zone, first)
    return source


def _settled(layout: Layout, ask: Callable[[str, str, Sequence[str]], str]) -> tuple[dict[str, Any], list[Guess]]:
    """Options of the time that are unsure, as a person says them."""
    time, guesses = dict(layout.options.get("time", {})), []
    for g in layout.guesses:
        key = g.key.removeprefix("time.")
        if g.sureness == "unsure" and g.key.startswith("time.") and key in time:
            answer = ask(f"{layout.path.name}: {g.key} ({g.why})", g.value, g.others)
            time[key] = answer == "true" if key == "day_first" else answer
            g = Guess(g.key, answer, "sure", "as answered")
        guesses.append(g)
    return {**layout.options, **({"time": time} if time else {})}, guesses


def _with_the_others(i: int, sources: Sequence[ExportSource], group: list[Layout], zone: str) -> ExportSource:
    """A source whose order of day and month is open, in the order that the times of the others bear out."""
    source = sources[i]
    open_ = [g for g in source.guesses if g.key == "time.day_first" and g.sureness == "unsure"]
    known = [s for s in sources if s is not source and len(s.time) and not _open_order(s)]
    if not open_ or not known:
        return source
    low, high = min(s.time[0] for s in known), max(s.time[-1] for s in known)
    if len(source.time) and _overlap(source, low, high) > 0.5:
        why, value = "the times of the other files agree", source.keys["time"]["day_first"]
    else:
        value = not source.keys["time"]["day_first"]
        other = [
            replace(la, options={**la.options, "time": {**la.options["time"], "day_first": value}}) for la in group
        ]
        turned = _read(other, zone, named=True)
        if not len(turned.time) or _overlap(turned, low, high) <= 0.5:
            return source
        source, why = turned, "so its times fall within those of the other files"
    settled = Guess("time.day_first", str(value).lower(), "likely", why)
    source.guesses = [settled if g.key == "time.day_first" else g for g in source.guesses]
    return source


def _open_order(source: ExportSource) -> bool:
    return any(g.key == "time.day_first" and g.sureness == "unsure" for g in source.guesses)


def _overlap(source: ExportSource, low: int, high: int) -> float:
    """Share of a source's times within a span."""
    return float(np.mean((source.time >= low) & (source.time <= high)))


def _own_unit(layout: Layout) -> str | None:
    return unit_in(layout.columns[0])


def _most_telling(group: Sequence[Layout]) -> Layout:
    """The file whose dates say most surely how they are written."""

    def rank(layout: Layout) -> int:
        order = {"sure": 2, "likely": 1, "unsure": 0}
        return min((order[g.sureness] for g in layout.guesses), default=2)

    return max(group, key=rank)


def _fill(source: ExportSource, zone: str, layout: Layout) -> None:
    """Read the source by its own keys, and put it in order where it is not."""
    options = options_type(source.keys["kind"]).model_validate(source.keys)
    reader = make_source(options, Context(zone, (), Path.cwd()))
    reader.open()
    whole = list(reader.batches())
    source.lost = {k: n for k, n in reader.counters().items() if n}
    batch = joined(whole)
    times = np.concatenate([b.time for b in whole]) if whole else np.empty(0, np.int64)
    if source.keys.get("long", {}).get("point") and len(times) > 1 and np.mean(np.diff(times) < 0) > 0:
        source.keys["sorted"] = False
        source.guesses.append(Guess("sorted", "false", "sure", "times run back from point to point"))
    axis = np.unique(batch.time)
    source.time, source.rows = axis, len(axis)
    for number, name in enumerate(batch.names):
        at = batch.point == number
        column = np.full(len(axis), np.nan)
        column[np.searchsorted(axis, batch.time[at])] = batch.value[at]
        source.values[name] = column
    source.values = {n: v for n, v in source.values.items() if n.strip()}


def sampling(source: ExportSource) -> float:
    """Usual time between samples of a point [s]: the median over points of each one's own."""
    steps = []
    for values in source.values.values():
        seen = source.time[np.isfinite(values)]
        if len(seen) > 2:
            steps.append(float(np.median(np.diff(seen))) / 1e9)
    return float(np.median(steps)) if steps else 300.0


def local_times(source: ExportSource, zone: str) -> pd.DatetimeIndex:
    """Times of the source on its own clock."""
    return pd.DatetimeIndex(pd.to_datetime(source.time, utc=True)).tz_convert(zone).tz_localize(None)
