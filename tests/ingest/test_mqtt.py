"""MQTT payloads, and the source against a real broker (mosquitto on the path or in FDD_MOSQUITTO)."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt import client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from fdd.records import Batch, Sample
from ingest.message import MalformedMessage, encode
from ingest.mqtt import MqttOptions, MqttSource
from ingest.mqtt.payload import bare_value, json_object, number
from ingest.source import Context, NotReady, Refused
from tests.ports import free_port


def test_words_and_numbers_are_values() -> None:
    assert [number(v) for v in ("21.5", " ON", "inactive", "", True, None, 3)] == [21.5, 1.0, 0.0, None, 1.0, None, 3.0]
    with pytest.raises(MalformedMessage, match="'warm' is no number"):
        number("warm")


def test_bare_value_takes_the_topics_name_and_the_time_of_arrival() -> None:
    batch = bare_value("ahu/1/sat", b"55.2", 7).batch
    assert (batch.names, batch.time.tolist(), batch.value.tolist()) == (("ahu/1/sat",), [7], [55.2])


def test_json_object_gives_value_and_time_in_their_keys() -> None:
    read = {"value_key": "v", "time_key": "ts", "time_unit": "ms"}
    batch = json_object("t", b'{"v": 1.5, "ts": 1700000000123}', 7, **read).batch
    assert batch.time.tolist() == [1_700_000_000_123_000_000]
    for payload, says in [
        (b"{", "no JSON"),
        (b"[1]", "no object with key 'v'"),
        (b'{"v": 1}', "no time in ms"),
        (b'{"v": 1, "ts": 1e40}', "too large"),
        (b'{"v": 1, "ts": true}', "no time in ms"),
        (b'{"v": [1], "ts": 1}', "no number"),
    ]:
        with pytest.raises(MalformedMessage, match=says):
            json_object("t", payload, 7, **read)


def test_a_broker_that_is_not_there_is_not_ready() -> None:
    source = _source(free_port())
    with pytest.raises(NotReady, match="does not answer"):
        source.open()


def _source(port: int, **options: Any) -> MqttSource:
    source = MqttSource()
    table = {"host": "127.0.0.1", "port": port, "topics": ["plant/#"], **options}
    source.configure(MqttOptions.model_validate(table), Context())
    return source


class Broker:
    """A mosquitto on loopback that can be restarted and keeps its sessions on disk."""

    def __init__(self, program: str, folder: Path) -> None:
        self.port, self._program, self._folder = free_port(), program, folder
        (folder / "users").write_text("")
        (folder / "broker.conf").write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\npersistence true\n"
            f"persistence_location {folder}/\nmax_queued_messages 100000\nuser root\n"
        )
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(
            [self._program, "-c", str(self._folder / "broker.conf")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.02)
        raise TimeoutError("mosquitto did not start within 10 s")

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait(10)

    def publish(self, payloads: list[bytes], topic: str = "plant/all") -> None:
        client = mqtt.Client(CallbackAPIVersion.VERSION2)
        client.connect("127.0.0.1", self.port)
        client.loop_start()
        for payload in payloads:
            client.publish(topic, payload, qos=1).wait_for_publish(10)
        client.disconnect()
        client.loop_stop()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    program = os.environ.get("FDD_MOSQUITTO") or shutil.which("mosquitto") or shutil.which("/usr/sbin/mosquitto")
    if program is None:
        pytest.skip("no mosquitto here; install Debian's or set FDD_MOSQUITTO")
    made = Broker(program, tmp_path)
    yield made
    made.stop()


def _messages(start: int, stop: int, end: bool = False) -> list[bytes]:
    return [
        encode(
            Batch.of([Sample("T", i, float(i))]),
            publisher="gateway",
            run="r1",
            seq=i,
            end=end and i == stop - 1,
        )
        for i in range(start, stop)
    ]


def _values(batches: list[Batch]) -> list[float]:
    return [v for b in batches for v in b.value.tolist()]


def _take(source: MqttSource, number_: int, seconds: float = 15.0) -> list[Batch]:
    got: list[Batch] = []
    deadline = time.monotonic() + seconds
    for batch in source.batches():
        got.append(batch)
        if len(_values(got)) >= number_:
            return got
        assert time.monotonic() < deadline, f"{len(_values(got))} of {number_} came within {seconds} s"
    return got


@pytest.mark.integration
def test_messages_sent_while_the_daemon_is_away_come_when_it_is_back(broker: Broker) -> None:
    first = _source(broker.port)
    first.open()
    broker.publish(_messages(1, 11))
    begun = _take(first, 10)
    position = begun[-1].position
    first.close()  # the last batch was never acknowledged: the broker sends it again
    broker.publish(_messages(11, 301, end=True))
    second = _source(broker.port, until_end=True)
    second.open(position)
    rest = list(second.batches())
    second.close()
    assert _values([*begun, *rest]) == [float(i) for i in range(1, 301)]
    assert second.counters()["message repeated"] >= 1
    assert "message lost" not in second.counters()


@pytest.mark.integration
def test_a_broker_restart_is_ridden_out(broker: Broker) -> None:
    source = _source(broker.port)
    source.open()
    broker.publish(_messages(1, 6))
    got = _take(source, 5)
    broker.stop()
    broker.start()
    broker.publish(_messages(6, 11))
    got += _take(source, 5)
    source.close()
    assert _values(got) == [float(i) for i in range(1, 11)]
    assert source.counters()["broker lost"] == 1


@pytest.mark.integration
def test_bare_values_are_points_named_like_their_topics(broker: Broker) -> None:
    source = _source(broker.port, payload="value")
    source.open()
    broker.publish([b"21.5", b"warm", b"22.5"], topic="plant/ahu/sat")
    got = _take(source, 2)
    counters = source.counters()
    source.close()
    assert _values(got) == [21.5, 22.5]
    assert {n for b in got for n in b.names} == {"plant/ahu/sat"}
    assert counters["malformed message"] == 1


@pytest.mark.integration
def test_a_login_that_the_broker_refuses_is_refused(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    broker.stop()
    config = broker._folder / "broker.conf"
    config.write_text(config.read_text().replace("allow_anonymous true", "allow_anonymous false"))
    broker.start()
    monkeypatch.setenv("WRONG", "guess")
    with pytest.raises(Refused, match="check user and password"):
        _source(broker.port, user="u", password_env="WRONG").open()
