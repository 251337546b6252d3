"""Real Zenoh sessions, peer to peer on loopback."""

from __future__ import annotations

import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from zenoh_processes import batch

from fdd.records import Batch
from ingest.source import Context, NotReady, Refused
from ingest.zenoh import ZenohOptions, ZenohPublisher, ZenohSource
from ingest.zenoh.session import open_session
from tests.ports import free_port

SCRIPT = Path(__file__).with_name("zenoh_processes.py")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def _start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
    )


def _send(publisher: subprocess.Popen[str], messages: int) -> None:
    assert publisher.stdin is not None
    publisher.stdin.write(f"{messages}\n")
    publisher.stdin.flush()


def _source(endpoint: str, **options: object) -> ZenohSource:
    source = ZenohSource()
    source.configure(ZenohOptions.model_validate({"connect": [endpoint], **options}), Context())
    return source


def _collect(source: ZenohSource, seconds: float = 10.0) -> list[Batch]:
    """Batches until the stream's end, or a failure after some seconds."""
    deadline, out = time.monotonic() + seconds, []
    for item in source.batches():
        out.append(item)
        assert time.monotonic() < deadline, f"no end of stream within {seconds} s; counters {source.counters()}"
    return out


def _values(batches: list[Batch]) -> list[float]:
    return [v for b in batches for v in b.value.tolist()]


def test_killed_subscriber_loses_nothing_and_doubles_nothing(
    endpoint: str, tmp_path: Path, processes: list[subprocess.Popen[str]]
) -> None:
    messages, database = 300, tmp_path / "samples.sqlite"
    publisher = _start("publish", endpoint)
    processes.append(publisher)
    for kill_after in (10, 610):
        subscriber = _start("subscribe", endpoint, str(database))
        processes.append(subscriber)
        _send(publisher, 100)
        _wait_for_samples(database, kill_after)
        subscriber.send_signal(signal.SIGKILL)
        subscriber.wait()
    _send(publisher, 100)  # while nobody listens
    _send(publisher, 0)
    last = _start("subscribe", endpoint, str(database))
    processes.append(last)
    out, _ = last.communicate(timeout=60)

    rows = sqlite3.connect(database).execute("SELECT point, time, value FROM sample ORDER BY value").fetchall()
    expected = [
        (b.names[p], t, v)
        for b in map(batch, range(messages))
        for p, t, v in zip(b.point.tolist(), b.time.tolist(), b.value.tolist(), strict=True)
    ]
    assert rows == expected
    assert "message lost" not in json.loads(out.splitlines()[-1])


def _count(database: Path) -> int:
    try:
        return int(sqlite3.connect(database).execute("SELECT count(*) FROM sample").fetchone()[0])
    except sqlite3.OperationalError:
        return 0


def _wait_for_samples(database: Path, number: int) -> None:
    deadline = time.monotonic() + 60
    while _count(database) < number:
        assert time.monotonic() < deadline, f"{_count(database)} of {number} samples came within 60 s"
        time.sleep(0.01)


def test_publisher_before_subscriber_gives_all_history(endpoint: str) -> None:
    with ZenohPublisher(ZenohOptions(listen=(endpoint,)), "fdd/plant") as publisher:
        for number in range(50):
            publisher.publish(batch(number))
        publisher.end()
        source = _source(endpoint, until_end=True)
        source.open()
        got = _values(_collect(source))
        source.close()
    assert got == [float(i) for i in range(300)]


def test_subscriber_before_publisher_gets_everything(endpoint: str) -> None:
    source = _source(endpoint, until_end=True)
    source.open()
    with ZenohPublisher(ZenohOptions(listen=(endpoint,)), "fdd/plant") as publisher:
        assert publisher.wait_for_subscriber(10)
        for number in range(50):
            publisher.publish(batch(number))
        publisher.end()
        got = _values(_collect(source))
        assert source.counters()["publishers present"] == 1
        source.close()
    assert got == [float(i) for i in range(300)]


def test_what_the_cache_no_longer_holds_is_counted_as_lost(endpoint: str) -> None:
    with ZenohPublisher(ZenohOptions(listen=(endpoint,)), "fdd/plant", cache=10) as publisher:
        for number in range(50):
            publisher.publish(batch(number))
        publisher.end()
        source = _source(endpoint, until_end=True)
        source.open()
        got = _values(_collect(source))
        counters, notes = source.counters(), source.notes()
        source.close()
    assert got == [float(i) for i in range(41 * 6, 300)]  # 9 messages and the end of the stream
    assert counters["message lost"] == 41
    assert "41 messages of plant/" in notes[0]


def test_malformed_messages_are_counted_and_the_stream_goes_on(endpoint: str) -> None:
    listener = open_session(ZenohOptions(listen=(endpoint,)), Path())
    source = _source(endpoint, until_end=True)
    source.open()
    publisher = listener.declare_publisher("fdd/stranger")
    deadline = time.monotonic() + 10
    while not publisher.matching_status.matching and time.monotonic() < deadline:
        time.sleep(0.02)
    for payload in ('{"v": 1, "names": ["a"], "time": [1], "value": ["x"]}', "\x00\xff", "[]", '{"v": 9}'):
        publisher.put(payload)
    publisher.put('{"v": 1, "names": ["a"], "time": [7], "value": [2.5]}')
    publisher.put('{"v": 1, "publisher": "p", "run": "r", "seq": 1, "end": true}')
    got = _collect(source)
    counters, notes = source.counters(), source.notes()
    source.close()
    publisher.undeclare()
    listener.close()
    assert _values(got) == [2.5]
    assert counters["malformed message"] == 4
    assert "value is no list of numbers" in notes[0]


def test_silence_yields_empty_batches_and_stop_ends(endpoint: str) -> None:
    source = _source(endpoint)
    source.open()
    stream = source.batches()
    assert len(next(stream)) == 0
    source.stop()
    assert list(stream) == []
    source.close()
    source.close()


def test_ten_thousand_points_a_second_are_easy(endpoint: str) -> None:
    """200 points in each of 500 messages: 100 000 samples in well under ten seconds."""
    names = tuple(f"p{i}" for i in range(200))
    source = _source(endpoint, until_end=True)
    source.open()
    with ZenohPublisher(ZenohOptions(listen=(endpoint,)), "fdd/plant") as publisher:
        assert publisher.wait_for_subscriber(10)
        began = time.monotonic()
        for number in range(500):
            publisher.publish(
                Batch(
                    names,
                    np.arange(200, dtype=np.int32),
                    np.full(200, number, dtype=np.int64),
                    np.full(200, float(number)),
                    np.zeros(200, np.uint8),
                )
            )
        publisher.end()
        got = sum(len(b) for b in _collect(source))
        seconds = time.monotonic() - began
        source.close()
    assert got == 100_000
    assert got / seconds > 10_000


def test_endpoint_that_is_taken_is_not_ready(endpoint: str) -> None:
    host, port = endpoint.removeprefix("tcp/").split(":")
    with socket.socket() as other:
        other.bind((host, int(port)))
        other.listen()
        with pytest.raises(NotReady, match="Is the port taken"):
            open_session(ZenohOptions(listen=(endpoint,)), Path())


def test_missing_password_is_refused_without_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_SUCH_SECRET", raising=False)
    options = ZenohOptions(connect=("tcp/127.0.0.1:1",), user="u", password_env="NO_SUCH_SECRET")
    with pytest.raises(Refused, match="NO_SUCH_SECRET"):
        open_session(options, Path())


def test_wrong_password_gets_no_samples_and_the_right_one_does(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "users").write_text("daemon:secret\n")
    monkeypatch.setenv("GOOD", "secret")
    monkeypatch.setenv("WRONG", "guess")
    listening = ZenohOptions(listen=(endpoint,), users_file=tmp_path / "users", user="daemon", password_env="GOOD")
    with ZenohPublisher(listening, "fdd/plant") as publisher:
        for number in range(5):
            publisher.publish(batch(number))
        publisher.end()
        intruder = _source(endpoint, user="daemon", password_env="WRONG", until_end=True)
        intruder.open()
        assert len(next(intruder.batches())) == 0
        assert intruder.counters()["publishers present"] == 0
        intruder.close()
        friend = _source(endpoint, user="daemon", password_env="GOOD", until_end=True)
        friend.open()
        assert _values(_collect(friend)) == [float(i) for i in range(30)]
        friend.close()
