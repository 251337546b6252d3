"""The real server, and Grafana's own types."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.store.influxd import influxd, influxd_server

__all__ = ["grafana_schema", "influxd", "influxd_server"]
HERE = Path(__file__).parent / "grafana_schema"


@pytest.fixture(scope="session")
def grafana_schema() -> Path:
    """Folder with the validator installed, outside the tree; skips where there is no npm."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("no npm here: Grafana's types cannot be installed")
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hvac-fdd" / "grafana-schema"
    cache.mkdir(parents=True, exist_ok=True)
    wanted = (HERE / "package.json").read_bytes()
    stamp = cache / "installed.json"
    if not stamp.is_file() or stamp.read_bytes() != wanted:
        (cache / "package.json").write_bytes(wanted)
        (cache / "dashboard.schema.json").unlink(missing_ok=True)
        command = [
            "npm",
            "install",
            "--no-package-lock",
            "--ignore-scripts",
            "--no-audit",
            "--no-fund",
            "--loglevel=error",
        ]
        subprocess.run(command, cwd=cache, check=True, timeout=300)
        stamp.write_bytes(wanted)
    shutil.copy(HERE / "validate.mjs", cache)
    return cache
