"""The nomenclature page owns symbols and units: nothing in a model may differ from it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

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


def test_every_word_of_charts_and_alarms_stands_in_the_code() -> None:
    section = PAGE.partition("## Charts and alarms\n")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in section.splitlines() if line.startswith("| ")][1:]
    words = {w for row in rows for w in re.findall(r"`([A-Za-z_]+)`", row[2])}
    assert len(words) > 25
    code = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "fdd").rglob("*.py"))
    missing = sorted(w for w in words if not re.search(rf"\b{w}\b", code))
    assert missing == [], "docs/nomenclature.md names what no code knows"
