"""A site without history records, fits when it has enough, and then watches; what is added later does the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fdd.service.baselines.learn import learn_site
from fdd.service.daemon.checkpoint import Checkpoint
from fdd.service.daemon.daemon import Daemon
from fdd.service.daemon.ready import ready_engine
from fdd.service.daemon.schedule import JobRunner, learning_job
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import open_site
from fdd.service.verbs.status import read_status
from tests.service.conftest import Truth, simulate
from tests.service.test_study import DAY, SITE


def site(folder: Path, rooms: tuple[str, ...] = ("south", "north")) -> Path:
    path = folder / "site.yaml"
    text = SITE.replace("step: 5 min", "step: 5 min\nfirst_fit: 10 d")
    if "north" not in rooms:
        text = text[: text.index("  north:")]
    path.write_text(text)
    return path


class Running:
    """A daemon on a site, fed by hand."""

    def __init__(self, path: Path) -> None:
        self.path, self.context = path, open_site(path)
        self.store = self.context.store()
        self.checkpoint = Checkpoint(self.context.checkpoint_path)
        self.daemon = Daemon(ready_engine(self.context, learning=True), self.store, self.checkpoint)

    def take(self, truth: Truth, start: int, stop: int) -> None:
        for at in range(start, stop, 500):
            batch = truth.batch(at, min(at + 500, stop))
            self.daemon._take(batch)
        self.daemon.save()

    def look(self) -> None:
        """What the daemon does every few seconds, and what its service does then."""
        self.daemon._poll_baselines()
        if self.daemon.reload_wanted:
            self.daemon.adopt(ready_engine(self.context, learning=True), JobRunner([], self.path.parent))

    @property
    def watched(self) -> list[str]:
        return [c.name for c in self.daemon.engine.watched]

    def close(self) -> None:
        self.daemon._tell()
        self.checkpoint.close()
        self.store.close()


def test_it_records_says_how_far_it_is_fits_and_watches(tmp_path: Path) -> None:
    truth = simulate(18 * DAY, 5, loss=900.0, onset=13 * DAY)
    running = Running(site(tmp_path))
    assert running.watched == []
    running.take(truth, 0, 4 * DAY)
    first = {learned.component: learned for learned in learn_site(running.path)}
    assert first["south"].days == pytest.approx(4.0, abs=0.05)
    assert first["south"].outcome == ""
    assert running.daemon.engine.realised_rate["years"] == 0.0  # nothing was watched, so nothing was promised
    running.take(truth, 4 * DAY, 12 * DAY)
    assert {learned.outcome for learned in learn_site(running.path)} == {"fitted, in force"}
    assert learn_site(running.path) == []
    running.look()
    assert running.watched == ["south", "north"]
    running.take(truth, 12 * DAY, 18 * DAY)
    assert {a.component for a in running.daemon.engine.alarms.open} == {"south"}
    running.close()


def test_status_says_how_far_it_is(tmp_path: Path) -> None:
    running = Running(site(tmp_path))
    running.take(simulate(3 * DAY, 5), 0, 3 * DAY)
    learn_site(running.path)
    running.close()
    (south, _) = sorted(read_status(running.path)["learning"], key=lambda d: d["component"] != "south")
    assert south["needed"] == 10.0
    assert south["days"] == pytest.approx(3.0, abs=0.05)


def test_equipment_that_is_added_later_does_the_same_and_alarms_stay(tmp_path: Path) -> None:
    truth = simulate(16 * DAY, 5, loss=900.0, onset=12 * DAY)
    running = Running(site(tmp_path, ("south",)))
    running.take(truth, 0, 11 * DAY)
    learn_site(running.path)
    running.look()
    running.take(truth, 11 * DAY, 14 * DAY)
    assert [a.component for a in running.daemon.engine.alarms.open][:1] == ["south"]
    running.close()
    site(tmp_path)
    again = Running(tmp_path / "site.yaml")
    again.daemon.recover()
    learn_site(again.path)
    again.look()
    assert again.watched == ["south", "north"]
    assert "south" in [a.component for a in again.daemon.engine.alarms.open]
    again.take(truth, 14 * DAY, 16 * DAY)
    again.close()


def test_a_replay_of_a_site_without_baselines_still_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="fit them to a healthy history first"):
        ready_engine(open_site(site(tmp_path)))


def test_the_job_is_one_that_the_program_understands(tmp_path: Path) -> None:
    job = learning_job(open_site(site(tmp_path)).site, tmp_path / "site.yaml")
    assert job.arguments[0] == "learn"
    assert json.dumps(job.arguments)
