"""The nomenclature page owns symbols and units: nothing in a model may differ from it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fdd.chiller_eiv.errors import RAW_UNITS
from fdd.chiller_eiv.forms import DIVISION_FREE
from fdd.models.registry import MODELS, get_model
from fdd.units import NAMES, conversion

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "nomenclature.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_symbol_of_a_model_stands_on_the_page_with_its_unit(name: str) -> None:
    _, _, section = PAGE.partition(f"### {name}\n")
    section = section.partition("\n### ")[0]
    model = get_model(name)
    for table in ("inputs", "outputs", "states", "parameters"):
        for q in getattr(model, table):
            row = f"| `{q.symbol}` | {q.unit} | {table[:-1]} | {q.meaning} |"
            assert row in section, f"docs/nomenclature.md, section {name}, lacks the row\n{row}"


@pytest.mark.parametrize("name", sorted(MODELS))
def test_inputs_and_outputs_are_in_the_units_used_inside(name: str) -> None:
    model = get_model(name)
    for q in (*model.inputs, *model.outputs):
        known = conversion(q.unit)
        assert (known.scale, known.offset) == (1.0, 0.0), f"{name}.{q.symbol} [{q.unit}] is not in SI"
        assert known.si in NAMES, f"{name}.{q.symbol} [{q.unit}]: no name for this quantity in fdd.units.NAMES"


@pytest.mark.parametrize("name", sorted(MODELS))
def test_no_row_of_a_model_s_section_is_of_a_symbol_that_it_lacks(name: str) -> None:
    section = PAGE.partition(f"### {name}\n")[2].partition("\n### ")[0].partition("\n## ")[0]
    told = set(re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE))
    known = {symbol for table in get_model(name).symbols.values() for symbol in table}
    assert told, f"docs/nomenclature.md has no section {name}"
    assert told <= known, f"docs/nomenclature.md, section {name}, names what the model lacks: {sorted(told - known)}"


@pytest.mark.parametrize("heading", ["Filters and statistics", "Charts and alarms"])
def test_every_word_that_the_page_says_stands_in_code_does(heading: str) -> None:
    section = PAGE.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in section.splitlines() if line.startswith("| ")][1:]
    words = {w for row in rows for w in re.findall(r"`([A-Za-z_]+)`", row[2])}
    code = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "fdd").rglob("*.py"))
    missing = sorted(w for w in words if not re.search(rf"\b{w}\b", code))
    assert len(words) > 8
    assert missing == [], f"docs/nomenclature.md, {heading}, names what no code knows"


def test_chillers_have_on_the_page_what_their_code_has_with_its_units() -> None:
    section = PAGE.partition("## Chillers\n")[2].partition("\n## ")[0]
    told = dict(re.findall(r"^\| `([A-Za-z_]+)` \| ([^ |]+) \|", section, re.MULTILINE))
    known = {**RAW_UNITS, "Q": "W", "E": "W", **dict(zip(DIVISION_FREE.parameters, DIVISION_FREE.units, strict=True))}
    assert told == known
