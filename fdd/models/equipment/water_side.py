"""Cooling tower, and a pump with its loop."""

from __future__ import annotations

from fdd.models.equipment.residuals import at_least, at_most, difference, of_largest, short_of
from fdd.models.expectation import EquipmentFault, EquipmentModel, Role, Row, Term

TOWER_SHORT, TOWER_SENSOR, TOWER_FAN = "tower short of capacity", "tower water sensor wrong", "tower fan without effect"
MERKEL = "Merkel (1925); ASHRAE Handbook HVAC Systems and Equipment (2020), ch. 40"
FULL, ON = at_least("fan", 0.95), at_least("fan", 0.1)

COOLING_TOWER = EquipmentModel(
    "cooling_tower",
    "Cooling tower",
    (
        Role(
            "T_out_water",
            "degC",
            "water leaving",
            0.5,
            True,
            ("Leaving_Condenser_Water_Temperature_Sensor", "condenser water leaving temp sensor"),
        ),
        Role("fan", "1", "fan speed", 0.0, True, ("Fan_Speed_Command", "fan cmd")),
        Role(
            "T_in_water",
            "degC",
            "water entering",
            0.5,
            False,
            ("Entering_Condenser_Water_Temperature_Sensor", "condenser water entering temp sensor"),
        ),
        Role(
            "T_wet_bulb",
            "degC",
            "outdoor wet bulb",
            1.0,
            False,
            ("Outside_Air_Wet_Bulb_Temperature_Sensor", "outside air wetBulb temp sensor"),
            driver=True,
        ),
        Role(
            "T_set",
            "degC",
            "set point of the water leaving",
            0.0,
            False,
            ("Leaving_Condenser_Water_Temperature_Setpoint", "condenser water leaving temp sp"),
        ),
    ),
    (
        Row(
            "water leaving against wet bulb",
            ("T_wet_bulb", "T_out_water", "fan"),
            difference("T_wet_bulb", "T_out_water", ON),
            MERKEL,
            high="the water leaves colder than the wet bulb",
            high_causes=(TOWER_SENSOR,),
            inequality=True,
            sd=0.5,
        ),
        Row(
            "approach at full fan",
            ("T_out_water", "T_wet_bulb", "fan"),
            difference("T_out_water", "T_wet_bulb", FULL, less=4.0, terms=("size",)),
            MERKEL,
            high="at full fan the water stays further above the wet bulb than towers do",
            high_causes=(TOWER_SHORT, TOWER_FAN, TOWER_SENSOR),
            terms=(Term("size", 2.5, "approach of such towers"),),
            sd=0.7,
        ),
        Row(
            "water over the running tower",
            ("T_out_water", "T_in_water", "fan"),
            difference("T_out_water", "T_in_water", ON),
            MERKEL,
            high="with the fan on the water leaves warmer than it enters",
            high_causes=(TOWER_SENSOR, TOWER_FAN),
            inequality=True,
            sd=0.4,
        ),
        Row(
            "set point at full fan",
            ("T_out_water", "T_set", "fan"),
            difference("T_out_water", "T_set", FULL, less=1.0, held=3600.0),
            "ASHRAE Guideline 36-2021, 5.20.12",
            high="after an hour at full fan the water is warmer than its set point",
            high_causes=(TOWER_SHORT, TOWER_FAN),
            inequality=True,
            sd=1.0,
        ),
    ),
    (
        EquipmentFault(
            TOWER_SHORT,
            "fill",
            "fouled fill, too little air or an uneven spray",
            ("look at fill, nozzles and drift eliminators: clean and even",),
        ),
        EquipmentFault(
            TOWER_FAN,
            "fan",
            "the fan does not move the air that its speed says",
            ("look at belt, blades and direction of rotation: tight, whole, right",),
        ),
        EquipmentFault(
            TOWER_SENSOR,
            "water sensor",
            "a sensor of the water or of the wet bulb reads wrong",
            ("compare the water sensors with the fan off, pump on: within 0.5 K",),
            0.5,
        ),
    ),
)

PUMP_SHORT, PUMP_METER, PUMP_RUNS, CHECK_VALVE = (
    "pump short of pressure",
    "flow meter wrong at zero",
    "pump runs though off",
    "non-return valve leaks",
)
AT_FULL, OFF = at_least("speed", 0.95), at_most("speed", 0.02)

PUMP_LOOP = EquipmentModel(
    "pump_loop",
    "Pump and its loop",
    (
        Role("speed", "1", "pump speed, 0 while it stands", 0.0, True, ("Pump_Speed_Command", "pump speed cmd")),
        Role(
            "dp",
            "Pa",
            "differential pressure",
            0.0,
            False,
            ("Differential_Pressure_Sensor", "differential pressure sensor"),
        ),
        Role(
            "dp_set",
            "Pa",
            "differential pressure set point",
            0.0,
            False,
            ("Differential_Pressure_Setpoint", "differential pressure sp"),
        ),
        Role("flow", "kg/s", "water flow", 0.0, False, ("Water_Flow_Sensor", "water flow sensor")),
        Role("P_el", "W", "electrical power", 0.0, False, ("Electrical_Power_Sensor", "elec power sensor")),
    ),
    (
        Row(
            "pressure at full speed",
            ("dp", "dp_set", "speed"),
            short_of("dp", "dp_set", AT_FULL, "sensor"),
            "ASHRAE Guideline 36-2021, 5.20",
            high="at full speed the pump does not reach its set pressure",
            high_causes=(PUMP_SHORT,),
            terms=(Term("sensor", 0.05, "error of the pressure sensor, as a share"),),
            sd=0.05,
            unit="1",
            inequality=True,
        ),
        Row(
            "flow while the pump stands",
            ("flow", "speed"),
            of_largest("flow", OFF, "zero"),
            "continuity",
            high="water flows while the pump stands",
            high_causes=(PUMP_METER, CHECK_VALVE, PUMP_RUNS),
            terms=(Term("zero", 0.04, "error of the flow meter at zero, as a share of the largest flow"),),
            sd=0.02,
            unit="1",
            inequality=True,
        ),
        Row(
            "power while the pump stands",
            ("P_el", "speed"),
            of_largest("P_el", OFF, "standby"),
            "continuity",
            high="power is taken while the pump stands",
            high_causes=(PUMP_RUNS,),
            terms=(Term("standby", 0.05, "standby of the drive, as a share of the largest power"),),
            sd=0.02,
            unit="1",
            inequality=True,
        ),
        Row(
            "pressure while the pump stands",
            ("dp", "speed"),
            of_largest("dp", OFF, "zero"),
            "hydrostatics",
            high="pressure is shown while the pump stands",
            high_causes=(PUMP_RUNS, CHECK_VALVE),
            terms=(Term("zero", 0.05, "error of the pressure sensor at zero, as a share of the largest pressure"),),
            sd=0.02,
            unit="1",
            inequality=True,
        ),
    ),
    (
        EquipmentFault(
            PUMP_SHORT,
            "pump",
            "worn impeller, a blocked strainer, or an open bypass",
            ("read the pressure drop of the strainer at a known flow: as in the commissioning report",),
        ),
        EquipmentFault(
            PUMP_METER,
            "flow meter",
            "the flow meter shows a flow at rest",
            ("read it with the pump off and the valve shut: zero",),
            0.5,
        ),
        EquipmentFault(
            PUMP_RUNS,
            "pump control",
            "the pump runs though it is commanded off",
            ("look at the hand-off-auto switch: on auto",),
        ),
        EquipmentFault(
            CHECK_VALVE,
            "non-return valve",
            "another pump drives water through this one",
            ("shut the valve behind it: flow and pressure vanish",),
            0.5,
        ),
    ),
)
