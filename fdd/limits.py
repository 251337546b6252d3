"""What anything that arrives may hold at most: every bound on size, depth, names, numbers and text, in this one place.

A decoder checks a payload against these before it builds anything from it, and raises its own error; nothing here
knows who sent it. ``docs/threat-model.md`` repeats the numbers, and a test compares the two.
"""

from __future__ import annotations

import json
import re
from typing import Any

# Messages with samples (Zenoh, MQTT) and the answers of a publisher's history.
MESSAGE_BYTES = 4_000_000
MESSAGE_SAMPLES = 100_000
MESSAGE_NAMES = 10_000
ANSWER_BYTES = 2 * MESSAGE_BYTES
ANSWER_MESSAGES = 10_000
QUESTION_BYTES = 1_000_000
SEQUENCE = 2**53
STREAMS = 1_000

# What an operator sends.
COMMAND_BYTES = 20_000
COMMENT_CHARACTERS = 2_000

# Any JSON, any name, any exact whole number.
JSON_DEPTH = 20
NAME_CHARACTERS = 256

# Text that is parsed: units, expressions, the site file.
UNIT_CHARACTERS = 80
UNIT_POWER = 12
EXPRESSION_CHARACTERS = 4_000
EXPRESSION_DEPTH = 150
EXPRESSION_TERMS = 1_000
SITE_FILE_BYTES = 4_000_000
SITE_FILE_DEPTH = 20
SITE_FILE_ENTRIES = 500_000

# Files that are read for their samples; what is compressed may unpack to so many times its size once it is large.
LINE_CHARACTERS = 1_000_000
HEADER_COLUMNS = 20_000
BLOCK_CHARACTERS = 64_000_000
UNPACKED_BYTES = 256_000_000
UNPACKED_RATIO = 500
PARQUET_TEXT_BYTES = 16_000_000

_STRINGS = re.compile(rb'"(?:[^"\\]|\\.)*"?', re.DOTALL)
# Control characters, halves of surrogate pairs, and what turns the reading direction or breaks a line.
UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class LimitError(ValueError):
    """What arrived passes a bound; the text says what, how much, and the bound."""


def json_within(payload: bytes, most_bytes: int) -> Any:
    """The JSON value in some bytes of bounded size and depth.

    Raises
    ------
    LimitError : too long, too deep, not UTF-8, no JSON.
    """
    if len(payload) > most_bytes:
        raise LimitError(f"{len(payload)} bytes; at most {most_bytes} are read")
    if _deeper(payload, JSON_DEPTH):
        raise LimitError(f"JSON nested deeper than {JSON_DEPTH}")
    try:
        return json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise LimitError(f"no JSON ({error})") from None


def _deeper(payload: bytes, most: int) -> bool:
    if payload.count(b"[") + payload.count(b"{") <= most:
        return False
    depth = 0
    for bracket in re.findall(rb"[\[\]{}]", _STRINGS.sub(b"", payload)):
        depth += 1 if bracket in b"[{" else -1
        if depth > most:
            return True
    return False


def text_within(value: Any, most: int, what: str) -> str:
    """A printable text of bounded length.

    Raises
    ------
    LimitError : no text, too long, or with characters that cannot be printed.
    """
    if not isinstance(value, str):
        raise LimitError(f"{what} is a {type(value).__name__}, not a text")
    if len(value) > most:
        raise LimitError(f"{what} has {len(value)} characters; at most {most} are taken")
    found = UNPRINTABLE.search(value)
    if found:
        raise LimitError(f"{what} holds the character U+{ord(found.group()):04X}, which cannot be printed")
    return value


def name_within(value: Any, what: str) -> str:
    """A name: a printable text of at most :data:`NAME_CHARACTERS`.

    Raises
    ------
    LimitError : as :func:`text_within`.
    """
    return text_within(value, NAME_CHARACTERS, what)
