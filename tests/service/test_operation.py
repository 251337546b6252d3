"""Running it: schedules, metrics, health, systemd, reload, status, graceful stop."""

from __future__ import annotations

import json
import os
import signal
import socket
import urllib.error
import urllib.request
from datetime import UTC, datetime
from pathlib import Path

import pytest

from benchmarks.drifting_room import Course
from fdd.records import NANOSECONDS
from fdd.service.daemon import metrics as metrics_module
from fdd.service.daemon import systemd
from fdd.service.daemon.metrics import MetricsServer, exposition
from fdd.service.daemon.schedule import Job, JobRunner, Schedule, jobs_of
from fdd.service.site.site_context import open_site
from fdd.service.verbs.status import read_status
from tests.ports import free_port
from tests.service.room_site import daemon, make_site, until


def ns(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()) * NANOSECONDS


@pytest.mark.parametrize(
    ("every", "zone", "after", "due"),
    [
        (1, "UTC", "2026-03-01T02:29:59", "2026-03-01T02:30:00"),
        (1, "UTC", "2026-03-01T02:30:00", "2026-03-02T02:30:00"),
        (1, "Europe/Copenhagen", "2026-07-01T00:00:00", "2026-07-01T00:30:00"),
        # 02:30 is left out on 29 March 2026 in Copenhagen; 02:30 winter time is 01:30 UTC
        (1, "Europe/Copenhagen", "2026-03-28T12:00:00", "2026-03-29T01:30:00"),
        # and comes twice on 25 October; the first one counts, and once
        (1, "Europe/Copenhagen", "2026-10-24T12:00:00", "2026-10-25T00:30:00"),
        (1, "Europe/Copenhagen", "2026-10-25T00:30:00", "2026-10-26T01:30:00"),
        ("weekly", "UTC", "2026-03-01T12:00:00", "2026-03-02T02:30:00"),
        ("monthly", "UTC", "2026-03-01T12:00:00", "2026-04-01T02:30:00"),
    ],
)
def test_next_time_is_local_and_strictly_later(every: object, zone: str, after: str, due: str) -> None:
    schedule = Schedule("job", every, (2, 30), zone)  # type: ignore[arg-type]
    assert schedule.next(ns(after)) == ns(due)


@pytest.mark.parametrize(
    ("every", "zone", "due", "since", "end"),
    [
        ("monthly", "UTC", "2026-03-01T06:00:00", "2026-02-01T00:00:00", "2026-03-01T00:00:00"),
        # months of the site: March begins in winter time and ends in summer time
        ("monthly", "Europe/Copenhagen", "2026-04-01T04:00:00", "2026-02-28T23:00:00", "2026-03-31T22:00:00"),
        ("monthly", "Europe/Copenhagen", "2026-01-01T05:00:00", "2025-11-30T23:00:00", "2025-12-31T23:00:00"),
        ("weekly", "Europe/Copenhagen", "2026-03-30T04:00:00", "2026-03-22T23:00:00", "2026-03-29T22:00:00"),
        # Auckland's first of June begins on the 31st of May in UTC
        ("monthly", "Pacific/Auckland", "2026-05-31T18:00:00", "2026-04-30T12:00:00", "2026-05-31T12:00:00"),
        (7, "UTC", "2026-03-01T06:00:00", "2026-02-27T06:00:00", "2026-03-01T06:00:00"),
    ],
)
def test_reports_are_about_whole_months_and_weeks_of_the_site(
    every: object, zone: str, due: str, since: str, end: str
) -> None:
    job = Job(Schedule("report", every, (6, 0), zone), (), 2 * 86400.0)  # type: ignore[arg-type]
    assert job.period(ns(due)) == (ns(since), ns(end))


@pytest.mark.slow
def test_a_job_runs_when_due_once_and_says_how_it_ended(tmp_path: Path) -> None:
    good, bad = ("version",), ("status", "no-such-file.yaml")
    jobs = [Job(Schedule("good", 1, (2, 30), "UTC"), good, 0), Job(Schedule("bad", 1, (2, 30), "UTC"), bad, 0)]
    runner = JobRunner(jobs, tmp_path)
    assert runner.tick(ns("2026-03-01T12:00:00")) == []
    later = JobRunner(jobs, tmp_path)
    later.restore(runner.state)
    ended: list[dict[str, object]] = []
    at = ns("2026-03-05T03:00:00")  # four days in one leap are one run
    until(lambda: bool(ended.extend(later.tick(at)) or len(ended) == 2))
    states = {str(d["job"]): (d["state"], d["due"]) for d in ended}
    assert states == {
        "good": ("done", ns("2026-03-02T02:30:00")),
        "bad": ("failed", ns("2026-03-02T02:30:00")),
    }
    assert later.tick(at) == []


def test_a_site_file_asks_for_jobs(tmp_path: Path) -> None:
    extra = 'reidentify: {every: 2 d, at: "03:15", window: 21 d, approval: true}\nreports: {every: weekly, pdf: true}\n'
    context = make_site(tmp_path, Course(8), 1, learning_days=7, extra=extra)
    first, second = jobs_of(context.site, tmp_path / "site.yaml")
    assert (first.schedule.every, first.schedule.at) == (2, (3, 15))
    assert first.arguments[-1] == "--propose"
    assert "21" in first.arguments
    assert (second.schedule.name, second.schedule.every) == ("report", "weekly")
    assert str(tmp_path / "reports" / "report-{day}.pdf") in second.arguments


STATUS = {
    "samples": 10, "frames": 2, "lag_seconds": 1.5, "open_alarms": 1, "phases": {"quiet": 3, "no data": 1},
    "counts": {'odd "reason"': 2}, "spool_bytes": None, "baselines": {"hx": 4}, "job_failures": 0, "rss_bytes": 1000,
}  # fmt: skip


def test_metrics_are_in_the_text_format_and_health_tells_a_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    text = exposition(STATUS)
    assert "# TYPE fdd_samples_total counter\nfdd_samples_total 10\n" in text
    assert 'fdd_charts{phase="no data"} 1\n' in text
    assert r'fdd_counts_total{reason="odd \"reason\""} 2' in text
    assert "fdd_spool_bytes" not in text
    server = MetricsServer(("127.0.0.1", 0))
    base = f"http://127.0.0.1:{server.address[1]}"
    try:
        server.publish(STATUS)
        with urllib.request.urlopen(f"{base}/metrics") as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
            assert answer.read().decode() == text
        with urllib.request.urlopen(f"{base}/health") as answer:
            assert json.load(answer)["healthy"] is True
        monkeypatch.setattr(metrics_module, "STALE_SECONDS", 0.0)
        with pytest.raises(urllib.error.HTTPError, match="503"):
            urllib.request.urlopen(f"{base}/health")
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{base}/")
    finally:
        server.close()


def test_systemd_hears_ready_and_alive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert systemd.notify("READY=1") is False
    for address in (str(tmp_path / "notify"), f"@fdd-test-{os.getpid()}"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
            heard.bind("\0" + address[1:] if address.startswith("@") else address)
            heard.settimeout(5)
            monkeypatch.setenv("NOTIFY_SOCKET", address)
            monkeypatch.setenv("WATCHDOG_USEC", "3600000000")
            assert systemd.notify("READY=1")
            assert heard.recv(100) == b"READY=1"
            dog = systemd.Watchdog()
            dog.alive()
            dog.alive()
            assert heard.recv(100) == b"WATCHDOG=1"
            heard.settimeout(0.1)
            with pytest.raises(TimeoutError):
                heard.recv(100)


def test_the_daemon_reloads_refuses_a_bad_file_tells_its_state_and_stops(tmp_path: Path) -> None:
    """A live MQTT source without a broker would wait; Zenoh listens by itself."""
    port, web = free_port(), free_port()
    extra = f"source: {{kind: zenoh, key: 'room/**', listen: ['tcp/127.0.0.1:{port}']}}\nmetrics: 127.0.0.1:{web}\n"
    make_site(tmp_path, Course(8), 1, learning_days=7, extra=extra)
    site_file, log = tmp_path / "site.yaml", tmp_path / "log"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "n"))
        heard.settimeout(60)
        with daemon(site_file, log, NOTIFY_SOCKET=str(tmp_path / "n"), WATCHDOG_USEC="1000000") as process:
            assert heard.recv(100) == b"READY=1"
            until(lambda: heard.recv(100) == b"WATCHDOG=1")
            until(lambda: read_status(site_file)["state"] == "running")
            assert read_status(site_file)["baselines"] == {"room": 1}
            text = site_file.read_text()
            site_file.write_text(text.replace("model: zone", "model: zonee"))
            process.send_signal(signal.SIGHUP)
            until(lambda: "reload refused" in log.read_text())
            site_file.write_text(text + "false_alarms_per_year: 3\n")
            process.send_signal(signal.SIGHUP)
            until(lambda: '"reloaded"' in log.read_text())
            with urllib.request.urlopen(f"http://127.0.0.1:{web}/metrics") as answer:
                assert b'fdd_baseline_version{component="room"} 1' in answer.read()
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    store = open_site(site_file).store(read_only=True)
    assert {"service/sample_rate", "service/rss"} <= set(store.series("health"))
    store.close()
    assert [x["event"] for x in lines if x["event"] in ("stopping", "stopped")] == ["stopping", "stopped"]
    assert all({"level", "timestamp"} <= set(x) for x in lines)


def test_status_before_the_first_run_says_so(tmp_path: Path) -> None:
    make_site(tmp_path, Course(8), 1, learning_days=7)
    assert read_status(tmp_path / "site.yaml")["state"] == "never ran"
