"""Every kind of equipment by days made by hand: what physics forbids rings, what it allows does not."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.equipment import Knowledge, Verdict, examine, judge_day
from fdd.models.declare import ModelError
from fdd.models.equipment import KINDS
from fdd.models.expectation import Day, EquipmentModel, Row
from fdd.units import conversion

N, STEP = 288, 300.0
HOUR = np.arange(N) * STEP / 3600
ON = (HOUR >= 6) & (HOUR < 18)


def verdict(kind: str, readings: dict[str, np.ndarray | float]) -> Verdict:
    rng = np.random.default_rng(1)
    values = {
        r: np.full(N, float(x)) if np.ndim(x) == 0 else np.asarray(x, dtype=float)
        for r, x in readings.items()
    }  # fmt: skip
    noisy = {r: x + 0.05 * rng.standard_normal(N) if r.startswith("T_") else x for r, x in values.items()}
    model = KINDS[kind]
    assert set(noisy) <= set(model.by_symbol)
    return judge_day(model, examine(model, Day(np.arange(N) * STEP, noisy, STEP)), Knowledge(), 1.0)


BOX = {"T_room": 22.0, "flow": np.where(ON, 0.3, 0.0), "flow_set": np.where(ON, 0.3, 0.0),
       "damper": np.where(ON, 0.5, 0.0), "heat": 0.0, "T_supply": 14.6, "T_entering": 14.0, "T_room_set_cool": 24.0,
       "T_room_set_heat": 20.0}  # fmt: skip
COIL = {"T_supply": np.where(ON, 23.0, 22.0), "T_mixed": 22.0, "fan": np.where(ON, 0.7, 0.0), "cool": 0.0, "heat": 0.0}
BURNS = {"T_supply": np.where(ON, 70.0, 70.0 - 2 * (HOUR % 12)), "T_return": np.where(ON, 55.0, 45.0),
         "fire": np.where(ON, 0.6, 0.0), "T_set": 70.0, "flow": np.where(ON, 1.0, 0.0),
         "P_fuel": np.where(ON, 70e3, 0.0)}  # fmt: skip
PUMPS_HEAT = {"T_supply": 40.0, "T_return": 35.0, "T_source_in": 5.0, "T_source_out": 2.0, "compressor": ON * 1.0,
              "P_el": np.where(ON, 2000.0, 20.0), "Q_heat": np.where(ON, 7500.0, 0.0)}  # fmt: skip
TOWER = {"T_out_water": 26.0, "T_in_water": 31.0, "T_wet_bulb": 21.5, "fan": np.where(ON, 1.0, 0.5), "T_set": 26.0}
LOOP = {"speed": np.where(ON, 1.0, 0.0), "dp": np.where(ON, 4e4, 0.0), "dp_set": 4e4, "flow": np.where(ON, 2.0, 0.0)}
ROOF = {"T_supply": np.where(ON, 13.0, 21.0), "T_return": 22.0, "T_out": 5.0, "fan": ON * 0.8, "cool": 0.0, "heat": 0.0,
        "damper": ON * 0.5, "T_supply_set": 13.0}  # fmt: skip

HEALTHY = {
    "vav_box": BOX, "fan_coil": COIL, "boiler": BURNS, "heat_pump": PUMPS_HEAT, "cooling_tower": TOWER,
    "pump_loop": LOOP, "rooftop_unit": ROOF,
}  # fmt: skip


@pytest.mark.parametrize("kind", HEALTHY)
def test_what_physics_allows_is_quiet(kind: str) -> None:
    found = verdict(kind, HEALTHY[kind])
    assert found.judged
    assert not found.rings, [(t.statistic.key, t.statistic.value) for t in found.ringing]


@pytest.mark.parametrize(
    ("kind", "changed", "causes"),
    [
        ("vav_box", {"T_supply": 24.0}, {"reheat leaks or is stuck open"}),
        ("vav_box", {"heat": 1.0, "T_supply": 14.0}, {"reheat gives no heat", "zone short of heating"}),
        ("vav_box", {"damper": ON * 1.0, "flow": ON * 0.1}, {"short of supply air", "damper stuck"}),
        ("vav_box", {"flow": 0.3}, {"damper leaks", "damper stuck"}),
        ("fan_coil", {"T_supply": np.where(ON, 31.0, 22.0)}, {"heating valve leaks", "heating valve stuck"}),
        ("fan_coil", {"heat": ON * 0.5, "cool": ON * 0.5, "T_supply": 22.5}, {"heating and cooling at the same time"}),
        ("rooftop_unit", {"T_supply": np.where(ON, 30.0, 21.0)}, {"heating valve leaks", "heating valve stuck"}),
        ("boiler", {"fire": ON * 1.0, "T_supply": 58.0, "P_fuel": ON * 15e3},
         {"boiler short of capacity", "burner gives no heat", "heat exchanger fouled"}),
        ("boiler", {"T_supply": np.where(ON, 70.0, 70.0 + 2 * (HOUR % 18))}, {"heat enters while the burner is off"}),
        ("boiler", {"P_fuel": ON * 160e3}, {"heat exchanger fouled"}),
        ("heat_pump", {"Q_heat": ON * 1500.0}, {"heat pump gives less heat for its power", "source gives no heat"}),
        ("heat_pump", {"P_el": 2000.0}, {"power taken while it is off"}),
        ("heat_pump", {"T_return": np.where(ON, 45.0, 35.0)}, {"compressor runs without effect"}),
        ("cooling_tower", {"T_out_water": 36.0, "T_in_water": 40.0},
         {"tower short of capacity", "tower fan without effect"}),
        ("cooling_tower", {"T_wet_bulb": 32.0}, {"tower water sensor wrong"}),
        ("pump_loop", {"dp": ON * 2e4}, {"pump short of pressure"}),
        ("pump_loop", {"flow": 2.0}, {"non-return valve leaks", "pump runs though off"}),
    ],
)  # fmt: skip
def test_what_physics_forbids_rings_and_is_named(
    kind: str, changed: dict[str, np.ndarray | float], causes: set[str]
) -> None:
    found = verdict(kind, {**HEALTHY[kind], **changed})
    assert found.rings
    assert found.causes[0].name in causes, [(c.name, c.probability) for c in found.causes]


def test_a_machine_that_cools_is_not_judged_as_one_that_heats() -> None:
    cooling = {
        **PUMPS_HEAT,
        "T_supply": 12.0,
        "T_return": 24.0,
        "T_source_in": 30.0,
        "T_source_out": 36.0,
        "heating": 0.0,
    }
    assert not verdict("heat_pump", cooling).rings
    assert verdict("heat_pump", {**cooling, "heating": 1.0}).rings


@pytest.mark.parametrize("kind", KINDS)
def test_every_row_cites_its_source_and_every_name_means_one_role(kind: str) -> None:
    model = KINDS[kind]
    assert all(r.source and (r.high or r.low) for r in model.rows)
    assert len({r.name for r in model.rows}) == len(model.rows)
    for role in model.roles:
        assert conversion(role.unit).si == role.unit
        assert all(model.symbol_of(name) is not None for name in role.names)
    assert all(f.checks and all(": " in c for c in f.checks) for f in model.faults)


def test_a_row_that_needs_an_unknown_role_is_refused() -> None:
    row = Row("odd", ("T_x",), lambda v: (v["T_x"], {}), "none", high="odd")
    with pytest.raises(ModelError, match="'T_x', which is no role"):
        EquipmentModel("odd", "Odd", (), (row,), ())
