"""Health says whether faults would be seen; who dawdles at the door is cut off; jobs are done or done again."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time as clock
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fdd.records import NANOSECONDS
from fdd.service.daemon import metrics
from fdd.service.daemon.health import Health
from fdd.service.daemon.metrics import MetricsServer
from fdd.service.daemon.schedule import Job, JobRunner, Schedule

HOUR = 3600 * NANOSECONDS
WELL: dict[str, Any] = {"counts": {}, "heard": {"z": 0.0}, "blind": (), "store": "", "failures": 0}


def whats(health: Health, now: float, **changed: Any) -> list[str]:
    found = health.look(now, **{**WELL, "frames": round(now), "samples": round(now), "heard": {"z": now}, **changed})
    return [p["what"] for p in found]


@pytest.mark.parametrize(
    ("what", "wrong"),
    [
        ("no frames", {"frames": 3}),
        ("dropped", {"counts": {"late": 5_000}}),
        ("source silent", {"heard": {"z": 0.0, "y": 5_000.0}}),
        ("store", {"store": "away"}),
        ("blind", {"blind": ("hx",)}),
        ("failing", {"failures": 3}),
        ("clock", {"counts": {"dated ahead of the clock": 50}}),
    ],
)
def test_what_keeps_the_service_from_watching_is_said_with_since_when(what: str, wrong: dict[str, Any]) -> None:
    health = Health(step=60.0, lateness=0.0)
    for now in range(0, 4_000, 10):
        assert whats(health, float(now)) == []
    changed = {**wrong}
    if what == "no frames":
        changed = {"frames": 3_990}
    found = [whats(health, float(now), **changed) for now in range(4_000, 5_000, 10)]
    assert [what] in found
    assert {w for ws in found for w in ws} == {what}
    table = {**WELL, "frames": 1, "samples": 5_000, "heard": {"z": 5_000.0}, "store": "away"}
    problem = health.look(5_000.0, **table)[-1]
    assert 4_000.0 <= problem["since"] <= 5_000.0


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[MetricsServer]:
    monkeypatch.setattr(metrics, "REQUEST_SECONDS", 0.5)
    found = MetricsServer(("127.0.0.1", 0))
    yield found
    found.close()


def test_health_is_503_with_the_problem_while_there_is_one(server: MetricsServer) -> None:
    base = f"http://127.0.0.1:{server.address[1]}"
    assert json.load(urllib.request.urlopen(f"{base}/health"))["healthy"] is True
    problem = {"what": "no frames", "since": 5.0, "detail": "no frame has closed for 900 s"}
    server.publish({"problems": [problem]})
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(f"{base}/health")
    assert refused.value.code == 503
    assert json.load(refused.value)["problems"] == [problem]
    assert urllib.request.urlopen(f"{base}/live").status == 200


def test_half_open_requests_keep_nobody_out_for_long(server: MetricsServer) -> None:
    before = threading.active_count()
    held = []
    for _ in range(100):
        link = socket.create_connection(server.address, timeout=5.0)
        link.sendall(b"GET /metr")
        held.append(link)
    assert threading.active_count() - before <= metrics.REQUESTS
    end = clock.monotonic() + 20.0
    while clock.monotonic() < end:
        for link in held[:50]:
            try:
                link.sendall(b"x")  # a byte now and then stays within every single time-out
            except OSError:
                continue
        try:
            assert urllib.request.urlopen(f"http://127.0.0.1:{server.address[1]}/live", timeout=1.0).status == 200
            break
        except OSError:
            clock.sleep(0.1)
    else:
        pytest.fail("nobody was let in")
    for link in held:
        link.close()


# ---- jobs


def runner(folder: Path, code: str) -> JobRunner:
    (folder / "fdd.py").write_text(code)
    return JobRunner([Job(Schedule("work", 7, (2, 30), "UTC"), ("work",))], folder)


def test_a_job_that_ran_as_the_daemon_died_is_due_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # `python -m fdd` finds the stand-in there
    first = runner(tmp_path, "import time; time.sleep(60)")
    first.tick(0)
    due = first.state["work"]
    first.tick(due)
    assert first.state["work"] == due  # what a checkpoint would keep
    ended = first.stop()
    assert ended[0]["state"] == "failed"
    assert first.state["work"] == due
    second = runner(tmp_path, "")
    second.restore(first.state)
    second.tick(due + HOUR)
    end = clock.monotonic() + 30.0
    found: list[Any] = []
    while not found and clock.monotonic() < end:
        clock.sleep(0.05)
        found = second.tick(due + HOUR)
    assert found[0]["state"] == "done"
    assert second.state["work"] > due


def test_a_job_that_was_killed_is_tried_again_within_the_hour_and_not_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # `python -m fdd` finds the stand-in there
    jobs = runner(tmp_path, "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    jobs.tick(0)
    time = jobs.state["work"]
    ended = 0
    for _ in range(6):
        jobs.tick(time)
        end = clock.monotonic() + 30.0
        while jobs._running and clock.monotonic() < end:
            clock.sleep(0.05)
            ended += len(jobs.tick(time))
        time += HOUR
    assert ended == 3


def test_a_job_ends_with_its_daemon(tmp_path: Path) -> None:
    child = "from fdd.service.daemon.parent import end_with_parent as e; e(); import time; time.sleep(60)"
    code = (
        "import os, subprocess, sys, time\n"
        f"command = [sys.executable, '-c', '{child}']\n"
        "job = subprocess.Popen(command, env={**os.environ, 'FDD_PARENT': str(os.getpid())})\n"
        "print(job.pid, flush=True); time.sleep(60)\n"
    )
    daemon = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert daemon.stdout is not None
    job = int(daemon.stdout.readline())
    clock.sleep(1.0)
    os.kill(job, 0)
    daemon.kill()
    daemon.wait()
    end = clock.monotonic() + 20.0
    while clock.monotonic() < end:
        try:
            if Path(f"/proc/{job}/stat").read_text().split()[2] == "Z":
                return
        except OSError:
            return
        clock.sleep(0.1)
    pytest.fail("the job is an orphan")
