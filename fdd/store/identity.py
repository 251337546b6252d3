"""Whether an open file is still the one that its name leads to: on Unix a deleted file can be written for ever."""

from __future__ import annotations

from pathlib import Path


class FileIdentity:
    """Device and number of a file as it was when this was made."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._was = self._now()

    def _now(self) -> tuple[int, int] | None:
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_dev, found.st_ino

    @property
    def problem(self) -> str:
        """What is wrong; empty while the name leads to the file that was opened."""
        now = self._now()
        if now == self._was:
            return ""
        return f"{self._path} was {'deleted' if now is None else 'replaced'} while it was open"
