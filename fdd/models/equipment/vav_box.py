"""Variable-air-volume box, cooling only or with reheat by water or electricity, with or without a fan of its own.

Rows follow the alarms that ASHRAE Guideline 36-2021, 5.5.6 and 5.6.6, gives terminal units.
"""

from __future__ import annotations

import numpy as np

from fdd.models.equipment.residuals import at_least, at_most, both, difference, of_largest, short_of
from fdd.models.expectation import BoolArray, Day, EquipmentFault, EquipmentModel, Role, Row, Term

G36 = "ASHRAE Guideline 36-2021, 5.5.6, 5.6.6"
DAMPER, DAMPER_LEAK, SHORT = "damper stuck", "damper leaks", "short of supply air"
HEAT_LEAK, HEAT_STUCK = "reheat leaks or is stuck open", "reheat gives no heat"
METER, BIAS, WARM, COLD = (
    "air flow meter wrong",
    "discharge air sensor biased",
    "zone short of cooling",
    "zone short of heating",
)

ROLES = (
    Role("T_room", "degC", "zone air temperature", 0.6, True, ("Zone_Air_Temperature_Sensor", "zone air temp sensor")),
    Role("flow", "kg/s", "supply air flow", 0.0, False, ("Supply_Air_Flow_Sensor", "discharge air flow sensor")),
    Role(
        "flow_set",
        "kg/s",
        "supply air flow set point",
        0.0,
        False,
        ("Supply_Air_Flow_Setpoint", "discharge air flow sp"),
    ),
    Role("damper", "1", "damper position", 0.0, False, ("Damper_Position_Command", "air damper cmd")),
    Role(
        "heat",
        "1",
        "reheat valve or heater",
        0.0,
        False,
        ("Reheat_Valve_Command", "Heating_Command", "reheat valve cmd"),
    ),
    Role(
        "T_supply",
        "degC",
        "discharge air temperature",
        0.6,
        False,
        ("Discharge_Air_Temperature_Sensor", "discharge air temp sensor"),
    ),
    Role(
        "T_entering",
        "degC",
        "air from the air handler",
        0.8,
        False,
        ("Entering_Air_Temperature_Sensor", "entering air temp sensor"),
        driver=True,
    ),
    Role(
        "T_room_set_cool",
        "degC",
        "zone cooling set point",
        0.0,
        False,
        ("Zone_Air_Cooling_Temperature_Setpoint", "zone air cooling temp sp"),
    ),
    Role(
        "T_room_set_heat",
        "degC",
        "zone heating set point",
        0.0,
        False,
        ("Zone_Air_Heating_Temperature_Setpoint", "zone air heating temp sp"),
    ),
    Role(
        "fan_upstream",
        "1",
        "whether the air handler runs",
        0.0,
        False,
        ("Supply_Fan_Status", "discharge fan run sensor"),
    ),
)

FULL = both(at_least("damper", 0.95), at_least("flow_set", 0.0))


def shut_for_good(v: Day) -> BoolArray:
    """The damper is commanded shut because no air is wanted, not because little opening gives enough."""
    wanted = v.get("flow_set", 0.0)
    largest = np.nanmax(v.get("flow_set", 1.0), initial=0.0)
    return (v["damper"] <= 0.005) & (wanted <= 0.1 * largest)


BLOWS = at_least("flow", 1e-3)
DUCT = Term("duct", 1.2, "heat that the duct takes up on the way")

ROWS = (
    Row(
        "air flow with the damper fully open",
        ("flow", "flow_set", "damper"),
        short_of("flow", "flow_set", FULL, "meter"),
        G36,
        high="with the damper fully open the box gets less air than its set point",
        high_causes=(SHORT, DAMPER, METER),
        terms=(Term("meter", 0.12, "error of the flow meter, as a share"),),
        sd=0.05,
        unit="1",
        inequality=True,
    ),
    Row(
        "air flow with the damper shut",
        ("flow", "damper"),
        of_largest("flow", shut_for_good, "zero"),
        G36,
        high="air flows through the shut damper",
        high_causes=(DAMPER, DAMPER_LEAK, METER),
        terms=(Term("zero", 0.06, "flow that a tight damper or the meter's zero shows, as a share of the largest"),),
        sd=0.03,
        unit="1",
        inequality=True,
    ),
    Row(
        "discharge air with reheat shut",
        ("T_supply", "T_entering", "heat", "flow"),
        difference("T_supply", "T_entering", both(at_most("heat", 0.02), BLOWS), terms=("duct",), held=1800.0),
        G36,
        high="with reheat shut the discharge air is warmer than the air that enters",
        high_causes=(HEAT_LEAK, BIAS),
        low="with reheat shut the discharge air is colder than the air that enters",
        low_causes=(BIAS,),
        terms=(DUCT,),
    ),
    Row(
        "discharge air with reheat fully open",
        ("T_supply", "T_entering", "heat", "flow"),
        difference("T_entering", "T_supply", both(at_least("heat", 0.95), BLOWS), less=-5.0),
        G36,
        high="with reheat fully open the discharge air is hardly warmer than the air that enters",
        high_causes=(HEAT_STUCK, BIAS),
        inequality=True,
    ),
    Row(
        "zone with cooling at its end",
        ("T_room", "T_room_set_cool", "damper"),
        difference("T_room", "T_room_set_cool", at_least("damper", 0.95), less=0.6),
        G36,
        high="with the damper fully open the zone stays warmer than its set point",
        high_causes=(WARM, SHORT, DAMPER, HEAT_LEAK),
        inequality=True,
        sd=0.5,
    ),
    Row(
        "zone with heating at its end",
        ("T_room", "T_room_set_heat", "heat"),
        difference("T_room_set_heat", "T_room", at_least("heat", 0.95), less=0.6, held=7200.0),
        G36,
        high="with reheat fully open the zone stays colder than its set point",
        high_causes=(COLD, HEAT_STUCK),
        inequality=True,
        sd=0.5,
    ),
    Row(
        "air flow while the air handler stands",
        ("flow", "fan_upstream"),
        of_largest("flow", at_most("fan_upstream", 0.5), "zero"),
        G36,
        high="air flow is shown while the air handler stands",
        high_causes=(METER,),
        terms=(Term("zero", 0.05, "error of the flow meter at zero, as a share of the largest flow"),),
        sd=0.02,
        unit="1",
        inequality=True,
    ),
)

STROKE = "command it from shut to open and watch: blades and flow follow from end to end unless it is stuck"
FAULTS = (
    EquipmentFault(DAMPER, "damper", "the damper does not follow its command", (STROKE,)),
    EquipmentFault(
        DAMPER_LEAK,
        "damper",
        "the shut damper lets air through",
        ("look at blade and seal with the damper shut: no gap",),
        0.5,
    ),
    EquipmentFault(
        SHORT,
        "supply",
        "too little air comes from the air handler",
        ("read the duct's pressure before the box: at its set point if the box is at fault",),
        1.0,
    ),
    EquipmentFault(
        HEAT_LEAK,
        "reheat",
        "heat comes though none is asked for",
        ("shut it by hand and feel the coil after half an hour: as warm as the duct if it is tight",),
    ),
    EquipmentFault(
        HEAT_STUCK,
        "reheat",
        "no heat comes though it is asked for",
        ("feel supply and return pipe of the coil, or measure the heater's current: hot, or as on its plate",),
    ),
    EquipmentFault(
        METER,
        "air flow meter",
        "the flow meter reads wrong",
        ("read it with the damper shut, or against a balometer: zero, or within 10 %",),
        0.5,
    ),
    EquipmentFault(
        BIAS,
        "discharge air sensor",
        "the discharge air sensor reads wrong by a constant",
        ("compare with the air handler's supply air, reheat shut: within 1 K if it is right",),
        0.5,
    ),
    EquipmentFault(
        WARM,
        "zone",
        "the zone gets more heat than its box can take away",
        ("read the supply air's temperature and the zone's loads: as designed if box and sensor are at fault",),
    ),
    EquipmentFault(
        COLD,
        "zone",
        "the zone loses more heat than its box can give",
        ("read the hot water's temperature, look for open windows: as designed, and none",),
    ),
)

VAV_BOX = EquipmentModel("vav_box", "Variable-air-volume box", ROLES, ROWS, FAULTS)
