"""A crash loses nothing that was journaled."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from fdd.records import Batch, Quality, Sample
from fdd.service.alarms.book import Command
from fdd.service.daemon.checkpoint import Checkpoint, CheckpointError, decode, encode, files_of


def test_state_keeps_every_bit_of_its_arrays() -> None:
    tree = {
        "a": {"x": np.array([0.1, np.nan, np.inf])},
        "n": 3,
        "list": [np.arange(3), "word", None],
        "f": np.float64(0.1),
    }
    back = decode(encode(tree))
    assert back["a"]["x"].tobytes() == tree["a"]["x"].tobytes()  # type: ignore[index]
    assert back["list"][0].tolist() == [0, 1, 2]
    assert back["f"] == 0.1


def test_state_refuses_what_it_cannot_keep() -> None:
    with pytest.raises(TypeError, match="set"):
        encode({"a": {1, 2}})


def test_journal_comes_back_in_order_after_reopening(tmp_path: Path) -> None:
    path = tmp_path / "state.sqlite"
    batch = Batch.of([Sample("p", 5, None, Quality.BAD), Sample("q", 6, 1.5)], {"row": 2})
    command = Command("hx@t", "shelve", "anna", 7, until=9)
    first = Checkpoint(path)
    first.journal(batch)
    first.journal(command)
    again = list(Checkpoint(path).entries())
    assert isinstance(again[0], Batch)
    assert again[0].names == ("p", "q")
    assert again[0].position == {"row": 2}
    assert again[0].value.tobytes() == batch.value.tobytes()
    assert again[1] == command


def test_saving_empties_the_journal(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.sqlite")
    checkpoint.journal(Batch.of([Sample("p", 5, 1.0)]))
    checkpoint.save({"x": 1})
    assert list(checkpoint.entries()) == []
    assert checkpoint.load() == {"x": 1}


def test_entries_have_numbers_of_their_own_after_the_journal_was_emptied(tmp_path: Path) -> None:
    first = Checkpoint(tmp_path / "state.sqlite")
    first.journal(Batch.of([Sample("p", 5, 1.0)]))
    first.save({"x": 1})
    first.close()
    again = Checkpoint(tmp_path / "state.sqlite")
    again.journal(Batch.of([Sample("p", 6, 1.0)]))
    assert [b.time.tolist() for b in again.entries() if isinstance(b, Batch)] == [[6]]
    again.save({"x": 2})
    again.journal(Batch.of([Sample("p", 7, 1.0)]))
    again.close()
    third = Checkpoint(tmp_path / "state.sqlite")
    assert third.load() == {"x": 2}
    assert [b.time.tolist() for b in third.entries() if isinstance(b, Batch)] == [[7]]


@pytest.mark.parametrize("lost", ["before the new state is whole", "before the journal is shortened"])
def test_a_crash_while_saving_leaves_one_state_with_what_was_journaled_after_it(tmp_path: Path, lost: str) -> None:
    path = tmp_path / "state.sqlite"
    running = Checkpoint(path)
    running.journal(Batch.of([Sample("p", 5, 1.0)]))
    running.save({"x": 1})
    assert running.load() == {"x": 1}
    running.journal(Batch.of([Sample("p", 6, 1.0)]))
    before = {f: f.read_bytes() for f in files_of(path) if f.exists()}
    running.save({"x": 2})
    running.close()
    _, saved, torn, *_ = files_of(path)
    whole = saved.read_bytes()
    for f in files_of(path):
        f.unlink(missing_ok=True)
    for f, content in before.items():
        f.write_bytes(content)
    if lost == "before the new state is whole":
        torn.write_bytes(whole[: len(whole) // 2])
        state, times = {"x": 1}, [[6]]
    else:
        saved.write_bytes(whole)
        state, times = {"x": 2}, []
    after = Checkpoint(path)
    assert after.load() == state
    assert [b.time.tolist() for b in after.entries() if isinstance(b, Batch)] == times


def test_a_state_is_saved_as_it_was_when_it_was_given(tmp_path: Path) -> None:
    checkpoint, x = Checkpoint(tmp_path / "state.sqlite"), np.zeros(100_000)
    checkpoint.save({"x": x})
    x[:] = 1.0
    found = checkpoint.load()
    assert found is not None
    assert not found["x"].any()


def test_a_disk_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.sqlite")
    files_of(tmp_path / "state.sqlite")[2].mkdir()
    checkpoint.save({"x": 1})
    with pytest.raises(OSError, match="saved"):
        checkpoint.save({"x": 2})


def test_state_of_another_schema_is_refused_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "state.sqlite"
    Checkpoint(path).save({"x": 1})
    with sqlite3.connect(path) as db:
        db.execute("update schema set version = 99")
    with pytest.raises(CheckpointError, match="move the file away"):
        Checkpoint(path).load()


def test_state_file_of_the_first_versions_is_refused_too(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "state.sqlite") as db:
        db.execute("create table checkpoint (id integer primary key, schema integer, state blob)")
        db.execute("create table journal (n integer primary key, kind text, entry blob)")
    with pytest.raises(CheckpointError, match="move the file away"):
        Checkpoint(tmp_path / "state.sqlite")
