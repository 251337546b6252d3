"""The store in an InfluxDB 2 server.

Rows become points of their measurement with the tags ``site``, ``component`` and ``name`` and double fields, so that
writing a point again overwrites it. Documents live in a second bucket, ``<bucket>_documents``, without retention: one
measurement a kind, the tag ``key``, and the JSON text in parts that fit the server's limit for a string.
"""

from __future__ import annotations

import csv
import io
import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from urllib.parse import urlsplit

import numpy as np
import pandas as pd
import pyarrow as pa
from influxdb_client.client.influxdb_client import InfluxDBClient
from influxdb_client.client.write_api import SYNCHRONOUS
from influxdb_client.domain.write_precision import WritePrecision
from influxdb_client.rest import ApiException
from pyarrow.csv import ConvertOptions, read_csv
from urllib3.exceptions import HTTPError

from fdd.records import JsonObject, Rows
from fdd.store.encoding import decode, encode
from fdd.store.line_protocol import digest, document_lines, row_lines
from fdd.store.schema import (
    MAX_SERIES,
    CheckedRows,
    StoreError,
    as_sequence,
    check_kind,
    check_name,
    check_rows,
    join_series,
    measurement_of,
    split_series,
)
from fdd.store.store import StoreConfig, StoreUnavailableError

BATCH_LINES = 5_000
SERIES_PER_QUERY = 50
TIMEOUT_MS = 30_000
_FIRST, _LAST = -(2**63) + 2, 2**63 - 2  # the times the server knows


def read_token(config: StoreConfig) -> str:
    """The token from the file or the environment variable that the site names; never from the site file itself."""
    if config.token_file is not None:
        try:
            token = config.token_file.read_text().strip()
        except OSError as problem:
            raise StoreError(f"store: cannot read token_file {config.token_file}: {problem.strerror}") from None
        where = f"token_file {config.token_file}"
    elif config.token_env:
        token, where = os.environ.get(config.token_env, "").strip(), f"environment variable {config.token_env}"
    else:
        raise StoreError("store: kind 'influx' needs 'token_file' or 'token_env', where its token is read from")
    if not token:
        raise StoreError(f"store: {where} is empty or not set; put the token there")
    return token


def flux_text(value: str) -> str:
    """A Flux string literal."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("${", "\\${") + '"'


def flux_time(nanoseconds: int) -> str:
    """A Flux time literal, exact to the nanosecond."""
    return f"time(v: {min(max(nanoseconds, _FIRST), _LAST)})"


def _userinfo(url: str) -> list[str]:
    """User and password in an address, longest first."""
    found = urlsplit(url)
    return sorted({s for s in (found.username, found.password) if s}, key=len, reverse=True)


class InfluxStore:
    """A :class:`fdd.store.store.Store` in a server; safe to share between threads.

    Raises
    ------
    StoreError : a value is missing or refused by the server
    StoreUnavailableError : the server does not answer, or says that it cannot just now
    """

    def __init__(self, config: StoreConfig, *, max_series: int = MAX_SERIES) -> None:
        for key in ("url", "org", "bucket"):
            if not getattr(config, key):
                raise StoreError(f"store: kind 'influx' needs {key!r}")
        self.config = config
        self.max_series = max_series
        self.documents_bucket = f"{config.bucket}_documents"
        self.site = check_name(config.site, "site")
        if config.ca_file is not None and not config.ca_file.is_file():
            raise StoreError(
                f"store: ca_file {config.ca_file} is not there; give the certificate that signed the server's"
            )
        trusted = None if config.ca_file is None else str(config.ca_file)
        token = read_token(config)
        # A server, or what stands before it, may send back what it was sent; an address may hold a password.
        self._secrets = [(token, "[token]"), *((s, "[password]") for s in _userinfo(config.url))]
        self._where = self._redacted(f"InfluxDB at {config.url}")
        self._client = InfluxDBClient(config.url, token=token, org=config.org, timeout=TIMEOUT_MS, ssl_ca_cert=trusted)
        self._writer = self._client.write_api(write_options=SYNCHRONOUS)
        self._query = self._client.query_api()
        self._held = threading.local()
        self._known: dict[str, set[str]] = {}

    # ---- talking to the server

    def _redacted(self, text: str) -> str:
        for secret, word in self._secrets:
            text = text.replace(secret, word)
        return text

    @contextmanager
    def _translated(self, doing: str) -> Iterator[None]:
        """The client's exceptions in the store's words."""
        where = self._where
        try:
            yield
        except ApiException as problem:
            status = problem.status or 0
            # Without an answer the client's message is a formula, and the reason says what happened.
            cause = problem.message or problem.reason if status else problem.reason or problem.message
            said = self._redacted(str(cause))[:300]
            if status == 0:  # no answer at all: a certificate that is not trusted, or has run out
                raise StoreUnavailableError(f"{where} does not answer: {said}; check ca_file") from None
            if status in (408, 429) or status >= 500:
                raise StoreUnavailableError(f"{where} cannot just now ({status}): {said}") from None
            remedy = {
                401: "; the token is not valid there",
                403: "; the token lacks the right",
                404: f"; check org {self.config.org!r} and bucket {self.config.bucket!r}, or run the set-up",
            }.get(status, "")
            raise StoreError(f"{where} refused {doing} ({status}): {said}{remedy}") from None
        except (HTTPError, OSError) as problem:
            raise StoreUnavailableError(f"{where} does not answer: {self._redacted(str(problem))}") from None

    def _send(self, bucket: str, lines: Iterator[str]) -> None:
        while batch := list(islice(lines, BATCH_LINES)):
            with self._translated("points"):
                record = "\n".join(batch).encode()
                self._writer.write(bucket=bucket, record=record, write_precision=WritePrecision.NS)  # type: ignore[arg-type]

    def _ask(self, flux: str) -> str:
        with self._translated("a query"):
            response = self._query.query_raw(flux, dialect={"header": True, "annotations": []})
            answer: str = response.read().decode()
        if answer.startswith((",error", "error,")):
            raise StoreError(f"{self._where}: {self._redacted(answer.splitlines()[1])[:300]}")
        return answer

    # ---- transactions

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Hold writes back to the end; then send rows before documents. Inner transactions join the outer one."""
        if self._pending() is not None:
            yield
            return
        held: tuple[list[CheckedRows], list[tuple[str, str, JsonObject]]] = ([], [])
        self._held.writes = held
        try:
            yield
        finally:
            self._held.writes = None
        for rows in held[0]:
            self._write(rows)
        for kind, key, document in held[1]:
            self.put(kind, key, document)

    def _pending(self) -> tuple[list[CheckedRows], list[tuple[str, str, JsonObject]]] | None:
        return getattr(self._held, "writes", None)

    # ---- rows

    def write(self, rows: Rows | Sequence[Rows]) -> None:
        """Upsert rows, in batches."""
        checked = [check_rows(r) for r in as_sequence(rows)]
        pending = self._pending()
        if pending is not None:
            pending[0].extend(checked)
            return
        for part in checked:
            self._write(part)

    def _write(self, rows: CheckedRows) -> None:
        if not len(rows):
            return
        self._bound(rows)
        self._send(self.config.bucket, row_lines(rows, self.site))

    def _bound(self, rows: CheckedRows) -> None:
        """Refuse more series than the server should index; counted since this process began."""
        known = self._known.setdefault(rows.measurement.name, set())
        new = [n for n in rows.names if n not in known]
        if new and len(known) + len(new) > self.max_series:
            raise StoreError(
                f"InfluxDB bucket {self.config.bucket}: {rows.measurement.name} has {len(known)} series and would get "
                f"{len(new)} more, the bound is {self.max_series}; "
                f"series {new[0]!r} looks like a name that changes with time"
            )
        known.update(new)

    def read(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """Rows with start <= time < end, ordered by series, then time."""
        return self._read(self.config.bucket, measurement, series, start, end)

    def read_hourly(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        """One row an hour, as far as the server's task has come."""
        return self._read(f"{self.config.bucket}_hourly", measurement, series, start, end)

    def maintain(self, now: int) -> None:
        """Nothing: a task of the server keeps the hourly values."""

    def _read(
        self, bucket: str, measurement: str, series: Sequence[str] | None, start: int | None, end: int | None
    ) -> pd.DataFrame:
        fields = measurement_of(measurement).field_names
        first = _FIRST if start is None else start
        beyond = _LAST if end is None else end
        groups: list[Sequence[str] | None] = [None]
        if series is not None:
            wanted = sorted(set(series))
            groups = [wanted[i : i + SERIES_PER_QUERY] for i in range(0, len(wanted), SERIES_PER_QUERY)]
        cells = [self._cells(bucket, measurement, g, first, beyond) for g in groups if first < beyond]
        return _rows_from_cells(fields, [c for c in cells if len(c)])

    def _source(self, bucket: str, measurement: str, first: int, beyond: int) -> str:
        return (
            f"from(bucket: {flux_text(bucket)}) "
            f"|> range(start: {flux_time(first)}, stop: {flux_time(beyond)}) "
            f'|> filter(fn: (r) => r._measurement == "{measurement}" and r.site == {flux_text(self.site)})'
        )

    def _cells(
        self, bucket: str, measurement: str, series: Sequence[str] | None, first: int, beyond: int
    ) -> pd.DataFrame:
        flux = self._source(bucket, measurement, first, beyond)
        if series is not None:
            pairs = [split_series(s) for s in series]
            any_of = " or ".join(f"(r.component == {flux_text(c)} and r.name == {flux_text(n)})" for c, n in pairs)
            flux += f" |> filter(fn: (r) => {any_of})"
        flux += ' |> keep(columns: ["_time", "_value", "_field", "component", "name"])'
        answer = self._ask(flux)
        if not answer.strip():
            return pd.DataFrame()
        texts = dict.fromkeys(("_time", "_field", "component", "name"), pa.string())
        convert = ConvertOptions(
            column_types={**texts, "_value": pa.float64()}, include_columns=[*texts, "_value"], null_values=[]
        )
        found: pd.DataFrame = read_csv(io.BytesIO(answer.encode()), convert_options=convert).to_pandas()
        return found

    def series(self, measurement: str) -> list[str]:
        """Names of the series that have been written, in order."""
        measurement_of(measurement)
        flux = self._source(self.config.bucket, measurement, _FIRST, _LAST)
        flux += ' |> first() |> keep(columns: ["component", "name"]) |> group()'
        found = _table(self._ask(flux))
        return sorted({join_series(r["component"], r["name"]) for r in found})

    # ---- documents

    def put(self, kind: str, key: str, document: JsonObject) -> None:
        """Keep a document under (kind, key)."""
        body = encode(document, f"{check_kind(kind)} {check_name(key, 'key')!r}")
        pending = self._pending()
        if pending is not None:
            pending[1].append((kind, key, decode(body)))
            return
        self._send(self.documents_bucket, document_lines(kind, key, body, self.site))

    def get(self, kind: str, key: str) -> JsonObject | None:
        """The document under (kind, key), or None."""
        return self._documents(kind, f" and r.key == {flux_text(key)}").get(key)

    def items(self, kind: str) -> dict[str, JsonObject]:
        """All documents of a kind by key, ordered by key."""
        return self._documents(kind, "")

    def list(self, kind: str) -> list[JsonObject]:
        """All documents of a kind, ordered by key."""
        return [*self.items(kind).values()]

    def _documents(self, kind: str, condition: str) -> dict[str, JsonObject]:
        flux = (
            f"from(bucket: {flux_text(self.documents_bucket)}) |> range(start: 0, stop: 1) "
            f'|> filter(fn: (r) => r._measurement == "{check_kind(kind)}") '
            f"|> filter(fn: (r) => r.site == {flux_text(self.site)}{condition}) "
            '|> filter(fn: (r) => r._field == "body" or r._field == "digest") '
            '|> keep(columns: ["key", "part", "_field", "_value"])'
        )
        parts: dict[str, dict[int, dict[str, str]]] = {}
        for row in _table(self._ask(flux)):
            parts.setdefault(row["key"], {}).setdefault(int(row["part"]), {})[row["_field"]] = row["_value"]
        return {key: decode(_joined(kind, key, parts[key])) for key in sorted(parts)}

    @property
    def misplaced(self) -> str:
        """A server keeps its own files."""
        return ""

    def renew(self) -> None:
        """Nothing to open again."""

    def close(self) -> None:
        """Let go of the connections."""
        self._writer.close()  # type: ignore[no-untyped-call]
        self._client.close()  # type: ignore[no-untyped-call]


def _joined(kind: str, key: str, parts: dict[int, dict[str, str]]) -> str:
    """The document's text from its parts; parts beyond its own are left from a longer one before it."""
    mark = parts[0]["digest"]
    count = int(mark.partition(":")[0])
    body = "".join(parts[i]["body"] for i in range(count) if i in parts)
    if digest(body, count) != mark:
        raise StoreError(f"{kind} {key!r} was cut short while it was written; put it again")
    return body


def _table(answer: str) -> Iterator[dict[str, str]]:
    """Rows of a CSV answer, whose header comes again where tables differ."""
    header: list[str] = []
    for row in csv.reader(io.StringIO(answer)):
        if not row:
            header = []
        elif not header:
            header = row
        else:
            yield dict(zip(header, row, strict=True))


def _rows_from_cells(fields: Sequence[str], cells: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """One row for each (series, time) from one line for each field's value."""
    empty = {"time": np.empty(0, np.int64), "series": np.empty(0, object)} | {f: np.empty(0) for f in fields}
    if not cells:
        return pd.DataFrame(empty).astype({"series": "str"})
    found = pd.concat(cells, ignore_index=True) if len(cells) > 1 else cells[0]
    time = found["_time"].str.rstrip("Z").to_numpy().astype("datetime64[ns]").astype(np.int64)
    pairs = pd.MultiIndex.from_arrays([found["component"], found["name"]])
    codes, unique = pd.factorize(pairs)
    labels = np.array([join_series(c, n) for c, n in unique], dtype=object)
    names, position = np.unique(labels.astype(str), return_inverse=True)
    code = position[codes]
    order = np.lexsort((time, code))
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(code[order]) != 0) | (np.diff(time[order]) != 0)
    row = np.empty(len(order), dtype=np.int64)
    row[order] = np.cumsum(new) - 1
    first = order[new]
    columns: dict[str, object] = {"time": time[first], "series": names[code[first]].astype(object)}
    values = found["_value"].to_numpy()
    for field in fields:
        column = np.full(len(first), np.nan)
        there = (found["_field"] == field).to_numpy()
        column[row[there]] = values[there]
        columns[field] = column
    return pd.DataFrame(columns).astype({"series": "str"})
