"""What makes a crash harmless: a journal of what came in, and now and then the whole state, in one SQLite file.

Every batch, every operator's command and every change of baselines is journaled before the engine sees it. A checkpoint
replaces the state and empties the journal in one transaction. After a crash the engine is restored from the checkpoint
and steps through the journal again; outputs are keyed by event time, so writing them again changes nothing.
"""

from __future__ import annotations

import io
import json
import sqlite3
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fdd.records import Baseline, Batch, JsonObject
from fdd.service.alarms import Command

SCHEMA = 2
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
    """The state file of one daemon.

    A thread copies the write-ahead log into the file after every save: that waits for the disk, and frames must not.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._db = sqlite3.connect(path, isolation_level=None)
        self._db.execute("pragma journal_mode = wal")
        self._db.execute("pragma synchronous = normal")
        self._db.execute(f"pragma wal_autocheckpoint = {MOST_PAGES}")
        self._db.execute("create table if not exists checkpoint (id integer primary key, schema integer, state blob)")
        self._db.execute("create table if not exists journal (n integer primary key, kind text, entry blob)")
        self._saved, self._closing = threading.Event(), False
        self._copier = threading.Thread(target=self._copy, args=(path,), daemon=True, name="checkpoint")
        self._copier.start()

    def _copy(self, path: Path) -> None:
        link = sqlite3.connect(path, isolation_level=None)
        while True:
            self._saved.wait()
            self._saved.clear()
            if self._closing:
                break
            for _ in range(TRIES):  # what is journaled meanwhile is copied by the next turn
                _, pages, copied = link.execute("pragma wal_checkpoint(passive)").fetchone()
                if pages == copied:
                    break
        link.close()

    def load(self) -> JsonObject | None:
        """The last state saved, or None in a new file.

        Raises
        ------
        CheckpointError
            Another version of the program wrote it in another form.
        """
        row = self._db.execute("select schema, state from checkpoint where id = 1").fetchone()
        if row is None:
            return None
        if row[0] != SCHEMA:
            raise CheckpointError(
                f"the state file has schema {row[0]}, this version reads {SCHEMA}; move the file away to start afresh"
            )
        return decode(row[1])

    def entries(self) -> Iterator[Batch | Command | Rebase]:
        """What was journaled since the last state was saved, in order."""
        for kind, entry in self._db.execute("select kind, entry from journal order by n").fetchall():
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
        self._db.execute("insert into journal (kind, entry) values (?, ?)", row)

    def save(self, state: JsonObject) -> None:
        """Replace the state and empty the journal, both or neither."""
        data = encode(state)
        self._db.execute("begin immediate")
        self._db.execute("insert or replace into checkpoint values (1, ?, ?)", (SCHEMA, data))
        self._db.execute("delete from journal")
        self._db.execute("commit")
        self._saved.set()

    def close(self) -> None:
        """Close the file."""
        self._closing = True
        self._saved.set()
        self._copier.join()
        self._db.close()
