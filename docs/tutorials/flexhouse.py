"""From a raw CSV of a real building to a validated model: python docs/tutorials/flexhouse.py RECORD.csv FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fdd import Data
from fdd.greybox.inference import forward_selection, profile
from fdd.greybox.plots import profile as plot_profile
from fdd.greybox.plots import write_html
from fdd.greybox.validate import validate
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

    name, result = selection.chosen
    print(f"\nselected: {name}\n{result.summary()}\n\n{result.trials_table()}\n")
    folder.mkdir(parents=True, exist_ok=True)
    validation = validate(result)
    print(validation.table())
    write_html(validation, folder / "validation.html")
    # The window area is well determined: its profile is a parabola.
    plot_profile(profile(result, "A_w", points=4)).savefig(folder / "profile.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
