"""The daemon as a process: fed over Zenoh, killed, restarted; the same verdicts as a replay."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from fdd.plant.faults import DAY, PlantFault
from fdd.plant.scenario import Scenario
from fdd.plant.site import plant_source
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import iso
from fdd.service.site.site_context import open_site
from fdd.service.verbs.demo import Prepared, prepare, publish, start_daemon

LEARNING_DAYS = 6.0


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    """A plant whose exchanger is fouled from the second watched day on, with baselines fitted."""
    fault = PlantFault("fouling", "hx", (LEARNING_DAYS + 1) * DAY, 0.3)
    scenario = Scenario(days=LEARNING_DAYS + 3, seed=4, faults=(fault,))
    return prepare(scenario, tmp_path_factory.mktemp("demo"), learning_days=LEARNING_DAYS, probation_days=0)


def verdicts_of_run(prepared: Prepared, folder: Path, kills: list[float]) -> list[str]:
    """Stream everything into a daemon that is killed after each of these seconds; every verdict it left, as lines."""
    shutil.copytree(prepared.site_file.parent, folder)
    site_file = folder / prepared.site_file.name
    own = replace(prepared, site_file=site_file, context=open_site(site_file))
    with publish(own):
        for seconds in kills:
            daemon = start_daemon(own)
            time.sleep(seconds)
            daemon.kill()
            daemon.wait()
        code = start_daemon(own).wait(timeout=120)
    assert code == 0, (folder / "daemon.log").read_text()
    return stored_verdicts(own)


def stored_verdicts(prepared: Prepared) -> list[str]:
    """What the store holds, one line a verdict, in the form of `fdd replay --verdicts`."""
    store = prepared.context.store(read_only=True)
    table = store.read("charts")
    # The store holds the words beside the verdict, for dashboards.
    alarms = [{key: value for key, value in a.items() if key != "summary"} for a in store.list("alarm")]
    store.close()
    columns = (table[c] for c in ("time", "series", "phase", "statistic", "limit"))
    charts = [
        json.dumps({"time": iso(t), "chart": c, "phase": Phase(int(p)).name.lower(), "statistic": s, "limit": h})
        for t, c, p, s, h in zip(*columns, strict=True)
    ]
    return sorted(charts) + sorted(json.dumps({"alarm": a}) for a in alarms)


def verdicts_of_replay(prepared: Prepared, folder: Path) -> list[str]:
    """The same plant replayed by `fdd replay`; alarms as they stand at the end."""
    shutil.copytree(prepared.site_file.parent, folder)
    site_file = folder / prepared.site_file.name
    yaml = YAML()
    site = yaml.load(site_file)
    site["sources"] = [plant_source(prepared.scenario)]
    yaml.dump(site, site_file)
    out = folder / "verdicts.jsonl"
    first = iso(int(prepared.batches[0].time[0]))
    command = [sys.executable, "-m", "fdd", "replay", str(site_file), "--from", first, "--verdicts", str(out)]
    # Once to compile: code fresh from the compiler and code from its cache may differ in a last bit.
    for _ in range(2):
        subprocess.run(command, check=True, capture_output=True, timeout=200)
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    alarms = {line["alarm"]["key"]: line for line in lines if "alarm" in line}
    return sorted(json.dumps(x) for x in lines if "chart" in x) + sorted(json.dumps(a) for a in alarms.values())


def test_run_and_replay_give_the_same_bytes_and_a_killed_daemon_loses_and_doubles_nothing(
    prepared: Prepared, tmp_path: Path
) -> None:
    replayed = verdicts_of_replay(prepared, tmp_path / "replay")
    undisturbed = verdicts_of_run(prepared, tmp_path / "undisturbed", [])
    assert any('"component": "hx"' in line for line in undisturbed)
    assert replayed == undisturbed
    kills = np.random.default_rng(1).uniform(1.0, 3.0, size=4).tolist()
    assert verdicts_of_run(prepared, tmp_path / "killed", kills) == undisturbed
