"""Day-wise verdicts of ``fdd replay`` on the shared air-handler records, by a site file as a stranger writes it.

Normal days are judged by baselines that have not seen them. Columns that give labels away (how long the fan ran, the
duct pressure of a simulator) are in no site file; how far the fan's hours alone would come stands beside.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
from rich.console import Console

from fdd.records import Alarm
from fdd.service.baselines.fitting import fit_site
from fdd.service.verbs.replay import replay_site

SETS = {"MZVAV-2-1": "lbnl_mzvav_2_1.csv.gz", "MZVAV-2-2": "lbnl_mzvav_2_2.csv.gz"}
PLACES = {"HC valve": "heating", "CC valve": "cooling", "OA damper": "outdoor air damper"}
RAN = 13.0
"""Hours of the fan from which the trivial rule calls a day faulty."""
QUIET = Console(quiet=True)

SITE = """
name: Test rig
step: 1 min
false_alarms_per_year: 2
source: {kind: csv, path: day.csv, time: {column: Datetime}}
points:
  SAT: {column: "AHU: Supply Air Temperature", unit: degF, missing: [0]}
  SATSP: {column: "AHU: Supply Air Temperature Set Point", unit: degF}
  OAT: {column: "AHU: Outdoor Air Temperature", unit: degF}
  MAT: {column: "AHU: Mixed Air Temperature", unit: degF, missing: [0]}
  RAT: {column: "AHU: Return Air Temperature", unit: degF, missing: [0]}
  on: {column: "AHU: Supply Air Fan Status"}
  speed: {column: "AHU: Supply Air Fan Speed Control Signal"}
  OAD: {column: "AHU: Outdoor Air Damper Control Signal"}
  CCV: {column: "AHU: Cooling Coil Valve Control Signal"}
  HCV: {column: "AHU: Heating Coil Valve Control Signal"}
equipment:
  AHU:
    model: air_handler
    inputs: {T_supply: SAT, T_supply_set: SATSP, T_out: OAT, T_mixed: MAT, T_return: RAT, fan: speed, fan_status: on,
             damper: OAD, cool: CCV, heat: HCV}
"""


@dataclass(frozen=True)
class Judged:
    """One day: its truth, the first finding's likeliest cause with its probability, and the fan's hours."""

    day: str
    fault: str
    cause: str
    probability: float
    fan_hours: float

    @property
    def rang(self) -> bool:
        """Whether there was any finding."""
        return bool(self.cause)

    @property
    def right(self) -> bool:
        """Whether the cause sits where the fault is."""
        place = next((p for word, p in PLACES.items() if self.fault.startswith(word)), "?")
        return self.cause.startswith(place)


def folder() -> Path:
    """The shared records, outside the project."""
    return Path(os.environ.get("FDD_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "data"


def judged_days(name: str, trained: bool, quick: bool = False) -> list[Judged]:
    """Every day of one set whose truth is certain, each replayed by itself.

    Parameters
    ----------
    trained : a baseline is fitted to the normal days, without the one that is judged
    """
    table, truth = _table(name), _truth(name)
    normal = [d for d in truth.index if truth.fault[d] == "normal"]
    days = list(truth.index)[:: 3 if quick else 1]
    found = []
    with TemporaryDirectory() as scratch:
        place = Path(scratch)
        baseline: tuple[str, ...] = ()
        for day in sorted(days, key=lambda d: d in normal):
            known = tuple(d for d in normal if d != day) if trained else ()
            if known != baseline:
                _fit(place, table, known)
                baseline = known
            found.append(_judge(place, table, day, str(truth.fault[day])))
    return sorted(found, key=lambda j: j.day)


def _table(name: str) -> pd.DataFrame:
    table = pd.read_csv(folder() / SETS[name])
    table.columns = pd.Index([c.strip() for c in table.columns])
    time = pd.to_datetime(table["Datetime"])
    return table.assign(Datetime=time.dt.strftime("%Y-%m-%d %H:%M"), day=time.dt.strftime("%Y-%m-%d"))


def _truth(name: str) -> pd.DataFrame:
    """Days by date with their fault; what the inventory leaves open is left out."""
    truth = pd.read_csv(folder() / "lbnl_days.csv").query("dataset == @name").set_index("day")
    return truth[~truth.note.fillna("").str.contains("not in the inventory")]


def _write(table: pd.DataFrame, days: Sequence[str], path: Path) -> None:
    table[table.day.isin(days)].drop(columns=["day", "Fault Detection Ground Truth"]).to_csv(path, index=False)


def _fit(place: Path, table: pd.DataFrame, days: Sequence[str]) -> None:
    for old in place.glob("*.sqlite*"):
        old.unlink()
    (place / "site.yaml").write_text(SITE)
    _write(table, days, place / "normal.csv")
    fit_site(
        place / "site.yaml", place / "normal.csv", since=None, until=None, only=None, html=None, starts=1, console=QUIET
    )


def _judge(place: Path, table: pd.DataFrame, day: str, fault: str) -> Judged:
    (place / "site.yaml").write_text(SITE)
    _write(table, [day], place / "day.csv")
    got = replay_site(place / "site.yaml", None, since=None, until=None, verdicts=None, console=QUIET)
    alarms: list[Alarm] = list(got.alarms.values())
    first = alarms[0].causes[0] if alarms else {"name": "", "likelihood": 0.0}
    hours = float((table[table.day == day]["AHU: Supply Air Fan Status"] > 0).sum()) / 60
    return Judged(day, fault, str(first["name"]), float(first["likelihood"]), hours)
