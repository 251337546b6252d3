"""Make the two pictures of measured.md: ``python docs/models/faults/plots.py`` (needs the measured pipes)."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np

from benchmarks.component_cases import CASES, experiment
from benchmarks.component_studies import _pipe_record
from fdd.greybox.fit import fit
from fdd.greybox.simulate import simulate
from fdd.models.registry import get_model

mpl.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent
SHARED = Path(os.environ.get("FDD_SHARED", HERE.parents[3] / "shared"))


def pipes() -> None:
    """Fitted to the first run, simulated on all."""
    model = get_model("pipe_thermal", compartments=12)
    files = sorted((SHARED / "data" / "modelica_pipe").glob("PipeDataULg*.mos"))
    records = {f.stem.removeprefix("PipeDataULg"): _pipe_record(f, model) for f in files}
    first = next(iter(records))
    found = fit(model, records[first], start={"C": 4.5e5}, errors="fisher")
    figure, axes = plt.subplots(2, 3, figsize=(11, 6), constrained_layout=True)
    for axis, (name, record) in zip(axes.flat, records.items(), strict=True):
        simulated = simulate(found, record)[:, 0]
        axis.plot(record.t, record.u[:, 0], color="0.7", label="inlet, measured")
        axis.plot(record.t, record.y[:, 0], "k.", ms=3, label="outlet, measured")
        axis.plot(record.t, simulated, "C3", label="outlet, simulated")
        off = np.sqrt(np.mean((record.y[:, 0] - simulated) ** 2))
        axis.set_title(f"{name}{' (fitted)' if name == first else ''}: {off:.2f} K rms", fontsize=9)
        axis.set(xlabel="time [s]", ylabel="temperature [degC]")
    axes[0, 0].legend(fontsize=7)
    figure.savefig(HERE / "measured-pipe.png", dpi=80)


def threshold() -> None:
    """Profile likelihood of the threshold's centre, true centre Re 2130."""
    model, record, _ = experiment(replace(CASES["pipe_hydraulic"], rows=3000), 3)
    free = fit(model, record, errors="observed")
    grid = free.params["Re_t"] + free.bse["Re_t"] * np.linspace(-4, 4, 13)
    rise = [free.llf - fit(model, record, start=free, fixed={"Re_t": c}, errors="fisher").llf for c in grid]
    figure, axis = plt.subplots(figsize=(5.5, 3.6), constrained_layout=True)
    axis.plot(grid, rise, "k.-")
    axis.axhline(1.92, color="0.6", ls="--", lw=1)
    axis.axvline(2130, color="C3", lw=1)
    axis.set(xlabel="centre of the threshold, Re", ylabel="rise of the negative log-likelihood")
    figure.savefig(HERE / "pipe-threshold.png", dpi=90)


if __name__ == "__main__":
    pipes()
    threshold()
