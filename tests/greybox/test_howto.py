"""The how-to page is followed to the letter, in a copy of the repository."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fdd.greybox.validate import validate

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "howto" / "add-a-component.md").read_text(encoding="utf-8")


def blocks(kind: str) -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", TEXT, flags=re.S)


def test_the_declaration_and_its_trial_work_as_they_stand() -> None:
    space: dict[str, object] = {}
    for block in blocks("python"):
        exec(compile(block.replace("from __future__ import annotations\n", ""), "add-a-component.md", "exec"), space)
    result, true = space["result"], space["true"]
    errors = np.array(list(result.bse.values()))  # type: ignore[attr-defined]
    assert (np.abs(result.values - true) < 3 * errors).all()  # type: ignore[attr-defined]
    assert validate(result).passed  # type: ignore[arg-type]


@pytest.mark.slow
def test_every_step_leads_to_a_model_that_passes_the_tests_of_all_models(tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(ROOT, root, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "var"))
    (root / "fdd" / "models" / "tank.py").write_text(blocks("python")[0], encoding="utf-8")
    name, entry = blocks("registry")[0].splitlines()
    edit(root / "fdd" / "models" / "registry.py", "from fdd.models.thermostatic_valve", f"{name}\n")
    edit(root / "fdd" / "models" / "registry.py", "):\n    register(", f"{entry}\n")
    edit(root / "docs" / "nomenclature.md", "### thermostatic_valve", blocks("nomenclature")[0] + "\n")
    for file, table in (("component_cases", "CASES"), ("component_balances", "BALANCES"), ("fault_matrix", "FAULTS")):
        path = root / "benchmarks" / f"{file}.py"
        head = re.search(rf"^{table}\b.*= {{\n", path.read_text(encoding="utf-8"), flags=re.M)
        assert head is not None
        edit(path, head[0], blocks(table)[0], after=True)
    commands = [line.split() for line in re.findall(r"^    (python -m .*)$", TEXT, flags=re.M)]
    assert len(commands) == 3
    for _, *rest in commands:
        done = subprocess.run(
            [sys.executable, *rest], cwd=root, capture_output=True, text=True, timeout=900,
            env={**os.environ, "PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
    assert (root / "docs" / "models" / "tank.md").is_file()


def edit(path: Path, anchor: str, text: str, after: bool = False) -> None:
    """Put text before (or after) the first place where the anchor stands."""
    old = path.read_text(encoding="utf-8")
    assert anchor in old
    path.write_text(old.replace(anchor, anchor + text if after else text + anchor, 1), encoding="utf-8")
