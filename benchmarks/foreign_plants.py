"""Plants that no model of the project has drawn: made by their own scripts, ready for ``fdd``.

    python -m benchmarks.foreign_plants --foreign DIR --to FOLDER --sets house-dev house-report substation-dev

One run of a script makes a few plants side by side: a site of several houses with a budget each. Every such site gets a
folder for each case: ``healthy`` over the heating season and spring, and shorter twins with one fault each, which equal
the healthy rows until the fault begins. Which effects are on is drawn by a seeded generator for each site, and stands
in its ``truth.json``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import track

START = "2025-11-01"
ONSET = 63.0  # day of a fault's beginning: four weeks to fit, four to calibrate, one watched
# Off and on are drawn with this chance, each effect by itself.
SWITCHED = 0.25


@dataclass(frozen=True)
class Case:
    """What a run of the script makes: ``days`` of plant, a fault of ``severity`` that grows over ``ramp`` days."""

    name: str
    fault: str
    severity: float
    days: float
    ramp: float = 0.0


@dataclass(frozen=True)
class Kind:
    """A script and what is asked of it; ``together`` plants share a run and the effects that are on."""

    script: str
    prefix: str
    together: int
    cases: tuple[Case, ...]
    on: tuple[str, ...]
    off: tuple[str, ...]


HOUSE = Kind(
    "make_house.py",
    "h",
    4,
    (
        Case("healthy", "none", 0.0, 212),
        Case("heater-20", "heater", 0.2, 96),
        Case("heater-10", "heater", 0.1, 96),
        Case("insulation-20", "insulation", 0.2, 96),
        Case("bias", "bias", 0.5, 96),
        Case("window", "window", 1.0, 96),
    ),
    ("wind", "facades", "people", "airing", "blinds", "radiator", "controller", "layers", "mass", "losses", "jitter"),
    ("stove", "neighbour", "ground", "sky", "holiday", "pulses", "moisture", "hunting", "coarse"),
)
SUBSTATION = Kind(
    "make_substation.py",
    "s",
    5,
    (
        Case("healthy", "none", 0.0, 130),
        Case("fouling-20", "fouling", 0.2, 95, ramp=10.0),
        Case("mixing-leak", "mixing-leak", 0.1, 84),
        Case("bias", "bias", 0.8, 84),
    ),
    ("maldistribution", "viscosity", "pipes", "lag", "rounding", "pulses", "network", "deadband", "night", "losses"),
    ("hot-water", "glycol", "pump-stop", "stratified", "slow-meter", "pressure-pump", "second-sensor"),
)
SETS = {
    "house-dev": (HOUSE, range(1, 21)),
    "house-report": (HOUSE, range(101, 121)),
    "substation-dev": (SUBSTATION, range(201, 211)),
    "substation-report": (SUBSTATION, range(301, 311)),
}


def effects(kind: Kind, seed: int) -> tuple[list[str], list[str]]:
    """Effects that a group of plants does without, and further ones that it has; ``seed`` is the group's first."""
    rng = np.random.default_rng([seed, 15])
    without = [e for e in kind.on if rng.random() < SWITCHED]
    return without, [e for e in kind.off if rng.random() < SWITCHED]


def groups(kind: Kind, seeds: Sequence[int]) -> Iterator[Sequence[int]]:
    """Seeds that one run of the script makes together."""
    for start in range(0, len(seeds), kind.together):
        yield seeds[start : start + kind.together]


def folder_of(to: Path, kind: Kind, seeds: Sequence[int]) -> Path:
    """Folder of a group of plants; under it there is one for each case."""
    return to / f"{kind.prefix}{seeds[0]}-{seeds[-1]}"


def make(foreign: Path, kind: Kind, seeds: Sequence[int], case: Case, to: Path) -> None:
    """Run the script for one case of a group, unless it is there."""
    folder = folder_of(to, kind, seeds) / case.name
    if folder.exists():
        return
    without, further = effects(kind, seeds[0])
    part = folder.with_suffix(".part")
    command = [
        *(sys.executable, str(foreign / kind.script), "--seed", str(seeds[0]), "--count", str(len(seeds))),
        *("--start", START, "--days", str(case.days), "--without", ",".join(without), "--with", ",".join(further)),
        *("--fault", case.fault, "--severity", str(case.severity), "--onset", str(min(ONSET, case.days - 1))),
        *("--ramp", str(case.ramp), "--out", str(part)),
    ]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    part.rename(folder)


def make_sets(foreign: Path, to: Path, names: Sequence[str], only: Sequence[str] = ()) -> None:
    """Every plant of these sets that is not there yet; ``only`` names cases."""
    tasks = [
        (kind, list(group), case)
        for kind, seeds in (SETS[n] for n in names)
        for group in groups(kind, seeds)
        for case in kind.cases
        if not only or case.name in only
    ]
    for kind, group, case in track(tasks, "making plants"):
        make(foreign, kind, group, case, to)


def main() -> None:
    """Make the sets asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--foreign", type=Path, default=Path("../shared/foreign"), help="folder of the scripts")
    parser.add_argument("--to", type=Path, default=Path("var/promise"), help="folder that the plants go to")
    parser.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    parser.add_argument("--cases", nargs="+", default=[], help="only these cases, such as healthy")
    given = parser.parse_args()
    make_sets(given.foreign, given.to, given.sets, given.cases)


if __name__ == "__main__":
    main()
