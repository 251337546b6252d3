"""The audit trail: what people asked and what became of it, one JSON line each, every line sealed by the one before.

A line's ``seal`` is SHA-256 over the seal of the line before and the line's own content. Whoever changes, takes out or
adds a line in the middle breaks every seal after it. The daemon tells the number of lines and the last seal in its
status and its checkpoint, so that lines cut off at the end are missed, too. What was journaled carries the journal's
number: replaying it after a crash adds no second line.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fdd.records import JsonObject

FIRST = "0" * 64


class TrailError(ValueError):
    """A trail that was tampered with or damaged; the text says at which line."""


@dataclass(frozen=True, slots=True)
class Head:
    """Where a trail stands: how many lines, and the seal of the last."""

    lines: int = 0
    seal: str = FIRST
    entry: int = 0  # the largest number of a journal entry in it


def sealed(before: str, content: JsonObject) -> str:
    """The seal of a line."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(f"{before}\n{text}".encode()).hexdigest()


def read(path: Path) -> Iterator[JsonObject]:
    """Every line, checked against the one before.

    Raises
    ------
    TrailError : a line that is none, or whose seal does not fit.
    """
    before = FIRST
    try:
        with path.open(encoding="utf-8") as lines:
            for number, text in enumerate(lines, 1):
                line = _line(text, number, path)
                if line.get("seal") != sealed(before, {k: v for k, v in line.items() if k != "seal"}):
                    raise TrailError(
                        f"{path.name}, line {number}: its seal does not fit; this line or one before was changed"
                    )
                before = line["seal"]
                yield line
    except (OSError, UnicodeDecodeError) as error:
        raise TrailError(f"{path} cannot be read ({error})") from None


def _line(text: str, number: int, path: Path) -> JsonObject:
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        line = None
    if not isinstance(line, dict):
        raise TrailError(f"{path.name}, line {number}: is no entry of an audit trail")
    return line


def verify(path: Path, known: Head | None = None) -> Head:
    """Check a whole trail, and that it still holds what ``known`` had seen of it.

    Raises
    ------
    TrailError : changed, damaged, or cut short.
    """
    head = Head()
    for line in read(path):
        head = Head(head.lines + 1, line["seal"], max(head.entry, int(line.get("entry", 0))))
        if known is not None and head.lines == known.lines and head.seal != known.seal:
            raise TrailError(f"{path.name}, line {head.lines}: is not the line that the daemon wrote there")
    if known is not None and head.lines < known.lines:
        raise TrailError(f"{path.name} has {head.lines} lines where the daemon wrote {known.lines}: cut short")
    return head


class Trail:
    """Appends to a trail; every line is on disk before its deed is answered."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem = ""
        self.head = Head()
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._continue()

    def _continue(self) -> None:
        """Go on after the last line; one that a crash cut in half was never answered, and goes."""
        data = self.path.read_bytes()
        if data and not data.endswith(b"\n"):
            os.truncate(self.path, data.rfind(b"\n") + 1)
        try:
            self.head = verify(self.path)
        except TrailError as error:
            self.problem = str(error)
            whole = [line for line in self.path.read_bytes().split(b"\n") if line.strip()]
            self.head = Head(len(whole), hashlib.sha256(b"\n".join(whole)).hexdigest(), self._entries(whole))

    @staticmethod
    def _entries(lines: list[bytes]) -> int:
        numbers = [0]
        for line in lines:
            try:
                numbers.append(int(json.loads(line)["entry"]))
            except (ValueError, TypeError, KeyError, RecursionError):
                continue
        return max(numbers)

    def add(self, content: JsonObject, entry: int = 0) -> None:
        """Append a line; one of a journal entry that is in the trail already is left out."""
        if entry and entry <= self.head.entry:
            return
        content = {**content, "line": self.head.lines + 1, **({"entry": entry} if entry else {})}
        seal = sealed(self.head.seal, content)
        text = json.dumps({**content, "seal": seal}, separators=(",", ":"))
        os.write(self._file, text.encode() + b"\n")
        os.fsync(self._file)
        self.head = Head(self.head.lines + 1, seal, max(self.head.entry, entry))

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)
