"""The README's path from the sample to a verdict, word for word."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def commands() -> list[str]:
    """The lines of the README's first path."""
    section = (ROOT / "README.md").read_text().split("## From an export to a verdict")[1].split("\n## ")[0]
    return re.findall(r"^    (fdd .+)$", section, re.M)


@pytest.mark.slow
def test_the_path_works_as_it_is_written(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "data", tmp_path / "data")
    said = {}
    for line in commands():
        words = [sys.executable, "-m", *shlex.split(line)]
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(
            words, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
        said[line.split()[1]] = done.stdout
    assert re.search(r"hx: alarm\n  hx\.1 \(raised, 2024-11-\d\d", said["study"])
    assert "What to check" in said["explain"]
    assert "hx" in (tmp_path / "var" / "report.html").read_text()
    assert (tmp_path / "var" / "after.html").exists()
