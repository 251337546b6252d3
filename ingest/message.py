"""The message that carries samples over Zenoh and MQTT: JSON, version 1, columns instead of objects.

    {"v": 1, "publisher": "plant", "run": "9f2c41d0", "seq": 17,
     "names": ["T_supply", "T_return"], "time": [1700000000000000000], "value": [61.2, null]}

``time`` is in nanoseconds UTC, ``value`` is a number or null, ``quality`` (0 good, 1 uncertain, 2 bad) may be left out.
Without ``point`` the values are a table, one row of all names for each time. With ``point`` every sample has its own
time, and ``point`` is its index into ``names``. ``seq`` counts a publisher's messages from 1 in every ``run`` (one run
of its process); messages without it are taken as they come. ``"end": true`` says that the stream is over.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdd.limits import MESSAGE_BYTES, MESSAGE_NAMES, MESSAGE_SAMPLES, SEQUENCE, LimitError, json_within, name_within
from fdd.records import Batch, IntArray, Quality

VERSION = 1


class MalformedMessage(ValueError):  # noqa: N818 - what it is
    """A message that does not follow the format; the text says where."""


@dataclass(frozen=True, slots=True)
class Message:
    """A decoded message: who sent it, its place in the sequence, its samples."""

    batch: Batch
    publisher: str = ""
    run: str = ""
    seq: int | None = None
    end: bool = False

    @property
    def stream(self) -> str:
        """What the sequence counts within."""
        return f"{self.publisher}/{self.run}"


def encode(batch: Batch, *, publisher: str, run: str, seq: int, end: bool = False) -> bytes:
    """A message's bytes; a table where the batch is one (shape (times, names)), otherwise with ``point``."""
    value = [v if v == v else None for v in batch.value.tolist()]
    table: dict[str, Any] = {"v": VERSION, "publisher": publisher, "run": run, "seq": seq, "names": list(batch.names)}
    times = _times_of_table(batch)
    if times is None:
        table |= {"point": batch.point.tolist(), "time": batch.time.tolist()}
    else:
        table["time"] = times.tolist()
    table["value"] = value
    if batch.quality.any():
        table["quality"] = batch.quality.tolist()
    if end:
        table["end"] = True
    return json.dumps(table, separators=(",", ":")).encode()


def _times_of_table(batch: Batch) -> IntArray | None:
    width = len(batch.names)
    if width == 0 or len(batch) % width:
        return None
    rows = batch.time.reshape(-1, width)
    whole = (batch.point.reshape(-1, width) == np.arange(width)).all() and (rows == rows[:, :1]).all()
    return rows[:, 0] if whole else None


def decode(payload: bytes) -> Message:
    """The message in some bytes.

    Raises
    ------
    MalformedMessage : no JSON, another version, missing columns, lengths that differ, values that are no numbers.
    """
    try:
        table = json_within(payload, MESSAGE_BYTES)
        return _message(table)
    except LimitError as error:
        raise MalformedMessage(str(error)) from None


def _message(table: Any) -> Message:
    if not isinstance(table, dict):
        raise MalformedMessage(f"a JSON {type(table).__name__}, not an object")
    if table.get("v") != VERSION:
        raise MalformedMessage(f"version {table.get('v')!r:.40}; this reader knows {VERSION}")
    seq = table.get("seq")
    if seq is not None and (type(seq) is not int or not 1 <= seq <= SEQUENCE):
        raise MalformedMessage(f"seq {seq!r:.40} is no count from 1 to {SEQUENCE}")
    return Message(
        batch=_batch(table),
        publisher=name_within(table.get("publisher", ""), "publisher"),
        run=name_within(table.get("run", ""), "run"),
        seq=seq,
        end=table.get("end") is True,
    )


def _batch(table: dict[str, Any]) -> Batch:
    names = table.get("names", [])
    if not isinstance(names, list):
        raise MalformedMessage("names is no list of texts")
    if len(names) > MESSAGE_NAMES:
        raise MalformedMessage(f"{len(names)} names; at most {MESSAGE_NAMES} are taken")
    for name in names:
        name_within(name, "a name")
    time = _integers(table, "time", np.int64)
    value = _numbers(table)
    if len(value) > MESSAGE_SAMPLES:
        raise MalformedMessage(f"{len(value)} samples; at most {MESSAGE_SAMPLES} are taken")
    if "point" in table:
        point = _integers(table, "point", np.int32)
        if len(point) and not (point.min() >= 0 and point.max() < len(names)):
            raise MalformedMessage(f"point has an index outside 0 to {len(names) - 1}")
    elif len(names) * len(time) != len(value):  # before the table is spread out: its size is the sender's choice
        raise MalformedMessage(f"{len(value)} values for a table of {len(time)} times and {len(names)} names")
    else:
        point = np.tile(np.arange(len(names), dtype=np.int32), len(time))
        time = np.repeat(time, len(names))
    quality = _integers(table, "quality", np.uint8) if "quality" in table else np.zeros(len(value), dtype=np.uint8)
    if not len(point) == len(time) == len(value) == len(quality):
        lengths = f"{len(point)} points, {len(time)} times, {len(value)} values, {len(quality)} qualities"
        raise MalformedMessage(f"columns differ in length: {lengths}")
    if len(quality) and quality.max() > Quality.BAD:
        raise MalformedMessage(f"quality {quality.max()} is none of 0, 1, 2")
    return Batch(tuple(names), point, time, value, quality)


def _integers(table: dict[str, Any], key: str, kind: type[np.integer[Any]]) -> Any:
    column = table.get(key, [])
    # NumPy would silently cut 1.5 to 1 and read "7" as 7.
    if not isinstance(column, list) or not all(type(v) is int for v in column):
        raise MalformedMessage(f"{key} is no list of whole numbers")
    try:
        return np.array(column, dtype=kind)
    except OverflowError:
        raise MalformedMessage(f"{key} holds a number that is too large") from None


def _numbers(table: dict[str, Any]) -> Any:
    column = table.get("value", [])
    if not isinstance(column, list) or not all(v is None or type(v) in (float, int) for v in column):
        raise MalformedMessage("value is no list of numbers and nulls")
    try:
        return np.array(column, dtype=np.float64)
    except OverflowError:
        raise MalformedMessage("value holds a number that is too large") from None
