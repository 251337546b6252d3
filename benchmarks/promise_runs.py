"""One site through the commands as a stranger types them: fit, audit at each budget, audit of every faulty twin.

What a command prints as JSON is kept in the site's folder; a command whose answer is there is not run again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from benchmarks.foreign_plants import ONSET, SETS, START, folder_of, groups, make
from fdd.plant.scenario import Scenario
from fdd.plant.site import demo_site

Json = dict[str, Any]

LEARNING = 56  # days: four weeks to fit, four to calibrate; two thirds of a record that is shorter than three times so
WARM = 7  # days before a fault from which its twin is watched: it is the healthy plant until then
OWN = range(1, 6)
OWN_DAYS = LEARNING + 182


@dataclass(frozen=True)
class Plant:
    """A site to run: its file, healthy data (None: its own source), end of the fit, faulty twins and their begin.

    ``plants`` are those that the site has, each with a budget of its own; a component is named after its plant.
    """

    group: str
    name: str
    site: Path
    data: Path | None
    until: str
    plants: tuple[str, ...]
    twins: tuple[tuple[str, Path], ...] = ()
    since: str = ""


def foreign(to: Path, group: str, seeds: Sequence[int]) -> Iterator[Plant]:
    """The sites of a set that are made, in order."""
    kind = SETS[group][0]
    for together in groups(kind, seeds):
        folder = folder_of(to, kind, together)
        healthy = folder / "healthy"
        if healthy.exists():
            twins = tuple((c.name, folder / c.name / "data.csv") for c in kind.cases if c.fault != "none")
            until, since = _day(START, LEARNING), _day(START, ONSET - WARM)
            names = tuple(f"{kind.prefix}{s}" for s in together)
            yield Plant(group, folder.name, healthy / "site.yaml", healthy / "data.csv", until, names, twins, since)


def real(folder: Path) -> list[Plant]:
    """Every site file of the shared records; fitted to eight weeks, or to two thirds of a shorter record."""
    found = []
    for site in sorted((folder / "sites").glob("*.yaml")):
        source = yaml.safe_load(site.read_text())["source"]
        data = (site.parent / source["path"]).resolve()
        time = pd.to_datetime(pd.read_csv(data, usecols=[source["time"]["column"]]).iloc[:, 0], utc=True)
        days = min(LEARNING, 2 * (time.iloc[-1] - time.iloc[0]).days // 3)
        until = _day(str(time.iloc[0].date()), days)
        found.append(Plant("real", site.stem, site, data, until, (site.stem,)))
    return found


def own(to: Path) -> list[Plant]:
    """Houses of the project's own simulator, healthy."""
    found = []
    for seed in OWN:
        scenario = Scenario(days=OWN_DAYS, seed=seed)
        folder = to / f"own{seed}"
        site = demo_site(folder, name=folder.name, scenario=scenario)
        found.append(Plant("own", folder.name, site, None, _day(scenario.start[:10], LEARNING), (folder.name,)))
    return found


def _day(start: str, days: float) -> str:
    return str((pd.Timestamp(start) + pd.Timedelta(days=days)).date())


def run(plant: Plant, to: Path, budgets: Sequence[float], faults: Sequence[str]) -> Json:
    """Every command of a plant; an answer that is an error says so under ``error``."""
    folder = to / plant.name
    folder.mkdir(parents=True, exist_ok=True)
    sites = {b: _site(plant, folder, b) for b in budgets}
    first = sites[budgets[0]]
    data = [] if plant.data is None else [str(plant.data.resolve())]
    answers: Json = {"group": plant.group, "name": plant.name, "plants": plant.plants}
    answers["fit"] = _fdd(folder, "fit", "fit", str(first), *data, "--until", plant.until)
    if "error" in answers["fit"]:
        return answers
    for budget, site in sites.items():
        answers[f"audit-{budget:g}"] = _fdd(
            folder, f"audit-{budget:g}", "audit", str(site), *data, "--from", plant.until
        )
    for fault, twin in plant.twins:
        if fault in faults and twin.exists():
            answers[fault] = _fdd(folder, fault, "audit", str(first), str(twin.resolve()), "--from", plant.since)
    return answers


def _site(plant: Plant, folder: Path, budget: float) -> Path:
    """The site file at a budget; its source's path and its store stay what they are beside the first."""
    table = yaml.safe_load(plant.site.read_text())
    table["false_alarms_per_year"] = budget * len(plant.plants)
    if plant.data is not None and "source" in table:
        table["source"]["path"] = str(plant.data.resolve())
    path = folder / f"site-{budget:g}.yaml"
    path.write_text(yaml.safe_dump(table, sort_keys=False))
    return path


def _fdd(folder: Path, name: str, *words: str) -> Json:
    answer = folder / f"{name}.json"
    if answer.exists():
        return dict(json.loads(answer.read_text()))
    command = [sys.executable, "-m", "fdd", *words, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "COLUMNS": "1000"})
    if done.returncode:
        found: Json = {"error": done.stderr.strip().replace("\n", " ")[-600:], "command": " ".join(words)}
    else:
        found = json.loads(done.stdout)
    part = answer.with_suffix(".part")
    part.write_text(json.dumps(found))
    part.rename(answer)
    return found


def plants(given: Any) -> Iterator[Plant]:
    """All plants asked for; foreign ones are made where they are missing."""
    for group in given.sets:
        if group in SETS:
            if not given.foreign.is_dir():
                print(f"{group}: skipped, {given.foreign} is not there", file=sys.stderr)
                continue
            kind, seeds = SETS[group]
            chosen = list(seeds)[: given.plants]
            for together in groups(kind, chosen):
                for case in kind.cases:
                    if case.name in {"healthy", *given.faults}:
                        make(given.foreign, kind, together, case, given.made)
            yield from foreign(given.made, group, chosen)
        elif group == "real":
            if not given.real.is_dir():
                print(f"real: skipped, {given.real} is not there", file=sys.stderr)
                continue
            yield from real(given.real)
        else:
            yield from own(given.to)
