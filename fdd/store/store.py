"""The port to a store: time series rows and JSON documents, both upserted by key.

Two ends implement it: :mod:`fdd.store.sqlite`, the embedded default, and :mod:`fdd.store.influx` for a server. Writing
the same rows or the same document twice is writing it once, so whatever was interrupted is simply done again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import pandas as pd

from fdd.records import JsonObject, Rows
from fdd.store.schema import SchemaError, StoreError

__all__ = ["SchemaError", "Store", "StoreConfig", "StoreError", "StoreUnavailableError"]


class StoreUnavailableError(StoreError):
    """The store cannot be reached now; the same call may succeed later."""


@runtime_checkable
class Store(Protocol):
    """Where outputs and documents are kept. Every method may raise :class:`StoreError`."""

    def write(self, rows: Rows | Sequence[Rows]) -> None:
        """Upsert rows on (measurement, series, time); a field that is not finite leaves what stood there."""

    def read(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """Rows with start <= time < end [ns], ordered by series, then time.

        Columns: ``time`` (int64, ns), ``series`` (str), then every field of the measurement (float64, NaN = missing).
        """

    def read_hourly(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """As :meth:`read`, one row an hour, timed at its start; as far as :meth:`maintain` or the server's task got."""

    def maintain(self, now: int) -> None:
        """Keep the hourly values up to the hour before ``now`` [ns]; call it about once an hour."""

    def series(self, measurement: str) -> list[str]:
        """Names of the series that have been written, in order."""

    def put(self, kind: str, key: str, document: JsonObject) -> None:
        """Keep a document of JSON values and numpy arrays under (kind, key), in place of what was there."""

    def get(self, kind: str, key: str) -> JsonObject | None:
        """The document, or None."""

    def items(self, kind: str) -> dict[str, JsonObject]:
        """All documents of a kind by key, ordered by key."""

    def list(self, kind: str) -> list[JsonObject]:
        """All documents of a kind, ordered by key."""

    def transaction(self) -> AbstractContextManager[None]:
        """Everything written inside becomes visible and durable at once, or, on an exception, not at all.

        A store without transactions holds the writes back to the end and sends rows before documents, so that a
        checkpoint never runs ahead of the outputs it stands for. Whether a read inside sees what was written inside
        is left open.
        """

    @property
    def misplaced(self) -> str:
        """What became of the store's own file while it was open (deleted, replaced); empty where nothing did."""

    def renew(self) -> None:
        """After that: go on with what the path leads to now, or a new file."""

    def close(self) -> None:
        """Let go of files and connections; a second call does nothing."""


@dataclass(frozen=True, slots=True)
class StoreConfig:
    """The store part of a site.

    Attributes
    ----------
    kind : ``sqlite`` or ``influx``
    site : name of the site; the tag ``site`` in InfluxDB
    path : SQLite: the database file; InfluxDB: folder of the spool
    url, org, bucket : of the InfluxDB server; documents go to ``<bucket>_documents``
    token_file, token_env : where the token is read from: a file, or an environment variable
    ca_file : certificate (PEM) that signed the server's, where ``url`` is https and the system does not know it
    spool_max_bytes : how much may wait on disk while the server is away
    """

    kind: str = "sqlite"
    site: str = "site"
    path: Path | None = None
    url: str = ""
    org: str = ""
    bucket: str = ""
    token_file: Path | None = None
    token_env: str = ""
    ca_file: Path | None = None
    spool_max_bytes: int = 1_000_000_000

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> StoreConfig:
        """From a mapping, refusing unknown keys with a suggestion."""
        known = [f.name for f in fields(cls)]
        for key in table:
            if key not in known:
                near = get_close_matches(key, known, 1)
                hint = f"; did you mean {near[0]!r}?" if near else f"; there are {', '.join(known)}"
                raise StoreError(f"store: unknown key {key!r}{hint}")
        values = dict(table)
        for key in ("path", "token_file", "ca_file"):
            if values.get(key) is not None:
                values[key] = Path(values[key])
        return cls(**values)
