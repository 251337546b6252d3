"""Killed at a hundred random moments, the service loses no row, doubles none, and changes none."""

from __future__ import annotations

import pytest

from benchmarks.doors.kills import STAGES, measure


@pytest.mark.slow
def test_kills_in_mid_stream_recovery_checkpoint_and_rebase_change_no_row() -> None:
    found = measure(100, seed=3)
    assert found["kills"] == 100
    assert min(found[f"kills in {stage}"] for stage in STAGES) >= 10
    assert {k: n for k, n in found.items() if k.startswith("wrong ") and n} == {}
    assert found["rows"] > 10_000
