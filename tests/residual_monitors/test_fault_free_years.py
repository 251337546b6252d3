"""Pooled counts of fault-free plant-years: what is held against the charts, and what chance still explains."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.fault_free_years import figures_of


def record(alarms: int, years: float = 10.0) -> dict[str, Any]:
    return {
        "years": years,
        "promised": {"fitted": {"cusum": 4.0 * years, "flatline": 0.1 * years}},
        "rang": {"fitted": {"cusum": alarms}},
    }


def test_runs_are_added_up_before_they_are_judged() -> None:
    found = figures_of([record(20), record(50)])
    assert found["fitted_plant_years"]["value"] == 20.0
    cusum, everything = found["fitted_cusum"], found["fitted_all"]
    assert (cusum["alarms"], cusum["promised"], cusum["holds"]) == (70, 80.0, True)
    assert everything["value"] == pytest.approx(70 / 82)
    # The exact interval of a count of 70 is 54.57 to 88.44 in tables of Poisson limits.
    assert [80 * x for x in cusum["interval"]] == pytest.approx([54.57, 88.44], abs=0.01)


def test_quiet_and_loud_sets_fall_short_and_few_alarms_say_nothing() -> None:
    assert figures_of([record(20)])["fitted_all"]["holds"] is False  # half of what was promised
    assert figures_of([record(82)])["fitted_cusum"]["holds"] is False  # more than twice
    few = figures_of([record(1, years=0.5)])
    assert few["fitted_cusum"]["holds"] is None
    assert figures_of([record(15, years=0.5)])["fitted_cusum"]["holds"] is False  # chance does not explain that
