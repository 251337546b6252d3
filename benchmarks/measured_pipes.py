"""Thermal pipe on measured temperature steps (University of Liege, 39 m of insulated steel), with and without a wall.

Every run is simulated by a model fitted to the other five, without any measurement of its own outlet after the first
sample. Columns of the files: time, flow, wall and water at the outlet, wall and water at the inlet.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.results import FitResult
from fdd.greybox.simulate import simulate
from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.records import FloatArray

SECTIONS = {False: 20, True: 12}
"""More sections disperse a front less; walls double the states and the time that a fit takes"""
AROUND = 18.0
"""Room temperature, not measured [degC]"""
ROWS = 200
"""Longer runs are thinned to about so many samples, a tenth of the time that the water takes or less"""
LENGTH, INSIDE, OUTSIDE = 39.0, 0.0525, 0.0603  # m, of the rig's data sheet (van der Heijde et al. 2017)
WATER = 4186.0 * 1000.0 * LENGTH * np.pi * INSIDE**2 / 4.0
STEEL = 480.0 * 7850.0 * LENGTH * np.pi * (OUTSIDE**2 - INSIDE**2) / 4.0
START: Mapping[bool, Mapping[str, float]] = {False: {"C": 4.5e5}, True: {"C": 3.5e5, "C_wall": 1e5, "B": 2e4}}


@dataclass(frozen=True)
class Run:
    """One measured step: the record, and the wall's temperature at the outlet, NaN where it was not measured."""

    record: Data
    wall: FloatArray


@dataclass(frozen=True)
class Judged:
    """A run simulated by a model that has not seen it: errors, rms [K], of the water and of the wall (not fitted)."""

    flow: float
    step: float
    error: float
    wall_error: float


def model_of(wall: bool) -> ComponentModel:
    """The pipe with one temperature a section, or with its wall's as well."""
    return get_model("pipe_thermal", compartments=SECTIONS[wall], wall=wall)


def folder() -> Path:
    """Where the measured runs are, outside the project."""
    root = Path(os.environ.get("FDD_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    return root / "data" / "modelica_pipe"


@cache
def load(wall: bool) -> dict[str, Run]:
    """All runs of the rig; empty where the data are not at hand."""
    files = sorted(folder().glob("PipeDataULg*.mos"))
    return {f.stem.removeprefix("PipeDataULg"): _run(f, len(model_of(wall).states)) for f in files}


def _run(path: Path, states: int) -> Run:
    lines = [line.strip().rstrip(";") for line in path.read_text().splitlines()]
    rows = [[float(v) for v in line.split(",")] for line in lines if re.match(r"^-?\d", line) and "," in line]
    table = np.array(rows)
    table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0])]
    table = table[:: max(1, len(table) // ROWS)]
    u = np.column_stack([table[:, 5], table[:, 1], np.full(len(table), AROUND)])
    x0 = np.full(states, table[0, 3])
    record = Data(table[:, 0], u, table[:, 3], hold="first", x0=x0, P0=np.eye(states) * 1e-4, name=path.stem)
    return Run(record, np.where(table[:, 2] == 0.0, np.nan, table[:, 2]))


def fitted(wall: bool, names: tuple[str, ...] | None = None) -> FitResult:
    """Maximum likelihood on the named runs together, by default on all."""
    runs = load(wall)
    return fit(model_of(wall), [runs[n].record for n in names or runs], start=START[wall], errors="fisher")


def judged(found: FitResult, wall: bool, name: str) -> Judged:
    """One run simulated."""
    run = load(wall)[name]
    off = run.record.y[:, 0] - simulate(found, run.record)[:, 0]
    on_wall = run.wall - wall_of(found, run.record) if wall else np.full(1, np.nan)
    known = on_wall[np.isfinite(on_wall)]
    return Judged(
        float(run.record.u[:, 1].mean()),
        float(np.ptp(run.record.y)),
        float(np.sqrt(np.mean(off**2))),
        float(np.sqrt(np.mean(known**2))) if len(known) else float("nan"),
    )


def wall_of(found: FitResult, record: Data) -> FloatArray:
    """Simulated temperature of the last section's wall, (N,)."""
    model = model_of(True)
    y = record.y.copy()
    y[1:] = np.nan
    free = Data(record.t, record.u, y, hold="first", x0=record.x0, P0=record.P0)
    return np.asarray(Likelihood(model, free).paths(found.values)[0].x[:, -1])


def cross_validated(wall: bool) -> dict[str, Judged]:
    """Every run by the model of the other five."""
    names = tuple(load(wall))
    return {n: judged(fitted(wall, tuple(m for m in names if m != n)), wall, n) for n in names}


def first_alone() -> dict[str, Judged]:
    """The other runs by a fit to the first one alone, one temperature a section."""
    first, *others = load(False)
    found = fitted(False, (first,))
    return {n: judged(found, False, n) for n in others}


def with_wall() -> tuple[FitResult, FitResult, dict[str, Judged]]:
    """Both variants fitted to the first run with as many sections, and the wall's errors on every run.

    The sensors' noise and the loss are given: the runs tell neither (see the page).
    """
    first, known = next(iter(load(True))), {"noise": 0.03, "UA": 1.0}
    wall = fit(model_of(True), load(True)[first].record, start=START[True], fixed=known, errors="fisher")
    single = get_model("pipe_thermal", compartments=SECTIONS[True])
    record = load(True)[first].record
    n = SECTIONS[True]
    short = replace(record, x0=record.x0[:n], P0=record.P0[:n, :n])
    plain = fit(single, short, start=START[False], fixed=known, errors="fisher")
    return wall, plain, {name: judged(wall, True, name) for name in load(True)}


def table(runs: Mapping[str, Judged]) -> str:
    """Markdown of the errors on runs not seen."""
    lines = ["| run | flow [kg/s] | step [K] | rms error [K] | of the step |", "|---|---|---|---|---|"]
    for name, j in runs.items():
        lines.append(f"| {name} | {j.flow:.3f} | {j.step:.1f} | {j.error:.2f} | {j.error / j.step:.1%} |")
    return "\n".join(lines)


def main() -> None:
    """One temperature a section on all runs; with ``--wall`` the wall's variant, fitted to the first run."""
    if not load(False):
        print(f"no measured pipes in {folder()}; set FDD_SHARED to the folder that holds data/modelica_pipe")
    elif "--wall" in sys.argv:
        wall, plain, runs = with_wall()
        print(dict(wall.params), dict(wall.bse), f"log-likelihood {wall.llf:.1f}, one capacity {plain.llf:.1f}")
        print(table(runs), {n: round(j.wall_error, 2) for n, j in runs.items()})
    else:
        print(table(cross_validated(False)))
        everything = fitted(False)
        print(dict(everything.params), dict(everything.bse), f"water {WATER:.0f}, steel {STEEL:.0f} J/K")


if __name__ == "__main__":
    main()
