"""Heat pump, air or water on either side, heating: its performance against Carnot's, and its temperatures."""

from __future__ import annotations

import numpy as np

from fdd.models.equipment.residuals import at_least, at_most, both, difference, of_largest
from fdd.models.expectation import BoolArray, Day, EquipmentFault, EquipmentModel, Residual, Role, Row, Term

WORN, METER, SENSOR = "heat pump gives less heat for its power", "heat or power meter wrong", "temperature sensor wrong"
IDLE, SHORT, NO_HEAT = "power taken while it is off", "heat pump short of capacity", "compressor runs without effect"
SOURCE = "source gives no heat"
CARNOT, CARNOT_SD = 0.42, 0.09
"""Share of Carnot's coefficient that heat pumps reach between the media, and how it varies among machines."""

ROLES = (
    Role(
        "T_supply",
        "degC",
        "heated medium leaving",
        0.5,
        True,
        ("Leaving_Hot_Water_Temperature_Sensor", "Supply_Air_Temperature_Sensor", "hot water leaving temp sensor"),
    ),
    Role(
        "compressor",
        "1",
        "whether the compressor runs, or its speed",
        0.0,
        True,
        ("Compressor_Command", "Run_Status", "compressor cmd"),
    ),
    Role(
        "T_return",
        "degC",
        "heated medium entering",
        0.5,
        False,
        ("Entering_Hot_Water_Temperature_Sensor", "Return_Air_Temperature_Sensor", "hot water entering temp sensor"),
    ),
    Role(
        "T_source_in",
        "degC",
        "source entering: outdoor air, brine or water",
        0.7,
        False,
        ("Outside_Air_Temperature_Sensor", "Entering_Water_Temperature_Sensor", "source entering temp sensor"),
        driver=True,
    ),
    Role(
        "T_source_out",
        "degC",
        "source leaving",
        0.7,
        False,
        ("Leaving_Water_Temperature_Sensor", "source leaving temp sensor"),
    ),
    Role("P_el", "W", "electrical power", 0.0, False, ("Electrical_Power_Sensor", "elec power sensor")),
    Role("Q_heat", "W", "heat given", 0.0, False, ("Thermal_Power_Sensor", "heat power sensor")),
    Role(
        "T_set",
        "degC",
        "set point of the heated medium",
        0.0,
        False,
        ("Leaving_Hot_Water_Temperature_Setpoint", "hot water leaving temp sp"),
    ),
    Role(
        "heating",
        "1",
        "1 while a reversible machine heats, 0 while it cools",
        0.0,
        False,
        ("Heating_Mode_Status", "heat mode"),
    ),
    Role("defrost", "1", "whether the outdoor coil is being defrosted", 0.0, False, ("Defrost_Command", "defrost cmd")),
)

ON, OFF = at_least("compressor", 0.05), at_most("compressor", 0.02)


def heats(v: Day) -> BoolArray:
    """The compressor runs, nothing is defrosted, and a machine that can do both heats."""
    return ON(v) & (v.get("defrost", 0.0) < 0.5) & (v.get("heating", 1.0) > 0.5)


def carnot_share(v: Day) -> Residual:
    """Measured coefficient of performance over Carnot's between the media, less what such machines reach."""
    hot = v["T_supply"] + 273.15
    lift = np.maximum(v["T_supply"] - v["T_source_in"], 10.0)
    share = v["Q_heat"] / v["P_el"] * lift / hot
    good = v.held(heats(v), 1200.0) & (v["P_el"] > 0) & (v["Q_heat"] > 0)
    return np.where(good, share - CARNOT, np.nan), {"machine": 1.0, "meters": share, "lift": 0.3 / lift * 10.0}


ROWS = (
    Row(
        "share of Carnot's coefficient",
        ("T_supply", "T_source_in", "P_el", "Q_heat", "compressor"),
        carnot_share,
        "second law; shares of machines after Staffell et al. (2012), Energy Environ. Sci. 5, 9291",
        high="more heat comes from its power than such machines reach",
        high_causes=(METER, SENSOR),
        low="less heat comes from its power than such machines reach",
        low_causes=(WORN, METER, SENSOR, SOURCE),
        terms=(
            Term("machine", CARNOT_SD, "share that this machine reaches"),
            Term("meters", 0.05, "error of both meters"),
            Term("lift", 0.1, "how the share goes with lift"),
        ),
        sd=0.02,
        unit="1",
    ),
    Row(
        "heated medium over the running machine",
        ("T_supply", "T_return", "compressor"),
        difference("T_return", "T_supply", heats),
        "heat balance",
        high="with the compressor on the heated medium leaves colder than it enters",
        high_causes=(NO_HEAT, SENSOR),
        inequality=True,
        sd=0.4,
    ),
    Row(
        "source over the running machine",
        ("T_source_in", "T_source_out", "compressor"),
        difference("T_source_out", "T_source_in", heats),
        "heat balance",
        high="with the compressor on the source leaves warmer than it enters",
        high_causes=(SOURCE, NO_HEAT, SENSOR),
        inequality=True,
        sd=0.4,
    ),
    Row(
        "power while it is off",
        ("P_el", "compressor"),
        of_largest("P_el", OFF, "standby"),
        "heat balance",
        high="power is taken though the compressor is off",
        high_causes=(IDLE, METER),
        terms=(Term("standby", 0.06, "control and crankcase heater, as a share of the largest power"),),
        sd=0.03,
        unit="1",
        inequality=True,
    ),
    Row(
        "set point at the machine's end",
        ("T_supply", "T_set", "compressor"),
        difference("T_set", "T_supply", both(at_least("compressor", 0.95)), less=2.0, held=7200.0),
        "ASHRAE Guideline 36-2021, 5.20",
        high="after two hours of full power the medium is colder than its set point",
        high_causes=(SHORT, WORN, NO_HEAT, SOURCE),
        inequality=True,
        sd=1.0,
    ),
)

FAULTS = (
    EquipmentFault(
        WORN,
        "refrigerant circuit",
        "fouled exchangers, too little refrigerant or a worn compressor",
        (
            "read evaporating and condensing temperature at a known load: as on the plate",
            "look at filters, fins and strainers: clean",
        ),
    ),
    EquipmentFault(
        METER,
        "meter",
        "the heat meter or the power meter reads wrong",
        ("compare with the supplier's meter over a week: within 3 %",),
        0.5,
    ),
    EquipmentFault(
        SENSOR,
        "temperature sensor",
        "a temperature sensor reads wrong, or two are interchanged",
        ("compare them with the machine off for an hour, pumps on: within 0.5 K",),
        0.5,
    ),
    EquipmentFault(
        IDLE,
        "standby",
        "auxiliaries run while the machine is off",
        ("look what runs beside the compressor: heater and control only",),
        0.5,
    ),
    EquipmentFault(
        SHORT,
        "capacity",
        "the load is more than the machine can give",
        ("compare load and plate at this source temperature: within it",),
        0.5,
    ),
    EquipmentFault(
        NO_HEAT,
        "compressor",
        "the compressor runs and no heat comes",
        ("listen for the four-way valve and read the pressures: apart by the lift",),
    ),
    EquipmentFault(
        SOURCE,
        "source",
        "fan, pump or filter of the source stand still or are blocked",
        ("look at the source's fan or pump and filter: running and clean",),
    ),
)

HEAT_PUMP = EquipmentModel("heat_pump", "Heat pump, heating", ROLES, ROWS, FAULTS)
