"""A writing process killed at random moments, before a real server that goes away and comes back: every row, once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fdd.store.opening import open_store
from fdd.store.store import StoreConfig
from tests.store.influxd import ORG, Influxd

pytestmark = pytest.mark.integration
KILLS = 20
SERIES = 40

# Outputs and the state they stand for go in one transaction, as in the daemon; state says where to take up.
WRITER = """
import sys, json
import numpy as np
from fdd.records import Rows
from fdd.store.opening import open_store
store = open_store(json.loads(sys.argv[1]))
names = tuple(f"c{i}/x:cusum" for i in range(SERIES))
k = (store.get("state", "engine") or {"next": 0})["next"]
while True:
    values = np.random.default_rng(k).normal(size=SERIES)
    time = np.full(SERIES, 1_700_000_000_000_000_000 + k * 10**9)
    with store.transaction():
        store.write(Rows("charts", names, np.arange(SERIES, dtype=np.int32), time, {"statistic": values}))
        store.put("state", "engine", {"next": k + 1})
        if k % 50 == 0:
            store.put("alarm", f"a/{k}", {"k": k})
    print(k, flush=True)
    k += 1
""".replace("SERIES", str(SERIES))


def test_killed_writer_and_absent_server_leave_the_rows_of_an_undisturbed_run(
    influxd: Influxd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
    table = {"kind": "influx", "site": "s", "path": str(tmp_path / "spool"), "url": influxd.url, "org": ORG}
    table |= {"bucket": influxd.new_bucket(), "token_env": "FDD_TEST_TOKEN"}
    rng = np.random.default_rng(20)
    said = -1
    for kill in range(KILLS):
        if kill % 5 == 2:
            influxd.kill()
        if kill % 5 == 4:
            influxd.start()
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, json.dumps(table)], stdout=subprocess.PIPE, text=True, env=os.environ
        )
        assert writer.stdout is not None
        first = writer.stdout.readline()
        assert first, f"writer {kill} did not start"
        said = max(said, int(first))
        time.sleep(float(rng.uniform(0, 0.6)))
        writer.kill()
        said = max([said, *map(int, writer.stdout.read().split())])
        writer.wait()

    store = open_store(StoreConfig.of(table))
    state = store.get("state", "engine")
    found = store.read("charts")
    alarms = store.list("alarm")
    store.close()
    assert state is not None
    assert state["next"] > said
    n = state["next"]
    assert n > 5 * KILLS
    assert len(found) == n * SERIES
    wide = found.pivot(index="time", columns="series", values="statistic")
    wide = wide[[f"c{i}/x:cusum" for i in range(SERIES)]]
    undisturbed = np.array([np.random.default_rng(k).normal(size=SERIES) for k in range(n)])
    np.testing.assert_array_equal(wide.to_numpy(), undisturbed)
    assert sorted(a["k"] for a in alarms) == list(range(0, n, 50))
