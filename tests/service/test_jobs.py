"""Scheduled jobs under the real daemon: a baseline is exchanged under way, reports are written, a failure is seen."""

from __future__ import annotations

import json
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from benchmarks.drifting_room import POINTS, START, Course, simulate
from fdd.records import Batch
from fdd.service.baselines.history import History
from fdd.service.site.site_context import open_site
from fdd.service.verbs.status import read_status
from ingest.zenoh.options import ZenohOptions
from ingest.zenoh.publisher import ZenohPublisher
from tests.ports import free_port
from tests.service.room_site import DAY_NS, daemon, make_site, until

pytestmark = pytest.mark.integration
COURSE, SEED = Course(60, season=0.09), 4
EXTRA = """
zone: UTC
reidentify: {{every: 1 d, at: "02:30", window: 28 d}}
reports: {{every: weekly, folder: reports}}
metrics: 127.0.0.1:{web}
source: {{kind: zenoh, key: 'room/**', connect: ['tcp/127.0.0.1:{port}']}}
"""


def message(part: History) -> Batch:
    return Batch.of_table(POINTS, part.time, part.values)


def test_jobs_change_the_baseline_under_way_write_reports_and_fail_without_harm(tmp_path: Path) -> None:
    """Days 40 to 53 are streamed; day 45 and day 52 are Mondays."""
    port, web = free_port(), free_port()
    make_site(tmp_path, COURSE, SEED, extra=EXTRA.format(port=port, web=web))
    site_file, history = tmp_path / "site.yaml", simulate(COURSE, SEED)
    reports = tmp_path / "reports"
    reports.write_text("a file where the folder should be: the first report fails")
    sent = 0
    with ZenohPublisher(ZenohOptions(listen=(f"tcp/127.0.0.1:{port}",)), "room/samples") as out:

        def send(first: int, beyond: int) -> int:
            part = history.between(START + first * DAY_NS, START + beyond * DAY_NS)
            out.publish(message(part))
            return len(part)

        with daemon(site_file, tmp_path / "log") as process:
            sent += send(40, 41)
            until(lambda: read_status(site_file).get("jobs_next", {}).keys() == {"reidentify", "report"}, 90)
            sent += send(41, 46)
            until(lambda: read_status(site_file)["baselines"] == {"room": 2}, 120)
            until(lambda: read_status(site_file)["job_failures"] == 1, 60)
            (failed,) = [j for j in read_status(site_file)["jobs"] if j["state"] == "failed"]
            assert (failed["job"], failed["key"]) == ("report", "job/report/2025-11-24T06:00:00Z")
            assert "could not be started" in failed["said"]
            with urllib.request.urlopen(f"http://127.0.0.1:{web}/metrics") as answer:
                text = answer.read().decode()
            assert "fdd_job_failures_total 1\n" in text
            assert 'fdd_baseline_version{component="room"} 2\n' in text
            reports.unlink()
            sent += send(46, 53)
            until(
                lambda: any(j["state"] == "done" and j["job"] == "report" for j in read_status(site_file)["jobs"]), 120
            )
            process.terminate()
            assert process.wait(60) == 0
    assert "<html" in (reports / "report-2025-12-01.html").read_text()
    lines = [json.loads(x) for x in (tmp_path / "log").read_text().splitlines() if x.startswith("{")]
    assert next((x["component"], x["version"]) for x in lines if x["event"] == "baseline in force") == ("room", 2)
    (stopped,) = [x for x in lines if x["event"] == "stopped"]
    assert stopped["counts"]["accepted"] == len(POINTS) * sent
    assert not any(n for reason, n in stopped["counts"].items() if reason.startswith("restart"))
    store = open_site(site_file).store(read_only=True)
    times = store.read("predictions", ["room/T_room"])["time"].to_numpy()
    store.close()
    # The first frame starts the filter and the last is still open; every one between has its prediction.
    assert len(times) == sent - 2
    assert set(np.diff(times)) == {900 * 10**9}
