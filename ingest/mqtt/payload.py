"""What a bare number or a JSON object on a topic means: one sample of the point named like the topic."""

from __future__ import annotations

import math
from typing import Any

from fdd.limits import MESSAGE_BYTES, NAME_CHARACTERS, LimitError, json_within, name_within
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
    if value is None:
        return None
    if isinstance(value, bool | int | float):
        try:
            return float(value)
        except OverflowError:
            raise MalformedMessage("the value is a whole number beyond 1e308") from None
    if not isinstance(value, str):
        raise MalformedMessage(f"the value is a {type(value).__name__}, no number")
    text = value.strip()
    if len(text) > NAME_CHARACTERS:
        raise MalformedMessage(f"the value has {len(text)} characters; at most {NAME_CHARACTERS} are read")
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    try:
        return float(text)
    except ValueError:
        raise MalformedMessage(f"{text[:40]!r} is no number") from None


def bare_value(topic: str, payload: bytes, arrival: int) -> Message:
    """A payload that is nothing but the value."""
    # A text that is longer than any number is refused there, with its length.
    return _sample(topic, arrival, number(payload[: 4 * NAME_CHARACTERS + 8].decode("utf-8", "replace")))


def json_object(
    topic: str, payload: bytes, arrival: int, *, value_key: str, time_key: str | None, time_unit: str
) -> Message:
    """A payload that is an object with the value and perhaps its time."""
    try:
        table = json_within(payload, MESSAGE_BYTES)
    except LimitError as error:
        raise MalformedMessage(str(error)) from None
    if not isinstance(table, dict) or value_key not in table:
        raise MalformedMessage(f"no object with key {value_key!r}")
    time = arrival
    if time_key is not None:
        time = _time(table.get(time_key), time_key, time_unit)
    return _sample(topic, time, number(table[value_key]))


def _time(stamp: Any, key: str, unit: str) -> int:
    if isinstance(stamp, bool) or not isinstance(stamp, int | float) or not abs(stamp) < math.inf:
        raise MalformedMessage(f"{key!r} is {stamp!r:.60}, no time in {unit} since 1970")
    # Compared before it is multiplied and rounded: neither is possible for every number.
    if abs(stamp) >= 2**63 / _UNITS[unit]:
        raise MalformedMessage(f"{key!r} is {stamp!r:.60}, too large for a time in {unit}; check time_unit")
    return round(stamp * _UNITS[unit])


def _sample(topic: str, time: int, value: float | None) -> Message:
    try:
        name_within(topic, "the topic")
    except LimitError as error:
        raise MalformedMessage(str(error)) from None
    return Message(Batch.of([Sample(topic, time, value)]))
