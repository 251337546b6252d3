"""A draft from a Haystack export loads as a site file."""

from __future__ import annotations

import json

import pytest

from fdd.config import parse_site
from ingest.haystack import ExportError, draft_site

VERSION_3 = {
    "meta": {"ver": "3.0"},
    "rows": [
        {"id": "r:ahu1 AHU 1", "dis": "s:AHU 1", "equip": "m:"},
        {
            "id": "r:p1 SAT",
            "dis": "s:AHU 1 SAT",
            "point": "m:",
            "kind": "s:Number",
            "unit": "s:°F",
            "equipRef": "r:ahu1 AHU 1",
        },
        {"id": "r:p2", "dis": "s:AHU 1 SAT", "point": "m:", "kind": "s:Number", "unit": "s:inH₂O"},
        {"id": "r:p3", "dis": "s:Fan cmd", "point": "m:", "kind": "s:Bool"},
        {"id": "r:p4", "dis": "s:Mode", "point": "m:", "kind": "s:Str"},
        {"id": "r:p5", "dis": "s:Odd", "point": "m:", "kind": "s:Number", "unit": "s:wombats"},
    ],
}
VERSION_4 = {
    "_kind": "grid",
    "rows": [
        {
            "id": {"_kind": "ref", "val": "p1", "dis": "Zone temp"},
            "dis": "Zone temp",
            "point": {"_kind": "marker"},
            "kind": "Number",
            "unit": "°C",
        }
    ],
}


def test_points_get_names_columns_and_units() -> None:
    text = draft_site(json.dumps(VERSION_3), name="School", zone="Europe/Copenhagen")
    site = parse_site(text)
    assert {n: (p.column, p.unit) for n, p in site.points.items()} == {
        "AHU_1_SAT": ("p1", "°F"),
        "AHU_1_SAT_2": ("p2", "inH2O"),
        "Fan_cmd": ("p3", "1"),
        "Odd": ("p5", "1"),
    }
    assert "of AHU 1" in text
    assert "unit wombats is not understood" in text


def test_version_4_is_read_too() -> None:
    site = parse_site(draft_site(json.dumps(VERSION_4), name="x"))
    assert site.units == {"Zone_temp": "degC"}
    assert site.column("Zone_temp") == "p1"


@pytest.mark.parametrize("export", ["", "[]", '{"rows": 3}', '{"rows": []}', '{"rows": [{"id": "r:a"}]}'])
def test_what_is_no_export_is_refused(export: str) -> None:
    with pytest.raises(ExportError):
        draft_site(export, name="x")
