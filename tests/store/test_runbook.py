"""The runbook's backups, taken while things run, come back whole."""

from __future__ import annotations

import re
import shutil
import sqlite3
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

from fdd.records import Rows
from fdd.store.influx import InfluxStore
from fdd.store.sqlite import SqliteStore
from fdd.store.store import StoreConfig
from tests.store.influxd import ORG, own_server

RUNBOOK = (Path(__file__).resolve().parents[2] / "docs" / "runbook.md").read_text()
N = 1000


def rows(k: int) -> Rows:
    """A thousand charts' statistics, written in one go at second k."""
    names = tuple(f"c{i}/T:cusum" for i in range(N))
    at = np.full(N, k * 10**9, dtype=np.int64)
    return Rows("charts", names, np.arange(N, dtype=np.int32), at, {"statistic": np.full(N, float(k))})


@pytest.mark.skipif(shutil.which("sqlite3") is None, reason="no sqlite3 program here")
def test_sqlite_backup_of_the_runbook_is_whole_while_the_daemon_writes(tmp_path: Path) -> None:
    (command,) = re.findall(r"`(sqlite3 store\.sqlite .*?)`", RUNBOOK)
    store = SqliteStore(tmp_path / "store.sqlite")
    store.write(rows(0))
    store.put("alarm", "hx@1", {"key": "hx@1", "state": "raised"})
    begun, ended, written = threading.Event(), threading.Event(), [0]

    def write() -> None:
        own = SqliteStore(tmp_path / "store.sqlite")
        while not ended.is_set():
            written[0] += 1
            own.write(rows(written[0]))
            if written[0] == 3:
                begun.set()
        own.close()

    writer = threading.Thread(target=write)
    writer.start()
    assert begun.wait(30)
    try:
        subprocess.run(["sh", "-c", command], cwd=tmp_path, check=True, timeout=60)
    finally:
        ended.set()
        writer.join()
        store.close()
    for name in ("store.sqlite", "store.sqlite-wal", "store.sqlite-shm"):
        (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / "backup.sqlite").rename(tmp_path / "store.sqlite")
    with sqlite3.connect(tmp_path / "store.sqlite") as db:
        assert db.execute("pragma integrity_check").fetchone() == ("ok",)
    restored = SqliteStore(tmp_path / "store.sqlite")
    found = restored.read("charts")
    sizes = found.groupby("time").size()
    assert set(sizes) == {N}  # every write is there whole or not at all
    assert 4 <= len(sizes) <= written[0] + 1
    assert restored.get("alarm", "hx@1") == {"key": "hx@1", "state": "raised"}
    restored.write(rows(10_000))
    restored.close()


@pytest.mark.integration
def test_folder_of_a_stopped_influxdb_is_a_backup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "copy its data folder" in RUNBOOK
    with own_server(tmp_path / "server") as server:
        server.set_up()
        monkeypatch.setenv("FDD_TEST_TOKEN", server.admin_token)
        bucket = server.new_bucket()

        def store() -> InfluxStore:
            return InfluxStore(
                StoreConfig("influx", "n", url=server.url, org=ORG, bucket=bucket, token_env="FDD_TEST_TOKEN")
            )

        store().write(rows(2_000_000_000 // 2))
        store().put("alarm", "hx@1", {"key": "hx@1"})
        assert server.process is not None
        server.process.terminate()
        server.process.wait(30)
        shutil.copytree(server.folder, tmp_path / "backup")
        server.process = None
        shutil.rmtree(server.folder)
        shutil.copytree(tmp_path / "backup", server.folder)
        server.start()
        assert len(store().read("charts")) == N
        assert store().get("alarm", "hx@1") == {"key": "hx@1"}
