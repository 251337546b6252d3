"""The Zenoh router's configuration, in a real router session on loopback: who may do what."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from fdd.records import Batch, Sample
from ingest.source import Context
from ingest.zenoh import ZenohOptions, ZenohPublisher, ZenohSource
from ingest.zenoh.session import ask
from tests.ports import free_port

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[str]:
    users = tmp_path / "users"
    users.write_text("fdd:one\ngateway:two\noperator:three\n")
    text = (DEPLOY / "zenoh" / "router.json5").read_text()
    address = f"tcp/127.0.0.1:{free_port()}"
    text = text.replace("tcp/0.0.0.0:7447", address).replace("/run/secrets/zenoh.users", str(users))
    path = tmp_path / "router.json5"
    path.write_text(text)
    with zenoh.open(zenoh.Config.from_file(str(path))):
        yield address


def client(endpoint: str, user: str = "", password: str = "") -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("connect/timeout_ms", "1500")
    config.insert_json5("scouting/multicast/enabled", "false")
    if user:
        config.insert_json5("transport/auth/usrpwd", f'{{user: "{user}", password: "{password}"}}')
    return zenoh.open(config)


def test_known_users_exchange_messages_on_the_service_s_keys_only(endpoint: str) -> None:
    seen: list[str] = []
    with client(endpoint, "fdd", "one") as daemon, client(endpoint, "gateway", "two") as gateway:
        subscribers = [
            daemon.declare_subscriber(k, lambda s: seen.append(str(s.key_expr))) for k in ("fdd/**", "other/**")
        ]
        for _ in range(50):
            gateway.put("other/T", b"1")
            gateway.put("fdd/north/T", b"1")
            if seen:
                break
            time.sleep(0.1)
        time.sleep(0.3)
        assert set(seen) == {"fdd/north/T"}
        for s in subscribers:
            s.undeclare()


def test_the_service_s_own_source_gets_what_a_gateway_sent_before_it_came(endpoint: str, tmp_path: Path) -> None:
    def options(user: str, password: str) -> ZenohOptions:
        (tmp_path / user).write_text(password)
        return ZenohOptions(
            mode="client",
            connect=(endpoint,),
            key="fdd/north/**",
            user=user,
            password_file=tmp_path / user,
            until_end=True,
        )

    gateway = ZenohPublisher(options("gateway", "two"), "fdd/north/ahu")
    for i in range(30):
        gateway.publish(Batch.of([Sample("T", i, float(i))]))
    time.sleep(2)  # until the router knows of the gateway's cache
    source = ZenohSource()
    source.configure(options("fdd", "one"), Context())
    source.open()
    gateway.wait_for_subscriber(5)
    time.sleep(1)  # history first: the end of the stream stops the source
    gateway.publish(Batch.of([Sample("T", 30, 30.0)]))
    gateway.end()
    values = [v for batch in source.batches() for v in batch.value.tolist()]
    said = source.counters(), source.notes()
    source.close()
    gateway.close()
    assert values == [float(i) for i in range(31)], said


@pytest.mark.parametrize(("user", "password"), [("", ""), ("fdd", "wrong"), ("stranger", "one")])
def test_who_has_no_password_gets_no_session(endpoint: str, user: str, password: str) -> None:
    with pytest.raises(zenoh.ZError):
        client(endpoint, user, password).close()


def test_a_gateway_neither_reads_alarms_nor_commands_and_an_operator_does_both_under_one_name(endpoint: str) -> None:
    key = "fdd/north/alarms"
    with (
        client(endpoint, "fdd", "one") as daemon,
        client(endpoint, "gateway", "two") as gateway,
        client(endpoint, "operator", "three") as operator,
    ):

        def answer(query: Any) -> None:
            with query:
                query.reply(str(query.key_expr), b"told")

        declared = [daemon.declare_queryable(k, answer) for k in (key, f"{key}/as/*")]
        end = time.monotonic() + 10.0
        while not ask(operator, key, b"", 1.0) and time.monotonic() < end:
            time.sleep(0.1)
        assert ask(operator, key, b"", 2.0) == [b"told"]
        assert ask(operator, f"{key}/as/operator", b"{}", 2.0) == [b"told"]
        assert ask(operator, f"{key}/as/anna", b"{}", 2.0) == []
        for selector in (key, f"{key}/as/operator", f"{key}/as/*", "fdd/**"):
            assert ask(gateway, selector, b"{}", 1.0) == [], selector
        for d in declared:
            d.undeclare()
