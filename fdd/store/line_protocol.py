"""Rows and documents as InfluxDB line protocol."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fdd.records import JsonObject
from fdd.store.encoding import decode
from fdd.store.schema import CheckedRows, split_series

PART_BYTES = 60_000  # the server promises 64 kB for a string field
_TAG = str.maketrans({",": r"\,", "=": r"\=", " ": r"\ "})
# What lists of alarms show and sort by, beside the document itself.
ALARM_TEXT = ("component", "state", "severity", "summary")
ALARM_TIMES = ("since", "raised", "updated")


def _text(value: str) -> str:
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _occurrence(rows: CheckedRows) -> NDArray[np.int64]:
    """How many rows of the same key came before each row; rows are ordered by key."""
    same = np.zeros(len(rows), dtype=bool)
    same[1:] = (np.diff(rows.series) == 0) & (np.diff(rows.time) == 0)
    index = np.arange(len(rows))
    return index - np.maximum.accumulate(np.where(same, 0, index))


def row_lines(rows: CheckedRows, site: str) -> Iterator[str]:
    """One line a row, with the fields it has; rows of equal key in their order."""
    head = []
    for series in rows.names:
        component, name = split_series(series)
        tags = f"component={component.translate(_TAG)},name={name.translate(_TAG)},site={site.translate(_TAG)}"
        head.append(f"{rows.measurement.name},{tags} ")
    names = list(rows.fields)
    given = np.array([~np.isnan(rows.fields[n]) for n in names])
    pattern = (1 << np.arange(len(names))) @ given
    # Rows with the same fields share a template; a later row of the same key must follow the earlier one.
    group = _occurrence(rows) * (1 << len(names)) + pattern
    for code in np.unique(group):
        at = np.flatnonzero(group == code)
        there = [n for k, n in enumerate(names) if code >> k & 1]
        template = "%s" + ",".join(f"{n}=%r" for n in there) + " %d"
        columns = [rows.fields[n][at].tolist() for n in there]
        starts = [head[s] for s in rows.series[at].tolist()]
        yield from (template % line for line in zip(starts, *columns, rows.time[at].tolist(), strict=True))


def _parts(body: str) -> list[str]:
    """The text in pieces of at most PART_BYTES bytes of UTF-8, cut between characters."""
    raw = body.encode()
    cuts = [0]
    while cuts[-1] < len(raw):
        end = min(cuts[-1] + PART_BYTES, len(raw))
        while end < len(raw) and raw[end] & 0xC0 == 0x80:
            end -= 1
        cuts.append(end)
    return [raw[a:b].decode() for a, b in pairwise(cuts)] or [""]


def digest(body: str, parts: int) -> str:
    """What each part carries to tell that all of them belong together."""
    return f"{parts}:{hashlib.sha256(body.encode()).hexdigest()[:32]}"


def document_lines(kind: str, key: str, body: str, site: str) -> Iterator[str]:
    """One line a part; an alarm's first part also has the fields that lists show."""
    parts = _parts(body)
    mark = digest(body, len(parts))
    for number, part in enumerate(parts):
        tags = f"key={key.translate(_TAG)},part={number},site={site.translate(_TAG)}"
        extra = _alarm_fields(decode(body)) if kind == "alarm" and number == 0 else ""
        yield f"{kind},{tags} body={_text(part)},digest={_text(mark)}{extra} 0"


def _alarm_fields(document: JsonObject) -> str:
    """Text fields only: lists put them side by side, and a column has one type. Times are in the server's own form."""
    texts = {n: str(document[n]) for n in ALARM_TEXT if isinstance(document.get(n), str)}
    times = {n: f"{np.datetime64(document[n], 'ns')}Z" for n in ALARM_TIMES if isinstance(document.get(n), int)}
    return "".join(f",{name}={_text(value)}" for name, value in (texts | times).items())
