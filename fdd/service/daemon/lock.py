"""One daemon a site: a lock that the operating system lets go of when its holder dies, however it dies."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from fdd.service.site.errors import UsageError


class StateLock:
    """Held from making to :meth:`close`.

    Raises
    ------
    UsageError : another process holds it.
    """

    def __init__(self, state: Path) -> None:
        state.parent.mkdir(parents=True, exist_ok=True)
        self.path = Path(f"{state}.lock")
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = os.read(self._file, 20).decode("ascii", "replace").strip() or "unknown"
            os.close(self._file)
            raise UsageError(
                f"another daemon (process {holder}) runs this site: it holds {self.path}; stop that one first"
            ) from None
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)

    def close(self) -> None:
        """Let go; the file stays, for whoever removed it would lock another file than the next holder."""
        os.close(self._file)
