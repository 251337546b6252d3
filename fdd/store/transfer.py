"""Copying a whole store: to another store, or to Parquet files for analysis."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from fdd.records import Rows
from fdd.store.encoding import encode
from fdd.store.schema import DOCUMENT_KINDS, MEASUREMENTS, measurement_of
from fdd.store.store import Store

SERIES_AT_ONCE = 20
Progress = Callable[[str, int, int], None]  # what is copied, series done, series in all


@dataclass(frozen=True, slots=True)
class Transferred:
    """What was copied: rows by measurement, documents by kind."""

    rows: dict[str, int] = field(default_factory=dict)
    documents: dict[str, int] = field(default_factory=dict)


def rows_of(measurement: str, frame: pd.DataFrame) -> Rows:
    """The rows that :meth:`Store.read` gave, as they were written."""
    codes, names = pd.factorize(frame["series"])
    fields = {f: frame[f].to_numpy(np.float64) for f in measurement_of(measurement).field_names}
    return Rows(measurement, tuple(names), codes.astype(np.int32), frame["time"].to_numpy(np.int64), fields)


def _blocks(
    store: Store, measurement: str, start: int | None, end: int | None, progress: Progress | None
) -> Iterator[pd.DataFrame]:
    names = store.series(measurement)
    for at in range(0, len(names), SERIES_AT_ONCE):
        block = store.read(measurement, names[at : at + SERIES_AT_ONCE], start, end)
        if len(block):
            yield block
        if progress:
            progress(measurement, min(at + SERIES_AT_ONCE, len(names)), len(names))


def migrate(source: Store, target: Store, progress: Progress | None = None) -> Transferred:
    """Copy every row and document. Upserts, so an interrupted copy is simply started again."""
    done = Transferred()
    for measurement in MEASUREMENTS:
        for block in _blocks(source, measurement, None, None, progress):
            target.write(rows_of(measurement, block))
            done.rows[measurement] = done.rows.get(measurement, 0) + len(block)
    for kind in DOCUMENT_KINDS:
        documents = source.items(kind)
        for key, document in documents.items():
            target.put(kind, key, document)
        if documents:
            done.documents[kind] = len(documents)
    return done


def export_parquet(
    store: Store,
    folder: Path,
    measurements: Sequence[str] = tuple(MEASUREMENTS),
    start: int | None = None,
    end: int | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """One Parquet file a measurement (time as UTC nanoseconds, series, fields) and one JSON file a kind of document.

    A file appears under its name only once it is whole. Units stand in the metadata of the columns.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name in measurements:
        blocks = _blocks(store, name, start, end, progress)
        first = next(blocks, None)
        if first is not None:
            written.append(_write_parquet(folder / f"{name}.parquet", name, first, blocks))
    for kind in DOCUMENT_KINDS:
        documents = store.items(kind)
        if documents:
            texts = {key: json.loads(encode(document, kind)) for key, document in documents.items()}
            path = folder / f"{kind}.json"
            path.write_text(json.dumps(texts, indent=1, ensure_ascii=False), encoding="utf-8")
            written.append(path)
    return written


def _write_parquet(path: Path, measurement: str, first: pd.DataFrame, rest: Iterator[pd.DataFrame]) -> Path:
    fields = measurement_of(measurement).fields
    schema = pa.schema(
        [
            pa.field("time", pa.timestamp("ns", tz="UTC"), nullable=False),
            pa.field("series", pa.dictionary(pa.int32(), pa.string()), nullable=False),
            *(pa.field(f.name, pa.float64(), metadata={"unit": f.unit, "meaning": f.meaning}) for f in fields),
        ]
    )
    part = path.with_suffix(".part")
    with pq.ParquetWriter(part, schema) as writer:
        for block in (first, *rest):
            columns = [pa.array(block["time"].to_numpy()).cast(schema.field("time").type)]
            columns.append(pa.array(block["series"].astype(object)).dictionary_encode())
            columns += [pa.array(block[f.name].to_numpy(), from_pandas=True) for f in fields]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
    part.replace(path)
    return path
