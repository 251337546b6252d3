"""Hydronic boiler: what its water and its burner may do."""

from __future__ import annotations

import numpy as np

from fdd.models.equipment.residuals import at_least, at_most, difference, rises
from fdd.models.expectation import Day, EquipmentFault, EquipmentModel, Residual, Role, Row, Term

SHORT, NO_FLAME, LEAK = "boiler short of capacity", "burner gives no heat", "heat enters while the burner is off"
SENSOR, METER, FOULED = "water temperature sensor wrong", "heat or fuel meter wrong", "heat exchanger fouled"
CP = 4186.0
BALANCE = "heat balance, ASHRAE Handbook HVAC Systems and Equipment (2020), ch. 32"

ROLES = (
    Role(
        "T_supply",
        "degC",
        "water leaving",
        0.5,
        True,
        (
            "Leaving_Hot_Water_Temperature_Sensor",
            "Hot_Water_Supply_Temperature_Sensor",
            "hot water leaving temp sensor",
        ),
    ),
    Role(
        "fire",
        "1",
        "firing rate, or whether the burner is on",
        0.0,
        True,
        ("Boiler_Command", "Firing_Rate_Command", "burner cmd"),
    ),
    Role(
        "T_return",
        "degC",
        "water entering",
        0.5,
        False,
        (
            "Entering_Hot_Water_Temperature_Sensor",
            "Hot_Water_Return_Temperature_Sensor",
            "hot water entering temp sensor",
        ),
    ),
    Role(
        "T_set",
        "degC",
        "set point of the water leaving",
        0.0,
        False,
        ("Leaving_Hot_Water_Temperature_Setpoint", "hot water leaving temp sp"),
    ),
    Role("flow", "kg/s", "water flow", 0.0, False, ("Hot_Water_Flow_Sensor", "hot water flow sensor")),
    Role("P_fuel", "W", "power of the fuel burnt", 0.0, False, ("Gas_Meter", "fuel power sensor")),
    Role("T_flue", "degC", "flue gas", 3.0, False, ("Flue_Gas_Temperature_Sensor", "flue gas temp sensor")),
    Role("T_room", "degC", "boiler room", 1.0, False, ("Zone_Air_Temperature_Sensor", "zone air temp sensor")),
)

ON, FULL, OFF = at_least("fire", 0.1), at_least("fire", 0.95), at_most("fire", 0.02)


def efficiency(v: Day) -> Residual:
    """Heat given to the water over fuel burnt, less what a boiler has: by the upper heating value 0.75 to 0.98."""
    on = v.held(ON(v) & (v["P_fuel"] > 0), 1800.0)
    heat = v["flow"] * CP * (v["T_supply"] - v["T_return"])
    return np.where(on, heat / v["P_fuel"] - 0.87, np.nan), {"efficiency": 1.0, "meters": 1.0}


ROWS = (
    Row(
        "water leaving with the burner at its end",
        ("T_supply", "T_set", "fire"),
        difference("T_set", "T_supply", FULL, less=2.0, held=3600.0),
        BALANCE,
        high="after an hour of full fire the water is colder than its set point",
        high_causes=(SHORT, NO_FLAME, SENSOR, FOULED),
        inequality=True,
        sd=1.0,
    ),
    Row(
        "water over the burning boiler",
        ("T_supply", "T_return", "fire"),
        difference("T_return", "T_supply", ON),
        BALANCE,
        high="with the burner on the water leaves colder than it enters",
        high_causes=(NO_FLAME, SENSOR),
        inequality=True,
        sd=0.5,
    ),
    Row(
        "water while the burner is off",
        ("T_supply", "fire"),
        rises("T_supply", OFF, ("T_return", "T_room"), "around", held=1800.0),
        "maximum principle of heat conduction, Protter & Weinberger (1967), ch. 3",
        high="with the burner off the water gets warmer than it was and than all around it",
        high_causes=(LEAK, SENSOR),
        terms=(Term("around", 2.0, "heat that the boiler's body gives after the burner stops"),),
        inequality=True,
        sd=0.5,
    ),
    Row(
        "efficiency",
        ("T_supply", "T_return", "flow", "P_fuel", "fire"),
        efficiency,
        BALANCE,
        high="more heat is measured than the fuel holds",
        high_causes=(METER, SENSOR),
        low="less heat reaches the water than such boilers give",
        low_causes=(FOULED, METER, SENSOR),
        terms=(Term("efficiency", 0.06, "efficiency of such boilers"), Term("meters", 0.05, "error of both meters")),
        sd=0.02,
        unit="1",
    ),
    Row(
        "flue gas over the water entering",
        ("T_flue", "T_return", "fire"),
        difference("T_flue", "T_return", FULL, less=60.0, terms=("size",)),
        "ASHRAE Handbook HVAC Systems and Equipment (2020), ch. 32",
        high="the flue gas is hotter over the returning water than it should be",
        high_causes=(FOULED,),
        terms=(Term("size", 40.0, "heating surface of such boilers"),),
        sd=5.0,
    ),
)

FAULTS = (
    EquipmentFault(
        SHORT,
        "capacity",
        "the boiler cannot give what is asked of it",
        ("read gas pressure and nozzle: as on the plate",),
    ),
    EquipmentFault(
        NO_FLAME,
        "burner",
        "the burner is commanded and gives no heat",
        ("look at the flame and the fault log: a flame, no lock-out",),
    ),
    EquipmentFault(
        LEAK,
        "isolation",
        "hot water comes from elsewhere, or the burner stays on",
        ("feel the pipes with the burner off: cooling down if the valves are tight",),
    ),
    EquipmentFault(
        SENSOR,
        "water sensor",
        "a water temperature sensor reads wrong, or two are interchanged",
        ("compare both with the pump on and the burner off: within 0.5 K",),
        0.5,
    ),
    EquipmentFault(
        METER,
        "meter",
        "the heat meter or the fuel meter reads wrong",
        ("compare with the supplier's meter over a week: within 3 %",),
        0.5,
    ),
    EquipmentFault(
        FOULED,
        "heat exchanger",
        "heating surfaces are fouled",
        ("read the flue gas at full fire: as in the commissioning report when clean",),
    ),
)

BOILER = EquipmentModel("boiler", "Hydronic boiler", ROLES, ROWS, FAULTS)
