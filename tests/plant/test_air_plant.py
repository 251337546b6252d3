"""The simulated air handler: how it works in health, what its faults do to it, and that the engine names them."""

from __future__ import annotations

from functools import cache

import pandas as pd
import pytest

from benchmarks.air_plant import AIR, CASES, ONSET, START, known, learned, watch
from fdd.plant.air_plant import AIR_STEP, air_plant
from fdd.plant.faults import DAY, PlantFault
from fdd.plant.network import PlantError
from fdd.plant.scenario import Scenario, simulate

BY_TITLE = {case.title: case for case in CASES}
DAYS = 6.0


@cache
def run(title: str) -> pd.DataFrame:
    """Six days of May with hours of cooling."""
    fault = BY_TITLE[title].fault
    return simulate(Scenario("2024-05-13", DAYS, AIR_STEP, 11, (fault,) if fault else ()), plant=AIR)


def after(title: str) -> pd.DataFrame:
    """From the onset on."""
    return run(title).iloc[round(ONSET * DAY / AIR_STEP) :]


def test_a_healthy_week_heats_cools_freely_and_cools_and_keeps_its_set_point():
    month = simulate(Scenario(START, 28.0, AIR_STEP, 5), plant=AIR)
    on = month[month["schedule.fan"] > 0]
    steady = on[on.index.hour >= 8]
    assert (steady["ahu.T_supply"] - 18.0).abs().median() < 0.5
    for command in ("ahu.heat", "ahu.cool"):
        assert (on[command] > 0.02).mean() > 0.02
        assert (month[month["schedule.fan"] == 0][command] == 0).all()
    assert (on["ahu.damper"] > 0.55).mean() > 0.2
    lowest = on[["weather.T_out", "room.T_return"]].min(axis=1)
    highest = on[["weather.T_out", "room.T_return"]].max(axis=1)
    inside = (steady["ahu.T_mixed"] > lowest[steady.index] - 0.5) & (
        steady["ahu.T_mixed"] < highest[steady.index] + 0.5
    )
    assert inside.mean() > 0.98


def test_nothing_changes_before_the_onset():
    rows = round(ONSET * DAY / AIR_STEP)
    for case in CASES:
        assert run(case.title)[:rows].equals(run("healthy")[:rows]), case.title


def test_a_leak_warms_the_coil_while_the_fan_stands_and_costs_cold_water_while_it_runs():
    leaking, healthy = after("heating valve leaks, 5 %"), after("healthy")
    still = healthy["schedule.fan"] == 0
    assert (leaking - healthy)[still]["ahu.T_mixed"].mean() > 0.5
    assert (leaking - healthy)[~still]["ahu.cool"].mean() > 0.02


def test_a_stuck_damper_lets_through_what_it_did_whatever_is_asked():
    def share(fault: PlantFault | None, asked_low: float, asked_high: float) -> float:
        """Outdoor air in the mixed air while the damper is asked to be so far open, from the onset on."""
        f = simulate(Scenario(START, 28.0, AIR_STEP, 12, (fault,) if fault else ()), plant=AIR)
        f = f.iloc[round(ONSET * DAY / AIR_STEP) :]
        cold = f["weather.T_out"] < f["room.T_return"] - 3
        asked = f["ahu.damper"].between(asked_low, asked_high) & (f["schedule.fan"] > 0) & (f.index.hour >= 9)
        part = f[asked & cold]
        assert len(part) > 50
        cooled, outdoor = part["room.T_return"] - part["ahu.T_mixed"], part["room.T_return"] - part["weather.T_out"]
        return float((cooled / outdoor).mean())

    fault = BY_TITLE["outdoor air damper stuck"].fault
    assert share(None, 0.9, 1.0) - share(None, 0.45, 0.6) > 0.25
    assert abs(share(fault, 0.9, 1.0) - share(fault, 0.45, 0.6)) < 0.08


def test_a_fouled_coil_asks_for_more_cold_water():
    fouled, healthy = after("cooling coil fouled, 30 %"), after("healthy")
    assert (healthy["ahu.cool"] > 0.05).sum() > 100
    assert fouled["ahu.cool"].mean() > 1.1 * healthy["ahu.cool"].mean()


@pytest.mark.parametrize("target", ["ahu", "ahu.n_cool", "control", "roof.leak_heat"])
def test_a_leak_names_the_valves_it_can_be_at(target):
    with pytest.raises(PlantError, match=r"ahu\.leak_heat"):
        simulate(Scenario(START, 0.1, AIR_STEP, 1, (PlantFault("leak", target, 0.0, 0.1),)), plant=AIR)


def test_the_plant_measures_commands_and_not_what_obeys_them():
    plant = air_plant()
    assert plant.sensors["ahu.damper"].source == "control.damper"
    assert plant.wires["ahu.damper"] == "damper.opening"


@pytest.mark.parametrize("title", ["heating valve leaks, 2 %", "outdoor air damper stuck", "cooling coil fouled, 30 %"])
def test_the_engine_alarms_the_air_handler_and_names_the_part(title):
    case = BY_TITLE[title]
    found = watch(case, 11, known(), DAYS)
    assert found.before == 0
    assert found.alarm is not None
    assert found.alarm.component == "ahu"
    assert found.delay < 1.5
    assert found.named == case.cause, found.alarm.causes


def test_the_engine_is_quiet_about_a_healthy_air_handler():
    found = watch(BY_TITLE["healthy"], 11, known(), DAYS)
    assert found.alarm is None
    assert found.before == 0


@pytest.mark.slow
@pytest.mark.parametrize("title", list(BY_TITLE))
def test_faults_are_named_with_a_fitted_baseline(title):
    case, found = BY_TITLE[title], watch(BY_TITLE[title], 11, learned(5))
    assert found.before == 0
    assert found.named == case.cause, found.alarm
