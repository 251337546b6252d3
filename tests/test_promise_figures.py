"""What ``benchmarks.promise`` makes of the commands' answers."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from benchmarks import foreign_plants, promise, promise_runs
from benchmarks.promise import BEGUN

GIVEN = Namespace(budgets=[2.0], faults=["heater-20"])


def alarm(component: str, day: float, cause: str, likelihood: float = 0.9, kind: str = "plant") -> dict[str, Any]:
    """Raised so many days after the fault's beginning."""
    raised = (BEGUN + pd.Timedelta(days=day)).strftime("%Y-%m-%dT%H:%M:%SZ")
    named = [{"name": cause, "likelihood": likelihood}]
    return {"component": component, "raised": raised, "kind": kind, "rang_as": named, "chart": "day"}


def audit(*alarms: dict[str, Any], promised: float = 1.0, judged: float = 0.5) -> dict[str, Any]:
    row = {"alarms": len(alarms), "promised": promised, "share_judged": judged}
    months = {"2026-01": row, "2026-04": {"alarms": 0, "promised": 0.0, "share_judged": 0.0}}
    return {"alarms": list(alarms), "charts": {"day": row}, "months": months, "all": row}


def site(healthy: dict[str, Any], faulty: dict[str, Any], foretold: float | None) -> dict[str, Any]:
    row = {"fault": "power P_heat less than its meter says", "unit": "1", "size": foretold, "reason": ""}
    fit = {"baselines": [{"component": c, "diagnostics": {"probation": {"foretold": [row]}}} for c in ("h1", "h10")]}
    plants = ("h1", "h10")
    return {"group": "house-dev", "name": "x", "plants": plants, "fit": fit, "audit-2": healthy, "heater-20": faulty}


@pytest.fixture
def figures() -> dict[str, Any]:
    """Two houses: one healthy alarm; the fault is found in one house after 3 days and in the other after 25."""
    healthy = audit(alarm("h1", 5, "bias", 0.6), promised=2.0)
    faulty = audit(alarm("h10", 25, "model"), alarm("h1", -2, "bias"), alarm("h1", 1, "x", kind="model"),
                   alarm("h1", 3, "heater"))  # fmt: skip
    return promise.figures_of([site(healthy, faulty, 0.1)], GIVEN)


def test_promise_counts_alarms_of_promised_with_the_exact_interval(figures: dict[str, Any]) -> None:
    whole = figures["house-dev_2_all"]
    assert (whole["value"], whole["alarms"], whole["holds"]) == (0.5, 1, True)
    assert whole["interval"] == pytest.approx([0.0253 / 2, 5.572 / 2], abs=1e-3)  # Garwood's table for one event
    assert figures["house-dev_2_winter"]["alarms"] == 1
    assert figures["house-dev_2_spring"]["value"] is None
    assert figures["house-dev_2_judged"]["value"] == pytest.approx(0.5)
    assert figures["house-dev_2_plants_ringing"]["value"] == 1
    assert figures["house-dev_2_accusing"]["value"] == 1


def test_detection_counts_the_first_alarm_of_the_plant_after_the_onset(figures: dict[str, Any]) -> None:
    found = {days: figures[f"house-dev_heater-20_found_{days}"]["value"] for days in (7, 20, 30)}
    assert found == {7: 1, 20: 1, 30: 2}
    right = figures["house-dev_heater-20_right"]
    assert (right["value"], right["unit"]) == (1, "of 2")
    assert right["named"] == {"heater": 1, "model": 1}
    assert figures["house-dev_healthy_ringing_7"]["value"] == 1


def test_foretold_faults_are_counted_apart_from_declined_ones(figures: dict[str, Any]) -> None:
    kept = figures["house-dev_heater-20_foretold_found"]
    assert (kept["value"], kept["unit"], kept["holds"]) == (2, "of 2", True)
    declined = promise.figures_of([site(audit(), audit(alarm("h1", 3, "heater")), None)], GIVEN)
    assert declined["house-dev_heater-20_declined_found"]["unit"] == "of 2"
    assert declined["house-dev_heater-20_foretold_found"]["unit"] == "of 0"


def test_a_site_that_could_not_be_fitted_is_told_and_counts_nowhere(figures: dict[str, Any]) -> None:
    refused = {"group": "house-dev", "name": "y", "plants": ("h2",), "fit": {"error": "too short"}}
    found = promise.figures_of([refused], GIVEN)
    assert found == {"house-dev_plants": {"value": 0, "unit": "plants watched", "target": "", "holds": None,
                                          "refused": {"y": "too short"}}}  # fmt: skip


def test_effects_of_a_group_are_the_same_in_every_run_and_differ_between_groups() -> None:
    house = foreign_plants.HOUSE
    drawn = [foreign_plants.effects(house, seed) for seed in range(1, 21, 4)]
    assert drawn == [foreign_plants.effects(house, seed) for seed in range(1, 21, 4)]
    assert len({str(d) for d in drawn}) > 1
    assert [list(g) for g in foreign_plants.groups(house, range(1, 6))] == [[1, 2, 3, 4], [5]]


@pytest.mark.slow
def test_an_answer_that_is_there_is_not_asked_for_again(tmp_path: Path) -> None:
    (plant, *_) = promise_runs.own(tmp_path)
    first = promise_runs._fdd(tmp_path, "check", "check", str(plant.site))
    (tmp_path / "check.json").write_text('{"kept": true}')
    assert "kept" not in first
    assert promise_runs._fdd(tmp_path, "check", "check", str(plant.site)) == {"kept": True}
