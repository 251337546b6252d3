"""Air handler: rows of expectations, a steady form, and its faults.

Steady form, with w the fan's speed, d the damper's position, T_r return, T_o outdoor air
    mixed air    T_m = T_r + s (T_o - T_r) + b_m,   s = s_low + (s_high - s_low) d^q
    heating      T_a = T_m + e(v_h; n_h, n_ha, g_h) (T_hw - T_m)
    supply air   T_s = T_a + f w^2 - e(v_c; n_c, n_ca, g_c) (T_a + f w^2 - T_cw) + b_s
where the air that enters the coils is the mixed air as measured less its error, so that what the mixing box does and
what the coils do are told apart. Coils by transfer units (Incropera et al. 2007, Eq. 11.35; Wetter 1999, LBNL-42355).
Rows follow ASHRAE Guideline 36-2021, 5.16.14 (fault conditions FC#1 to FC#15) where it has one; faults follow ASHRAE
RP-1312 (Li & Wen 2010).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fdd.models.equipment import air
from fdd.models.equipment.air import G36, passing, with_value
from fdd.models.expectation import (
    Alternative,
    BoolArray,
    Day,
    EquipmentFault,
    EquipmentModel,
    Prior,
    Role,
    Row,
    SteadyForm,
    Term,
    Values,
)
from fdd.records import FloatArray

ROLES = (
    Role(
        "T_supply",
        "degC",
        "supply air temperature",
        0.56,
        True,
        ("Supply_Air_Temperature_Sensor", "discharge air temp sensor", "Discharge_Air_Temperature_Sensor"),
    ),
    Role(
        "fan",
        "1",
        "supply fan speed, 0 while it stands",
        0.0,
        True,
        ("Supply_Fan_Speed_Command", "discharge fan cmd", "Fan_Speed_Command"),
    ),
    Role(
        "cool",
        "1",
        "cooling valve position",
        0.0,
        True,
        ("Cooling_Valve_Command", "Chilled_Water_Valve_Command", "cool valve cmd"),
    ),
    Role(
        "heat",
        "1",
        "heating valve position",
        0.0,
        True,
        ("Heating_Valve_Command", "Hot_Water_Valve_Command", "heat valve cmd"),
    ),
    Role(
        "T_mixed",
        "degC",
        "mixed air temperature",
        1.0,
        False,
        ("Mixed_Air_Temperature_Sensor", "mixed air temp sensor"),
    ),
    Role(
        "T_return",
        "degC",
        "return air temperature",
        0.56,
        False,
        ("Return_Air_Temperature_Sensor", "return air temp sensor"),
    ),
    Role(
        "T_out",
        "degC",
        "outdoor air temperature",
        0.7,
        False,
        ("Outside_Air_Temperature_Sensor", "outside air temp sensor"),
        driver=True,
    ),
    Role(
        "damper",
        "1",
        "outdoor air damper position",
        0.0,
        False,
        ("Outside_Damper_Position_Command", "Outside_Air_Damper_Command", "outside air damper cmd"),
    ),
    Role(
        "T_supply_set",
        "degC",
        "supply air temperature set point",
        0.0,
        False,
        ("Supply_Air_Temperature_Setpoint", "discharge air temp sp", "Discharge_Air_Temperature_Setpoint"),
    ),
    Role(
        "fan_status",
        "1",
        "whether the supply fan runs",
        0.0,
        False,
        ("Supply_Fan_Status", "Fan_Status", "discharge fan run sensor"),
    ),
    Role(
        "T_room",
        "degC",
        "temperature of the room around the unit, or of its zone",
        1.0,
        False,
        ("Zone_Air_Temperature_Sensor", "zone air temp sensor"),
    ),
    Role(
        "damper_return",
        "1",
        "return air damper position",
        0.0,
        False,
        ("Return_Damper_Position_Command", "return air damper cmd"),
    ),
    Role(
        "damper_exhaust",
        "1",
        "exhaust air damper position",
        0.0,
        False,
        ("Exhaust_Damper_Position_Command", "exhaust air damper cmd"),
    ),
    Role("fan_return", "1", "return fan speed", 0.0, False, ("Return_Fan_Speed_Command", "return fan cmd")),
    Role(
        "p_static",
        "Pa",
        "supply duct static pressure",
        0.0,
        False,
        ("Supply_Air_Static_Pressure_Sensor", "discharge air pressure sensor"),
    ),
    Role(
        "p_static_set",
        "Pa",
        "supply duct static pressure set point",
        0.0,
        False,
        ("Supply_Air_Static_Pressure_Setpoint", "discharge air pressure sp"),
    ),
    Role("flow", "kg/s", "supply air flow", 0.0, False, ("Supply_Air_Flow_Sensor", "discharge air flow sensor")),
    Role(
        "humidity_return",
        "1",
        "relative humidity of return air",
        0.03,
        False,
        ("Return_Air_Humidity_Sensor", "return air humidity sensor"),
    ),
    Role(
        "humidity_supply",
        "1",
        "relative humidity of supply air",
        0.03,
        False,
        ("Supply_Air_Humidity_Sensor", "discharge air humidity sensor"),
    ),
)

HEAT_LEAK, HEAT_STUCK, HEAT_SHORT = (
    "heating valve leaks",
    "heating valve stuck",
    "heating coil fouled or short of hot water",
)
COOL_LEAK, COOL_STUCK, COOL_SHORT = (
    "cooling valve leaks",
    "cooling valve stuck",
    "cooling coil fouled or short of cold water",
)
DAMPER_STUCK, DAMPER_LEAK = "outdoor air damper stuck", "outdoor air damper leaks"
BIAS_MIXED, BIAS_SUPPLY = "mixed air sensor biased", "supply air sensor biased"
BIAS_RETURN, BIAS_OUT = "return air sensor biased", "outdoor air sensor biased"
FAN_SHORT, TOGETHER = "supply fan short of pressure", "heating and cooling at the same time"
CONTROL = "control hunts or is out of sequence"
FLOW_METER = "air flow meter off at zero"

HEATS, COOLS = (HEAT_LEAK, HEAT_STUCK), (COOL_LEAK, COOL_STUCK)
SENSORS = (BIAS_MIXED, BIAS_SUPPLY)
MIXING = (BIAS_MIXED, BIAS_RETURN, BIAS_OUT)
FAN_TERM = Term("fan", air.FAN_SD, "heat of the fan at full speed")
AROUND = Term("around", 1.2, "how far the room around the unit is from return and outdoor air")

SEAT = "close the valve by hand and feel both pipes behind it after half an hour: as warm as the room if it is tight"
COMPARE = (
    "with both valves shut, compare mixed and supply air: apart by the fan's warming only, 1 to 2 K, if both are tight"
)
STROKE = "command the valve from shut to open and watch its stem: it follows from stop to stop unless it is stuck"

FAULTS = (
    EquipmentFault(
        HEAT_LEAK,
        "heating valve",
        "hot water passes the closed heating valve",
        (
            SEAT,
            COMPARE,
        ),
    ),
    EquipmentFault(
        HEAT_STUCK,
        "heating valve",
        "the heating valve does not follow its command",
        (STROKE, "look at actuator, linkage and supply voltage: whole, and the stem's position is the signal's"),
    ),
    EquipmentFault(
        HEAT_SHORT,
        "heating coil",
        "the heating coil gives less than its valve asks for",
        (
            "read the hot water's temperature and pressure: as designed if the coil is at fault",
            "open strainer and air vent of the coil: clean, no air",
        ),
        0.5,
    ),
    EquipmentFault(
        COOL_LEAK,
        "cooling valve",
        "chilled water passes the closed cooling valve",
        (
            SEAT,
            COMPARE,
        ),
    ),
    EquipmentFault(
        COOL_STUCK,
        "cooling valve",
        "the cooling valve does not follow its command",
        (STROKE, "look at actuator, linkage and supply voltage: whole, and the stem's position is the signal's"),
    ),
    EquipmentFault(
        COOL_SHORT,
        "cooling coil",
        "the cooling coil gives less than its valve asks for",
        (
            "read the chilled water's temperature and pressure: as designed if the coil is at fault",
            "look at the coil's fins, the filter and the strainer: clean",
        ),
        0.5,
    ),
    EquipmentFault(
        DAMPER_STUCK,
        "outdoor air damper",
        "the outdoor air damper does not follow its command",
        (
            "watch the damper through a full stroke: the blades follow from stop to stop",
            "look at linkage and actuator: no play, its position is the signal's",
        ),
    ),
    EquipmentFault(
        DAMPER_LEAK,
        "outdoor air damper",
        "the closed outdoor air damper lets air in",
        ("look at blades and seals with the damper shut: no gap",),
        0.5,
    ),
    EquipmentFault(
        BIAS_MIXED,
        "mixed air sensor",
        "the mixed air sensor reads wrong by a constant",
        ("compare with return air, dampers in recirculation: within 0.5 K after ten minutes if it is right",),
        0.5,
    ),
    EquipmentFault(
        BIAS_SUPPLY,
        "supply air sensor",
        "the supply air sensor reads wrong by a constant",
        ("compare with mixed air, valves shut and fan on, less the fan's warming: within 0.5 K if it is right",),
        0.5,
    ),
    EquipmentFault(
        BIAS_RETURN,
        "return air sensor",
        "the return air sensor reads wrong by a constant",
        ("compare with the rooms' mean: within 1 K if the sensor is right",),
        0.3,
    ),
    EquipmentFault(
        BIAS_OUT,
        "outdoor air sensor",
        "the outdoor air sensor reads wrong by a constant",
        ("compare with the nearest weather station in the morning: within 2 K if the sensor is right",),
        0.3,
    ),
    EquipmentFault(
        FAN_SHORT,
        "supply fan",
        "the supply fan does not make its pressure",
        ("look at belt, filter and inlet: tight and clean", "look for open doors and leaks of the duct: none"),
        0.5,
    ),
    EquipmentFault(
        TOGETHER,
        "control",
        "the control opens heating and cooling at the same time",
        ("read the sequence of the controller: valves follow one another unless air is being dried",),
        0.5,
    ),
    EquipmentFault(
        CONTROL,
        "control",
        "the control hunts, or its sequence is wrong",
        ("look at gains and dead bands of the supply temperature's loop: steps settle within minutes",),
        0.5,
    ),
    EquipmentFault(
        FLOW_METER,
        "air flow meter",
        "the air flow meter shows a flow while the fan stands",
        ("read it with the fan off and dampers shut: zero",),
        0.3,
    ),
)


def _damper_row(name: str, low: float, high: float, share: float, sd: float) -> Row:
    return Row(
        f"outdoor air share, damper {name}",
        ("T_mixed", "T_return", "T_out", "damper", "fan"),
        air.outdoor_share(low, high, share),
        f"{G36} FC#6, FC#10",
        high=f"more outdoor air is mixed in than the damper, {name}, lets in",
        low=f"less outdoor air is mixed in than the damper, {name}, lets in",
        high_causes=(DAMPER_STUCK, DAMPER_LEAK, *MIXING),
        low_causes=(DAMPER_STUCK, *MIXING),
        terms=(Term("share", sd, "share of outdoor air at this position"),),
    )


ROWS = (
    Row(
        "supply air with cooling fully open",
        ("T_supply", "T_supply_set", "cool", "fan"),
        air.supply_above_set_point,
        f"{G36} FC#13",
        high="with the cooling valve fully open the supply air stays warmer than its set point",
        high_causes=(COOL_STUCK, COOL_SHORT, *HEATS, DAMPER_STUCK, DAMPER_LEAK, BIAS_SUPPLY),
        inequality=True,
        sd=0.6,
    ),
    Row(
        "supply air with heating fully open",
        ("T_supply", "T_supply_set", "heat", "fan"),
        air.supply_below_set_point,
        f"{G36} FC#7",
        high="with the heating valve fully open the supply air stays colder than its set point",
        high_causes=(HEAT_STUCK, HEAT_SHORT, *COOLS, DAMPER_STUCK, DAMPER_LEAK, BIAS_SUPPLY),
        inequality=True,
        sd=0.6,
    ),
    Row(
        "air over shut coils",
        ("T_supply", "T_mixed", "fan"),
        air.coils_shut,
        f"{G36} FC#8, FC#14, FC#15",
        high="with both valves shut the air is warmer behind the coils than the fan explains",
        low="with both valves shut the air is colder behind the coils than before them",
        high_causes=(*HEATS, *SENSORS),
        low_causes=(*COOLS, *SENSORS),
        terms=(FAN_TERM,),
    ),
    Row(
        "air over the cooling coil",
        ("T_supply", "T_mixed", "cool", "fan"),
        air.cooling_only,
        f"{G36} FC#12",
        high="the air is warmer behind the coils than before them, though only cooling is asked for",
        high_causes=(*HEATS, *SENSORS),
        terms=(FAN_TERM,),
        inequality=True,
    ),
    Row(
        "air over the heating coil",
        ("T_supply", "T_mixed", "heat", "fan"),
        air.heating_only,
        f"{G36} FC#5",
        high="the air is colder behind the coils than before them, though only heating is asked for",
        high_causes=(*COOLS, *SENSORS),
        terms=(FAN_TERM,),
        inequality=True,
    ),
    Row(
        "mixed air between return and outdoor air",
        ("T_mixed", "T_return", "T_out", "fan"),
        air.mixed_outside,
        f"{G36} FC#2, FC#3",
        high="the mixed air is warmer, or colder, than both return and outdoor air",
        high_causes=(*MIXING, HEAT_LEAK, HEAT_STUCK),
        inequality=True,
    ),
    *(
        Row(
            f"supply air over shut coils, {'above' if side > 0 else 'below'} all that enters",
            ("T_supply", "T_return", "T_out", "cool", "heat", "fan"),
            air.supply_outside(side),
            f"{G36} FC#2, FC#3, FC#8",
            high=f"with both valves shut the supply air is {more} than return and outdoor air",
            high_causes=(*(HEATS if side > 0 else COOLS), BIAS_SUPPLY, BIAS_RETURN, BIAS_OUT),
            terms=(FAN_TERM,),
            inequality=True,
        )
        for side, more in ((1, "hotter"), (-1, "colder"))
    ),
    _damper_row("shut", 0.0, air.SHUT, 0.03, 0.05),
    _damper_row("a little open", 0.05, 0.30, 0.14, 0.10),
    _damper_row("half open", 0.30, 0.80, 0.40, 0.15),
    _damper_row("open", 0.98, 1.0, 0.95, 0.05),
    *(
        Row(
            f"{word} section while the fan stands, {'above' if side > 0 else 'below'}",
            (section, "T_return", "T_out", "fan"),
            air.stands(section, side),
            "maximum principle of heat conduction, Protter & Weinberger (1967), ch. 3",
            high=f"while the fan stands the {word} section gets {more} than its surroundings",
            high_causes=(*(HEATS if side > 0 else COOLS), BIAS_MIXED if section == "T_mixed" else BIAS_SUPPLY),
            terms=(AROUND,),
            inequality=True,
            span=900.0,
        )
        for section, word in (("T_mixed", "mixed air"), ("T_supply", "supply air"))
        for side, more in ((1, "hotter"), (-1, "colder"))
    ),
    Row(
        "free cooling against outdoor air",
        ("T_out", "T_supply", "T_supply_set", "damper", "cool", "heat", "fan"),
        air.too_warm_outside,
        f"{G36} FC#9",
        high="outdoor air alone is left to cool though it is warmer than the set point",
        high_causes=(CONTROL, COOL_LEAK, COOL_STUCK, BIAS_OUT, BIAS_SUPPLY),
        terms=(FAN_TERM,),
        inequality=True,
        sd=0.5,
    ),
    Row(
        "cooling with outdoor air colder than the set point",
        ("T_out", "T_supply", "T_supply_set", "damper", "cool", "heat", "fan"),
        air.too_cold_outside,
        f"{G36} FC#11",
        high="with the damper fully open the coil cools though outdoor air is colder than the set point",
        high_causes=(CONTROL, DAMPER_STUCK, HEAT_LEAK, HEAT_STUCK, BIAS_OUT, BIAS_SUPPLY),
        terms=(FAN_TERM,),
        inequality=True,
        sd=0.5,
    ),
    Row(
        "changes of the operating state",
        ("heat", "cool", "fan"),
        air.hunting,
        f"{G36} FC#4",
        high="the control changes between heating, free cooling and cooling more than seven times an hour",
        high_causes=(CONTROL,),
        inequality=True,
        sd=1.5,
        unit="1",
    ),
    Row(
        "heating and cooling together",
        ("heat", "cool", "fan"),
        air.both_coils,
        "ASHRAE Guideline 36-2021, 5.16.2: valves in sequence",
        high="heating and cooling valves are open at the same time",
        high_causes=(TOGETHER,),
        inequality=True,
        sd=0.03,
        unit="1",
    ),
    Row(
        "duct pressure at full speed",
        ("p_static", "p_static_set", "fan"),
        air.pressure_short,
        f"{G36} FC#1",
        high="at full speed the fan does not reach the duct's set pressure",
        high_causes=(FAN_SHORT,),
        terms=(Term("pressure", 0.05, "error of the pressure sensor, as a share of the set point"),),
        inequality=True,
        sd=0.05,
        unit="1",
    ),
    Row(
        "air flow while the fan stands",
        ("flow", "fan"),
        air.flow_standing,
        "continuity",
        high="air flow is shown while the fan stands",
        high_causes=(FLOW_METER,),
        terms=(Term("flow_zero", 0.05, "error of the flow meter at zero"),),
        inequality=True,
        sd=0.02,
        unit="1",
    ),
)

PRIORS = (
    Prior("s_low", "1", "share of outdoor air, damper shut", 0.03, 0.03),
    Prior("s_high", "1", "share of outdoor air, damper open", 0.95, 0.06),
    Prior("q", "1", "curve of the damper", 1.4, 0.35, "log"),
    Prior("n_h", "1", "heating coil, water side: transfer units, valve open", 1.0, 0.6, "log"),
    Prior("n_ha", "1", "heating coil, air side: transfer units", 1.0, 0.5, "log"),
    Prior("g_h", "1", "curve of the heating valve", 1.2, 0.5, "log"),
    Prior("T_hw", "degC", "hot water", 60.0, 12.0),
    Prior("n_c", "1", "cooling coil, water side: transfer units, valve open", 5.0, 0.6, "log"),
    Prior("n_ca", "1", "cooling coil, air side: transfer units", 2.0, 0.4, "log"),
    Prior("g_c", "1", "curve of the cooling valve", 1.2, 0.5, "log"),
    Prior("T_cw", "degC", "chilled water", 7.0, 1.5),
    Prior("f", "K", "heat of the fan at full speed", air.FAN, air.FAN_SD),
    Prior("b_m", "K", "mixed air sensor, stratification", 0.0, 0.7),
    Prior("b_s", "K", "supply air sensor", 0.0, 0.5),
)


def settled(v: Day) -> BoolArray:
    """The fan has run for a while."""
    return v.held(air.running(v), air.SETTLED)


def predict(v: Values, p: Values) -> Values:
    """Mixed and supply air; whichever of the mixing box's quantities is missing leaves that out."""
    out: Values = {}
    if {"T_return", "T_out", "damper"} <= v.keys():
        d = np.clip(v["damper"], 0.0, 1.0)
        share = p["s_low"] + (p["s_high"] - p["s_low"]) * d ** p["q"]
        before = v["T_return"] + share * (v["T_out"] - v["T_return"])
        out["T_mixed"] = before + p["b_m"]
    if "T_mixed" in v:
        before = v["T_mixed"] - p["b_m"]
    elif "T_mixed" not in out:
        return out
    warmed = before + air.effectiveness(v["heat"], p["n_h"], p["n_ha"], p["g_h"]) * np.maximum(p["T_hw"] - before, 0.0)
    blown = warmed + p["f"] * np.clip(v["fan"], 0.2, 1.2) ** 2
    cooled = blown - air.effectiveness(v["cool"], p["n_c"], p["n_ca"], p["g_c"]) * np.maximum(blown - p["T_cw"], 0.0)
    out["T_supply"] = cooled + p["b_s"]
    return out


def _leaks(valve: str) -> Callable[[Values, Values, FloatArray], tuple[Values, Values]]:
    return lambda v, p, size: (with_value(v, **{valve: passing(v[valve], size)}), p)


def _stuck(actuator: str) -> Callable[[Values, Values, FloatArray], tuple[Values, Values]]:
    return lambda v, p, size: (with_value(v, **{actuator: size + 0.0 * v[actuator]}), p)


def _off(sensor: str) -> Callable[[Values, Values, FloatArray], tuple[Values, Values]]:
    """A reading is too high by the size: the truth is that much lower."""
    return lambda v, p, size: (with_value(v, **{sensor: v[sensor] - size}), p)


def _bias(parameter: str) -> Callable[[Values, Values, FloatArray], tuple[Values, Values]]:
    return lambda v, p, size: (v, with_value(p, **{parameter: p[parameter] + size}))


def _fouled(parameter: str) -> Callable[[Values, Values, FloatArray], tuple[Values, Values]]:
    return lambda v, p, size: (v, with_value(p, **{parameter: p[parameter] * size}))


AT = (0.1, 0.4, 0.7, 0.95)
SHIFT = (-4.0, 4.0)

FORM = SteadyForm(
    settled=settled,
    needs=("fan", "cool", "heat", "T_supply"),
    predict=predict,
    priors=PRIORS,
    outputs={"T_mixed": 0.7, "T_supply": 0.7},
    alternatives=(
        Alternative(HEAT_LEAK, _leaks("heat"), 0.005, 0.3, "log", "1", (0.03, 0.2)),
        Alternative(COOL_LEAK, _leaks("cool"), 0.005, 0.3, "log", "1", (0.03, 0.2)),
        Alternative(HEAT_STUCK, _stuck("heat"), 0.0, 1.0, "identity", "1", AT),
        Alternative(COOL_STUCK, _stuck("cool"), 0.0, 1.0, "identity", "1", AT),
        Alternative(DAMPER_STUCK, _stuck("damper"), 0.0, 1.0, "identity", "1", AT, ("damper", "T_return", "T_out")),
        Alternative(DAMPER_LEAK, _bias("s_low"), 0.05, 0.6, "identity", "1", (0.2,), ("damper", "T_return", "T_out")),
        Alternative(HEAT_SHORT, _fouled("n_h"), 0.02, 0.7, "log", "1", (0.1, 0.4)),
        Alternative(COOL_SHORT, _fouled("n_c"), 0.02, 0.7, "log", "1", (0.1, 0.4)),
        Alternative(BIAS_MIXED, _bias("b_m"), -8.0, 8.0, "identity", "K", SHIFT, ("T_mixed",)),
        Alternative(BIAS_SUPPLY, _bias("b_s"), -8.0, 8.0, "identity", "K", SHIFT),
        Alternative(BIAS_RETURN, _off("T_return"), -8.0, 8.0, "identity", "K", SHIFT, ("T_return", "T_out", "damper")),
        Alternative(BIAS_OUT, _off("T_out"), -8.0, 8.0, "identity", "K", SHIFT, ("T_return", "T_out", "damper")),
    ),
)

AIR_HANDLER = EquipmentModel("air_handler", "Air handler", ROLES, ROWS, FAULTS, FORM)
