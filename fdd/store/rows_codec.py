"""Rows as bytes: a JSON header and the raw columns, so that a batch is one blob on disk."""

from __future__ import annotations

import json
import struct

import numpy as np

from fdd.records import Rows

_LENGTH = struct.Struct("<I")


def encode_rows(rows: Rows) -> bytes:
    """Little-endian columns behind a header; exact."""
    n = len(rows.time)
    header = json.dumps([rows.measurement, list(rows.names), n, list(rows.fields)], ensure_ascii=False).encode()
    columns = [np.asarray(rows.series, "<i4").tobytes(), np.asarray(rows.time, "<i8").tobytes()]
    columns += [np.asarray(values, "<f8").tobytes() for values in rows.fields.values()]
    return b"".join([_LENGTH.pack(len(header)), header, *columns])


def decode_rows(raw: bytes) -> Rows:
    """Inverse of :func:`encode_rows`; every field comes back as doubles."""
    start = _LENGTH.size + _LENGTH.unpack_from(raw)[0]
    measurement, names, n, fields = json.loads(raw[_LENGTH.size : start])
    series = np.frombuffer(raw, "<i4", n, start).astype(np.int32)
    time = np.frombuffer(raw, "<i8", n, start + 4 * n).astype(np.int64)
    at = start + 12 * n
    values = {f: np.frombuffer(raw, "<f8", n, at + 8 * n * k).astype(np.float64) for k, f in enumerate(fields)}
    return Rows(measurement, tuple(names), series, time, values)
