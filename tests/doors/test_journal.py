"""Nothing that was asked, left in the store, or journaled keeps the daemon from starting and watching on."""

from __future__ import annotations

import json
import os
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdd.records import Batch, Sample
from fdd.service.alarms.authority import Authority, CommandError
from fdd.service.alarms.book import Command
from fdd.service.daemon.checkpoint import Checkpoint, decode, encode
from fdd.service.daemon.codec import DamagedError, decode_entry, encode_entry
from fdd.service.daemon.commands import submit
from fdd.service.daemon.lock import StateLock
from fdd.service.engine.engine import Engine
from fdd.service.site.errors import UsageError
from tests.doors.daemons import HOUR, START, Feed, Site, pieces, ring, simulate, watched

POISON: dict[str, dict[str, Any]] = {
    "a zero as the alarm": {"alarm": "\u0000"},
    "half a pair as the actor": {"actor": "\ud800"},
    "a megabyte as the alarm": {"alarm": "x" * 1_000_000},
    "a comment of 20 MB": {"comment": "x" * 20_000_000},
    "an end beyond all time": {"action": "shelve", "comment": "c", "span": 1e308 * 86400},
    "shelved for 9999 years": {"action": "shelve", "comment": "c", "span": 9999 * 365 * 86400.0},
    "an end that is none": {"action": "shelve", "comment": "c", "span": float("nan")},
    "an end in 300 digits": {"action": "shelve", "comment": "c", "until": 10**300},
    "shelved without a reason": {"action": "shelve", "span": 3600.0},
    "no such action": {"action": "delete"},
    "a list as the actor": {"actor": ["a"]},
    "a time that is none": {"time": 10**30},
}


@pytest.mark.parametrize("wrong", POISON.values(), ids=POISON.keys())
def test_a_command_that_nobody_may_give_is_refused_before_the_journal(tmp_path: Path, wrong: dict[str, Any]) -> None:
    site = Site(tmp_path)
    daemon = site.start()
    key = ring(daemon)
    command = Command(**{"alarm": key, "action": "clear", "actor": "anna", "time": HOUR, **wrong})
    with pytest.raises(CommandError):
        Authority().check(command)
    assert list(site.checkpoint.entries()) == []
    site.stop()


@pytest.mark.parametrize(
    "document",
    [
        {"alarm": "\ud83d", "action": "clear", "actor": "a", "time": 1},
        {"alarm": "k", "action": "clear"},
        {"action": {"a": [1]}, "alarm": 5, "actor": None, "time": "x"},
        {"alarm": "k", "action": "shelve", "actor": "a", "time": 1, "span": 1e400, "comment": "c"},
        {},
        {"action": "turn back", "time": 10**40, "actor": "a"},
    ],
)
def test_a_document_that_is_no_command_is_answered_where_it_lies(tmp_path: Path, document: dict[str, Any]) -> None:
    site = Site(tmp_path)
    daemon = site.start()
    key = ring(daemon)
    with sqlite3.connect(site.folder / "fdd.sqlite") as db:  # as another program may leave it
        db.execute("insert into documents values ('command', '0/left', ?)", (json.dumps(document),))
    submit(site.store, Command(key, "acknowledge", "anna", HOUR))
    for _ in range(2):
        daemon.run(Feed())  # type: ignore[arg-type]
        assert site.store.items("command")["0/left"]["outcome"].startswith("refused: ")
        (alarm,) = daemon.engine.alarms.open
        assert str(alarm.state) == "acknowledged"
        daemon = site.restarted()
    site.stop()


@pytest.mark.parametrize(
    ("kind", "entry"),
    [
        ("command", b'{"alarm": "k", "action": "explode", "actor": "a", "time": 1}'),
        ("command", b'{"alarm": "k"'),
        ("command", b"[" * 100_000),
        ("batch", b"rubbish"),
        ("batch", b"PK rubbish"),
        ("batch", b'{"names": ["a"], "position": {}, "samples": 1}\nxx'),
        ("rebase", b"[{}]"),
        ("unheard of", b""),
    ],
)
def test_rubbish_in_the_journal_is_buried_and_the_rest_is_replayed(tmp_path: Path, kind: str, entry: bytes) -> None:
    truth, site = simulate(100, seed=1), Site(tmp_path)
    daemon = site.start()
    daemon.run(Feed(pieces(truth, 0, 50)))  # type: ignore[arg-type]
    frames = daemon.frames
    site.stop()
    with sqlite3.connect(site.state) as db:
        db.execute("update journal set n = n + 1000 where n > 3")
        db.execute("insert into journal (n, kind, entry) values (500, ?, ?)", (kind, entry))
    daemon = site.start()
    assert daemon.frames == frames
    status = daemon.status()
    assert (status["buried"], status["dead"][0]["kind"]) == (1, kind)
    daemon.run(Feed(pieces(truth, 50, 100)))  # type: ignore[arg-type]
    assert daemon.frames > frames
    again = site.restarted()
    assert again.status()["buried"] == 1
    site.stop()


def test_a_batch_that_breaks_the_engine_costs_itself_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, mark = simulate(200, seed=1), 12_345.0
    step = Engine.step

    def fragile(self: Engine, batch: Batch) -> Any:
        outputs = step(self, batch)
        if (batch.value == mark).any():
            raise np.linalg.LinAlgError("singular")  # half way: the engine has moved already
        return outputs

    monkeypatch.setattr(Engine, "step", fragile)
    poison = Batch.of([Sample("south.T", int(truth.time[100]), mark)])
    whole, hurt = Site(tmp_path / "whole"), Site(tmp_path / "hurt")
    rows = pieces(truth, 0, 200)
    for site, batches in ((whole, rows), (hurt, [*rows[:20], poison, *rows[20:]])):
        site.folder.mkdir()
        daemon = site.start(save_every=30)
        daemon.run(Feed(batches))  # type: ignore[arg-type]
        assert daemon.status()["buried"] == (site is hurt)
        again = site.restarted()
        assert again.status()["buried"] == (site is hurt)
    assert watched(hurt.store) == watched(whole.store)
    whole.stop()
    hurt.stop()


def test_a_journal_that_is_no_database_is_set_aside_and_said(tmp_path: Path) -> None:
    truth, site = simulate(100, seed=1), Site(tmp_path)
    daemon = site.start(save_every=20)
    daemon.run(Feed(pieces(truth, 0, 60)))  # type: ignore[arg-type]
    daemon.save()
    site.stop()
    site.state.write_bytes(os.urandom(20_000))
    daemon = site.start()
    assert "is damaged" in daemon.status()["mishaps"][0]
    frames = daemon.frames
    daemon.run(Feed(pieces(truth, 60, 80)))  # type: ignore[arg-type]
    again = site.restarted()  # what came after the new journal was begun is replayed on the old state
    assert again.frames == daemon.frames > frames > 0
    site.stop()


@pytest.mark.parametrize("hurt", ["cut", "one byte", "empty", "rubbish"])
def test_a_damaged_state_is_stepped_back_from_and_nothing_is_lost(tmp_path: Path, hurt: str) -> None:
    truth, site = simulate(200, seed=1), Site(tmp_path)
    daemon = site.start(save_every=20)
    daemon.run(Feed(pieces(truth, 0, 150)))  # type: ignore[arg-type]
    frames = daemon.frames
    site.stop()
    saved = site.state.with_name(f"{site.state.name}.saved")
    data = bytearray(saved.read_bytes())
    data[len(data) // 2] ^= 1
    saved.write_bytes({"cut": data[: len(data) // 2], "one byte": data, "empty": b"", "rubbish": b"\x80rubbish"}[hurt])
    daemon = site.start()
    assert daemon.frames == frames
    assert "it is kept as" in daemon.status()["mishaps"][0]
    before = watched(site.store)
    daemon.run(Feed(pieces(truth, 150, 200)))  # type: ignore[arg-type]
    undisturbed = Site(tmp_path / "undisturbed")
    undisturbed.folder.mkdir()
    undisturbed.start(save_every=20).run(Feed(pieces(truth, 0, 200)))  # type: ignore[arg-type]
    assert watched(site.store) == watched(undisturbed.store) != before
    site.stop()
    undisturbed.stop()


def test_without_any_whole_state_the_daemon_starts_afresh_and_says_so(tmp_path: Path) -> None:
    truth, site = simulate(200, seed=1), Site(tmp_path)
    daemon = site.start(save_every=20)
    daemon.run(Feed(pieces(truth, 0, 100)))  # type: ignore[arg-type]
    site.stop()
    for suffix in (".saved", ".saved.1"):
        Path(f"{site.state}{suffix}").write_bytes(b"rubbish")
    daemon = site.start()
    assert any("start afresh" in m for m in daemon.status()["mishaps"])
    daemon.run(Feed(pieces(truth, 100, 200)))  # type: ignore[arg-type]
    assert daemon.engine.phases
    site.stop()


def test_a_state_that_the_version_before_wrote_is_taken_over(tmp_path: Path) -> None:
    """Schema 3: the state without a head, batches in the journal as archives of arrays, one generation."""
    path = tmp_path / "state.sqlite"
    with sqlite3.connect(path) as db:
        db.execute("create table schema (id integer primary key, version integer)")
        db.execute("insert into schema values (1, 3)")
        db.execute("create table journal (n integer primary key autoincrement, kind text, entry blob)")
        batch = Batch.of([Sample("p", 5, 1.5), Sample("q", 6, None)], {"row": 2})
        data = encode({name: getattr(batch, name) for name in Batch.__slots__})
        db.execute("insert into journal values (7, 'batch', ?)", (data,))
        db.execute("insert into journal values (8, 'batch', ?)", (data,))
    Path(f"{path}.saved").write_bytes(encode({"schema": 3, "journaled": 7, "state": {"x": np.arange(3.0)}}))
    checkpoint = Checkpoint(path)
    state = checkpoint.load()
    assert state is not None
    assert state["x"].tolist() == [0.0, 1.0, 2.0]
    (entry,) = checkpoint.entries()
    assert isinstance(entry, Batch)
    assert (entry.names, entry.time.tolist(), entry.position) == (("p", "q"), [5, 6], {"row": 2})
    checkpoint.save({"x": 1})
    checkpoint.close()
    assert Checkpoint(path).load() == {"x": 1}


def test_entries_keep_their_bytes_and_take_little_room() -> None:
    batch = Batch(
        tuple(f"point {i}" for i in range(10_000)),
        np.array([7, 9_000, 7], np.int32),
        np.array([1, 2, 3]),
        np.array([0.1, np.nan, -0.0]),
        np.array([0, 2, 1], np.uint8),
        {"s": 1},
    )
    kind, data = encode_entry(batch)
    back = decode_entry(kind, data)
    assert len(data) < 300
    assert isinstance(back, Batch)
    assert [back.names[i] for i in back.point] == ["point 7", "point 9000", "point 7"]
    for column in ("time", "value", "quality"):
        assert getattr(back, column).tobytes() == getattr(batch, column).tobytes()
    assert back.position == {"s": 1}


def test_rubbish_is_no_state() -> None:
    chance = np.random.default_rng(3)
    whole = encode({"a": np.arange(100.0), "b": "text"})
    for _ in range(300):
        data = bytearray(whole)
        for at in chance.integers(0, len(data), 5):
            data[at] = chance.integers(256)
        try:
            decode(bytes(data[: chance.integers(1, len(data))]))
        except DamagedError:
            continue


def test_a_flood_of_messages_without_samples_leaves_no_trace_in_the_journal(tmp_path: Path) -> None:
    site = Site(tmp_path)
    daemon = site.start()
    flood = [Batch.of([], {"streams": {f"forged {i}/r": 1}}) for i in range(7_000)]
    daemon.run(Feed(flood))  # type: ignore[arg-type]
    assert list(site.checkpoint.entries()) == []
    assert daemon.position == {} or "streams" in daemon.position
    site.stop()


def test_a_second_daemon_on_the_same_site_is_refused_by_name(tmp_path: Path) -> None:
    first = StateLock(tmp_path / "rooms.state.sqlite")
    with pytest.raises(UsageError, match=f"process {os.getpid()}"):
        StateLock(tmp_path / "rooms.state.sqlite")
    first.close()
    StateLock(tmp_path / "rooms.state.sqlite").close()


def test_state_and_journal_are_for_their_owner_alone(tmp_path: Path) -> None:
    site = Site(tmp_path)
    daemon = site.start()
    daemon.save()
    site.stop()
    for file in (site.state, Path(f"{site.state}.saved"), tmp_path / "rooms.audit.jsonl"):
        assert file.stat().st_mode & 0o077 == 0, file
    assert START > 0
