"""Days of an air handler that the project's forms were not written for: what rings on the first day, and is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fdd.diagnosis.equipment import Knowledge, Verdict, examine, judge_day, teach
from fdd.models.equipment.air_handler import AIR_HANDLER
from fdd.models.expectation import Day
from tests.diagnosis.air_days import Plant, air_day

BUDGET = 2.0


def verdict(day: Day, knowledge: Knowledge | None = None) -> Verdict:
    return judge_day(AIR_HANDLER, examine(AIR_HANDLER, day), knowledge or Knowledge(), BUDGET)


@pytest.mark.parametrize("outside", [-5.0, 5.0, 12.0, 20.0, 30.0])
def test_a_healthy_first_day_is_quiet(outside: float) -> None:
    for seed in range(4):
        found = verdict(air_day(Plant(), outside, seed))
        assert found.judged
        assert not found.rings, [(t.statistic.key, t.ratio) for t in found.ringing]


@pytest.mark.parametrize(
    ("plant", "outside", "actuator"),
    [
        (Plant(heat_leak=0.3), 14.0, "heating valve"),
        (Plant(heat=0.9), 12.0, "heating valve"),
        (Plant(heat=0.0), -22.0, "heating"),
        (Plant(cool=0.9), 5.0, "cooling valve"),
        (Plant(cool=0.0), 30.0, "cooling"),
        (Plant(damper=1.0), -8.0, "outdoor air damper"),
        (Plant(damper=0.0), 8.0, "outdoor air damper"),
        (Plant(bias={"T_mixed": 6.0}), 12.0, "mixed air sensor"),
    ],
)
def test_a_fault_is_seen_on_the_first_day_and_its_place_is_named(plant: Plant, outside: float, actuator: str) -> None:
    found = verdict(air_day(plant, outside, seed=1))
    assert found.rings
    assert found.causes[0].name.startswith(actuator), [(c.name, c.probability) for c in found.causes]
    assert all(check.code == "check" for check in found.causes[0].checks)
    assert sum(c.probability for c in found.causes) == pytest.approx(1.0, abs=0.06)


def test_five_normal_days_show_a_leak_that_the_first_day_hides() -> None:
    small = air_day(Plant(heat_leak=0.06), 14.0, seed=9)
    assert not verdict(small).rings
    normal = [
        examine(AIR_HANDLER, air_day(Plant(), outside, seed))
        for seed, outside in enumerate((10.0, 12.0, 14.0, 16.0, 13.0, 15.0))
    ]
    assert teach(AIR_HANDLER, normal[:4]).rows.tests == {}
    knowledge = teach(AIR_HANDLER, normal)
    found = verdict(small, knowledge)
    assert found.rings
    assert found.causes[0].name.startswith("heating valve")
    assert not any(verdict(air_day(Plant(), 13.5, seed), knowledge).rings for seed in range(20, 24))


def test_knowledge_survives_storage_to_the_bit() -> None:
    normal = [examine(AIR_HANDLER, air_day(Plant(), 12.0 + k, k)) for k in range(5)]
    knowledge = teach(AIR_HANDLER, normal)
    again = Knowledge.of(json.loads(json.dumps(knowledge.document())))
    day = air_day(Plant(cool_leak=0.05), 8.0, 7)
    assert verdict(day, again) == verdict(day, knowledge)


def test_without_set_points_damper_and_mixed_air_what_is_left_is_judged() -> None:
    full = air_day(Plant(cool=0.9), 5.0, 1)
    few = Day(full.time, {r: full.values[r] for r in ("T_supply", "fan", "cool", "heat")}, full.step)
    assert verdict(few).tests == () or not verdict(few).rings
    some = Day(full.time, {r: full.values[r] for r in ("T_supply", "fan", "cool", "heat", "T_mixed")}, full.step)
    assert verdict(some).rings


def test_a_day_without_readings_is_not_judged() -> None:
    full = air_day(Plant(), 12.0)
    empty = Day(full.time, {r: np.full(len(full.time), np.nan) for r in full.values}, full.step)
    assert not verdict(empty).judged


def test_what_was_learned_in_one_season_is_not_held_against_another() -> None:
    cold = enumerate((-4.0, -2.0, 0.0, 1.0, 2.0, 3.0))
    winter = [examine(AIR_HANDLER, air_day(Plant(), outside, seed)) for seed, outside in cold]
    knowledge = teach(AIR_HANDLER, winter)
    assert any(b.days == 6 for b in knowledge.rows.tests.values())
    for outside in (12.0, 20.0, 28.0):
        found = verdict(air_day(Plant(), outside, 40), knowledge)
        assert not found.rings
        warm = [t for t in found.tests if t.statistic.drivers["T_out"] > 10.0]
        assert warm
        assert {t.learned_days for t in warm} == {0}
