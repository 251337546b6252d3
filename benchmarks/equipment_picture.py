"""The picture of ``docs/equipment.md``: one faulty day as a technician would draw it.

python -m benchmarks.equipment_picture    # needs the shared records
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from benchmarks.equipment_days import SETS, folder

mpl.use("Agg")
import matplotlib.pyplot as plt

DAY = "2007-08-29"
PAGE = Path(__file__).resolve().parents[1] / "docs" / "images" / "equipment-day.png"
LINES = {
    "Mixed Air Temperature": ("mixed air", "C3"),
    "Supply Air Temperature": ("supply air", "C0"),
    "Supply Air Temperature Set Point": ("set point", "0.5"),
    "Return Air Temperature": ("return air", "C2"),
    "Outdoor Air Temperature": ("outdoor air", "C8"),
}


def draw(path: Path = PAGE) -> None:
    """Temperatures above, commands below, and where the row applied."""
    table = pd.read_csv(folder() / SETS["MZVAV-2-1"])
    table.columns = pd.Index([c.strip().removeprefix("AHU: ") for c in table.columns])
    time = pd.to_datetime(table["Datetime"])
    day = table[time.dt.strftime("%Y-%m-%d") == DAY]
    hour = (time[day.index] - pd.Timestamp(DAY)).dt.total_seconds() / 3600
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9, 5.5), sharex=True, height_ratios=(2, 1), constrained_layout=True
    )
    for column, (label, colour) in LINES.items():
        celsius = (day[column].where(day[column] > 0) - 32) / 1.8
        above.plot(hour, celsius, color=colour, lw=1.2, label=label)
    for column, label in (("Cooling Coil Valve", "cooling valve"), ("Heating Coil Valve", "heating valve")):
        below.plot(hour, 100 * day[f"{column} Control Signal"], lw=1.2, label=label)
    below.plot(hour, 100 * day["Supply Air Fan Status"], color="0.7", lw=1.0, label="fan runs")
    stopped = hour[day["Supply Air Fan Status"] == 0]
    first = float(stopped[stopped > 12].min())
    for axis in (above, below):
        axis.axvspan(first, 24, color="C3", alpha=0.08)
        axis.legend(loc="upper left", fontsize=8, ncols=2)
    above.annotate("both valves shut, the fan stands", (first + 0.3, 11), fontsize=8)
    above.set_ylabel("degC")
    below.set_ylabel("%")
    below.set_xlabel("hour of the day")
    below.set_xlim(0, 24)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw()
