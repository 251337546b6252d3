"""Which tests fail if a line of the core is changed? Mutants of core files, each run against the nearest tests.

A mutant changes one place: a comparison, an arithmetic or boolean operator, a number, or a negation. It is killed where
the tests that stand nearest to its file fail; numba's and the kernels' caches follow the source's text, so that none is
stale. Survivors that change nothing that can be seen are listed in ``benchmarks/mutants.md`` with the reason.

    python -m benchmarks.mutants --quick
    python -m benchmarks.mutants --only cusum.py --sample 20
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.progress import track

ROOT = Path(__file__).resolve().parents[1]
SEED = 14
TARGET = 0.85
CORE: dict[str, tuple[str, ...]] = {
    "fdd/residual_monitors/cusum.py": ("tests/residual_monitors/test_cusum.py",),
    "fdd/residual_monitors/flatline.py": ("tests/residual_monitors/test_flatline.py",),
    "fdd/residual_monitors/score.py": ("tests/residual_monitors/test_score.py",),
    "fdd/residual_monitors/predictive.py": (
        "tests/residual_monitors/test_uncertain_scale.py",
        "tests/residual_monitors/test_score.py",
    ),
    "fdd/residual_monitors/budget.py": ("tests/residual_monitors/test_budget.py",),
    "fdd/residual_monitors/run_length.py": ("tests/residual_monitors/test_run_length.py",),
    "fdd/chiller_eiv/drift.py": ("tests/chiller_eiv/test_drift.py",),
    "fdd/chiller_eiv/estimators.py": ("tests/chiller_eiv/test_estimators.py",),
    "fdd/chiller_eiv/steady_state.py": ("tests/chiller_eiv/test_steady_state.py",),
    "fdd/greybox/filter_bank.py": ("tests/greybox/test_filter_bank.py",),
    "fdd/greybox/likelihood.py": ("tests/greybox/test_kernels.py", "tests/greybox/test_fit.py"),
    "fdd/greybox/fit.py": ("tests/greybox/test_fit.py", "tests/greybox/test_never_invents.py"),
    "fdd/service/alarms/life.py": ("tests/service/test_alarm_life.py",),
    "fdd/service/alarms/book.py": ("tests/service/test_alarms.py", "tests/service/test_alarm_life.py"),
    "fdd/service/filtering/framing.py": ("tests/service/test_framing.py",),
    "fdd/service/filtering/filters.py": ("tests/service/test_engine.py",),
    "fdd/service/engine/engine.py": ("tests/service/test_engine.py", "tests/service/test_alarms.py"),
}
"""Core file to the tests that stand nearest to it."""

_COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
_COMPUTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
_JOINED = {ast.And: ast.Or, ast.Or: ast.And}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one line; ``text`` is the whole file with it."""

    file: str
    line: int
    before: str
    after: str
    text: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant."""

    file: str
    line: int
    before: str
    after: str
    killed: bool


def mutants(file: str) -> list[Mutant]:
    """Every mutant of a file, in order."""
    source = (ROOT / file).read_text(encoding="utf-8")
    return list(_mutants(file, source))


def _mutants(file: str, source: str) -> Iterator[Mutant]:
    tree = ast.parse(source)
    skipped = {id(n) for n in _told(tree)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        for other in _changed(node):
            segment = ast.get_source_segment(source, node)
            if segment is None or not isinstance(node, ast.expr):
                continue
            yield Mutant(file, node.lineno, segment, ast.unparse(other), _replaced(source, node, ast.unparse(other)))


def _told(tree: ast.AST) -> Iterator[ast.AST]:
    """What is words, not work: error texts and annotations."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise | ast.JoinedStr):
            yield from ast.walk(node)
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if part is not None:
                yield from ast.walk(part)


def _changed(node: ast.AST) -> Iterator[ast.expr]:
    other = copy.deepcopy(node)
    if isinstance(other, ast.Compare) and type(other.ops[0]) in _COMPARED:
        other.ops[0] = _COMPARED[type(other.ops[0])]()
        yield other
    elif isinstance(other, ast.BinOp) and type(other.op) in _COMPUTED:
        other.op = _COMPUTED[type(other.op)]()
        yield other
    elif isinstance(other, ast.BoolOp):
        other.op = _JOINED[type(other.op)]()
        yield other
    elif isinstance(other, ast.UnaryOp) and isinstance(other.op, ast.Not):
        yield other.operand
    elif isinstance(other, ast.Constant) and type(other.value) in (int, float):
        other.value = other.value + 1 if type(other.value) is int else other.value * 1.5 + 0.25
        yield other


def _replaced(source: str, node: ast.expr, text: str) -> str:
    lines = source.splitlines(keepends=True)
    first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
    head = lines[first].encode()[: node.col_offset].decode()
    tail = lines[last].encode()[node.end_col_offset :].decode()
    return "".join([*lines[:first], f"{head}({text}){tail}", *lines[last + 1 :]])


def judge(mutant: Mutant, tree: Path, timeout: float) -> Outcome:
    """Run the nearest tests against one mutant in a copy of the project; no end within ``timeout`` [s] is a kill."""
    target = tree / mutant.file
    before = target.read_text(encoding="utf-8")
    target.write_text(mutant.text, encoding="utf-8")
    try:
        killed = not passes(CORE[mutant.file], tree, timeout)
    finally:
        target.write_text(before, encoding="utf-8")
    return Outcome(mutant.file, mutant.line, mutant.before, mutant.after, killed)


def passes(tests: Sequence[str], tree: Path, timeout: float) -> bool:
    """Whether the tests pass in a tree."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / "numba")}
    try:
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two mutants a file")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--sample", type=int, default=12, help="mutants a file, drawn at random")
    parser.add_argument("--only", default="", help="files whose path holds this")
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds after which a mutant counts as killed")
    options = parser.parse_args()
    files = [f for f in CORE if options.only in f]
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv", "var", "__pycache__", ".mypy_cache"))
        chosen = []
        for file in files:
            if not passes(CORE[file], tree, 10 * options.timeout):
                raise SystemExit(f"{file}: its nearest tests fail without any mutant; mend them first")
            found = mutants(file)
            count = min(len(found), 2 if options.quick else options.sample)
            chosen += [found[i] for i in sorted(rng.choice(len(found), count, replace=False))]
        outcomes = [judge(m, tree, options.timeout) for m in track(chosen, "mutants", disable=options.json)]
    tell(outcomes, options.json)


def tell(outcomes: Sequence[Outcome], as_json: bool) -> None:
    """By folder: killed and survived; then the survivors."""
    folders: dict[str, list[bool]] = {}
    for o in outcomes:
        folders.setdefault(str(Path(o.file).parent), []).append(o.killed)
    table = {f: {"killed": sum(k), "survived": len(k) - sum(k), "share": sum(k) / len(k)} for f, k in folders.items()}
    survivors = [asdict(o) for o in outcomes if not o.killed]
    if as_json:
        print(json.dumps({"folders": table, "survivors": survivors, "target": TARGET, "seed": SEED}))
        return
    for folder, row in table.items():
        mark = "holds" if row["share"] >= TARGET else "FALLS SHORT"
        print(f"{folder:<28} killed {row['killed']:>3}  survived {row['survived']:>3}  {row['share']:.0%}  {mark}")
    for s in survivors:
        print(f"survived: {s['file']}:{s['line']}: {s['before']}  ->  {s['after']}")


if __name__ == "__main__":
    main()
