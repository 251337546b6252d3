"""Tables fit the screen or become blocks; at no width is anything cut."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from fdd.service.verbs.listing import show

ROWS = [
    {"symbol": "C", "meaning": "heat capacity of water and metal in every section", "typical": 50000.0, "unit": "J/K"},
    {"symbol": "a_long_symbol_without_any_blank", "meaning": "[bold] is no markup here", "typical": 0.1, "unit": ""},
]


def shown(width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    show(ROWS, console, "parameters")
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return text


@pytest.mark.parametrize("width", [30, 80, 120])
def test_nothing_is_cut_at_any_width(width: int) -> None:
    text = " ".join(shown(width).split())
    for row in ROWS:
        for value in row.values():
            assert (f"{value:.6g}" if isinstance(value, float) else " ".join(str(value).split())) in text
    assert "…" not in text


def test_a_wide_screen_has_a_table_and_a_narrow_one_blocks() -> None:
    assert len(shown(120).splitlines()) == 4
    assert "meaning: heat capacity" in shown(60)


def test_no_rows_print_nothing() -> None:
    console = Console(file=io.StringIO())
    show([], console)
    assert console.file.getvalue() == ""  # type: ignore[attr-defined]
