"""The spool: the conformance suite with a store behind it, outages, crashes, and its bound."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.records import JsonObject, Rows
from fdd.store.opening import open_store
from fdd.store.rows_codec import decode_rows, encode_rows
from fdd.store.spool import SpooledStore, SpoolStatus
from fdd.store.sqlite import SqliteStore
from fdd.store.store import StoreConfig, StoreError, StoreUnavailableError
from tests.store.conformance import T0, StoreConformance, rows
from tests.store.influxd import ORG, Influxd


class Switchable(SqliteStore):
    """A real store with a plug that can be pulled, in the middle of a write too."""

    away = False
    writes_until_away: int | None = None
    refuse_series = ""

    def _check(self) -> None:
        if self.writes_until_away is not None:
            self.writes_until_away -= 1
            self.away = self.away or self.writes_until_away < 0
        if self.away:
            raise StoreUnavailableError("unplugged")

    def write(self, rows: Rows | Sequence[Rows]) -> None:
        for r in [rows] if isinstance(rows, Rows) else rows:
            self._check()
            if self.refuse_series in r.names:
                raise StoreError("refused for good")
            super().write(r)

    def read(
        self, measurement: str, series: Sequence[str] | None = None, start: int | None = None, end: int | None = None
    ) -> pd.DataFrame:
        self._check()
        return super().read(measurement, series, start, end)

    def put(self, kind: str, key: str, document: JsonObject) -> None:
        self._check()
        super().put(kind, key, document)

    def items(self, kind: str) -> dict[str, JsonObject]:
        self._check()
        return super().items(kind)

    def get(self, kind: str, key: str) -> JsonObject | None:
        self._check()
        return super().get(kind, key)


@pytest.fixture
def inner(tmp_path: Path) -> Switchable:
    return Switchable(tmp_path / "inner.sqlite")


@pytest.fixture
def spool(inner: Switchable, tmp_path: Path) -> Iterator[SpooledStore]:
    store = SpooledStore(inner, tmp_path / "spool")
    yield store
    store.close()


class TestSpooledStore(StoreConformance):
    @pytest.fixture
    def store(self, spool: SpooledStore) -> SpooledStore:
        return spool


def wait(condition: object, seconds: float = 20) -> None:
    deadline = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)


def one(i: int, name: str = "p") -> Rows:
    return Rows("samples", (name,), np.zeros(1, np.int32), np.array([T0 + i]), {"value": np.array([float(i)])})


def test_rows_survive_the_codec_bit_for_bit() -> None:
    written = rows("charts", ("a/ü", "b"), 7)
    found = decode_rows(encode_rows(written))
    assert (found.measurement, found.names) == (written.measurement, written.names)
    np.testing.assert_array_equal(found.series, written.series)
    np.testing.assert_array_equal(found.time, written.time)
    for name, column in written.fields.items():
        np.testing.assert_array_equal(found.fields[name], column)


def test_outage_loses_and_doubles_nothing(spool: SpooledStore, inner: Switchable) -> None:
    rng = np.random.default_rng(3)
    for i in range(200):
        if i % 40 == 10:
            inner.writes_until_away = int(rng.integers(0, 3))
        if i % 40 == 30:
            inner.away, inner.writes_until_away = False, None
        with spool.transaction():
            spool.write([one(i), one(i, "q")])
            spool.put("run", "last", {"i": i})
    wait(lambda: spool.status.pending_bytes == 0)
    for name in ("p", "q"):
        assert inner.read("samples", [name])["value"].tolist() == [float(i) for i in range(200)]
    assert inner.get("run", "last") == {"i": 199}
    status = spool.status
    assert (status.connected, status.dropped_rows, status.refused_rows) == (True, 0, 0)


def test_outage_is_told_once_and_so_is_the_return(inner: Switchable, tmp_path: Path) -> None:
    told: list[SpoolStatus] = []
    spool = SpooledStore(inner, tmp_path / "spool", changed=told.append)
    inner.away = True
    for i in range(20):
        spool.write(one(i))
    wait(lambda: told)
    assert spool.status.pending_rows == 20
    assert "unplugged" in spool.status.problem
    inner.away = False
    wait(lambda: spool.status.pending_rows == 0)
    assert [s.connected for s in told] == [False, True]
    spool.close()


def test_documents_and_state_are_readable_during_an_outage(spool: SpooledStore, inner: Switchable) -> None:
    inner.away = True
    spool.put("state", "engine", {"position": 7})
    spool.put("alarm", "k", {"x": 1})
    assert spool.get("state", "engine") == {"position": 7}
    assert spool.get("alarm", "k") == {"x": 1}
    assert spool.list("alarm") == [{"x": 1}]
    with pytest.raises(StoreUnavailableError):
        spool.read("samples")


def test_server_that_leaves_while_nothing_waits_is_found_again(spool: SpooledStore, inner: Switchable) -> None:
    inner.put("alarm", "k", {"x": 1})
    inner.away = True
    assert spool.get("alarm", "k") is None
    assert not spool.status.connected
    inner.away = False
    wait(lambda: spool.status.connected)
    assert spool.get("alarm", "k") == {"x": 1}


def test_document_changed_by_another_process_is_seen(spool: SpooledStore, inner: Switchable) -> None:
    spool.put("command", "k", {"done": False})
    spool.flush()
    inner.put("command", "k", {"done": True})
    inner.put("command", "l", {"new": True})
    assert spool.items("command") == {"k": {"done": True}, "l": {"new": True}}


def test_full_spool_drops_the_oldest_rows_counts_them_and_keeps_documents(inner: Switchable, tmp_path: Path) -> None:
    inner.away = True
    size = len(encode_rows(one(0)))
    told: list[SpoolStatus] = []
    spool = SpooledStore(inner, tmp_path / "spool", max_bytes=10 * size + 20, changed=told.append)
    spool.put("run", "r", {"x": 1})
    for i in range(25):
        spool.write(one(i))
    assert spool.status.pending_bytes <= 10 * size + 20
    assert spool.status.dropped_rows == 15
    assert told[-1].dropped_rows == 15
    inner.away = False
    wait(lambda: spool.status.pending_bytes == 0)
    assert inner.read("samples")["value"].tolist() == [float(i) for i in range(15, 25)]
    assert inner.get("run", "r") == {"x": 1}
    spool.close()
    assert SpooledStore(inner, tmp_path / "spool").status.dropped_rows == 15


def test_entry_that_is_refused_for_good_is_set_aside_and_the_rest_go_on(spool: SpooledStore, inner: Switchable) -> None:
    inner.refuse_series = "bad"
    inner.away = True
    for i in range(6):
        spool.write(one(i, "bad" if i == 3 else "p"))
    inner.away = False
    wait(lambda: spool.status.pending_bytes == 0)
    assert inner.read("samples")["value"].tolist() == [0.0, 1.0, 2.0, 4.0, 5.0]
    assert spool.status.refused_rows == 1


def test_full_disk_under_the_spool_is_said_and_the_spool_goes_on(spool: SpooledStore, inner: Switchable) -> None:
    inner.away = True
    spool.write(one(0))
    (pages,) = spool._link.execute("PRAGMA page_count").fetchone()
    spool._link.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreError, match="disk is full"):
        spool.write(rows(n=20_000))
    assert spool.status.pending_rows == 1
    spool._link.execute("PRAGMA max_page_count = 1000000")
    spool.write(one(1))
    inner.away = False
    wait(lambda: spool.status.pending_bytes == 0)
    assert inner.read("samples")["value"].tolist() == [0.0, 1.0]


KILLED = """
import sys
from pathlib import Path
from tests.store.test_spool import Switchable, SpooledStore, one
inner = Switchable(Path(sys.argv[1]) / "inner.sqlite")
inner.away = sys.argv[2] == "away"
spool = SpooledStore(inner, Path(sys.argv[1]) / "spool")
i = (spool.get("state", "engine") or {"next": 0})["next"]
while True:
    with spool.transaction():
        spool.write(one(i))
        spool.put("state", "engine", {"next": i + 1})
    print(i, flush=True)
    i += 1
"""


def test_killed_process_takes_up_where_it_was_and_every_row_arrives_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    said = -1
    for k in range(6):
        mode = "away" if k % 2 else "there"
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(tmp_path), mode], stdout=subprocess.PIPE, text=True, cwd=Path.cwd()
        )
        assert process.stdout is not None
        for _ in range(int(rng.integers(5, 40))):
            process.stdout.readline()
        process.kill()
        said = int((process.stdout.read().split() or [said])[-1])
        process.wait()
    inner = SqliteStore(tmp_path / "inner.sqlite")
    spool = SpooledStore(inner, tmp_path / "spool")
    state = spool.get("state", "engine")
    spool.flush()
    assert state is not None
    assert state["next"] > said
    assert inner.read("samples")["value"].tolist() == [float(i) for i in range(state["next"])]
    spool.close()


@pytest.mark.integration
class TestSpoolBeforeInflux(StoreConformance):
    @pytest.fixture
    def store(self, influxd: Influxd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SpooledStore]:
        store = open_store(influx_config(influxd, tmp_path, monkeypatch))
        assert isinstance(store, SpooledStore)
        yield store
        store.close()


def influx_config(influxd: Influxd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StoreConfig:
    monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
    bucket = influxd.new_bucket()
    return StoreConfig("influx", "s", tmp_path / "spool", influxd.url, ORG, bucket, token_env="FDD_TEST_TOKEN")


@pytest.mark.integration
def test_server_killed_in_the_middle_gets_every_row_in_the_end(
    influxd: Influxd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(influx_config(influxd, tmp_path, monkeypatch))
    assert isinstance(store, SpooledStore)
    names = tuple(f"c{i}/x" for i in range(200))
    for i in range(60):
        time_ = np.full(200, T0 + i * 1_000_000_000)
        batch = Rows("samples", names, np.arange(200, dtype=np.int32), time_, {"value": np.full(200, float(i))})
        if i in (15, 40):
            influxd.kill()
        if i in (30, 55):
            assert store.status.pending_rows > 0
            influxd.start()
        with store.transaction():
            store.write(batch)
            store.put("state", "engine", {"i": i})
        time.sleep(0.01)
    wait(lambda: store.status.pending_rows == 0, 40)
    found = store.read("samples")
    assert len(found) == 60 * 200
    assert found.groupby("time")["value"].agg(["min", "max"]).to_numpy().tolist() == [[i, i] for i in range(60)]
    assert store.status.dropped_rows == store.status.refused_rows == 0
    store.close()
