"""The two pictures of measured.md: ``PYTHONPATH=. python docs/models/faults/plots.py``; needs the measured pipes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

from benchmarks import measured_pipes
from benchmarks.component_cases import CASES, experiment
from fdd.greybox.fit import fit
from fdd.greybox.inference import profile
from fdd.greybox.simulate import simulate

mpl.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent


def pipes() -> None:
    """Every run simulated by the model that was fitted to the other five."""
    runs = measured_pipes.load(False)
    figure, axes = plt.subplots(2, 3, figsize=(11, 6), constrained_layout=True)
    for axis, (name, run) in zip(axes.flat, runs.items(), strict=True):
        found = measured_pipes.fitted(False, tuple(n for n in runs if n != name))
        record, simulated = run.record, simulate(found, run.record)[:, 0]
        axis.plot(record.t, record.u[:, 0], color="0.7", label="inlet, measured")
        axis.plot(record.t, record.y[:, 0], "k.", ms=3, label="outlet, measured")
        axis.plot(record.t, simulated, "C3", label="outlet, simulated")
        off = measured_pipes.judged(found, False, name).error
        axis.set_title(f"{name}, {record.u[0, 1]:.2f} kg/s: {off:.2f} K rms", fontsize=9)
        axis.set(xlabel="time [s]", ylabel="temperature [degC]")
    axes[0, 0].legend(fontsize=7)
    figure.savefig(HERE / "measured-pipe.png", dpi=80)


def threshold() -> None:
    """Profile likelihood of the threshold's centre, true centre Re 2130."""
    model, record, _ = experiment(replace(CASES["pipe_hydraulic"], rows=3000), 3)
    free = fit(model, record, errors="observed")
    found = profile(free, "Re_t")
    figure, axis = plt.subplots(figsize=(5.5, 3.6), constrained_layout=True)
    axis.plot(found.values, found.drop, "k.-")
    axis.axhline(found.threshold, color="0.6", ls="--", lw=1)
    axis.axvline(2130, color="C3", lw=1)
    axis.set(xlabel="centre of the threshold, Re", ylabel="twice the loss of log-likelihood")
    figure.savefig(HERE / "pipe-threshold.png", dpi=90)


if __name__ == "__main__":
    threshold()
    pipes()
