"""The page on threats says what the code does: its tests exist, its bounds are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

from fdd import limits

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "threat-model.md").read_text(encoding="utf-8")


def test_every_line_names_tests_that_exist() -> None:
    rows = [
        r for r in PAGE.partition("## What each door does")[2].partition("## Bounds")[0].splitlines() if r[:1] == "|"
    ]
    for row in rows[2:]:
        named = re.findall(r"`(test_\w+\.py)?::(\w+)`", row)
        assert named, row
        file = ""
        for where, test in named:
            file = where or file
            assert f"def {test}(" in (ROOT / "tests" / "doors" / file).read_text(encoding="utf-8"), (file, test)


def test_every_bound_is_told_with_its_value() -> None:
    told = {name: int(value) for name, value in re.findall(r"^\| `([A-Z_]+)` \| (\d+) \|", PAGE, flags=re.MULTILINE)}
    own = {name: value for name, value in vars(limits).items() if name.isupper() and isinstance(value, int)}
    assert told == own
