"""Killed at random moments, the service loses no row, doubles none, and changes none."""

from __future__ import annotations

import pytest

from benchmarks.doors.kills import measure


@pytest.mark.slow
def test_kills_in_mid_stream_recovery_and_checkpoint_change_no_row() -> None:
    stages = ("stream", "recovery", "checkpoint")
    found = measure(24, seed=3, stages=stages)
    assert found["kills"] == 24
    assert min(found[f"kills in {stage}"] for stage in stages) >= 6
    assert {k: n for k, n in found.items() if k.startswith("wrong ") and n} == {}
    assert found["rows"] > 10_000
