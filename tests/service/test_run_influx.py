"""The daemon before a real InfluxDB: the server away, the daemon killed; the rows of an undisturbed run."""

from __future__ import annotations

import json
import shutil
import sqlite3
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ruamel.yaml import YAML

from fdd.plant.faults import DAY, PlantFault
from fdd.plant.scenario import Scenario
from fdd.service.site.site_context import open_site
from fdd.service.verbs.demo import TOPIC, Prepared, prepare, start_daemon
from fdd.store.transfer import migrate
from ingest.zenoh.options import ZenohOptions
from ingest.zenoh.publisher import ZenohPublisher
from tests.store.influxd import ORG, Influxd, influxd, influxd_server

__all__ = ["influxd", "influxd_server"]
pytestmark = pytest.mark.integration
LEARNING_DAYS = 6.0
KILLS = 20
# What verdicts are made of; gauges of the service itself are at wall-clock time.
MEASUREMENTS = ("samples", "predictions", "charts", "parameters", "scores", "gates")
ROWS = 17  # a frame's samples


@dataclass(frozen=True)
class Kept:
    """What a run left in the database."""

    tables: dict[str, pd.DataFrame]
    alarms: list[str]
    accepted: float

    def assert_same(self, other: Kept) -> None:
        for name, table in self.tables.items():
            assert not table.duplicated(["series", "time"]).any(), name
            pd.testing.assert_frame_equal(table, other.tables[name], check_exact=True, obj=name)
        assert self.alarms == other.alarms
        assert self.accepted == other.accepted


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    """Three watched days of a plant whose exchanger is fouled from the second one on, in messages of one frame."""
    fault = PlantFault("fouling", "hx", (LEARNING_DAYS + 1) * DAY, 0.3)
    scenario = Scenario(days=LEARNING_DAYS + 3, seed=4, faults=(fault,))
    found = prepare(scenario, tmp_path_factory.mktemp("plant"), learning_days=LEARNING_DAYS, probation_days=0)
    frames = [b.slice(i, i + ROWS) for b in found.batches for i in range(0, len(b), ROWS)]
    assert all(len(set(f.time.tolist())) == 1 for f in frames)
    return replace(found, batches=frames)


@pytest.fixture(scope="module")
def undisturbed(prepared: Prepared, influxd_server: Influxd, tmp_path_factory: pytest.TempPathFactory) -> Kept:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FDD_TEST_TOKEN", influxd_server.admin_token)
        kept = run(prepared, influxd_server, tmp_path_factory.mktemp("run") / "site", alone)
    assert '"component": "hx"' in " ".join(kept.alarms)
    assert len(kept.tables["samples"]) == sum(len(b) for b in prepared.batches)
    assert kept.accepted == len(kept.tables["samples"])
    return kept


def own_site(prepared: Prepared, influxd: Influxd, folder: Path) -> Prepared:
    """A copy of the site that keeps its results in a fresh bucket, baselines included."""
    shutil.copytree(prepared.site_file.parent, folder)
    site_file, yaml = folder / prepared.site_file.name, YAML()
    site = yaml.load(site_file)
    site["store"] = {"kind": "influx", "url": influxd.url, "org": ORG, "bucket": influxd.new_bucket()}
    site["store"] |= {"token_env": "FDD_TEST_TOKEN"}
    yaml.dump(site, site_file)
    own = replace(prepared, site_file=site_file, context=open_site(site_file))
    source, target = prepared.context.store(read_only=True), own.context.store(read_only=True)
    migrate(source, target)
    source.close()
    target.close()
    return own


class Stream:
    """The plant's messages, sent as the test goes along; late and restarted readers get what they missed."""

    def __init__(self, site: Prepared, out: ZenohPublisher) -> None:
        self.site, self._out, self._left = site, out, list(site.batches)
        self._log = site.site_file.parent / "daemon.log"

    def send(self, share: float, seconds: float) -> None:
        """The next messages, this share of all, spread over so long."""
        n = min(len(self._left), round(share * len(self.site.batches)))
        began = time.monotonic()
        for k in range(n):
            time.sleep(max(0.0, began + seconds * k / n - time.monotonic()))
            self._out.publish(self._left.pop(0))

    def started(self) -> subprocess.Popen[bytes]:
        """A daemon that has said that it runs."""
        before = self.said("running")
        daemon = start_daemon(self.site)
        while self.said("running") == before:
            assert daemon.poll() is None, self._log.read_text()[-3000:]
            time.sleep(0.02)
        return daemon

    def said(self, event: str) -> int:
        """How often the log tells of an event."""
        return self._log.read_text().count(f'"event": "{event}"') if self._log.exists() else 0

    def finish(self, daemon: subprocess.Popen[bytes]) -> None:
        """Send what is left, and let the daemon end."""
        self.send(1.0, 0.0)
        self._out.end()
        assert daemon.wait(timeout=200) == 0, self._log.read_text()[-3000:]


def run(prepared: Prepared, influxd: Influxd, folder: Path, disturbed: Callable[[Stream], None]) -> Kept:
    """Stream into the daemon while it is disturbed; what it left in the database."""
    own = own_site(prepared, influxd, folder)
    with ZenohPublisher(ZenohOptions(listen=(own.endpoint,)), TOPIC, cache=len(own.batches) + 10) as out:
        disturbed(Stream(own, out))
    store = own.context.store(read_only=True)
    tables = {name: store.read(name) for name in MEASUREMENTS}
    alarms = [json.dumps(a, sort_keys=True) for a in store.list("alarm")]
    accepted = float(store.read("counts", ["engine/accepted"])["value"].iloc[-1])
    store.close()
    return Kept(tables, alarms, accepted)


def alone(stream: Stream) -> None:
    stream.finish(stream.started())


@pytest.mark.parametrize("away", [6.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_server_that_was_away_has_the_rows_of_an_undisturbed_run(
    prepared: Prepared,
    undisturbed: Kept,
    influxd: Influxd,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    away: float,
) -> None:
    monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
    waiting: list[int] = []

    def disturbed(stream: Stream) -> None:
        daemon = stream.started()
        stream.send(0.3, 3.0)
        influxd.kill()
        stream.send(0.4, away)
        with closing(sqlite3.connect(stream.site.context.state_folder / "spool" / "spool.sqlite")) as spool:
            waiting.append(int(spool.execute("select sum(rows) from pending").fetchone()[0] or 0))
        influxd.start()
        stream.send(0.1, 2.0)
        stream.finish(daemon)

    kept = run(prepared, influxd, tmp_path / "site", disturbed)
    assert waiting[0] > 1000, "nothing waited on disk: the outage missed the run"
    kept.assert_same(undisturbed)


def test_a_daemon_killed_twenty_times_leaves_the_rows_of_an_undisturbed_run(
    prepared: Prepared, undisturbed: Kept, influxd: Influxd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Most kills hit it at work at a random message, a quarter while it starts and recovers."""
    monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
    rng = np.random.default_rng(6)

    def disturbed(stream: Stream) -> None:
        for kill in range(KILLS):
            if kill % 4 == 3:
                daemon = start_daemon(stream.site)
                time.sleep(rng.uniform(0.5, 3.0))
            else:
                daemon = stream.started()
                stream.send(1 / KILLS * rng.uniform(0.3, 1.0), rng.uniform(0.2, 1.2))
            assert daemon.poll() is None
            daemon.kill()
            daemon.wait()
        assert stream.said("recovered") >= KILLS // 2
        stream.finish(stream.started())

    kept = run(prepared, influxd, tmp_path / "site", disturbed)
    kept.assert_same(undisturbed)
