"""The embedded store: one SQLite file in write-ahead mode, one writing process, any number of readers.

Readers see the last committed state and never hold up the writer. A killed process loses nothing it had committed; a
power cut may lose the last commits but leaves the file whole, and since checkpoint and outputs share the file they go
back together. Each measurement is a table clustered by (series, time).
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd

from fdd.records import IntArray, JsonObject, Rows
from fdd.store import rollup
from fdd.store.encoding import decode, encode
from fdd.store.identity import FileIdentity
from fdd.store.schema import (
    MAX_SERIES,
    MEASUREMENTS,
    SCHEMA_VERSION,
    CheckedRows,
    StoreError,
    as_sequence,
    check_kind,
    check_name,
    check_rows,
    measurement_of,
)
from fdd.store.store import StoreUnavailableError

APPLICATION_ID = 0x68666464  # "hfdd": tells this file from any other SQLite database
BUSY_SECONDS = 30.0
_EVER = (-(2**63), 2**63 - 1)


class SqliteStore:
    """A :class:`fdd.store.store.Store` in one file; safe to share between threads.

    Raises
    ------
    StoreError : the file is not a store, is of another schema version, or is missing and ``read_only``
    """

    def __init__(self, path: Path | str, *, read_only: bool = False, max_series: int = MAX_SERIES) -> None:
        self.path = Path(path)
        self.read_only = read_only
        self.max_series = max_series
        self._ids: dict[tuple[str, tuple[str, ...]], IntArray] = {}
        self._lock = threading.RLock()
        self._depth = 0
        self._readers = threading.local()
        self._open: list[sqlite3.Connection] = []
        if read_only:
            if not self.path.is_file():
                raise StoreError(f"no store at {self.path}: start the daemon or the replay that writes it first")
            self._check_version(self._reader())
        else:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._begin()

    # ---- connections

    def _begin(self) -> None:
        self._writer = self._connect("rwc")
        self._prepare()
        self._identity = FileIdentity(self.path)

    @property
    def misplaced(self) -> str:
        """What became of the file under the open store: deleted or replaced; empty while it is the one opened."""
        return "" if self.read_only else self._identity.problem

    def renew(self) -> None:
        """Open what the path leads to now, a new store if nothing; what was open is let go of."""
        with self._lock:
            self.close()
            self._readers = threading.local()
            self._ids.clear()
            for suffix in ("-wal", "-shm"):  # they belong to the file that has gone
                Path(f"{self.path}{suffix}").unlink(missing_ok=True)
            self._begin()

    def _connect(self, mode: str) -> sqlite3.Connection:
        uri = f"{self.path.resolve().as_uri()}?mode={mode}"
        try:
            # check_same_thread: the writer is shared under a lock, readers are closed by whoever closes the store.
            link = sqlite3.connect(uri, uri=True, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False)
            link.execute("PRAGMA cache_size = -65536")
        except sqlite3.Error as problem:
            raise StoreError(f"{self.path} is not a store or cannot be opened: {problem}") from problem
        self._open.append(link)
        return link

    def _reader(self) -> sqlite3.Connection:
        link: sqlite3.Connection | None = getattr(self._readers, "link", None)
        if link is None:
            link = self._readers.link = self._connect("ro")
        return link

    def _prepare(self) -> None:
        link = self._writer
        try:
            self._check_version(link)  # before anything is changed in what may be another's file
            link.execute("PRAGMA journal_mode = WAL")
            link.execute("PRAGMA synchronous = NORMAL")
            link.execute("PRAGMA journal_size_limit = 67108864")
            with self.transaction():
                self._create(link)
        except sqlite3.DatabaseError as problem:
            self.close()
            raise StoreError(f"{self.path} is not a store: {problem}; give another path") from problem
        except StoreError:
            self.close()
            raise

    def _check_version(self, link: sqlite3.Connection) -> None:
        try:
            found = link.execute("PRAGMA application_id").fetchone()[0]
            version = link.execute("PRAGMA user_version").fetchone()[0]
            empty = link.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0
        except sqlite3.DatabaseError as problem:
            raise StoreError(f"{self.path} is not a store: {problem}; give another path") from problem
        if empty and not self.read_only:
            return
        if found != APPLICATION_ID:
            raise StoreError(f"{self.path} is an SQLite database of something else; give another path")
        if version != SCHEMA_VERSION:
            raise StoreError(
                f"{self.path} has schema version {version}, this release reads and writes {SCHEMA_VERSION}; "
                + ("upgrade hvac-fdd" if version > SCHEMA_VERSION else "move the file away and replay the history")
            )

    def _create(self, link: sqlite3.Connection) -> None:
        link.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        link.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        link.execute(
            "CREATE TABLE IF NOT EXISTS series "
            "(id INTEGER PRIMARY KEY, measurement TEXT NOT NULL, name TEXT NOT NULL, UNIQUE (measurement, name))"
        )
        link.execute(
            "CREATE TABLE IF NOT EXISTS documents "
            "(kind TEXT NOT NULL, key TEXT NOT NULL, body TEXT NOT NULL, PRIMARY KEY (kind, key))"
        )
        for m in MEASUREMENTS.values():
            columns = ", ".join(f'"{f}" REAL' for f in m.field_names)
            link.execute(
                f"CREATE TABLE IF NOT EXISTS {m.name} (series INTEGER NOT NULL, time INTEGER NOT NULL, {columns}, "
                "PRIMARY KEY (series, time)) WITHOUT ROWID"
            )
        rollup.create(link)

    # ---- transactions

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """All or nothing; inner transactions join the outer one."""
        if self.read_only:
            raise StoreError(f"the store {self.path} was opened read only")
        with self._lock, translated(self.path):
            if self._depth == 0:
                self._writer.execute("BEGIN IMMEDIATE")
            self._depth += 1
            try:
                yield
                if self._depth == 1:
                    self._writer.execute("COMMIT")
            except BaseException:
                if self._depth == 1:
                    self._ids.clear()  # some may stand for series that are rolled back
                    if self._writer.in_transaction:  # a full disk has rolled back already
                        self._writer.execute("ROLLBACK")
                raise
            finally:
                self._depth -= 1

    @contextmanager
    def _snapshot(self) -> Iterator[sqlite3.Connection]:
        """A connection that sees one state throughout: the open transaction's own, or the last committed one."""
        if not self.read_only and self._lock.acquire(blocking=False):
            try:
                if self._depth:
                    yield self._writer
                    return
            finally:
                self._lock.release()
        link = self._reader()
        with translated(self.path):
            link.execute("BEGIN")
            try:
                yield link
            finally:
                link.execute("COMMIT")

    # ---- rows

    def write(self, rows: Rows | Sequence[Rows]) -> None:
        """Upsert rows; all of them in one transaction."""
        checked = [check_rows(r) for r in as_sequence(rows)]
        with self.transaction():
            for part in checked:
                if len(part):
                    self._write(part)

    def _write(self, rows: CheckedRows) -> None:
        name = rows.measurement.name
        ids = self._numbers(name, rows.names)
        columns = list(rows.fields)
        places = ", ".join("?" * (2 + len(columns)))
        names = _quoted(columns)
        update = ", ".join(f'"{c}" = coalesce(excluded."{c}", "{c}")' for c in columns)
        self._writer.executemany(
            f"INSERT INTO {name} (series, time, {names}) VALUES ({places}) "
            f"ON CONFLICT (series, time) DO UPDATE SET {update}",
            zip(
                ids[rows.series].tolist(), rows.time.tolist(), *(c.tolist() for c in rows.fields.values()), strict=True
            ),
        )
        rollup.note(self._writer, name, int(rows.time.min()))

    def _numbers(self, measurement: str, names: tuple[str, ...]) -> IntArray:
        """Numbers of the series; those that are new are entered."""
        if (measurement, names) in self._ids:
            return self._ids[measurement, names]
        known = self._series(self._writer, measurement)
        new = [name for name in names if name not in known]
        if new and len(known) + len(new) > self.max_series:
            raise StoreError(
                f"{self.path}: {measurement} has {len(known)} series and would get {len(new)} more, the bound is "
                f"{self.max_series}; series {new[0]!r} looks like a name that changes with time"
            )
        self._writer.executemany(
            "INSERT INTO series (measurement, name) VALUES (?, ?)", [(measurement, name) for name in new]
        )
        known = self._series(self._writer, measurement) if new else known
        if len(self._ids) > 1000:
            self._ids.clear()
        self._ids[measurement, names] = np.array([known[name] for name in names], dtype=np.int64)
        return self._ids[measurement, names]

    def read(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """Rows with start <= time < end, ordered by series, then time."""
        return self._read(measurement, measurement, series, start, end)

    def read_hourly(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """One row an hour, as far as :meth:`maintain` has come."""
        return self._read(measurement, f"{measurement}_hourly", series, start, end)

    def maintain(self, now: int) -> None:
        """Keep the hourly values up to the hour before ``now`` [ns]."""
        with self.transaction():
            rollup.roll_up(self._writer, now)

    def prune(self, before: int) -> int:
        """Delete rows older than ``before`` [ns] whose hourly values have been made; returns how many."""
        with self.transaction():
            return rollup.prune(self._writer, before)

    def _read(
        self, measurement: str, table: str, series: Sequence[str] | None, start: int | None, end: int | None
    ) -> pd.DataFrame:
        fields = measurement_of(measurement).field_names
        first = _EVER[0] if start is None else start
        beyond = _EVER[1] if end is None else end
        query = f"SELECT time, {_quoted(fields)} FROM {table} WHERE series = ? AND time >= ? AND time < ? ORDER BY time"
        with self._snapshot() as link:
            ids = self._series(link, measurement) if self._has(link, table) else {}
            names = sorted(ids) if series is None else sorted(set(series) & set(ids))
            blocks = [(n, link.execute(query, (ids[n], first, beyond)).fetchall()) for n in names]
        return _frame(fields, blocks)

    def _has(self, link: sqlite3.Connection, table: str) -> bool:
        """Whether the table is there: a file of an earlier release that is only read may lack some."""
        return link.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (table,)).fetchone() is not None

    def _series(self, link: sqlite3.Connection, measurement: str) -> dict[str, int]:
        found = link.execute("SELECT name, id FROM series WHERE measurement = ?", (measurement,))
        return {name: int(number) for name, number in found}

    def series(self, measurement: str) -> list[str]:
        """Names of the series that have been written, in order."""
        measurement_of(measurement)
        with self._snapshot() as link:
            return sorted(self._series(link, measurement))

    # ---- documents

    def put(self, kind: str, key: str, document: JsonObject) -> None:
        """Keep a document under (kind, key)."""
        body = encode(document, f"{check_kind(kind)} {check_name(key, 'key')!r}")
        with self.transaction():
            self._writer.execute(
                "INSERT INTO documents (kind, key, body) VALUES (?, ?, ?) "
                "ON CONFLICT (kind, key) DO UPDATE SET body = excluded.body",
                (kind, key, body),
            )

    def get(self, kind: str, key: str) -> JsonObject | None:
        """The document under (kind, key), or None."""
        with self._snapshot() as link:
            found = link.execute(
                "SELECT body FROM documents WHERE kind = ? AND key = ?", (check_kind(kind), key)
            ).fetchone()
        return None if found is None else decode(found[0])

    def items(self, kind: str) -> dict[str, JsonObject]:
        """All documents of a kind by key, ordered by key."""
        query = "SELECT key, body FROM documents WHERE kind = ? ORDER BY key"
        with self._snapshot() as link:
            return {key: decode(body) for key, body in link.execute(query, (check_kind(kind),))}

    def list(self, kind: str) -> list[JsonObject]:
        """All documents of a kind, ordered by key."""
        return [*self.items(kind).values()]

    def close(self) -> None:
        """Close every connection."""
        with self._lock:
            while self._open:
                self._open.pop().close()


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """SQLite's errors in the store's words."""
    try:
        yield
    except sqlite3.OperationalError as problem:
        said = str(problem)
        if "locked" in said or "busy" in said:
            raise StoreUnavailableError(
                f"{path}: another process has written for {BUSY_SECONDS:g} s without end"
            ) from problem
        raise StoreError(f"{path}: {said}; look for space on the disk and for the rights of the file") from problem
    except sqlite3.DatabaseError as problem:
        raise StoreError(f"{path}: {problem}; restore it from the last backup (docs/runbook.md)") from problem


def _quoted(names: Sequence[str]) -> str:
    """Column names as SQL: some, like "limit", are its words."""
    return ", ".join(f'"{name}"' for name in names)


def _frame(fields: Sequence[str], blocks: Sequence[tuple[str, list[tuple[float, ...]]]]) -> pd.DataFrame:
    """One frame from each series' rows."""
    counts = [len(rows) for _, rows in blocks]
    columns: dict[str, object] = {"time": np.empty(sum(counts), dtype=np.int64)}
    columns["series"] = np.repeat(np.array([name for name, _ in blocks], dtype=object), counts)
    values = np.empty((len(fields), sum(counts)))
    at = 0
    for _, rows in blocks:
        if not rows:
            continue
        time, *cells = zip(*rows, strict=True)
        columns["time"][at : at + len(rows)] = time  # type: ignore[index]
        values[:, at : at + len(rows)] = np.array(cells, dtype=np.float64)
        at += len(rows)
    columns.update(zip(fields, values, strict=True))
    return pd.DataFrame(columns).astype({"series": "str"})
