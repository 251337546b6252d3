"""From a raw CSV of a real building to a validated model: python docs/tutorials/flexhouse.py RECORD.csv FOLDER."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fdd import Data
from fdd.greybox.inference import forward_selection, profile
from fdd.greybox.plots import diagnostics, write_html
from fdd.greybox.plots import profile as plot_profile
from fdd.greybox.validate import Validation, validate
from fdd.models.zone import zone


def main(record: Path, folder: Path) -> None:
    """Read, select, validate, plot."""
    rows = np.genfromtxt(record, delimiter=",", skip_header=1, usecols=range(5))
    # Columns: t [h], outdoor [degC], sun [kW/m2], heater [kW], indoor [degC]; SI from here on.
    data = Data(rows[:, 0] * 3600, rows[:, 1:4] * [1, 1e3, 1e3], rows[:, 4], name="FlexHouse")

    names = ["Ti", "TiTe", "TiTh", "TiTeTh"]
    models = {name: zone(name) for name in names}  # type: ignore[arg-type]
    larger = {"Ti": ["TiTe", "TiTh"], "TiTe": ["TiTeTh"], "TiTh": ["TiTeTh"]}
    selection = forward_selection(models, larger, data, first="Ti", starts=12, seed=1)
    print(selection.table())

    folder.mkdir(parents=True, exist_ok=True)
    raw(data).savefig(folder / "flexhouse-data.png", dpi=80)
    validations = {name: validate(result) for name, result, _ in selection.path}
    periodograms(validations).savefig(folder / "flexhouse-periodograms.png", dpi=80)

    name, result = selection.chosen
    print(f"\nselected: {name}\n{result.summary()}\n\n{result.trials_table()}\n")
    print(validations[name].table())
    write_html(validations[name], folder / "validation.html")
    diagnostics(validations[name]).savefig(folder / "flexhouse-residuals.png", dpi=70)
    # The window area is well determined: its profile is a parabola.
    plot_profile(profile(result, "A_w")).savefig(folder / "flexhouse-profile.png", dpi=80)


def raw(data: Data) -> Figure:
    """What was measured."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    names = ("indoor [degC]", "outdoor [degC]", "sun [W/m2]", "heater [W]")
    for a, name, values in zip(axes, names, (data.y[:, 0], *data.u.T), strict=True):
        a.plot(data.t / 3600, values, lw=0.8)
        a.set_ylabel(name)
    axes[-1].set_xlabel("time [h]")
    return figure


def periodograms(validations: Mapping[str, Validation]) -> Figure:
    """Cumulated periodograms of the residuals of each model on the path: white ones stay within the band."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    axes = figure.subplots(1, len(validations), sharey=True)
    for a, (name, v) in zip(axes, validations.items(), strict=True):
        curve = v.curves["T_room"]
        a.plot(curve["frequency"], curve["cumulated"])
        for band in (-curve["ks"], curve["ks"]):
            a.plot(curve["frequency"], 2 * curve["frequency"] + band, color="C3", lw=0.7, ls="--")
        a.set(title=name, xlabel="cycles a sample", ylim=(0, 1))
    return figure


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
