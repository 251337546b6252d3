"""The latest messages of a publisher, and the answer to one who missed some.

A question is ``{"have": {stream: last number}}``. An answer is one line ``{"stream": ..., "newest": ...}`` and then a
message a line, in order, the next ones after what the asker has; who wants more asks again.
"""

from __future__ import annotations

import json
from collections import deque
from threading import Lock

from fdd.limits import (
    ANSWER_BYTES,
    ANSWER_MESSAGES,
    NAME_CHARACTERS,
    QUESTION_BYTES,
    LimitError,
    json_within,
    text_within,
)
from ingest.message import MalformedMessage

# A message beyond this size goes alone; a reader takes answers of twice the largest message.
_ANSWER_BYTES = 2_000_000


class History:
    """A bounded memory of one stream's messages, numbered from 1."""

    def __init__(self, stream: str, size: int) -> None:
        self.stream = stream
        self._kept: deque[bytes] = deque(maxlen=size)
        self._newest = 0
        self._lock = Lock()

    def keep(self, message: bytes) -> None:
        """Remember the next message."""
        with self._lock:
            self._kept.append(message)
            self._newest += 1

    def answer(self, question: bytes) -> bytes:
        """What comes after the asker's last message, as much as fits one answer."""
        try:
            last = json_within(question, QUESTION_BYTES)["have"].get(self.stream, 0)
        except (LimitError, TypeError, KeyError, AttributeError):
            last = 0
        if type(last) is not int:
            last = 0  # who does not say gets everything
        with self._lock:
            oldest = self._newest - len(self._kept) + 1
            kept = [self._kept[n - oldest] for n in range(max(last + 1, oldest), self._newest + 1)]
            head = json.dumps({"stream": self.stream, "newest": self._newest}).encode()
        lines, size = [head], 0
        for message in kept:
            size += len(message)
            if len(lines) > ANSWER_MESSAGES or (size > _ANSWER_BYTES and len(lines) > 1):
                break
            lines.append(message)
        return b"\n".join(lines)


def read_answer(answer: bytes) -> tuple[str, list[bytes]]:
    """The stream that answered, and its messages.

    Raises
    ------
    MalformedMessage : not an answer.
    """
    if len(answer) > ANSWER_BYTES or answer.count(b"\n") > ANSWER_MESSAGES:
        held = f"{len(answer)} bytes in {answer.count(10)} messages"
        raise MalformedMessage(f"an answer of {held}; at most {ANSWER_BYTES} bytes in {ANSWER_MESSAGES} are read")
    head, *messages = answer.split(b"\n")
    try:
        stream = json_within(head, QUESTION_BYTES)["stream"]
        return text_within(stream, 2 * NAME_CHARACTERS + 1, "stream"), messages
    except (LimitError, TypeError, KeyError):
        raise MalformedMessage(f"no answer of a publisher's history; it starts {head[:80]!r}") from None
