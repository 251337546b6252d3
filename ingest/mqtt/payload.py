"""What a bare number or a JSON object on a topic means: one sample of the point named like the topic."""

from __future__ import annotations

import json
import math
from typing import Any

from fdd.records import Batch, Sample
from ingest.message import MalformedMessage, Message

_UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
_WORDS = {"on": 1.0, "true": 1.0, "active": 1.0, "off": 0.0, "false": 0.0, "inactive": 0.0, "null": None, "": None}


def number(value: Any) -> float | None:
    """A value as a number; words for on and off are 1 and 0.

    Raises
    ------
    MalformedMessage : neither.
    """
    if value is None or isinstance(value, bool | int | float):
        return None if value is None else float(value)
    text = str(value).strip()
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    try:
        return float(text)
    except ValueError:
        raise MalformedMessage(f"{text[:40]!r} is no number") from None


def bare_value(topic: str, payload: bytes, arrival: int) -> Message:
    """A payload that is nothing but the value."""
    return _sample(topic, arrival, number(payload.decode("utf-8", "replace")))


def json_object(
    topic: str, payload: bytes, arrival: int, *, value_key: str, time_key: str | None, time_unit: str
) -> Message:
    """A payload that is an object with the value and perhaps its time."""
    try:
        table = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise MalformedMessage(f"no JSON ({error})") from None
    if not isinstance(table, dict) or value_key not in table:
        raise MalformedMessage(f"no object with key {value_key!r}")
    time = arrival
    if time_key is not None:
        stamp = table.get(time_key)
        if isinstance(stamp, bool) or not isinstance(stamp, int | float) or not math.isfinite(stamp):
            raise MalformedMessage(f"{time_key!r} is {stamp!r}, no time in {time_unit} since 1970")
        time = round(stamp * _UNITS[time_unit])
        if abs(time) >= 2**63:
            raise MalformedMessage(f"{time_key!r} is {stamp!r}, too large for a time in {time_unit}; check time_unit")
    return _sample(topic, time, number(table[value_key]))


def _sample(topic: str, time: int, value: float | None) -> Message:
    return Message(Batch.of([Sample(topic, time, value)]))
