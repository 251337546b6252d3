"""A store that keeps working while the server behind it is away.

Everything is first committed to a file on this machine and then forwarded, in order, by a thread. While the server is
away, entries wait; after a crash they are still there. An entry is taken off the spool only after the server has
accepted it, and writing it twice is writing it once, so nothing is lost and nothing doubled.

The spool is bounded. When it is full the oldest *rows* are dropped and counted; documents are kept, since a newer one
replaces an older one of the same key. Documents written here are also kept in the spool's file, for reading during an
outage. Other processes of the same machine may use the same folder.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fdd.records import JsonObject, Rows
from fdd.store.encoding import decode, encode
from fdd.store.identity import FileIdentity
from fdd.store.rows_codec import decode_rows, encode_rows
from fdd.store.schema import StoreError, as_sequence, check_kind, check_name, check_rows
from fdd.store.sqlite import translated
from fdd.store.store import Store, StoreUnavailableError

ENTRIES_AT_ONCE = 200
BYTES_AT_ONCE = 4_000_000
FIRST_PAUSE, LONGEST_PAUSE = 0.2, 10.0  # s between tries while the server is away
_SCHEMA = """
CREATE TABLE IF NOT EXISTS pending (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, kind TEXT, key TEXT, rows INTEGER NOT NULL, size INTEGER NOT NULL,
    body BLOB NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS pending_document ON pending (kind, key) WHERE kind IS NOT NULL;
CREATE TABLE IF NOT EXISTS documents (kind TEXT, key TEXT, body TEXT NOT NULL, PRIMARY KEY (kind, key));
CREATE TABLE IF NOT EXISTS refused (
    seq INTEGER PRIMARY KEY, reason TEXT NOT NULL, rows INTEGER NOT NULL, body BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS counts (name TEXT PRIMARY KEY, value INTEGER NOT NULL);
"""
_WAITING = "EXISTS (SELECT 1 FROM pending WHERE pending.kind = documents.kind AND pending.key = documents.key)"
KEEP_REFUSED = 100


@dataclass(frozen=True, slots=True)
class SpoolStatus:
    """How the spool stands: what waits, what was lost to its bound or refused by the server, and why."""

    connected: bool
    pending_rows: int
    pending_bytes: int
    dropped_rows: int
    refused_rows: int
    problem: str = ""


_Written = tuple[str | None, str | None, int, bytes]  # kind and key of a document, or None; rows; body


@dataclass(frozen=True, slots=True)
class _Entry:
    seq: int
    kind: str | None
    key: str | None
    rows: int
    body: bytes


class SpooledStore:
    """A :class:`fdd.store.store.Store` before another one.

    Parameters
    ----------
    inner : the store behind, usually :class:`fdd.store.influx.InfluxStore`
    folder : where the spool's file lives
    max_bytes : how much may wait
    changed : called with the status when the server is lost, when it is back, and when entries are dropped or refused
    """

    def __init__(
        self,
        inner: Store,
        folder: Path | str,
        max_bytes: int = 1_000_000_000,
        changed: Callable[[SpoolStatus], None] | None = None,
    ) -> None:
        self.inner = inner
        self.max_bytes = max_bytes
        self._changed = changed
        self._problem = ""
        self._lock = threading.RLock()  # the file
        self._forward_lock = threading.Lock()  # one forwarder at a time keeps the order
        self._held = threading.local()
        self._wake, self._stop = threading.Event(), threading.Event()
        self._path = Path(folder) / "spool.sqlite"
        self._open()
        self._wake.set()
        self._thread = threading.Thread(target=self._run, name="spool", daemon=True)
        self._thread.start()

    def _open(self) -> None:
        path = self._path
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._link = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=30)
            self._link.execute("PRAGMA journal_mode = WAL")
            self._link.execute("PRAGMA synchronous = NORMAL")
            self._link.execute("PRAGMA journal_size_limit = 67108864")
            self._link.executescript(_SCHEMA)
        except sqlite3.Error as problem:
            raise StoreError(
                f"cannot use the spool {path}: {problem}; give another folder or move the file away"
            ) from problem
        self._rows, self._bytes = self._link.execute(
            "SELECT coalesce(sum(rows), 0), coalesce(sum(size), 0) FROM pending"
        ).fetchone()
        self._identity = FileIdentity(path)

    @property
    def misplaced(self) -> str:
        """What became of the spool's file while it was open; empty while it is the one opened."""
        return self._identity.problem

    def renew(self) -> None:
        """Go on with what the path leads to now, or a new spool."""
        with self._lock:
            self._link.close()
            for suffix in ("-wal", "-shm"):
                Path(f"{self._path}{suffix}").unlink(missing_ok=True)
            self._open()

    # ---- writing: to disk, at once

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Everything inside goes to the spool in one commit; inner transactions join the outer one."""
        if self._pending() is not None:
            yield
            return
        held: list[_Written] = []
        self._held.writes = held
        try:
            yield
        finally:
            self._held.writes = None
        self._append(held)

    def _pending(self) -> list[_Written] | None:
        return getattr(self._held, "writes", None)

    def write(self, rows: Rows | Sequence[Rows]) -> None:
        """Upsert rows: durable here when this returns, in the server soon after."""
        many = as_sequence(rows)
        for r in many:
            check_rows(r)
        self._take([(None, None, len(r), encode_rows(r)) for r in many if len(r)])

    def put(self, kind: str, key: str, document: JsonObject) -> None:
        """Keep a document: durable here when this returns, in the server soon after."""
        body = encode(document, f"{check_kind(kind)} {check_name(key, 'key')!r}")
        self._take([(kind, key, 0, body.encode())])

    def _take(self, entries: list[_Written]) -> None:
        pending = self._pending()
        if pending is None:
            self._append(entries)
        else:
            pending.extend(entries)

    def _append(self, entries: Sequence[_Written]) -> None:
        with self._commit():
            for kind, key, rows, body in entries:
                if kind is not None:
                    self._link.execute("REPLACE INTO documents VALUES (?, ?, ?)", (kind, key, body.decode()))
                    self._remove("kind = ? AND key = ?", (kind, key))
                self._link.execute(
                    "INSERT INTO pending (kind, key, rows, size, body) VALUES (?, ?, ?, ?, ?)",
                    (kind, key, rows, len(body), body),
                )
                self._rows += rows
                self._bytes += len(body)
        dropped = self._drop_oldest()
        self._wake.set()
        if dropped:
            self._tell()

    def _remove(self, condition: str, values: tuple[Any, ...]) -> int:
        """Take entries off the spool; returns how many rows they held."""
        rows, size = self._link.execute(
            f"SELECT coalesce(sum(rows), 0), coalesce(sum(size), 0) FROM pending WHERE {condition}", values
        ).fetchone()
        self._link.execute(f"DELETE FROM pending WHERE {condition}", values)
        self._rows -= rows
        self._bytes -= size
        return int(rows)

    @contextmanager
    def _commit(self) -> Iterator[None]:
        with self._lock, translated(self._path):
            before = self._rows, self._bytes
            self._link.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._link.execute("COMMIT")
            except BaseException:
                if self._link.in_transaction:  # a full disk has rolled back already
                    self._link.execute("ROLLBACK")
                self._rows, self._bytes = before
                raise

    def _drop_oldest(self) -> bool:
        """Keep within the bound by dropping the oldest rows; say how many in the file itself."""
        with self._lock:
            if self._bytes <= self.max_bytes:
                return False
            with self._commit():
                excess, last = self._bytes - self.max_bytes, -1
                oldest = self._link.execute("SELECT seq, size FROM pending WHERE kind IS NULL ORDER BY seq")
                for last, size in oldest:  # noqa: B007
                    excess -= size
                    if excess <= 0:
                        break
                oldest.close()
                rows = self._remove("kind IS NULL AND seq <= ?", (last,))
                self._count("dropped_rows", rows)
        return rows > 0

    def _count(self, name: str, more: int) -> None:
        self._link.execute(
            "INSERT INTO counts VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET value = value + excluded.value",
            (name, more),
        )

    # ---- forwarding

    def _run(self) -> None:
        pause = FIRST_PAUSE
        while not self._stop.is_set():
            self._wake.wait()
            self._wake.clear()
            try:
                while not self._stop.is_set() and self._forward():
                    pause = FIRST_PAUSE
            except StoreError as problem:  # the server is away, or this machine's disk is full: try again later
                self._note(str(problem))
                self._stop.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                self._wake.set()

    def _forward(self) -> bool:
        """Send the oldest entries; False where there are none.

        Raises
        ------
        StoreUnavailableError : the server is away; the entries stay
        """
        with self._forward_lock:
            entries = self._oldest()
            if not entries and not self._problem:
                return False
            try:
                with self._noted():
                    self._send(entries)
            except StoreUnavailableError:
                raise
            except StoreError:
                self._send_singly(entries)
            with self._commit():
                for e in entries:
                    self._remove("seq = ?", (e.seq,))
            self._note("")
            return bool(entries)

    def _oldest(self) -> list[_Entry]:
        with self._lock:
            found: list[_Entry] = []
            size = 0
            cursor = self._link.execute(
                "SELECT seq, kind, key, rows, body FROM pending ORDER BY seq LIMIT ?", (ENTRIES_AT_ONCE,)
            )
            for row in cursor:
                found.append(_Entry(*row))
                size += len(row[4])
                if size > BYTES_AT_ONCE:
                    break
            if not found:
                self._rows = self._bytes = 0  # another process may have forwarded some of ours
            return found

    @contextmanager
    def _noted(self) -> Iterator[None]:
        try:
            yield
        except StoreUnavailableError as problem:
            self._note(str(problem))
            raise

    def _send(self, entries: Sequence[_Entry]) -> None:
        if not entries:
            self.inner.get("run", "is the server there")
        rows = [decode_rows(e.body) for e in entries if e.kind is None]
        if rows:
            self.inner.write(rows)
        for e in entries:
            if e.kind is not None and e.key is not None:
                self.inner.put(e.kind, e.key, decode(e.body.decode()))

    def _send_singly(self, entries: Sequence[_Entry]) -> None:
        """One by one, setting aside what the server refuses for good, so that one bad entry does not stop the rest."""
        for e in entries:
            try:
                with self._noted():
                    self._send([e])
            except StoreUnavailableError:
                raise
            except StoreError as problem:
                with self._commit():
                    self._link.execute(
                        "REPLACE INTO refused VALUES (?, ?, ?, ?)", (e.seq, str(problem), e.rows, e.body)
                    )
                    self._link.execute(
                        "DELETE FROM refused WHERE seq NOT IN (SELECT seq FROM refused ORDER BY seq DESC LIMIT ?)",
                        (KEEP_REFUSED,),
                    )
                    self._count("refused_rows", max(e.rows, 1))
                    self._remove("seq = ?", (e.seq,))
                self._tell()

    def _note(self, problem: str) -> None:
        """Say once that the server is lost and once that it is back."""
        changed = bool(problem) != bool(self._problem)
        self._problem = problem
        if changed:
            self._tell()

    def _tell(self) -> None:
        if self._changed is not None:
            self._changed(self.status)

    @property
    def status(self) -> SpoolStatus:
        """How the spool stands now."""
        with self._lock:
            counts = dict(self._link.execute("SELECT name, value FROM counts"))
            return SpoolStatus(
                connected=not self._problem,
                pending_rows=self._rows,
                pending_bytes=self._bytes,
                dropped_rows=counts.get("dropped_rows", 0),
                refused_rows=counts.get("refused_rows", 0),
                problem=self._problem,
            )

    def flush(self) -> None:
        """Forward everything that waits.

        Raises
        ------
        StoreUnavailableError : the server is away; what waits stays on disk
        """
        while self._forward():
            pass

    # ---- reading

    def read(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """Rows from the server, once what waited here has reached it."""
        self.flush()
        return self.inner.read(measurement, series, start, end)

    def read_hourly(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """Hourly values of the store behind."""
        self.flush()
        return self.inner.read_hourly(measurement, series, start, end)

    def maintain(self, now: int) -> None:
        """Maintain the store behind; while it is away there is nothing to do."""
        with suppress(StoreUnavailableError):
            self.flush()
            self.inner.maintain(now)

    def series(self, measurement: str) -> list[str]:
        """Names of the series, once what waited here has reached the server."""
        self.flush()
        return self.inner.series(measurement)

    def get(self, kind: str, key: str) -> JsonObject | None:
        """The document: as written here while that has not reached the server, otherwise the server's."""
        waiting = self._local(f"WHERE kind = ? AND key = ? AND {_WAITING}", (check_kind(kind), key))
        # While the server is known to be away it is not asked; the forwarder finds out when it is back.
        if not waiting and not self._problem:
            try:
                with self._noted():
                    return self.inner.get(kind, key)
            except StoreUnavailableError:
                self._wake.set()
        return self._local("WHERE kind = ? AND key = ?", (kind, key)).get(key)

    def items(self, kind: str) -> dict[str, JsonObject]:
        """All documents of a kind by key; while the server is away, those written here."""
        waiting = self._local(f"WHERE kind = ? AND {_WAITING}", (check_kind(kind),))
        if not self._problem:
            try:
                with self._noted():
                    return dict(sorted((self.inner.items(kind) | waiting).items()))
            except StoreUnavailableError:
                self._wake.set()
        return dict(sorted(self._local("WHERE kind = ?", (kind,)).items()))

    def _local(self, condition: str, values: tuple[str, ...]) -> dict[str, JsonObject]:
        with self._lock:
            found = self._link.execute(f"SELECT key, body FROM documents {condition}", values).fetchall()
        return {key: decode(body) for key, body in found}

    def list(self, kind: str) -> list[JsonObject]:
        """All documents of a kind, ordered by key."""
        return [*self.items(kind).values()]

    def close(self) -> None:
        """Forward what can be forwarded now, leave the rest on disk, and close the store behind."""
        if self._stop.is_set():
            return
        with suppress(StoreUnavailableError):  # what is left waits on disk for the next start
            self.flush()
        self._stop.set()
        self._wake.set()
        self._thread.join()
        with self._lock:
            self._link.close()
        self.inner.close()


def spool_rows(status: SpoolStatus, time: int) -> list[Rows]:
    """The status as rows that dashboards and alert rules read, at the wall-clock ``time`` [ns]."""

    def rows(measurement: str, values: dict[str, int]) -> Rows:
        names = tuple(f"store/{name}" for name in values)
        index = np.arange(len(names), dtype=np.int32)
        return Rows(
            measurement, names, index, np.full(len(names), time), {"value": np.array([*values.values()], float)}
        )

    waiting = {"spool_bytes": status.pending_bytes, "spool_rows": status.pending_rows}
    lost = {"dropped_rows": status.dropped_rows, "refused_rows": status.refused_rows}
    return [rows("health", waiting), rows("counts", lost)]
