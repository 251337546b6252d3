"""What Haystack grids (JSON, Zinc) and Brick models (Turtle) say of points: names, units, equipment and facets.

Sources: Project Haystack, docHaystack (Zinc and JSON formats of grids); Balaji et al. (2018), Brick: Metadata schema
for portable smart building applications, Applied Energy 226; QUDT units as Brick uses them.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fdd.onboarding.guess import ExportError
from fdd.onboarding.vocabulary import facets

_MARKS: Mapping[str, str] = {
    "temp": "temperature", "flow": "flow", "power": "power", "energy": "energy", "pressure": "pressure",
    "humidity": "humidity", "sp": "setpoint", "cmd": "command", "outside": "outdoor", "zone": "room", "room": "room",
    "discharge": "supply", "supply": "supply", "return": "return", "mixed": "mixed", "exhaust": "exhaust",
    "entering": "inlet", "leaving": "outlet", "chilled": "chilled", "condenser": "condenser", "hot": "heating",
    "air": "air", "water": "water", "damper": "damper", "valve": "valve", "fan": "fan", "pump": "pump",
    "chiller": "chiller", "heating": "heating", "cooling": "cooling", "co2": "co2", "speed": "speed", "run": "status",
    "elec": "gain", "primary": "primary", "secondary": "secondary", "irradiance": "irradiance", "solar": "irradiance",
    "delta": "difference", "load": "load", "boiler": "boiler", "enable": "status", "dew": "dewpoint",
}  # fmt: skip
_QUDT = {"DEG_C": "degC", "DEG_F": "degF", "K": "K", "KiloW": "kW", "W": "W", "MegaW": "MW", "PERCENT": "%", "PA": "Pa",
         "KiloPA": "kPa", "BAR": "bar", "PSI": "psi", "IN_H2O": "inH2O", "FT3-PER-MIN": "cfm", "GAL_US-PER-MIN": "gpm",
         "L-PER-SEC": "l/s", "M3-PER-HR": "m3/h", "M3-PER-SEC": "m3/s", "KiloGM-PER-SEC": "kg/s", "W-PER-M2": "W/m2",
         "KiloW-HR": "kWh", "PPM": "ppm", "UNITLESS": "1", "L-PER-MIN": "l/min", "TON_FG": "tons",
         "IN_HG": "inHg", "HZ": "Hz", "REV-PER-MIN": "rpm"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Tagged:
    """A point as a model of the building knows it: ``keys`` are what a data column may call it."""

    keys: tuple[str, ...]
    title: str
    unit: str
    facets: frozenset[str]
    group: str
    zone: str = ""


def read_tags(path: Path) -> list[Tagged]:
    """Points of one file.

    Raises
    ------
    ExportError : the file is not what its ending says, or holds no point.
    """
    text = path.read_text(encoding="utf-8-sig")
    found = {".ttl": _brick, ".zinc": _zinc, ".json": _json}[path.suffix.lower()](text, path)
    if not found:
        raise ExportError(f"{path}: it holds no point (Haystack: rows with the tag 'point'; Brick: a Point's class)")
    return found


def _json(text: str, path: Path) -> list[Tagged]:
    try:
        grid = json.loads(text)
        rows = [{k: _value(v) for k, v in dict(row).items()} for row in grid["rows"]]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ExportError(f"{path}: no Haystack grid: expected JSON with a list 'rows'") from None
    return list(_haystack(rows))


def _value(raw: Any) -> Any:
    """Plain value of a Haystack 3 text (``s:...``) or a Haystack 4 object; True for a marker."""
    if isinstance(raw, Mapping):
        if raw.get("_kind") == "marker":
            return True
        if raw.get("_kind") == "ref":
            return f"@{raw.get('val', '')} {raw.get('dis', '')}".strip()
        return raw.get("val", "")
    if raw == "m:" or raw == "✓":
        return True
    if isinstance(raw, str):
        return f"@{raw[2:]}" if raw.startswith("r:") else re.sub(r"^[snbuhdtz]:", "", raw)
    return raw


_ZINC_CELL = re.compile(r'"((?:[^"\\]|\\.)*)"|@([\w:.~-]+)(?: "((?:[^"\\]|\\.)*)")?|([^,]*)')


def _zinc(text: str, path: Path) -> list[Tagged]:
    lines = [line for line in text.splitlines() if line.strip()]
    if len(lines) < 2 or not lines[0].startswith("ver:"):
        raise ExportError(f'{path}: no Zinc grid: its first line is ver:"3.0"')
    names = [cell.split(" ")[0] for cell in next(csv.reader([lines[1]]))]
    rows = []
    for line in lines[2:]:
        cells = _zinc_cells(line)
        rows.append({n: c for n, c in zip(names, cells, strict=False) if c not in ("", None)})
    return list(_haystack(rows))


def _zinc_cells(line: str) -> list[Any]:
    """Cells of a line: texts, references with their display name, markers (M), nothing (N)."""
    cells: list[Any] = []
    at = 0
    while at <= len(line):
        match = _ZINC_CELL.match(line, at)
        assert match is not None  # the last alternative fits anything
        text, reference, shown, word = match.groups()
        if text is not None:
            cells.append(text.encode().decode("unicode_escape") if "\\" in text else text)
        elif reference is not None:
            cells.append(f"@{reference} {shown or ''}".strip())
        else:
            cells.append({"M": True, "N": "", "T": True, "F": False}.get(word.strip(), word.strip()))
        at = match.end() + 1
    return cells


def _haystack(rows: list[dict[str, Any]]) -> Iterator[Tagged]:
    shown = {_id(r.get("id")): str(r.get("dis") or r.get("navName") or _id(r.get("id"))) for r in rows}
    for row in rows:
        if row.get("point") is not True or str(row.get("kind", "Number")) not in ("Number", "Bool"):
            continue
        marks = {tag for tag, value in row.items() if value is True}
        title = shown[_id(row.get("id"))]
        said = facets(title) | {_MARKS[m] for m in marks if m in _MARKS}
        if "weather" in marks or "weatherStationRef" in row or "weatherRef" in row:
            said |= {"outdoor"}
        if str(row.get("kind")) == "Bool":
            said |= {"status"}
        group = shown.get(_id(row.get("equipRef")), _id(row.get("equipRef")))
        keys = (_id(row.get("id")), title, str(row.get("navName") or title))
        unit = str(row.get("unit", "")).replace("₂", "2").replace("³", "3").replace("²", "2")
        yield Tagged(keys, title, unit, frozenset(said), group, str(row.get("tz", "")))


def _id(reference: Any) -> str:
    return str(reference or "").removeprefix("@").split(" ")[0]


def _brick(text: str, path: Path) -> list[Tagged]:
    from rdflib import RDF, RDFS, Graph, Namespace, URIRef

    graph = Graph()
    try:
        graph.parse(data=text, format="turtle")
    except Exception as error:  # the parser raises many kinds
        raise ExportError(f"{path}: no Turtle ({str(error).splitlines()[0]})") from None
    brick, ref = (
        Namespace("https://brickschema.org/schema/Brick#"),
        Namespace("https://brickschema.org/schema/Brick/ref#"),
    )

    def name(node: Any) -> str:
        label = graph.value(node, RDFS.label)
        return str(label) if label is not None else re.split(r"[#/]", str(node))[-1]

    found = []
    for node, kind in graph.subject_objects(RDF.type):
        word = str(kind)
        if not word.startswith(str(brick)) or not _is_point_class(word.removeprefix(str(brick))):
            continue
        of = graph.value(node, brick.isPointOf) or graph.value(None, brick.hasPoint, node)
        unit = graph.value(node, brick.hasUnit)
        keys = [re.split(r"[#/]", str(node))[-1], name(node)]
        for reference in graph.objects(node, ref.hasExternalReference):
            keys += [str(v) for v in graph.objects(reference) if not isinstance(v, URIRef)]
        spelt = re.split(r"[#/]", str(unit))[-1] if unit is not None else ""
        said = facets(word.removeprefix(str(brick)).replace("_", " ")) | ({"room"} if of is not None and "Room" in str(
            graph.value(of, RDF.type)) and "Temperature" in word else set())  # fmt: skip
        group = name(of) if of is not None else ""
        found.append(Tagged(tuple(dict.fromkeys(keys)), name(node), _QUDT.get(spelt, spelt), frozenset(said), group))
    return found


def _is_point_class(word: str) -> bool:
    return word.endswith(("_Sensor", "_Setpoint", "_Command", "_Status", "Sensor", "_Alarm", "_Parameter"))
