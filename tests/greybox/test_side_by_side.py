"""The page that shows our numbers beside other programs' says what is computed now, and names tests that exist."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ROOT / "docs" / "studies"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("side_by_side", STUDIES / "identification_side_by_side.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = made
    spec.loader.exec_module(made)
    return made


def test_every_number_stands_as_it_is_computed_now(script: ModuleType) -> None:
    assert script.check() == []


def test_a_number_that_moved_is_found(script: ModuleType) -> None:
    row = "| D | Bus | exact filter | 12.4095 (.1912) | 12.4095 (0.1912) | test_d |"
    assert script.same(row, row.replace("| 12.4095 (0.1912)", "| 12.4096 (0.1912)"))
    assert not script.same(row, row.replace("| 12.4095 (0.1912)", "| 12.4195 (0.1912)"))
    assert not script.same(row, row.replace("(0.1912)", "(0.2912)"))
    assert not script.same(row, row.replace("12.4095 (.1912)", "12.5095 (.1912)"))


def test_every_test_that_it_names_exists() -> None:
    named = set(re.findall(r"test_\w+", (STUDIES / "identification-side-by-side.md").read_text(encoding="utf-8")))
    files = Path(__file__).parent.glob("test_*.py")
    defined = {name for f in files for name in re.findall(r"^def (test_\w+)", f.read_text(encoding="utf-8"), re.M)}
    assert len(named) >= 13
    assert named <= defined
