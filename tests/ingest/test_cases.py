"""Folders in ``ingest/*/cases``: a site file and data, and what must come of it (by hand) or the error it gives."""

from __future__ import annotations

import csv
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from fdd.config import ConfigError, load_site
from ingest.mapping import PointMap
from ingest.source import Context, Refused, make_source

ROOT = Path(__file__).resolve().parents[2]
CASES = sorted((ROOT / "ingest").glob("*/cases/*"))

Row = tuple[str, int, float]


def _run(folder: Path) -> list[Row]:
    site = load_site(folder / "site.yaml")
    rows: list[Row] = []
    for options in site.sources:
        points = PointMap(site.points_of(options))
        source = make_source(options, Context(site.zone, points.columns, site.folder))
        source.open()
        for batch in map(points, source.batches()):
            names = [batch.names[p] for p in batch.point]
            rows += zip(names, batch.time.tolist(), batch.value.tolist(), strict=True)
        source.close()
    return rows


def _expected(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return [(row["point"], _nanoseconds(row["time"]), float(row["value"] or "nan")) for row in csv.DictReader(file)]


def _nanoseconds(text: str) -> int:
    moment = datetime.fromisoformat(text)
    return int(moment.timestamp()) * 10**9 + moment.microsecond * 1000


def test_there_are_cases() -> None:
    assert len(CASES) >= 7


@pytest.mark.parametrize("folder", CASES, ids=lambda path: f"{path.parents[1].name}-{path.name}")
def test_case_gives_what_it_says(folder: Path) -> None:
    error = folder / "error.txt"
    if error.exists():
        with pytest.raises((ConfigError, Refused)) as caught:
            _run(folder)
        assert error.read_text(encoding="utf-8").strip() in str(caught.value)
        return
    got, expected = _run(folder), _expected(folder / "expected.csv")
    assert [r[:2] for r in got] == [r[:2] for r in expected]
    np.testing.assert_allclose([r[2] for r in got], [r[2] for r in expected], rtol=1e-8, atol=1e-9)
