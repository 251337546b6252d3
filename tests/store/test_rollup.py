"""Hourly values of the SQLite store equal those computed by pandas from the rows, whatever was written when."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.records import Rows
from fdd.store.rollup import HOUR
from fdd.store.schema import MEASUREMENTS
from fdd.store.sqlite import SqliteStore

START = 470_000 * HOUR


@pytest.fixture
def store(tmp_path: Path) -> SqliteStore:
    return SqliteStore(tmp_path / "s.sqlite")


def random_rows(measurement: str, rng: np.random.Generator, n: int, hours: int = 30) -> Rows:
    """Rows at random times with every fifth value missing."""
    fields = {}
    for name in MEASUREMENTS[measurement].field_names:
        column = rng.integers(0, 50, n).astype(float)
        column[rng.random(n) < 0.2] = np.nan
        fields[name] = column
    time = START + rng.integers(0, hours * HOUR, n)
    return Rows(measurement, ("a/x", "b/y"), rng.integers(0, 2, n).astype(np.int32), time, fields)


def expected(store: SqliteStore, measurement: str, end: int) -> pd.DataFrame:
    raw = store.read(measurement, end=end)
    rules = {f.name: f.hourly for f in MEASUREMENTS[measurement].fields}
    grouped = raw.assign(time=raw["time"] // HOUR * HOUR).groupby(["series", "time"], as_index=False).agg(rules)
    return grouped[["time", "series", *rules]].astype({"series": "str"})


@pytest.mark.parametrize("measurement", ["charts", "gates", "predictions", "counts"])
def test_hourly_values_follow_late_rows_and_rewrites(store: SqliteStore, measurement: str) -> None:
    rng = np.random.default_rng(8)
    for hours in (5, 12, 12, 30):  # later rounds write into hours that have been rolled up
        store.write(random_rows(measurement, rng, 400, hours))
        now = START + hours * HOUR + HOUR // 3
        store.maintain(now)
        pd.testing.assert_frame_equal(store.read_hourly(measurement), expected(store, measurement, now // HOUR * HOUR))


def test_the_running_hour_waits_until_it_is_whole(store: SqliteStore) -> None:
    store.write(
        Rows("samples", ("p",), np.zeros(2, np.int32), START + np.array([0, HOUR]), {"value": np.array([1.0, 2.0])})
    )
    store.maintain(START + HOUR + HOUR // 2)
    assert store.read_hourly("samples")["value"].tolist() == [1.0]
    store.maintain(START + 2 * HOUR)
    assert store.read_hourly("samples")["value"].tolist() == [1.0, 2.0]


def test_maintaining_again_does_no_hour_twice(store: SqliteStore) -> None:
    store.write(random_rows("charts", np.random.default_rng(1), 300, 10))
    store.maintain(START + 20 * HOUR)
    before = store.read_hourly("charts")
    changes = store._writer.total_changes
    store.maintain(START + 20 * HOUR)
    assert store._writer.total_changes == changes
    pd.testing.assert_frame_equal(store.read_hourly("charts"), before)


def test_pruned_rows_are_gone_and_their_hours_stand(store: SqliteStore) -> None:
    store.write(random_rows("charts", np.random.default_rng(2), 500, 10))
    store.maintain(START + 10 * HOUR)
    hourly, written = store.read_hourly("charts"), len(store.read("charts"))
    gone = store.prune(START + 6 * HOUR + 5)
    left = store.read("charts")
    assert gone > 0
    assert gone + len(left) == written
    assert left["time"].min() >= START + 6 * HOUR
    store.write(Rows("charts", ("a/x",), np.zeros(1, np.int32), np.array([START]), {"statistic": np.array([1e6])}))
    store.maintain(START + 10 * HOUR)
    pd.testing.assert_frame_equal(store.read_hourly("charts"), hourly)


def test_rows_that_have_not_been_rolled_up_are_not_pruned(store: SqliteStore) -> None:
    store.write(random_rows("charts", np.random.default_rng(3), 100, 10))
    assert store.prune(START + 10 * HOUR) == 0
    assert len(store.read("charts")) == 100


def test_a_span_of_hours_of_one_series_is_read(store: SqliteStore) -> None:
    store.write(random_rows("charts", np.random.default_rng(4), 400, 10))
    store.maintain(START + 10 * HOUR)
    found = store.read_hourly("charts", ["b/y"], START + 2 * HOUR, START + 4 * HOUR)
    assert found["time"].tolist() == [START + 2 * HOUR, START + 3 * HOUR]
    assert set(found["series"]) == {"b/y"}
