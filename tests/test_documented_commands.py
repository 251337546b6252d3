"""Every `fdd` command line that the documents and the help texts print is one that the program understands."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer.main

from fdd.cli import app
from fdd.store.influx_setup import main as influx_setup

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "deploy").rglob("*.md"))]
FDD: Any = typer.main.get_command(app)


class MisunderstoodError(Exception):
    """The program would refuse this command line."""


def lines_of(page: Path) -> list[str]:
    """Commands that stand in code blocks: whole ones, without comment and prompt."""
    text = page.read_text().replace("\\\n", " ")
    found = re.findall(r"^(?: {4,}|\t)?(?:\$ )?((?:\S*/)?(?:fdd|python -m) [^#\n]+)", text, re.M)
    return [part.strip().removeprefix("and ") for line in found for part in re.split(r"; | && ", line)]


def spans_of(page: Path) -> list[str]:
    """Commands within a sentence: often only the verb, or with an option."""
    return re.findall(r"`(fdd [a-z][^`\n]*)`", page.read_text())


def examples() -> list[str]:
    found: list[str] = []

    def walk(command: Any) -> None:
        found.extend(re.findall(r"^\$ (fdd .+)$", command.epilog or "", re.M))
        for child in getattr(command, "commands", {}).values():
            walk(child)

    walk(FDD)
    return found


def understood(line: str, *, whole: bool) -> None:
    """Parse as the program would; ``whole``: nothing that it needs may be missing.

    Raises
    ------
    MisunderstoodError : it would refuse
    """
    command: Any = FDD
    words = shlex.split(line)[1:]
    context = command.make_context("fdd", list(words), resilient_parsing=True)
    while hasattr(command, "commands"):
        name = next((w for w in words if not w.startswith("-")), None)
        if name is None:
            assert not whole or words, f"{line}: no verb"
            return
        child = command.get_command(context, name)
        if child is None:
            raise MisunderstoodError(f"there is no verb {name!r}")
        command, words = child, words[words.index(name) + 1 :]
    if whole:
        try:
            command.make_context("fdd", list(words))
        except Exception as refused:
            raise MisunderstoodError(f"{line}: {refused}") from refused
        return
    known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    unknown = [w for w in words if w.startswith("--") and w not in known]
    if unknown:
        raise MisunderstoodError(f"no option {unknown[0]}")


WHOLE = [
    (p.relative_to(ROOT).as_posix(), line) for p in PAGES for line in lines_of(p) if line.split("/")[-1][:3] == "fdd"
]
SPANS = [(p.relative_to(ROOT).as_posix(), line) for p in PAGES for line in spans_of(p)]


@pytest.mark.parametrize(("page", "line"), WHOLE, ids=lambda v: str(v)[:60])
def test_a_command_line_is_understood(page: str, line: str) -> None:
    understood(line, whole=True)


@pytest.mark.parametrize(("page", "line"), SPANS, ids=lambda v: str(v)[:60])
def test_a_verb_within_a_sentence_exists(page: str, line: str) -> None:
    understood(line, whole=False)


def test_examples_of_the_help_texts_are_understood() -> None:
    assert len(examples()) > 15
    for line in examples():
        understood(line, whole=True)


def test_enough_is_found_and_wrong_lines_are_refused() -> None:
    assert len(WHOLE) > 10
    assert len(SPANS) > 10
    for wrong in (
        "fdd fitt house.yaml",
        "fdd fit house.yaml --untill 2026-01-01",
        "fdd report",
        "fdd alarms ack a.yaml",
    ):
        with pytest.raises(MisunderstoodError):
            understood(wrong, whole=True)


def test_modules_that_the_documents_run_exist_with_the_options_of_the_set_up() -> None:
    lines = [line for p in PAGES for line in lines_of(p) if "python -m " in line]
    modules = {re.search(r"python -m ([\w.]+)", line).group(1) for line in lines}  # type: ignore[union-attr]
    assert "fdd.store.influx_setup" in modules
    assert [m for m in modules if importlib.util.find_spec(m) is None] == []
    setup = typer.Typer()
    setup.command()(influx_setup)
    known = {o for p in typer.main.get_command(setup).params for o in p.opts}
    used = {o for line in lines if "influx_setup" in line for o in re.findall(r"--[\w-]+", line)}
    assert used
    assert used <= known | {"--help"}
