"""Setting up a real server: buckets, retention, the downsampling task, and tokens that can do no more than needed."""

from __future__ import annotations

import stat
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from influxdb_client import InfluxDBClient
from typer.testing import CliRunner

from fdd.records import Rows
from fdd.store.influx import InfluxStore
from fdd.store.influx_setup import Plan, downsampling, set_up
from fdd.store.store import StoreConfig, StoreError
from tests.store.influxd import ORG, Influxd, own_server

pytestmark = pytest.mark.integration
HOUR = 3600 * 10**9


@pytest.fixture
def plan(request: pytest.FixtureRequest) -> Plan:
    return Plan(ORG, f"setup {abs(hash(request.node.nodeid))}")


def store_of(influxd: Influxd, plan: Plan, token: Path, bucket: str = "") -> InfluxStore:
    config = StoreConfig("influx", "north", url=influxd.url, org=ORG, bucket=bucket or plan.bucket, token_file=token)
    return InfluxStore(config)


def test_tokens_can_do_what_they_need_and_no_more(influxd: Influxd, plan: Plan, tmp_path: Path) -> None:
    files = set_up(influxd.url, influxd.admin_token, plan, tmp_path / "tokens")
    assert {stat.S_IMODE(f.stat().st_mode) for f in files.values()} == {0o600}
    daemon, grafana = (store_of(influxd, plan, files[who]) for who in ("daemon", "grafana"))
    now = np.array([time.time_ns()])
    row = Rows("samples", ("p",), np.zeros(1, np.int32), now, {"value": np.ones(1)})
    daemon.write(row)
    daemon.put("alarm", "k", {"x": 1})
    assert len(grafana.read("samples")) == 1
    assert grafana.get("alarm", "k") == {"x": 1}
    with pytest.raises(StoreError, match="refused points"):
        grafana.write(row)
    with pytest.raises(StoreError, match="refused points"):
        grafana.put("alarm", "k", {"x": 2})
    other = influxd.new_bucket()
    with pytest.raises(StoreError, match="refused"):
        store_of(influxd, plan, files["daemon"], other).write(row)
    with InfluxDBClient(influxd.url, token=files["daemon"].read_text().strip(), org=ORG) as client:
        assert other not in [b.name for b in client.buckets_api().find_buckets().buckets]


def test_setting_up_again_changes_only_what_differs(influxd: Influxd, plan: Plan, tmp_path: Path) -> None:
    first = {w: f.read_text() for w, f in set_up(influxd.url, influxd.admin_token, plan, tmp_path).items()}
    longer = replace(plan, raw_days=10)
    second = {w: f.read_text() for w, f in set_up(influxd.url, influxd.admin_token, longer, tmp_path).items()}
    assert first == second
    with InfluxDBClient(influxd.url, token=influxd.admin_token, org=ORG) as client:
        bucket = client.buckets_api().find_bucket_by_name(plan.bucket)
        assert bucket.retention_rules[0].every_seconds == 10 * 86_400
        assert (
            client.buckets_api().find_bucket_by_name(f"{plan.bucket}_documents").retention_rules[0].every_seconds == 0
        )
        assert len(client.tasks_api().find_tasks(name=f"fdd downsample {plan.bucket}")) == 1


def test_rotation_revokes_the_old_tokens(influxd: Influxd, plan: Plan, tmp_path: Path) -> None:
    files = set_up(influxd.url, influxd.admin_token, plan, tmp_path)
    old = tmp_path / "old"
    old.write_text(files["daemon"].read_text())
    set_up(influxd.url, influxd.admin_token, plan, tmp_path, rotate=True)
    assert files["daemon"].read_text() != old.read_text()
    assert store_of(influxd, plan, files["daemon"]).list("alarm") == []
    with pytest.raises(StoreError, match="401"):
        store_of(influxd, plan, old).list("alarm")


def test_points_older_than_the_retention_are_refused_aloud(influxd: Influxd, plan: Plan, tmp_path: Path) -> None:
    files = set_up(influxd.url, influxd.admin_token, plan, tmp_path)
    with pytest.raises(StoreError, match=r"retention|beyond"):
        store_of(influxd, plan, files["daemon"]).write(
            Rows("samples", ("p",), np.zeros(1, np.int32), np.array([10**18]), {"value": np.ones(1)})
        )


def test_downsampling_keeps_the_mean_the_worst_code_and_the_last_count(
    influxd: Influxd, plan: Plan, tmp_path: Path
) -> None:
    files = set_up(influxd.url, influxd.admin_token, replace(plan, raw_days=0), tmp_path)
    daemon = store_of(influxd, plan, files["daemon"])
    hour = time.time_ns() // HOUR * HOUR - 2 * HOUR
    stamps = hour + np.arange(4) * HOUR // 4
    at = np.zeros(4, np.int32)
    values = np.array([1.0, 2.0, 4.0, 9.0])
    daemon.write(
        [
            Rows("charts", ("hx/T:cusum",), at, stamps, {"statistic": values, "phase": np.array([2.0, 3.0, 2.0, 2.0])}),
            Rows("counts", ("ingest/late",), at, stamps, {"value": values}),
        ]
    )
    with InfluxDBClient(influxd.url, token=influxd.admin_token, org=ORG) as client:
        for _ in range(2):  # doing it again changes nothing
            client.query_api().query_raw(downsampling(plan)).read()
    hourly = store_of(influxd, plan, files["grafana"], plan.hourly)
    charts = hourly.read("charts")
    assert charts[["time", "statistic", "phase"]].to_numpy().tolist() == [[hour, 4.0, 3.0]]
    assert hourly.read("counts")["value"].tolist() == [9.0]


def test_the_command_sets_up_a_server_that_was_never_used(tmp_path: Path) -> None:
    import typer

    from fdd.store.influx_setup import main

    app = typer.Typer()
    app.command()(main)
    with own_server(tmp_path / "server") as server:
        (tmp_path / "password").write_text("a-long-password\n")
        shared = ["--url", server.url, "--org", "plant", "--bucket", "hvac", "--tokens", str(tmp_path / "tokens")]
        shared += ["--admin-token-file", str(tmp_path / "tokens" / "admin.token")]
        (tmp_path / "tokens").mkdir()
        first = CliRunner().invoke(app, [*shared, "--admin-password-file", str(tmp_path / "password")])
        assert first.exit_code == 0, first.output
        assert CliRunner().invoke(app, [*shared, "--rotate"]).exit_code == 0
        config = StoreConfig(
            "influx", "n", url=server.url, org="plant", bucket="hvac", token_file=tmp_path / "tokens/daemon.token"
        )
        InfluxStore(config).put("run", "r", {"x": 1})
    wrong = CliRunner().invoke(app, [*shared, "--rotate"])
    assert wrong.exit_code == 1
    assert "does not answer" in wrong.output
