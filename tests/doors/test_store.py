"""A store whose file goes away under the running service: it is missed, said, and gone on without."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from fdd.service.baselines.versions import in_force
from tests.doors.daemons import Feed, Site, pieces, ring, simulate, watched


@pytest.mark.parametrize("how", ["deleted", "replaced"])
def test_a_store_that_is_gone_is_begun_anew_with_baselines_alarms_and_the_rows_since_the_checkpoint(
    tmp_path: Path, how: str
) -> None:
    truth, site = simulate(200, seed=1), Site(tmp_path)
    daemon = site.start(save_every=1000)
    key = ring(daemon)
    daemon.run(Feed(pieces(truth, 0, 100)))  # type: ignore[arg-type]
    before = watched(site.store)
    if how == "replaced":
        shutil.copy(tmp_path / "fdd.sqlite", tmp_path / "other")
    (tmp_path / "fdd.sqlite").unlink()
    if how == "replaced":
        (tmp_path / "other").rename(tmp_path / "fdd.sqlite")
    daemon.run(Feed())  # type: ignore[arg-type]
    assert (tmp_path / "fdd.sqlite").exists()
    assert watched(site.store) == before
    assert set(in_force(site.store, ["south", "north"])) == {"south", "north"}
    (alarm,) = daemon.engine.alarms.open
    assert site.store.get("alarm", key)["state"] == str(alarm.state)  # type: ignore[index]
    status = daemon.status()
    assert how in status["mishaps"][0]
    assert [p["what"] for p in status["problems"]] == ["store"]
    daemon.run(Feed(pieces(truth, 100, 200)))  # type: ignore[arg-type]
    assert watched(site.store) != before
    site.stop()
