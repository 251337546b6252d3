"""A crash loses nothing that was journaled."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from fdd.records import Batch, Quality, Sample
from fdd.service.alarms import Command
from fdd.service.checkpoint import Checkpoint, CheckpointError, decode, encode


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


def test_state_of_another_schema_is_refused_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "state.sqlite"
    Checkpoint(path).save({"x": 1})
    with sqlite3.connect(path) as db:
        db.execute("update checkpoint set schema = 99")
    with pytest.raises(CheckpointError, match="move the file away"):
        Checkpoint(path).load()
