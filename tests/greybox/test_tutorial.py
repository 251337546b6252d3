"""The tutorial on a real building prints the tables and draws the pictures of its page; needs the shared data."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorials" / "flexhouse.md"


@pytest.mark.slow
def test_the_tutorial_prints_what_its_page_shows(shared_data: Path, tmp_path: Path) -> None:
    record = shared_data / "flexhouse_prbs_5min.csv"
    done = subprocess.run(
        [sys.executable, "docs/tutorials/flexhouse.py", str(record), str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, timeout=300, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    page = PAGE.read_text(encoding="utf-8")
    shown = [line[4:] for line in page.splitlines() if line.startswith("    ") and "python " not in line]
    assert len(shown) >= 12
    assert [line for line in shown if line not in done.stdout] == []
    for picture in re.findall(r"\((flexhouse-\w+\.png)\)", page):
        assert (tmp_path / picture).stat().st_size > 10_000
        assert (PAGE.parent / picture).is_file()
