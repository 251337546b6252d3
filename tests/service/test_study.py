"""``fdd study`` and all that works on it afterwards without a daemon, on rooms whose truth is simulated apart."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner, Result

from fdd.cli import app
from fdd.records import JsonObject
from fdd.service.alarms.handles import handles, key_of
from fdd.service.daemon.lock import StateLock
from fdd.service.site.errors import UsageError
from fdd.service.site.site_context import open_site
from tests.service.conftest import START, simulate

ROOT = Path(__file__).resolve().parents[2]
SITE = """
name: rooms
step: 5 min
false_alarms_per_year: 2
store: {kind: sqlite, path: rooms.sqlite}
source: {kind: csv, path: rooms.csv}
points:
  outside: {unit: degC}
  sun: {unit: W/m2}
  south.heat: {unit: W}
  south.T: {unit: degC}
  north.heat: {unit: W}
  north.T: {unit: degC}
equipment:
  south:
    model: zone
    options: {nodes: Ti}
    inputs: {T_out: outside, I_solar: sun, P_heat: south.heat}
    outputs: {T_room: south.T}
  north:
    model: zone
    options: {nodes: Ti}
    inputs: {T_out: outside, I_solar: sun, P_heat: north.heat}
    outputs: {T_room: north.T}
"""
DAY = 288


def run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words), catch_exceptions=False)


def said(*words: str) -> Any:
    result = run(*words, "--json")
    assert result.exit_code in (0, 1), result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rooms, fourteen days learned and six watched; from the second of these on the south room loses 900 W."""
    folder = tmp_path_factory.mktemp("study")
    truth = simulate(20 * DAY, 5, loss=900.0, onset=15 * DAY)
    frame = pd.DataFrame(truth.points)
    frame.insert(0, "time", pd.to_datetime(truth.time, utc=True).strftime("%Y-%m-%dT%H:%M:%SZ"))
    frame.to_csv(folder / "rooms.csv", index=False, float_format="%.4f")
    (folder / "site.yaml").write_text(SITE)
    until = pd.Timestamp(START + 14 * DAY * 300 * 10**9, tz="UTC").isoformat()
    result = run("study", str(folder / "site.yaml"), "--until", until, "--out", str(folder / "report.html"),
                 "--starts", "1", "--json")  # fmt: skip
    assert result.exit_code == 0, result.output
    (folder / "study.json").write_text(result.stdout)
    return folder


@pytest.fixture
def site(studied: Path, tmp_path: Path) -> str:
    """The study's folder to oneself."""
    shutil.copytree(studied, tmp_path / "own")
    return str(tmp_path / "own" / "site.yaml")


def test_every_equipment_has_a_verdict_and_the_report_is_there(studied: Path) -> None:
    study = json.loads((studied / "study.json").read_text())
    found = {v["equipment"]: v for v in study["verdicts"]}
    assert found["south"]["outcome"] == "alarm"
    assert found["north"]["outcome"] == "quiet"
    assert "6 days watched" in found["north"]["words"]
    html = (studied / "report.html").read_text()
    assert "south" in html


def test_alarms_are_listed_explained_acknowledged_and_cleared_without_a_daemon(site: str) -> None:
    handle = said("alarms", "list", site)["alarms"][0]["handle"]
    assert handle.startswith("south.")
    assert "What rang" in run("explain", site, handle).stdout
    assert "done" in run("alarms", "ack", site, handle, "--comment", "on my way").stdout
    (one, *_) = said("alarms", "list", site)["alarms"]
    assert (one["state"], one["history"][-1]["comment"]) == ("acknowledged", "on my way")
    assert "done" in run("alarms", "clear", site, handle).stdout
    assert handle not in [a["handle"] for a in said("alarms", "list", site)["alarms"]]
    assert run("replay", site, "--store").exit_code == 0  # a study may follow a study, whatever was said between them
    assert run("report", site, "--out", str(Path(site).with_name("again.html"))).exit_code == 0


def test_status_says_that_the_run_has_ended(site: str) -> None:
    assert said("status", site)["state"] == "ended"
    assert run("status", site).exit_code == 1


def test_nothing_that_a_command_needs_is_cut_in_a_pipe(site: str) -> None:
    listed = run("alarms", "list", site).stdout
    for alarm in said("alarms", "list", site)["alarms"]:
        assert alarm["handle"] in listed
        assert alarm["summary"] in listed


def test_replay_keeps_nothing_unless_told(site: str) -> None:
    before = said("alarms", "list", site, "--all")
    assert run("replay", site).exit_code == 0
    assert said("alarms", "list", site, "--all") == before


def test_a_replay_that_is_kept_stands_in_for_the_one_before(site: str) -> None:
    """Over the healthy part alone: what an earlier run raised within it is closed; later alarms are not touched."""
    split = pd.Timestamp(START + 15 * DAY * 300 * 10**9, tz="UTC").isoformat()
    assert run("replay", site, "--store", "--until", split).exit_code == 0
    assert said("status", site)["frames"] == 15 * DAY
    assert len(said("alarms", "list", site, "--all")["alarms"]) >= 1


def test_a_study_beside_a_running_daemon_is_refused(site: str) -> None:
    lock = StateLock(open_site(Path(site)).checkpoint_path)
    with pytest.raises(UsageError, match="another daemon"):
        run("study", site)
    lock.close()


def test_a_study_never_replaces_what_a_daemon_has_come_to(site: str) -> None:
    context = open_site(Path(site))
    store = context.store()
    store.put("run", "daemon", {**(store.get("run", "daemon") or {}), "batch": False})
    store.close()
    before = context.checkpoint_path.read_bytes()
    for verb in (["study", site], ["replay", site, "--store"]):
        with pytest.raises(UsageError, match="state of this site's daemon"):
            run(*verb)
    assert context.checkpoint_path.read_bytes() == before


def test_a_split_outside_the_data_is_refused(site: str) -> None:
    with pytest.raises(UsageError, match="leaves nothing to watch: the data reach from"):
        run("study", site, "--until", "2030-01-01")


ALARMS: list[JsonObject] = [
    {"key": "hx@1", "component": "hx", "raised": 1},
    {"key": "hx@9", "component": "hx", "raised": 9},
    {"key": "ahu@5", "component": "ahu", "raised": 5},
]


def test_handles_are_the_component_and_the_number_of_its_alarm() -> None:
    assert handles(ALARMS) == {"hx@1": "hx.1", "hx@9": "hx.2", "ahu@5": "ahu.1"}


def test_an_alarm_is_meant_by_key_handle_or_component_alone() -> None:
    assert [key_of(s, ALARMS) for s in ("hx@9", "hx.2", "ahu")] == ["hx@9", "hx@9", "ahu@5"]
    with pytest.raises(UsageError, match=r"more than one alarm is meant by 'hx'; there are: hx\.1, ahu\.1, hx\.2"):
        key_of("hx", ALARMS)
    with pytest.raises(UsageError, match="no alarm is meant by 'pump'"):
        key_of("pump", ALARMS)
