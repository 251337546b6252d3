"""A daemon of two rooms, killed at random moments of a stage until it is through; what it left against undisturbed.

The stages: taking in samples, recovering, writing a checkpoint, putting a new baseline in force. The daemon is a forked
process on files of its own, ended by SIGKILL: nothing of it can tidy up.
"""

from __future__ import annotations

import os
import select
import signal
import tempfile
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import structlog

from fdd.records import Batch
from fdd.service.alarms.book import Command
from fdd.service.baselines.versions import accept, versions
from fdd.service.daemon.commands import submit
from fdd.service.daemon.daemon import Daemon
from fdd.store.sqlite import SqliteStore
from tests.doors.daemons import Site
from tests.service.conftest import Truth, baselines, simulate

STAGES = ("stream", "recovery", "checkpoint", "baseline")
ROWS, PIECE = 900, 5
_NEW_BASELINE, _COMMAND = 300, 600
_TABLES = ("samples", "predictions", "charts", "parameters")


class _Feed:
    """The rooms' rows after a position; on the way a new baseline is accepted, and a person takes an alarm."""

    def __init__(self, truth: Truth, site: Site, daemon: Daemon, tell: Callable[[str], None]) -> None:
        self._truth, self._site, self._daemon, self._tell = truth, site, daemon, tell
        self.heard: dict[str, float] = {}

    def batches(self) -> Iterator[Batch]:
        row = int(self._daemon.position.get("row", 0))
        yield replace(Batch.of([]), position=self._daemon.position)  # what was left undone is looked for first
        for start in range(row, ROWS, PIECE):
            if start == _NEW_BASELINE and len(versions(self._site.store, "south")) == 1:
                self._tell("baseline")
                accept(self._site.store, replace(baselines()["south"], reason="identified again"))
            if start == _COMMAND and self._daemon.engine.alarms.open:
                submit(self._site.store, Command(self._daemon.engine.alarms.open[0].key, "acknowledge", "anna", 5))
            yield replace(self._truth.batch(start, start + PIECE), position={"row": start + PIECE})
            self._tell("stream")

    def counters(self) -> dict[str, int]:
        return {}


def _run(folder: Path, truth: Truth, tell: Callable[[str], None]) -> None:
    """One life of the daemon, to its end."""
    site = Site(folder)
    tell("recovery")
    daemon = site.start(save_every=10)
    if not len(versions(site.store, "south")):
        for baseline in baselines().values():
            accept(site.store, baseline)
    save = daemon.save

    def saving() -> None:
        tell("checkpoint")
        save()

    daemon.save = saving  # type: ignore[method-assign]
    daemon.run(_Feed(truth, site, daemon, tell))  # type: ignore[arg-type]
    daemon.finish()
    site.stop()


def _life(folder: Path, truth: Truth, kill: tuple[str, int, float] | None) -> bool:
    """Fork a daemon and wait for its end; killed so long [s] after a stage was told for the nth time."""
    out, told = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))

            def tell(stage: str) -> None:
                os.write(told, stage[:1].encode())

            _run(folder, truth, tell)
        except BaseException:
            os._exit(1)
        os._exit(0)
    os.close(told)
    if kill is not None:
        stage, number, delay = kill
        while number > 0 and (heard := os.read(out, 1)):
            number -= heard == stage[:1].encode()
        clock.sleep(delay)
        os.kill(child, signal.SIGKILL)
    else:
        while select.select([out], [], [])[0] and os.read(out, 4096):
            pass
    _, status = os.waitpid(child, 0)
    os.close(out)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        raise RuntimeError(f"the daemon ended with code {os.WEXITSTATUS(status)}")
    return os.WIFEXITED(status)


def _left(folder: Path) -> dict[str, dict[object, object]]:
    """Everything a store holds, by key."""
    store = SqliteStore(folder / "fdd.sqlite", read_only=True)
    found: dict[str, dict[object, object]] = {}
    for table in _TABLES:
        frame = store.read(table)
        keys = zip(frame["series"].tolist(), frame["time"].tolist(), strict=True)
        cells = frame.drop(columns=["series", "time"]).to_numpy(dtype=np.float64)
        found[table] = {key: row.tobytes() for key, row in zip(keys, cells, strict=True)}
    for kind in ("alarm", "baseline"):
        found[kind] = dict(store.items(kind))
    store.close()
    return found


def measure(kills: int, seed: int, stages: tuple[str, ...] = STAGES) -> dict[str, int]:
    """Kill so often; rows and documents that were lost, are too many, or differ, by table, and the kills that hit."""
    chance, truth = np.random.default_rng(seed), simulate(ROWS, seed=2, loss=900.0, onset=400)
    result = {"kills": 0, **{f"kills in {stage}": 0 for stage in stages}}
    with tempfile.TemporaryDirectory() as place:
        whole, hurt = Path(place) / "whole", Path(place) / "hurt"
        whole.mkdir()
        _life(whole, truth, None)
        wanted = _left(whole)
        wrong = dict.fromkeys(wanted, 0)
        while result["kills"] < kills:
            hurt = Path(place) / f"hurt-{result['kills']}"
            hurt.mkdir()
            for stage in chance.permutation(stages)[: kills - result["kills"]]:
                number = int(chance.integers(1, {"stream": 60, "checkpoint": 6}.get(str(stage), 1) + 1))
                if not _life(hurt, truth, (str(stage), number, float(chance.uniform(0.0, 0.02)))):
                    result["kills"] += 1
                    result[f"kills in {stage}"] += 1
            _life(hurt, truth, None)
            found = _left(hurt)
            for table, rows in wanted.items():
                wrong[table] += sum(found[table].get(key) != row for key, row in rows.items())
                wrong[table] += len(found[table].keys() - rows.keys())
    return {**result, **{f"wrong {table}": n for table, n in wrong.items()}, "rows": sum(map(len, wanted.values()))}
