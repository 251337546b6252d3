"""What makes a crash harmless: a journal of what came in, in SQLite, and beside it now and then the whole state.

Every batch, every operator's command and every change of baselines is journaled before the engine sees it. A checkpoint
replaces the one before the last in one step; it says up to which entry of the journal it goes, and the entries that
neither generation needs are deleted after it is safe on disk. After a crash the engine is restored from the last whole
checkpoint and steps through what was journaled after it; outputs are keyed by event time, so writing them again changes
nothing.

An entry that cannot be replayed is buried: it goes to the table ``dead`` with the reason, and the rest is replayed
without it. So nothing that was ever journaled can keep the service from starting.
"""

from __future__ import annotations

import os
import sqlite3
import time as clock
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import structlog

from fdd.records import JsonObject
from fdd.service.daemon.codec import DamagedError, Entry, Rebase, TurnBack, decode, decode_entry, encode, encode_entry
from fdd.service.daemon.generations import READABLE, SCHEMA, Generations, OtherSchemaError

__all__ = ["Checkpoint", "CheckpointError", "Entry", "Rebase", "TurnBack", "decode", "encode", "files_of"]

log = structlog.get_logger()

# Pages that may wait in the write-ahead log (80 MB) before a commit has to copy them itself.
MOST_PAGES = 20_000
TRIES = 5
# Entries that could not be replayed are kept for a person to look at: so many, each up to so long.
DEAD_KEPT, DEAD_BYTES = 1_000, 100_000


class CheckpointError(RuntimeError):
    """A state file that this version cannot continue from; the text says what to do."""


class Checkpoint:
    """The state of one daemon: the journal at ``path``, two generations of the saved state beside it.

    Checkpoints are written by a thread: frames do not wait for megabytes to reach the disk.

    Raises
    ------
    CheckpointError
        Another version of the program wrote the file.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self.mishaps: list[str] = []
        self.unsaved_bytes = 0
        self._generations = Generations(path)
        self._open()
        self._covered: int | None = None  # the number of the last entry in the saved state, once that was read
        self._before: int | None = None  # the same of the generation before, which the next save keeps
        self._writer = ThreadPoolExecutor(1, "checkpoint")
        self._writing: Future[None] | None = None

    def _open(self) -> None:
        try:
            self._connect()
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise CheckpointError(f"the journal {self.path} cannot be opened ({error}); check its rights") from None
            self._set_aside(str(error))
            self._connect()

    def _connect(self) -> None:
        self._db, self._eraser = _connection(self.path), _connection(self.path)
        if self._db.execute("select 1 from sqlite_master where name = 'checkpoint'").fetchone():
            raise _of_another_version(self.path, "one below 3")  # up to 2 the state was in a table of this file
        self._db.execute("create table if not exists schema (id integer primary key, version integer)")
        self._db.execute("insert or ignore into schema values (1, ?)", (SCHEMA,))
        # Numbers never come again, also after everything was deleted: a checkpoint counts by them.
        self._db.execute(
            "create table if not exists journal (n integer primary key autoincrement, kind text, entry blob)"
        )
        self._db.execute(
            "create table if not exists dead "
            "(i integer primary key autoincrement, n integer, kind text, entry blob, reason text, wall real)"
        )
        row = self._db.execute("select seq from sqlite_sequence where name = 'journal'").fetchone()
        self._last: int = row[0] if row else 0

    def _set_aside(self, why: str) -> None:
        """Keep a journal that is no database under another name; what it held after the last checkpoint is lost."""
        for link in ("_db", "_eraser"):
            with suppress(AttributeError, sqlite3.Error):
                getattr(self, link).close()
        aside = next(p for i in range(1, 10**6) if not (p := Path(f"{self.path}.damaged-{i}")).exists())
        for suffix in ("", "-wal", "-shm"):
            with suppress(FileNotFoundError):
                Path(f"{self.path}{suffix}").replace(f"{aside}{suffix}")
        self.mishaps.append(
            f"the journal {self.path.name} is damaged ({why}); it is kept as {aside.name}, and what it held since the "
            "last checkpoint is asked of the publishers again"
        )
        log.error("journal is damaged, starting a new one", kept=str(aside), reason=why)

    def load(self) -> JsonObject | None:
        """The last state saved that is whole, or None in a new file.

        Raises
        ------
        CheckpointError
            Another version of the program wrote it in another form.
        """
        found = self._saved()
        return None if found is None else found["state"]

    def _saved(self) -> JsonObject | None:
        self._settle()
        (version,) = self._db.execute("select version from schema where id = 1").fetchone()
        if version not in READABLE:
            raise _of_another_version(self._generations.last, version)
        said = len(self._generations.stepped_back)
        try:
            found = self._generations.read()
        except OtherSchemaError as error:
            raise _of_another_version(error.file, error.schema) from None
        except DamagedError:
            found = None
            self.mishaps.append("no saved state is whole: filters and charts start afresh")
            log.error("no saved state is whole, starting afresh")
        self.mishaps += self._generations.stepped_back[said:]
        self._db.execute("update schema set version = ? where id = 1", (SCHEMA,))
        self._covered = self._before = 0 if found is None else int(found["journaled"])
        self._number_after(self._covered)
        return found

    def _number_after(self, covered: int) -> None:
        """A new journal beside an older state counts on from what the state covers."""
        if self._last < covered:
            self._db.execute("delete from sqlite_sequence where name = 'journal'")
            self._db.execute("insert into sqlite_sequence (name, seq) values ('journal', ?)", (covered,))
            self._last = covered

    def entries(self) -> Iterator[Entry]:
        """What was journaled since the last state was saved, in order."""
        return (entry for _, entry in self.numbered())

    def numbered(self) -> Iterator[tuple[int, Entry]]:
        """The same with each one's number; what cannot be read is buried."""
        if self._covered is None:
            self._saved()
        after = self._covered or 0
        while (row := self._next(after)) is not None:
            after, kind, data = row
            try:
                entry = decode_entry(str(kind), bytes(data))
            except (DamagedError, TypeError) as error:
                self.bury(after, str(error))
                continue
            yield after, entry

    def _next(self, after: int) -> tuple[int, str, bytes] | None:
        try:
            found = self._db.execute(
                "select n, kind, entry from journal where n > ? order by n limit 1", (after,)
            ).fetchone()
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError as error:
            self._set_aside(str(error))
            self._connect()
            self._number_after(max(after, self._covered or 0))
            return None
        return None if found is None else (int(found[0]), found[1], found[2])

    def journal(self, entry: Entry) -> int:
        """Keep what is about to be processed; returns its number."""
        row = encode_entry(entry)
        self._last = int(self._db.execute("insert into journal (kind, entry) values (?, ?)", row).lastrowid or 0)
        self.unsaved_bytes += len(row[1])
        return self._last

    def bury(self, number: int, reason: str) -> None:
        """Take an entry out of the journal, and keep it beside with the reason."""
        with self._db:
            self._db.execute("begin")
            self._db.execute(
                "insert into dead (n, kind, entry, reason, wall) "
                "select n, kind, substr(entry, 1, ?), ?, ? from journal where n = ?",
                (DEAD_BYTES, reason[:1000], clock.time(), number),
            )
            self._db.execute("delete from journal where n = ?", (number,))
            self._db.execute("delete from dead where i <= (select max(i) from dead) - ?", (DEAD_KEPT,))
        log.error("journal entry cannot be replayed, buried", number=number, reason=reason[:300])

    @property
    def buried(self) -> int:
        """Entries buried so far."""
        row = self._db.execute("select seq from sqlite_sequence where name = 'dead'").fetchone()
        return int(row[0]) if row else 0

    def dead(self) -> list[JsonObject]:
        """The latest entries that could not be replayed, oldest first, without their bytes."""
        rows = self._db.execute("select n, kind, length(entry), reason, wall from dead order by i desc limit 20")
        return [dict(zip(("entry", "kind", "bytes", "reason", "wall"), row, strict=True)) for row in rows][::-1]

    def save(self, state: JsonObject) -> None:
        """Replace the older generation by this state, as it is now, and forget the journal that neither needs.

        Returns before it is on disk; what went wrong there is raised by the next call.
        """
        self._settle()
        if self._before is None:
            self._saved()
        before, self._before, self._covered = self._before or 0, self._last, None
        data = encode({"schema": SCHEMA, "journaled": self._last, "state": state})
        self.unsaved_bytes = 0
        self._writing = self._writer.submit(self._write, data, before)

    def _write(self, data: bytes, before: int) -> None:
        """Write the state, then shorten the journal to what the generation before it still needs."""
        self._generations.write(data)
        with suppress(sqlite3.OperationalError):  # a full disk: it is done after the next checkpoint
            self._eraser.execute("delete from journal where n <= ?", (before,))
            for _ in range(TRIES):  # what is journaled meanwhile is copied by the next turn
                _, pages, copied = self._eraser.execute("pragma wal_checkpoint(passive)").fetchone()
                if pages == copied:
                    break

    def _settle(self) -> None:
        """Wait for the checkpoint that is being written."""
        if self._writing is not None:
            self._writing.result()
            self._writing = None

    def close(self) -> None:
        """Wait for what is being written, and close the files."""
        try:
            self._settle()
        finally:
            self._writer.shutdown()
            self._db.close()
            self._eraser.close()


def _of_another_version(file: Path, schema: object) -> CheckpointError:
    return CheckpointError(
        f"the state file {file} has schema {schema}, this version reads {SCHEMA}; move the file away, or start with "
        "--fresh"
    )


def files_of(path: Path) -> tuple[Path, ...]:
    """Every file of a daemon's state, the journal's first and the checkpoint's second."""
    return tuple(Path(f"{path}{suffix}") for suffix in ("", ".saved", ".saved.new", "-wal", "-shm", ".saved.1"))


def _connection(path: Path) -> sqlite3.Connection:
    if not path.exists():
        os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))  # it holds the plant's data: for its owner alone
    link = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    link.execute("pragma journal_mode = wal")
    link.execute("pragma synchronous = normal")
    link.execute(f"pragma wal_autocheckpoint = {MOST_PAGES}")
    return link
