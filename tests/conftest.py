"""Where tests find what is not shipped with the project."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does; before numpy is loaded

import pytest

ROOT = Path(__file__).resolve().parents[1]


def _shared(folder: str) -> Path:
    path = Path(os.environ.get("FDD_SHARED", ROOT.parent / "shared")) / folder
    if not path.is_dir():
        pytest.skip(f"no reference {folder} here; set FDD_SHARED to the folder that holds {folder}/")
    return path


@pytest.fixture
def shared_data() -> Path:
    """Folder of measured data that may not be shipped; skips where it is missing."""
    return _shared("data")


@pytest.fixture
def shared_oracles() -> Path:
    """Folder of reference numbers; skips where it is missing."""
    return _shared("oracles")


@pytest.fixture
def oracle() -> Path:
    """Folder of the reference numbers shipped with the tests."""
    return ROOT / "tests" / "oracle"
