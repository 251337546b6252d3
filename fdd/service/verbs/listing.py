"""Rows for people: a table where it fits the screen, else a block for each row; nothing is cut."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text


def show(rows: Sequence[Mapping[str, Any]], console: Console, title: str = "") -> None:
    """Print rows that have the same keys; the first key names the row."""
    if not rows:
        return
    head = list(rows[0])
    cells = [[_text(row.get(k)) for k in head] for row in rows]
    widths = [max(len(c) for c in column) for column in zip(head, *cells, strict=True)]
    if sum(widths) + 2 * len(widths) <= console.width and not any("\n" in c for row in cells for c in row):
        table = Table(*head, title=title or None, title_justify="left", box=None, pad_edge=False)
        for row in cells:
            table.add_row(*map(Text, row))
        console.print(table, highlight=False)
        return
    if title:
        console.print(title, highlight=False, markup=False, style="italic")
    for row in cells:
        console.print(row[0], highlight=False, markup=False, style="bold", soft_wrap=True)
        told = "; ".join(f"{k}: {c}" for k, c in zip(head[1:], row[1:], strict=True) if c)
        lines = textwrap.wrap(told, console.width - 2, break_long_words=False, break_on_hyphens=False)
        console.print("\n".join(f"  {line}" for line in lines), highlight=False, markup=False, soft_wrap=True)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return " ".join(map(str, value))
    return "" if value is None else str(value)
