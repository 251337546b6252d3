"""Operators' commands: none is lost, whatever the clocks say; over Zenoh they are answered by the running daemon."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.drifting_room import DAY, POINTS, START, Course, plan, simulate
from fdd.config import load_site
from fdd.config.load import parse_site
from fdd.evidence import ChartEvidence, ChartKind
from fdd.records import NANOSECONDS, AlarmState, Batch, Sample
from fdd.service.alarms.book import Command, Ring
from fdd.service.daemon.checkpoint import Checkpoint
from fdd.service.daemon.commands import DONE, key_of, submit
from fdd.service.daemon.daemon import Daemon
from fdd.service.engine.engine import Engine
from fdd.service.verbs.operate import command, read_alarms
from fdd.service.verbs.status import read_status
from fdd.store.sqlite import SqliteStore
from ingest.zenoh import OperatorOptions, ZenohOptions, ZenohPublisher
from ingest.zenoh.session import ask, open_session
from tests.ports import free_port
from tests.service.room_site import daemon, first_baseline, make_site, until

HOUR = 3600 * NANOSECONDS
RANG = Ring("room", "room/T:cusum", None, 0, ChartEvidence("T", ChartKind.CUSUM))


class Feed:
    """A source that has nothing to say, so often."""

    def __init__(self, turns: int) -> None:
        self.turns = turns
        self.heard: dict[str, float] = {}

    def batches(self) -> Iterator[Batch]:
        for _ in range(self.turns):
            yield Batch.of([])

    def counters(self) -> dict[str, int]:
        return {}


class Clock:
    """Moves on by ten seconds whenever it is read."""

    def __init__(self) -> None:
        self.seconds = 1_800_000_000.0

    def __call__(self) -> float:
        self.seconds += 10.0
        return self.seconds


def daemon_of(folder: Path) -> tuple[Daemon, SqliteStore, Checkpoint]:
    opened = make_site(folder, Course(15), 1, learning_days=14)
    store, checkpoint = opened.store(), Checkpoint(folder / "state.sqlite")
    engine = Engine(plan(), {"room": first_baseline(opened, Course(15), 1, 14)})
    assert isinstance(store, SqliteStore)
    return Daemon(engine, store, checkpoint, now=Clock()), store, checkpoint


def outcomes(store: SqliteStore) -> dict[str, str]:
    return {d["comment"]: d.get("outcome", "waits") for d in store.list("command")}


def test_a_command_that_is_older_than_the_last_one_is_carried_out(tmp_path: Path) -> None:
    """The clock of a second operator is an hour behind; and the store brings what waited on another machine."""
    daemon, store, checkpoint = daemon_of(tmp_path)
    (alarm,) = daemon.engine.alarms.ring(HOUR, [RANG])
    submit(store, Command(alarm.key, "acknowledge", "anna", 10 * HOUR, "first"))
    daemon.run(Feed(2))  # type: ignore[arg-type]
    submit(store, Command(alarm.key, "clear", "bert", 9 * HOUR, "late"))
    submit(store, Command("room@never", "clear", "bert", 8 * HOUR, "mistaken"))
    daemon.run(Feed(2))  # type: ignore[arg-type]
    assert daemon.engine.alarms.open == ()
    said = outcomes(store)
    assert (said["first"], said["late"]) == (DONE, DONE)
    assert said["mistaken"].startswith("refused: no open alarm 'room@never'")
    checkpoint.close()
    store.close()


def test_a_command_is_carried_out_once_across_restarts(tmp_path: Path) -> None:
    daemon, store, checkpoint = daemon_of(tmp_path)
    (alarm,) = daemon.engine.alarms.ring(HOUR, [RANG])
    daemon.save()
    submit(store, Command(alarm.key, "acknowledge", "anna", 10 * HOUR, "first"))
    daemon.run(Feed(2))  # type: ignore[arg-type]
    # The store has lost what became of it, as one that was away may have; the daemon was killed before it saved.
    (document,) = store.list("command")
    store.put("command", document["key"], {k: v for k, v in document.items() if k != "outcome"})
    again = Daemon(Engine(plan(), daemon.engine._baselines), store, checkpoint, now=Clock())
    again.recover()
    again.run(Feed(3))  # type: ignore[arg-type]
    (now,) = again.engine.alarms.open
    assert now.state is AlarmState.ACKNOWLEDGED
    assert [e.state for e in now.history].count("acknowledged") == 1
    assert outcomes(store) == {"first": DONE}
    checkpoint.close()
    store.close()


def test_the_key_of_the_questions_holds_the_sites_name() -> None:
    site = parse_site("name: Hillside 3/a\noperator: {listen: ['tcp/127.0.0.1:7448']}\n")
    assert key_of(site) == "fdd/Hillside-3-a/alarms"
    assert isinstance(site.operator, OperatorOptions)


class Running:
    """A daemon process of the room, which loses a third more heat from day 16 on, and a session that asks it."""

    course = Course(26, step=0.35, onset=16.0)

    def __init__(self, site_file: Path, samples: int, questions: int) -> None:
        self.site_file = site_file
        self.publisher = ZenohPublisher(ZenohOptions(connect=(f"tcp/127.0.0.1:{samples}",)), "room/plant")
        (site_file.parent / "anna.password").write_text("secret")
        options = OperatorOptions(
            connect=(f"tcp/127.0.0.1:{questions}",), user="anna", password_file=Path("anna.password")
        )
        self.session: Any = open_session(options, site_file.parent)
        self.key = key_of(load_site(site_file))

    def publish(self) -> None:
        days = simulate(self.course, 4).between(START + 14 * DAY * NANOSECONDS, None)
        rows = zip(days.time.tolist(), days.values.tolist(), strict=True)
        self.publisher.publish(Batch.of(Sample(p, t, v) for t, row in rows for p, v in zip(POINTS, row, strict=True)))

    def ask(self, selector: str = "", **asked: str) -> Any:
        selector = "/as/anna" if asked else selector
        (answer,) = ask(self.session, self.key + selector, json.dumps(asked).encode() if asked else b"", 30.0)
        return json.loads(answer)

    def close(self) -> None:
        self.session.close()
        self.publisher.close()


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    samples, questions = free_port(), free_port()
    extra = (
        f"source: {{kind: zenoh, key: 'room/**', listen: ['tcp/127.0.0.1:{samples}']}}\n"
        f"operator: {{listen: ['tcp/127.0.0.1:{questions}'], users_file: users, people: {{anna: {{role: clear}}}}}}\n"
    )
    (tmp_path / "users").write_text("anna:secret\n")
    make_site(tmp_path, Running.course, 4, learning_days=14, extra=extra)
    site_file, log = tmp_path / "site.yaml", tmp_path / "log"
    with daemon(site_file, log) as process:
        until(lambda: "running" in log.read_text() or process.poll() is not None)
        plant = Running(site_file, samples, questions)
        yield plant
        plant.close()
        process.terminate()
        process.wait(30)


def test_operators_list_and_handle_alarms_over_zenoh(running: Running) -> None:
    running.publish()
    last = START + running.course.days * DAY * NANOSECONDS
    until(lambda: read_status(running.site_file).get("time", 0) in (last, last - 900 * NANOSECONDS))
    alarm, *models = running.ask()["alarms"]
    assert all(a["state"] == "suppressed by design" for a in models)
    key, shared = alarm["key"], {"alarm": alarm["key"], "by": "anna"}
    assert (alarm["component"], alarm["state"]) == ("room", "raised")
    done = running.ask(action="acknowledge", comment="on my way", **shared)
    assert (done["outcome"], done["alarm"]["state"]) == (DONE, "acknowledged")
    last = done["alarm"]["history"][-1]
    assert (last["actor"], last["comment"], last["through"]) == ("anna", "on my way", "zenoh")
    assert "cannot be acknowledged" in running.ask(action="acknowledge", **shared)["outcome"]
    shelved = running.ask(action="shelve", comment="part ordered", **shared, **{"for": "8 h"})
    assert shelved["alarm"]["evidence"]["shelved_until"] == shelved["alarm"]["history"][-1]["time"] + 8 * HOUR
    assert running.ask(action="unshelve", **shared)["alarm"]["state"] == "raised"
    # What the store and the CLI see is the same alarm; the CLI's own command is answered by the daemon, too.
    stored = next(a for a in read_alarms(running.site_file) if a["key"] == key)
    assert (stored["key"], stored["state"]) == (key, "raised")
    assert command(running.site_file, key, "acknowledge", "bert") == f"acknowledge {key}: {DONE}"
    assert running.ask(action="clear", comment="window closed", **shared)["alarm"]["state"] == "cleared"
    assert running.ask()["alarms"] == []
    told = {a["key"]: a["state"] for a in running.ask("?all=true")["alarms"]}
    assert told == dict.fromkeys([key, *(a["key"] for a in models)], "cleared")
    for asked, wrong in (
        ({"action": "delete", **shared}, "there is no action 'delete'"),
        ({"action": "clear", "by": "anna"}, "alarm missing"),
        ({"action": "clear", "alarm": key, "by": "bert"}, "this key is 'anna''s"),
        ({"action": "clear", **shared, "who": "me"}, "unknown who"),
        ({"action": "shelve", **shared, "for": "soon"}, "soon"),
        ({"action": "clear", **shared}, "no open alarm"),
    ):
        assert wrong in running.ask(**asked)["outcome"], asked


def test_a_taken_endpoint_is_named(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        extra = (
            f"source: {{kind: zenoh, key: 'room/**', listen: ['tcp/127.0.0.1:{free_port()}']}}\n"
            f"operator: {{listen: ['tcp/127.0.0.1:{port}']}}\n"
        )
        make_site(tmp_path, Course(15), 1, learning_days=14, extra=extra)
        begun = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "fdd", "run", str(tmp_path / "site.yaml")],
            capture_output=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 1
        assert f"tcp/127.0.0.1:{port}" in done.stderr.decode()
        assert time.monotonic() - begun < 60
