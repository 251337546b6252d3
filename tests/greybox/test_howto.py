"""The how-to page is followed to the letter."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fdd.greybox.validate import validate

PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto" / "add-a-component.md"


def test_the_page_works_as_it_stands(capsys: object) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    space: dict[str, object] = {}
    for block in blocks:
        exec(compile(block.replace("from __future__ import annotations\n", ""), str(PAGE), "exec"), space)
    result, true = space["result"], space["true"]
    errors = np.array(list(result.bse.values()))  # type: ignore[attr-defined]
    assert (np.abs(result.values - true) < 3 * errors).all()  # type: ignore[attr-defined]
    assert validate(result).passed  # type: ignore[arg-type]
