"""Copies of a store: to another, to Parquet."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from fdd.store.influx import InfluxStore
from fdd.store.schema import MEASUREMENTS
from fdd.store.sqlite import SqliteStore
from fdd.store.store import Store, StoreConfig
from fdd.store.transfer import export_parquet, migrate
from tests.store.conformance import T0, rows
from tests.store.influxd import ORG, Influxd


def fill(store: Store) -> None:
    for m in ("samples", "charts", "predictions"):
        store.write(rows(m, tuple(f"c{i}/x" for i in range(45)), 20))
    store.write(rows("samples", ("gappy",), 4, value=[1, np.nan, 3, 4], quality=[0, 2, np.nan, 0]))
    store.put("alarm", "hx@2026", {"key": "hx@2026", "since": T0, "array": np.arange(3.0)})
    store.put("baseline", "hx/000001", {"parameters": {"U": 0.1}})


def same(a: Store, b: Store) -> None:
    for m in MEASUREMENTS:
        pd.testing.assert_frame_equal(a.read(m), b.read(m))
    assert b.items("baseline") == a.items("baseline")
    np.testing.assert_array_equal(b.items("alarm")["hx@2026"]["array"], np.arange(3.0))


def test_migration_copies_everything_and_can_be_repeated(tmp_path: Path) -> None:
    source, target = SqliteStore(tmp_path / "a.sqlite"), SqliteStore(tmp_path / "b.sqlite")
    fill(source)
    seen: list[tuple[str, int, int]] = []
    done = migrate(source, target, lambda *p: seen.append(p))
    assert done.rows == {"samples": 904, "predictions": 900, "charts": 900}
    assert done.documents == {"alarm": 1, "baseline": 1}
    assert seen[-1] == ("charts", 45, 45)
    migrate(source, target)
    same(source, target)


@pytest.mark.integration
def test_migration_from_sqlite_to_influx_copies_everything(
    influxd: Influxd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
    source = SqliteStore(tmp_path / "a.sqlite")
    fill(source)
    config = StoreConfig("influx", url=influxd.url, org=ORG, bucket=influxd.new_bucket(), token_env="FDD_TEST_TOKEN")
    target = InfluxStore(config)
    migrate(source, target)
    same(source, target)


def test_parquet_holds_rows_units_and_documents(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "a.sqlite")
    fill(store)
    paths = export_parquet(store, tmp_path / "out")
    assert sorted(p.name for p in paths) == [
        "alarm.json", "baseline.json", "charts.parquet", "predictions.parquet", "samples.parquet",
    ]  # fmt: skip
    table = pq.read_table(tmp_path / "out" / "samples.parquet")
    assert table.schema.field("quality").metadata[b"unit"] == b"code"
    frame = table.to_pandas()
    frame["time"] = frame["time"].astype("int64")
    frame["series"] = frame["series"].astype("str")
    pd.testing.assert_frame_equal(frame, store.read("samples"))
    assert json.loads((tmp_path / "out" / "baseline.json").read_text()) == store.items("baseline")
    assert not list((tmp_path / "out").glob("*.part"))


def test_parquet_of_a_span_holds_only_that_span(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "a.sqlite")
    fill(store)
    export_parquet(store, tmp_path / "out", ["charts"], T0, T0 + 2_000_000_000)
    assert pq.read_table(tmp_path / "out" / "charts.parquet").num_rows == 90
    assert not (tmp_path / "out" / "samples.parquet").exists()
