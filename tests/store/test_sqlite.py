"""The SQLite store: the conformance suite, and what only a file can suffer."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from fdd.records import Rows
from fdd.store.opening import open_store
from fdd.store.sqlite import SqliteStore
from fdd.store.store import Store, StoreConfig, StoreError, StoreUnavailableError
from tests.store.conformance import T0, StoreConformance, rows


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "store.sqlite"


class TestSqliteStore(StoreConformance):
    @pytest.fixture
    def store(self, path: Path) -> SqliteStore:
        return SqliteStore(path)


WRITER = """
import sys, numpy as np
from fdd.records import Rows
from fdd.store.sqlite import SqliteStore
store = SqliteStore(sys.argv[1])
names = tuple(f"c{i}/x" for i in range(50))
batch = 0
while True:
    time = np.full(50, batch, dtype=np.int64)
    with store.transaction():
        store.write(Rows("samples", names, np.arange(50, dtype=np.int32), time, {"value": np.full(50, float(batch))}))
        store.put("state", "engine", {"batch": batch})
    print(batch, flush=True)
    batch += 1
"""


def _start_writer(path: Path) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)


def test_killed_writer_loses_no_committed_batch_and_leaves_no_half_batch(path: Path) -> None:
    rng = np.random.default_rng(11)
    for _ in range(4):
        writer = _start_writer(path)
        assert writer.stdout is not None
        for _ in range(int(rng.integers(5, 60))):
            said = writer.stdout.readline()
        time.sleep(float(rng.uniform(0, 0.005)))
        os.kill(writer.pid, signal.SIGKILL)
        said = (writer.stdout.read().split() or [said])[-1]
        writer.wait()
        with_store = SqliteStore(path)
        found = with_store.read("samples")
        state = with_store.get("state", "engine")
        with_store.close()
        assert state is not None
        assert state["batch"] >= int(said)
        np.testing.assert_array_equal(found.groupby("time").size(), np.full(state["batch"] + 1, 50))
        path.unlink()


def test_other_processes_read_whole_batches_while_the_writer_writes(path: Path) -> None:
    writer = _start_writer(path)
    assert writer.stdout is not None
    writer.stdout.readline()
    reader = SqliteStore(path, read_only=True)
    try:
        counts = [len(reader.read("samples")) for _ in range(10)]
    finally:
        writer.kill()
        writer.wait()
    assert all(n % 50 == 0 for n in counts)
    assert counts[-1] > counts[0]


def test_a_long_read_does_not_hold_up_the_writer(path: Path) -> None:
    store = SqliteStore(path)
    store.write(rows(n=100))
    link = sqlite3.connect(path)
    link.execute("BEGIN")
    link.execute("SELECT count(*) FROM charts").fetchone()
    began = time.perf_counter()
    store.write(rows(series=("other/x",), n=100))
    assert time.perf_counter() - began < 5
    assert link.execute("SELECT count(*) FROM charts").fetchone() == (100,)
    link.close()


def test_two_threads_write_without_losing_a_row(path: Path) -> None:
    store = SqliteStore(path)

    def work(name: str) -> None:
        for i in range(50):
            store.write(
                Rows("samples", (name,), np.zeros(1, np.int32), np.array([T0 + i]), {"value": np.array([i * 1.0])})
            )

    threads = [threading.Thread(target=work, args=(f"t{k}",)) for k in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert store.read("samples").groupby("series").size().tolist() == [50] * 4


def test_a_read_only_store_refuses_to_write(path: Path) -> None:
    SqliteStore(path).close()
    reader = SqliteStore(path, read_only=True)
    with pytest.raises(StoreError, match="read only"):
        reader.write(rows())
    with pytest.raises(StoreError, match="read only"):
        reader.put("alarm", "k", {})


def test_reading_a_store_that_is_not_there_says_so(path: Path) -> None:
    with pytest.raises(StoreError, match=r"no store at .*store\.sqlite"):
        SqliteStore(path, read_only=True)
    assert not path.exists()


@pytest.mark.parametrize("read_only", [False, True])
def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path: Path, read_only: bool) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("not a database, long enough to be read as a header " * 40)
    other = tmp_path / "other.sqlite"
    link = sqlite3.connect(other)
    link.execute("CREATE TABLE t (x)")
    link.commit()
    link.close()
    for path in (text, other):
        before = path.read_bytes()
        with pytest.raises(StoreError, match=r"not a store|something else"):
            SqliteStore(path, read_only=read_only)
        assert path.read_bytes() == before


def test_another_schema_version_is_refused_with_both_numbers(path: Path) -> None:
    SqliteStore(path).close()
    link = sqlite3.connect(path)
    link.execute("PRAGMA user_version = 99")
    link.close()
    with pytest.raises(StoreError, match=r"schema version 99.*writes 1; upgrade"):
        SqliteStore(path)


def test_a_full_disk_is_said_and_what_was_committed_stays(path: Path) -> None:
    store = SqliteStore(path)
    store.write(rows(n=100))
    (pages,) = store._writer.execute("PRAGMA page_count").fetchone()
    store._writer.execute(f"PRAGMA max_page_count = {pages + 2}")
    with pytest.raises(StoreError, match=r"store\.sqlite: database or disk is full; look for space"):
        store.write(rows(series=tuple(f"s{i}/x" for i in range(50)), n=200))
    assert len(store.read("charts")) == 100
    store._writer.execute("PRAGMA max_page_count = 1000000")
    store.write(rows(series=("s1/x",), n=10))
    assert len(store.read("charts")) == 110


def test_a_damaged_file_is_said_with_the_remedy(path: Path) -> None:
    store = SqliteStore(path)
    store.write(rows(n=5000))
    store.close()
    raw = bytearray(path.read_bytes())
    raw[4096 * 40 :] = b"\xa5" * (len(raw) - 4096 * 40)
    path.write_bytes(raw)
    with pytest.raises(StoreError, match="restore it from the last backup"):
        SqliteStore(path, read_only=True).read("charts")


def test_an_endless_writer_beside_us_is_named_as_such(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fdd.store.sqlite.BUSY_SECONDS", 0.2)
    store = SqliteStore(path)
    link = sqlite3.connect(path)
    link.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreUnavailableError, match="another process has written"):
        store.write(rows())
    link.rollback()
    store.write(rows())
    link.close()


def test_more_series_than_the_bound_are_refused(path: Path) -> None:
    store = SqliteStore(path, max_series=3)
    store.write(rows(series=("a", "b", "c")))
    with pytest.raises(StoreError, match=r"has 3 series and would get 1 more.*'d'"):
        store.write(rows(series=("d",)))
    store.write(rows(series=("a",), n=5))


def test_open_store_takes_the_site_s_store_part(path: Path) -> None:
    store = open_store({"kind": "sqlite", "path": str(path)})
    assert isinstance(store, Store)
    store.put("run", "r", {"x": 1})
    assert open_store(StoreConfig(path=path), read_only=True).get("run", "r") == {"x": 1}


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"kind": "sqlite"}, "needs 'path'"),
        ({"kind": "postgres"}, "'postgres' is not known"),
        ({"kind": "sqlite", "paht": "x"}, "did you mean 'path'"),
    ],
)
def test_a_bad_store_part_is_refused_with_the_remedy(table: dict[str, str], says: str) -> None:
    with pytest.raises(StoreError, match=says):
        open_store(table)
