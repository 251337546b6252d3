"""The store a site asks for: embedded SQLite, or InfluxDB behind a spool on disk."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fdd.store.store import Store, StoreConfig, StoreError


def open_store(config: StoreConfig | Mapping[str, Any], *, read_only: bool = False) -> Store:
    """The store a site asks for.

    ``read_only`` is for a process beside the daemon: it never makes a file and never blocks the daemon's writing.

    Raises
    ------
    StoreError : a value is missing or cannot be used
    StoreUnavailableError : InfluxDB, read only: the server does not answer
    """
    if not isinstance(config, StoreConfig):
        config = StoreConfig.of(config)
    if config.kind == "sqlite":
        from fdd.store.sqlite import SqliteStore  # one that is not used need not load its library

        if config.path is None:
            raise StoreError("store: kind 'sqlite' needs 'path', the database file")
        return SqliteStore(config.path, read_only=read_only)
    if config.kind == "influx":
        from fdd.store.influx import InfluxStore
        from fdd.store.spool import SpooledStore

        inner = InfluxStore(config)
        if read_only:
            return inner
        if config.path is None:
            raise StoreError(
                "store: kind 'influx' needs 'path', the folder where outputs wait while the server is away"
            )
        return SpooledStore(inner, config.path, config.spool_max_bytes)
    raise StoreError(f"store: kind {config.kind!r} is not known; there are sqlite, influx")
