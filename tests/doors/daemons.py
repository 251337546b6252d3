"""A daemon of two rooms on files of its own, which can be stopped anywhere and started again on what it left."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from fdd.evidence import ChartEvidence, ChartKind
from fdd.records import NANOSECONDS, Batch, JsonObject
from fdd.service.alarms.book import Ring
from fdd.service.daemon.checkpoint import Checkpoint
from fdd.service.daemon.daemon import Daemon
from fdd.service.daemon.trail import Trail
from fdd.service.engine.engine import Engine
from fdd.store.sqlite import SqliteStore
from tests.service.conftest import START, STEP, Truth, baselines, plan, simulate

HOUR = 3600 * NANOSECONDS


class Clock:
    """Moves on by ten seconds whenever it is read."""

    def __init__(self) -> None:
        self.seconds = 1_800_000_000.0

    def __call__(self) -> float:
        self.seconds += 10.0
        return self.seconds


class Feed:
    """Batches from a list, and then nothing, a few times."""

    def __init__(self, batches: Iterable[Batch] = (), turns: int = 3) -> None:
        self._batches, self._turns = batches, turns
        self.heard: dict[str, float] = {}

    def batches(self) -> Iterator[Batch]:
        yield from self._batches
        for _ in range(self._turns):
            yield Batch.of([])

    def counters(self) -> dict[str, int]:
        return {}


class Site:
    """The folder of a daemon."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.state = folder / "rooms.state.sqlite"

    def start(self, save_every: int = 100) -> Daemon:
        """A daemon that has recovered what the one before left."""
        self.store = SqliteStore(self.folder / "fdd.sqlite")
        self.checkpoint = Checkpoint(self.state)
        self.trail = Trail(self.folder / "rooms.audit.jsonl")
        daemon = Daemon(
            Engine(plan(), baselines()),
            self.store,
            self.checkpoint,
            save_every=save_every,
            now=Clock(),
            trail=self.trail,
        )
        daemon.recover()
        return daemon

    def stop(self) -> None:
        """As a crash leaves it: nothing is saved."""
        self.checkpoint.close()
        self.store.close()
        self.trail.close()

    def restarted(self, save_every: int = 100) -> Daemon:
        """Crash, and start again."""
        self.stop()
        return self.start(save_every)


def ring(daemon: Daemon, component: str = "south") -> str:
    """An alarm that is open, and in the saved state."""
    rung = Ring(component, f"{component}/T_in:cusum", None, START, ChartEvidence("T", ChartKind.CUSUM))
    (alarm,) = daemon.engine.alarms.ring(START, [rung])
    daemon.save()
    return alarm.key


def pieces(truth: Truth, start: int, stop: int, size: int = 5) -> list[Batch]:
    """Rows of the truth in batches of so many rows."""
    return [truth.batch(k, min(k + size, stop)) for k in range(start, stop, size)]


def watched(store: SqliteStore) -> JsonObject:
    """What a store holds of verdicts and predictions, exactly."""
    return {m: [_bytes(store, m, c) for c in store.read(m).columns] for m in ("charts", "predictions", "samples")}


def _bytes(store: SqliteStore, measurement: str, column: str) -> bytes:
    values = store.read(measurement)[column]
    return "\n".join(values).encode() if column == "series" else values.to_numpy().tobytes()


__all__ = ["HOUR", "START", "STEP", "Feed", "Site", "pieces", "ring", "simulate", "watched"]
