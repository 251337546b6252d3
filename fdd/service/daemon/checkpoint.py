"""What makes a crash harmless: a journal of what came in, in SQLite, and beside it now and then the whole state.

Every batch, every operator's command and every change of baselines is journaled before the engine sees it. A checkpoint
is a file that replaces the one before in one step; it says up to which entry of the journal it goes, and these entries
are deleted after it is safe on disk. After a crash the engine is restored from the last whole checkpoint and steps
through what was journaled after it; outputs are keyed by event time, so writing them again changes nothing.
"""

from __future__ import annotations

import io
import json
import os
import sqlite3
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fdd.records import Baseline, Batch, JsonObject
from fdd.service.alarms.book import Command

SCHEMA = 3
# Pages that may wait in the write-ahead log (80 MB) before a commit has to copy them itself.
MOST_PAGES = 20_000
TRIES = 5


@dataclass(frozen=True, slots=True)
class Rebase:
    """New baselines that were put in force between two batches."""

    baselines: tuple[Baseline, ...]


class CheckpointError(RuntimeError):
    """A state file that this version cannot continue from; the text says what to do."""


def encode(tree: JsonObject) -> bytes:
    """A tree of dicts, lists, JSON scalars and arrays as bytes, without pickle."""
    arrays: list[np.ndarray[Any, Any]] = []

    def reference(value: object) -> object:
        if isinstance(value, np.ndarray):
            arrays.append(value)
            return {"__array__": len(arrays) - 1}
        if isinstance(value, np.generic):
            return value.item()
        raise TypeError(f"state holds a {type(value).__name__}; only arrays and JSON values can be kept")

    text = json.dumps(tree, default=reference)
    buffer = io.BytesIO()
    named = {str(i): a for i, a in enumerate(arrays)}
    np.savez(buffer, allow_pickle=False, tree=np.frombuffer(text.encode(), dtype=np.uint8), **named)
    return buffer.getvalue()


def decode(data: bytes) -> JsonObject:
    """The tree that :func:`encode` wrote."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:

        def resolve(value: JsonObject) -> Any:
            return archive[str(value["__array__"])] if "__array__" in value else value

        tree: JsonObject = json.loads(archive["tree"].tobytes().decode(), object_hook=resolve)
        return tree


def _encode_batch(batch: Batch) -> bytes:
    return encode({name: getattr(batch, name) for name in Batch.__slots__})


def _decode_batch(data: bytes) -> Batch:
    tree = decode(data)
    return Batch(**{**tree, "names": tuple(tree["names"])})


class Checkpoint:
    """The state of one daemon: the journal at ``path``, the last checkpoint beside it in ``path.saved``.

    Checkpoints are written by a thread: frames do not wait for megabytes to reach the disk.

    Raises
    ------
    CheckpointError
        Another version of the program wrote the file.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = files_of(path)[1]
        self._db, self._eraser = _connection(path), _connection(path)
        if self._db.execute("select 1 from sqlite_master where name = 'checkpoint'").fetchone():
            raise _of_another_version(path, "one below 3")  # up to 2 the state was in a table of this file
        self._db.execute("create table if not exists schema (id integer primary key, version integer)")
        self._db.execute("insert or ignore into schema values (1, ?)", (SCHEMA,))
        # Numbers never come again, also after everything was deleted: a checkpoint counts by them.
        self._db.execute(
            "create table if not exists journal (n integer primary key autoincrement, kind text, entry blob)"
        )
        row = self._db.execute("select seq from sqlite_sequence where name = 'journal'").fetchone()
        self._last: int = row[0] if row else 0
        self._covered: int | None = None  # the number of the last entry in the saved state, once that was read
        self._writer = ThreadPoolExecutor(1, "checkpoint")
        self._writing: Future[None] | None = None

    def load(self) -> JsonObject | None:
        """The last state saved, or None in a new file.

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
        found = decode(self._file.read_bytes()) if self._file.exists() else None
        for schema in (version, SCHEMA if found is None else found["schema"]):
            if schema != SCHEMA:
                raise _of_another_version(self._file, schema)
        self._covered = 0 if found is None else found["journaled"]
        return found

    def entries(self) -> Iterator[Batch | Command | Rebase]:
        """What was journaled since the last state was saved, in order."""
        if self._covered is None:
            self._saved()
        rows = self._db.execute("select kind, entry from journal where n > ? order by n", (self._covered,)).fetchall()
        for kind, entry in rows:
            match kind:
                case "batch":
                    yield _decode_batch(entry)
                case "rebase":
                    yield Rebase(tuple(Baseline(**d) for d in json.loads(entry)))
                case _:
                    yield Command(**json.loads(entry))

    def journal(self, entry: Batch | Command | Rebase) -> None:
        """Keep what is about to be processed."""
        if isinstance(entry, Batch):
            row = ("batch", _encode_batch(entry))
        elif isinstance(entry, Rebase):
            row = ("rebase", json.dumps([asdict(b) for b in entry.baselines]).encode())
        else:
            row = ("command", json.dumps(asdict(entry)).encode())
        self._last = int(self._db.execute("insert into journal (kind, entry) values (?, ?)", row).lastrowid or 0)

    def save(self, state: JsonObject) -> None:
        """Replace the state by this one, as it is now, and forget what was journaled before, both or neither.

        Returns before it is on disk; what went wrong there is raised by the next call.
        """
        self._settle()
        self._covered = None
        data = encode({"schema": SCHEMA, "journaled": self._last, "state": state})
        self._writing = self._writer.submit(self._write, data, self._last)

    def _write(self, data: bytes, journaled: int) -> None:
        new = self._file.with_name(f"{self._file.name}.new")
        with new.open("wb") as out:
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
        new.replace(self._file)
        folder = os.open(self._file.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # a journal may be shortened only once the new name is safe, too
        finally:
            os.close(folder)
        self._eraser.execute("delete from journal where n <= ?", (journaled,))
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
    return tuple(Path(f"{path}{suffix}") for suffix in ("", ".saved", ".saved.new", "-wal", "-shm"))


def _connection(path: Path) -> sqlite3.Connection:
    link = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    link.execute("pragma journal_mode = wal")
    link.execute("pragma synchronous = normal")
    link.execute(f"pragma wal_autocheckpoint = {MOST_PAGES}")
    return link
