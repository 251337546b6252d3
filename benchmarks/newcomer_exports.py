"""Ten exports as plants give them, made unlike one another from records whose units and roles are known.

Two come of the sample data that the project ships, the others of measured records beside the project, where they are
there. ``truth`` says of each export which column has which unit and plays which role.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "data"


@dataclass(frozen=True)
class Export:
    """One export in ``paths``: units of its columns, and roles: (model, role) to column; when the healthy part ends."""

    name: str
    paths: tuple[Path, ...]
    units: Mapping[str, str]
    roles: Mapping[tuple[str, str], str]
    zone: str | None = None
    until: str | None = None
    more: tuple[str, ...] = field(default_factory=tuple)


HX = {f"hx.{role}": role for role in ("T_hot_in", "T_hot_out", "T_cold_in", "T_cold_out", "m_flow_hot", "m_flow_cold")}


def _house() -> pd.DataFrame:
    return pd.read_csv(ROOT / "data" / "house_fouling.csv.gz", parse_dates=["time"])


def _shared(name: str) -> pd.DataFrame | None:
    path = SHARED / name
    return pd.read_csv(path) if path.exists() else None


def _roles(model: str, columns: Mapping[str, str]) -> dict[tuple[str, str], str]:
    return {(model, role): column for column, role in columns.items()}


def german(folder: Path) -> Export:
    """The exchanger as a German meter writes it: day first, decimal commas, title lines, local time, cp1252."""
    names = {"hx.T_hot_in": "Primär Vorlauf [°C]", "hx.T_hot_out": "Primär Rücklauf [°C]",
             "hx.T_cold_in": "Sekundär Rücklauf [°C]", "hx.T_cold_out": "Sekundär Vorlauf [°C]",
             "hx.m_flow_hot": "Primär Durchfluss [l/h]", "hx.m_flow_cold": "Sekundär Durchfluss [l/h]"}  # fmt: skip
    frame = _house()[["time", *names]].rename(columns=names)
    flows = [c for c in frame if "Durchfluss" in c]
    frame[flows] = frame[flows] * 3600.0
    local = frame.pop("time").dt.tz_convert("Europe/Berlin")
    frame.insert(0, "Datum", local.dt.strftime("%d.%m.%Y"))
    frame.insert(1, "Uhrzeit", local.dt.strftime("%H:%M"))
    path = folder / "zaehler.csv"
    body = frame.to_csv(index=False, sep=";", decimal=",", float_format="%.3f")
    path.write_bytes(("Fernwärmestation Nord\nAuswertung;;\n\n" + body).encode("cp1252"))
    units = {c: "l/h" if c in flows else "degC" for c in names.values()}
    roles = _roles("heat_exchanger", {names[c]: r for c, r in HX.items()})
    return Export("german meter", (path,), units, roles, "Europe/Berlin", "2024-10-28")


def fahrenheit_workbook(folder: Path) -> Export:
    """The exchanger in degF and gpm in a workbook, a title above the header and a row of units below it."""
    names = {"hx.T_hot_in": "Primary Supply Temp", "hx.T_hot_out": "Primary Return Temp",
             "hx.T_cold_in": "Secondary Return Temp", "hx.T_cold_out": "Secondary Supply Temp",
             "hx.m_flow_hot": "Primary Flow", "hx.m_flow_cold": "Secondary Flow"}  # fmt: skip
    frame = _house()[["time", *names]].rename(columns=names).iloc[: 21 * 288]
    for column in names.values():
        flow = column.endswith("Flow")
        frame[column] = (frame[column] / 0.06309 if flow else frame[column] * 1.8 + 32.0).round(3)
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("Trend")
    sheet.append(["Substation trend"])
    sheet.append(["Date", *names.values()])
    units = {c: "gpm" if c.endswith("Flow") else "°F" for c in names.values()}
    sheet.append(["", *units.values()])
    for row in frame.itertuples(index=False):
        sheet.append([row[0].tz_convert(None).to_pydatetime(), *row[1:]])
    path = folder / "substation.xlsx"
    book.save(path)
    roles = _roles("heat_exchanger", {names[c]: r for c, r in HX.items()})
    return Export("workbook in degF", (path,), {c: u.replace("°", "deg") for c, u in units.items()}, roles, "UTC",
                  "2024-10-25")  # fmt: skip


def swapped_dates(folder: Path) -> Export:
    """The same exchanger with American dates and times of twelve hours."""
    frame = _house()[["time", *HX]]
    frame["time"] = frame["time"].dt.strftime("%m/%d/%Y %I:%M:%S %p")
    path = folder / "trend.csv"
    frame.to_csv(path, index=False)
    units = {c: "kg/s" if "flow" in c else "degC" for c in HX}
    return Export("American dates", (path,), units, _roles("heat_exchanger", HX), "UTC", "2024-10-28")


def one_file_a_point(folder: Path) -> Export | None:
    """A measured exchanger, a file for each point, each on times of its own."""
    frame = _shared("real2/condat_exchanger_5min.csv.gz")
    if frame is None:
        return None
    where = folder / "points"
    where.mkdir()
    rng = np.random.default_rng(1)
    for column in ("V_hot", "V_cold", "T_hot_in", "T_hot_out", "T_cold_in", "T_cold_out", "P_meter"):
        kept = frame.loc[rng.random(len(frame)) > 0.02, ["time", column]].dropna()
        kept.rename(columns={column: "value"}).to_csv(where / f"{column}.csv", index=False)
    units = dict.fromkeys(("T_hot_in", "T_hot_out", "T_cold_in", "T_cold_out"), "degC") | dict.fromkeys(
        ("V_hot", "V_cold"), "m3/h"
    )
    roles = {("heat_exchanger", r): r for r in ("T_hot_in", "T_hot_out", "T_cold_in", "T_cold_out")}
    roles |= {("heat_exchanger", "m_flow_hot"): "V_hot", ("heat_exchanger", "m_flow_cold"): "V_cold"}
    return Export("one file a point", (where,), units | {"P_meter": "kW"}, roles, "UTC", "2020-05-01")


AHU = {"AHU: Outdoor Air Temperature": "T_out", "AHU: Return Air Temperature": "T_return",
       "AHU: Mixed Air Temperature": "T_mixed", "AHU: Supply Air Temperature": "T_supply",
       "AHU: Outdoor Air Damper Control Signal": "damper", "AHU: Supply Air Fan Speed Control Signal": "fan",
       "AHU: Cooling Coil Valve Control Signal": "cool",
       "AHU: Heating Coil Valve Control Signal": "heat"}  # fmt: skip


def long_by_point(folder: Path) -> Export | None:
    """A measured air handler, one value a line, sorted by point as historians write it."""
    frame = _shared("lbnl_mzvav_2_1.csv.gz")
    if frame is None:
        return None
    frame.columns = frame.columns.str.strip()
    kept = frame[["Datetime", *AHU]].iloc[::5]
    long = kept.melt("Datetime", var_name="Tag", value_name="Value")
    path = folder / "historian.csv.gz"
    long.to_csv(path, index=False)
    units = {c: "degF" if "Temperature" in c else "1" for c in AHU}
    return Export("long, by point", (path,), units, _roles("air_handler", AHU), "America/Chicago")


def sentinels(folder: Path) -> Export | None:
    """A measured house with -9999 and words where values were lost."""
    frame = _shared("flexhouse_prbs_5min.csv")
    if frame is None:
        return None
    kept = frame[["TimeDate", "Ta", "Ps", "Ph", "yTi"]].astype(object)
    rng = np.random.default_rng(2)
    for column, word in (("Ta", -9999), ("yTi", "Bad"), ("Ph", "No Data")):
        kept.loc[rng.random(len(kept)) < 0.01, column] = word
    path = folder / "flexhouse.csv"
    kept.to_csv(path, index=False, sep="\t")
    units = {"Ta": "degC", "Ps": "kW/m2", "Ph": "kW", "yTi": "degC"}
    roles = _roles("zone", {"Ta": "T_out", "Ps": "I_solar", "Ph": "P_heat", "yTi": "T_room"})
    return Export("sentinels", (path,), units, roles, "Europe/Copenhagen", "2009-02-09")


def two_clocks(folder: Path) -> Export | None:
    """The same house from two systems: the weather in UTC, the house on the wall's clock."""
    frame = _shared("flexhouse_prbs_5min.csv")
    if frame is None:
        return None
    local = pd.to_datetime(frame["TimeDate"])
    weather = pd.DataFrame({
        "timestamp": (local - pd.Timedelta("1h")).dt.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "Outdoor temperature (°C)": frame["Ta"], "Global radiation (W/m2)": 1000 * frame["Ps"],
    })  # fmt: skip
    house = pd.DataFrame({"Time": local.dt.strftime("%d/%m/%Y %H:%M"), "Heater power": frame["Ph"] * 1000,
                          "Room temperature": frame["yTi"]})  # fmt: skip
    where = folder / "both"
    where.mkdir()
    weather.to_csv(where / "weather.csv", index=False)
    house.to_csv(where / "house.csv", index=False)
    units = {"Outdoor temperature (°C)": "degC", "Global radiation (W/m2)": "W/m2", "Heater power": "W",
             "Room temperature": "degC"}  # fmt: skip
    roles = _roles("zone", {"Outdoor temperature (°C)": "T_out", "Global radiation (W/m2)": "I_solar",
                            "Heater power": "P_heat", "Room temperature": "T_room"})  # fmt: skip
    return Export("two clocks", (where,), units, roles, "Europe/Copenhagen", "2009-02-09")


def american_chiller(folder: Path) -> Export | None:
    """A measured chiller as its building automation wrote it: degF, gpm, offsets in the times."""
    path = SHARED / "esb_chiller1_raw_5min.csv.gz"
    if not path.exists():
        return None
    columns = {"Cond Entering Water Temp": "T_cdi", "Cond Leaving Water Temp": "T_cdo",
               "Evaporator Entering Water Temperature": "T_chi", "Evaporator Leaving Water Temperature": "T_cho",
               "Flexim M-3 (WCM-1) volumetric flow rate": "flow_ch",
               "Starter Input Power Consumption (kW)": "power"}  # fmt: skip
    units = dict.fromkeys(columns, "degF") | {
        "Flexim M-3 (WCM-1) volumetric flow rate": "gpm",
        "Starter Input Power Consumption (kW)": "kW",
    }
    return Export("American chiller", (path,), units, _roles("gordon_ng", columns), "America/Chicago")


def haystack_parquet(folder: Path) -> Export:
    """The exchanger in Parquet under ids that say nothing, and a Haystack grid that knows them."""
    frame = _house()[["time", *HX]]
    ids = {c: f"p:{0x1A00 + i:x}" for i, c in enumerate(HX)}
    frame.rename(columns=ids).to_parquet(folder / "his.parquet")
    marks = {"hx.T_hot_in": "hot primary supply water temp", "hx.T_hot_out": "primary return water temp",
             "hx.T_cold_in": "secondary return water temp", "hx.T_cold_out": "secondary supply water temp",
             "hx.m_flow_hot": "primary flow", "hx.m_flow_cold": "secondary flow"}  # fmt: skip
    rows: list[dict[str, Any]] = [{"id": "r:hx-1 Substation", "dis": "s:Substation", "equip": "m:"}]
    for column, said in marks.items():
        unit = "kg/s" if "flow" in column else "°C"
        row: dict[str, Any] = {"id": f"r:{ids[column]}", "dis": f"s:Point {ids[column][-2:]}", "point": "m:",
                               "kind": "s:Number", "unit": f"s:{unit}", "equipRef": "r:hx-1 Substation",
                               "tz": "s:Copenhagen"}  # fmt: skip
        rows.append(row | dict.fromkeys(said.split(), "m:"))
    (folder / "points.json").write_text(json.dumps({"meta": {"ver": "3.0"}, "rows": rows}))
    units = {ids[c]: "kg/s" if "flow" in c else "degC" for c in HX}
    roles = _roles("heat_exchanger", {ids[c]: r for c, r in HX.items()})
    return Export("Haystack and Parquet", (folder / "his.parquet", folder / "points.json"), units, roles, None,
                  "2024-10-28")  # fmt: skip


def brick_air_handler(folder: Path) -> Export | None:
    """A simulated air handler with ids for columns and a Brick model that classes them."""
    frame = _shared("lbnl_mzvav_2_2.csv.gz")
    if frame is None:
        return None
    frame.columns = frame.columns.str.strip()
    classes = {"T_out": "Outside_Air_Temperature_Sensor", "T_return": "Return_Air_Temperature_Sensor",
               "T_mixed": "Mixed_Air_Temperature_Sensor", "T_supply": "Supply_Air_Temperature_Sensor",
               "damper": "Outside_Damper_Position_Command", "fan": "Supply_Fan_Speed_Command",
               "cool": "Cooling_Valve_Command", "heat": "Heating_Valve_Command"}  # fmt: skip
    ids = {c: f"bldg-{i:03d}" for i, c in enumerate(AHU)}
    kept = frame[["Datetime", *AHU]].iloc[::5].rename(columns=ids)
    kept.to_csv(folder / "bms.csv", index=False)
    head = ("@prefix brick: <https://brickschema.org/schema/Brick#> .\n@prefix unit: <http://qudt.org/vocab/unit/> .\n"
            "@prefix b: <urn:building#> .\nb:AHU-1 a brick:AHU .\n")  # fmt: skip
    lines = [
        f"b:{ids[c]} a brick:{classes[r]} ; brick:isPointOf b:AHU-1"
        + (" ; brick:hasUnit unit:DEG_F .\n" if r.startswith("T_") else " .\n")
        for c, r in AHU.items()
    ]
    (folder / "model.ttl").write_text(head + "".join(lines))
    units = {ids[c]: "degF" if "Temperature" in c else "1" for c in AHU}
    roles = _roles("air_handler", {ids[c]: r for c, r in AHU.items()})
    return Export("Brick", (folder / "bms.csv", folder / "model.ttl"), units, roles, "America/Chicago")


ALL: tuple[Callable[[Path], Export | None], ...] = (
    german, fahrenheit_workbook, swapped_dates, one_file_a_point, long_by_point, sentinels, two_clocks,
    american_chiller, haystack_parquet, brick_air_handler,
)  # fmt: skip


def exports(folder: Path) -> Iterator[Export]:
    """Every export that can be made here, each in a folder of its own."""
    for make in ALL:
        own = folder / make.__name__
        own.mkdir(parents=True, exist_ok=True)
        found = make(own)
        if found is not None:
            yield found
