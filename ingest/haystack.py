"""First draft of a site file from a Project Haystack export (a grid in JSON, as ``read?filter=point`` gives it).

Points get names, columns (their ids) and units; what equipment they belong to stands in comments, for a person to map
to the roles of a model. Units that are not understood are left out and named.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap

from fdd.units import UnitError, conversion


class ExportError(ValueError):
    """An export that cannot be read; the text says what was expected."""


def draft_site(export: str, *, name: str, zone: str = "UTC") -> str:
    """YAML of a site with every numeric or boolean point of an export; it loads as it stands.

    Parameters
    ----------
    export : Haystack grid in JSON (version 3 or 4)
    name, zone : of the site

    Raises
    ------
    ExportError : no JSON, or no grid with points.
    """
    rows = _rows(export)
    names = {_reference(r.get("id")): _text(r.get("dis") or r.get("navName") or r.get("id")) for r in rows}
    points = CommentedMap()
    for row in rows:
        if "point" not in row or _text(row.get("kind", "Number")) not in {"Number", "Bool"}:
            continue
        key = _distinct(_symbol(names[_reference(row.get("id"))]), points)
        points[key], comment = _point(row, names)
        if comment:
            points.yaml_add_eol_comment(comment, key)
    if not points:
        raise ExportError("the grid holds no row with the tag 'point' and kind Number or Bool")
    site = CommentedMap({"name": name, "zone": zone, "points": points})
    site.yaml_set_comment_before_after_key(
        "points", before="Drafted from an export. Add a source, and equipment with its inputs and outputs."
    )
    out = io.StringIO()
    yaml = YAML()
    yaml.width = 200
    yaml.dump(site, out)
    return out.getvalue()


def _rows(export: str) -> list[Mapping[str, Any]]:
    try:
        grid = json.loads(export)
        rows: list[Mapping[str, Any]] = [dict(row) for row in grid["rows"]]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ExportError("no Haystack grid: expected JSON with a list 'rows'") from None
    return rows


def _text(value: Any) -> str:
    """Plain text of a Haystack 3 string (``s:...``), a Haystack 4 object (``{"val": ...}``) or a text."""
    if isinstance(value, Mapping):
        return str(value.get("dis") or value.get("val", ""))
    return re.sub(r"^[snrb]:", "", str(value))


def _reference(value: Any) -> str:
    """The id within a reference, without the display name that may follow it."""
    text = str(value.get("val", "")) if isinstance(value, Mapping) else re.sub(r"^r:", "", str(value))
    return text.split(" ")[0].removeprefix("@")


def _symbol(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_") or "point"


def _distinct(key: str, taken: Mapping[str, Any]) -> str:
    number, made = 2, key
    while made in taken:
        made, number = f"{key}_{number}", number + 1
    return made


def _point(row: Mapping[str, Any], names: Mapping[str, str]) -> tuple[CommentedMap, str]:
    table = CommentedMap({"column": _reference(row.get("id"))})
    table.fa.set_flow_style()
    equipment = names.get(_reference(row.get("equipRef", "")), "")
    remarks = [f"of {equipment}"] if equipment else []
    unit = _text(row["unit"]).replace("₂", "2") if "unit" in row else ""
    if unit:
        try:
            conversion(unit)
            table["unit"] = unit
        except UnitError:
            remarks.append(f"unit {unit} is not understood")
    return table, "; ".join(remarks)
