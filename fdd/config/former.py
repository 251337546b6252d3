"""Keys and symbols that the site file had in the version before: taken, and told with the new one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from fdd.models.former import present


def modernised(table: dict[str, Any]) -> tuple[dict[str, Any], tuple[tuple[str, str, str], ...]]:
    """A site's table in today's words, and what was replaced: (where, former, present).

    Tables of another shape than expected are left for validation to refuse.
    """
    told: list[tuple[str, str, str]] = []
    table = {**table}
    if isinstance(table.get("reidentify"), dict):
        table["reidentify"] = _renamed(table["reidentify"], "reidentify", {"slack": "deadband"}.get, told)
    if isinstance(table.get("equipment"), dict):
        table["equipment"] = {n: _equipment(e, f"equipment.{n}", told) for n, e in table["equipment"].items()}
    return table, tuple(told)


def _equipment(table: Any, where: str, told: list[tuple[str, str, str]]) -> Any:
    if not isinstance(table, dict):
        return table
    table, model = {**table}, str(table.get("model"))

    def symbol(former: str) -> str:
        return present(model, former)

    for key in ("inputs", "outputs", "parameters"):
        if isinstance(table.get(key), dict):
            table[key] = _renamed(table[key], f"{where}.{key}", symbol, told)
    if isinstance(table.get("charts"), dict):
        charts = {**table["charts"]}
        for key, now in (("kinds", {"still": "flatline"}.get), ("exclude", symbol)):
            if isinstance(charts.get(key), list):
                charts[key] = list(_values(charts[key], f"{where}.charts.{key}", now, told))
        table["charts"] = charts
    return table


def _renamed(
    table: dict[str, Any], where: str, now: Callable[[str], str | None], told: list[tuple[str, str, str]]
) -> dict[str, Any]:
    return dict(zip(_values(list(table), where, now, told), table.values(), strict=True))


def _values(
    words: list[Any], where: str, now: Callable[[str], str | None], told: list[tuple[str, str, str]]
) -> Iterator[Any]:
    for word in words:
        new = (now(word) if isinstance(word, str) else None) or word
        # Where both stand, the present one counts, and validation names the other.
        if new != word and new not in words:
            told.append((where, word, new))
            yield new
        else:
            yield word
