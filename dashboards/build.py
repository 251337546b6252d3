"""Write the dashboards' JSON and Grafana's provisioning files, or check that the committed ones are up to date.

python -m dashboards.build [--check]
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from grafana_foundation_sdk.builders.dashboard import Dashboard
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from ruamel.yaml import YAML
from ruamel.yaml.scalarstring import LiteralScalarString

from dashboards import alarm_list, chiller, component, plant, provisioning, service

HERE = Path(__file__).parent
BOARDS: dict[str, Callable[[], Dashboard]] = {
    "plant": plant.build,
    "component": component.build,
    "chiller": chiller.build,
    "service": service.build,
    "alarms": alarm_list.build,
}
# The SDK writes these on every variable; Grafana's schema has them for intervals only.
_STRAY = ("auto", "auto_min", "auto_count")


def board_json(build: Callable[[], Dashboard]) -> dict[str, Any]:
    """A dashboard as plain data."""
    board: dict[str, Any] = json.loads(json.dumps(build().build(), cls=JSONEncoder))
    for variable in board["templating"]["list"]:
        for key in _STRAY:
            variable.pop(key, None)
    return board


def _literal(tree: Any) -> Any:
    """Long texts as blocks, so that queries can be read and compared line by line."""
    if isinstance(tree, dict):
        return {k: _literal(v) for k, v in tree.items()}
    if isinstance(tree, list):
        return [_literal(v) for v in tree]
    return LiteralScalarString(tree) if isinstance(tree, str) and "\n" in tree else tree


def _yaml(tree: dict[str, Any]) -> str:
    yaml = YAML()
    yaml.width = 10_000
    out = io.StringIO()
    yaml.dump(_literal(tree), out)
    return out.getvalue()


def generated() -> dict[Path, str]:
    """Every generated file with its text."""
    note = "# Written by python -m dashboards.build; change the Python beside it instead.\n"
    boards = {
        HERE / "generated" / f"{name}.json": json.dumps(board_json(build), indent=2, ensure_ascii=False) + "\n"
        for name, build in BOARDS.items()
    }
    files = {HERE / "provisioning" / name: note + _yaml(content()) for name, content in provisioning.FILES.items()}
    return boards | files


def stale() -> list[Path]:
    """Committed files that differ from what would be generated, or that nothing generates any more."""
    wanted = generated()
    there = {p for folder in ("generated", "provisioning") for p in (HERE / folder).rglob("*") if p.is_file()}
    differ = [p for p, text in wanted.items() if not p.is_file() or p.read_text(encoding="utf-8") != text]
    return sorted({*differ, *(there - set(wanted))})


def main(
    check: Annotated[bool, typer.Option("--check", help="change nothing; fail where files differ")] = False,
) -> None:
    """Write every generated file, or check them."""
    if check:
        for path in (old := stale()):
            typer.echo(f"out of date: {path.relative_to(HERE.parent)}; run python -m dashboards.build", err=True)
        raise typer.Exit(1 if old else 0)
    for path, text in generated().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        typer.echo(path.relative_to(HERE.parent))


if __name__ == "__main__":
    typer.run(main)
