"""The reading to expect of each check that a model declares: a check without one tells a technician nothing."""

from __future__ import annotations

from fdd.evidence import Message
from fdd.evidence import check as check_of

SEAT = "shuts tight over the full stroke if the valve is well"
BEHIND = "it cools within minutes if the valve is tight"
READINGS: dict[str, str] = {
    "compare the sensor with a hand-held one in the same pocket": "within 0.2 K if the sensor is right",
    "compare the sensor with a hand-held one": "within 0.2 K if the sensor is right",
    "look whether a pipe-mounted sensor has lost contact or insulation": "held fast and insulated all round",
    "look whether sun or a heat source reaches it": "in the shade all day, a metre or more from any heater",
    "look at the pocket's contact and insulation": "the sensor touches the bottom of the pocket, which is insulated",
    "compare the heat given off by the hot side with that taken up by the cold side": "equal within 3 % if both meters "
    "are right",
    "check the meter's pulse value": "the same on the meter's plate and in the controller",
    "compare with a clamp-on meter": "within 2 % if the installed meter is right",
    "with the heating valve closed and the fan off, feel both pipes of the heating coil": "cold after half an hour if "
    "the valve is tight, warm if it leaks",
    "compare mixed and supply air temperature with both valves closed": "apart by the fan's warming only, 1 to 2 K, if "
    "no valve leaks",
    "check the valve's seat, the actuator's stroke and whether it closes against the pump's pressure": SEAT,
    "with the cooling valve closed, feel both pipes of the cooling coil": "as warm as the room after half an hour if "
    "the valve is tight, cold if it leaks",
    "check seat and stroke of the valve": SEAT,
    "check seat, stroke and actuator": SEAT,
    "check the chilled water's temperature and pressure": "as designed if the coil is at fault, too warm or too low if "
    "the supply is",
    "check the hot water's temperature and pressure": "as designed if the coil is at fault, too cold or too low if the "
    "supply is",
    "look at the coil's fins and the filter": "clean, and the filter's pressure drop below its limit",
    "check the strainer": "clean",
    "check strainer and air vent of the coil": "a clean strainer, water without air at the vent",
    "watch the damper through a full stroke": "the blades follow from stop to stop",
    "check linkage and actuator": "no play, and the actuator's position is the signal's",
    "compare with return air, dampers in full recirculation": "within 0.5 K after ten minutes if the sensor is right",
    "compare with mixed air, valves closed and fan running, less the fan's warming": "within 0.5 K if the sensor is "
    "right",
    "check strainers and shut-off valves on the way": "clean strainers, every valve fully open",
    "measure the pressure drop section by section": "in proportion to length if clean; the blocked section stands out",
    "walk along the pipe, feel or film the insulation": "dry, whole, and at most a few kelvin warmer than the air",
    "look for leaks into ducts and pits": "dry",
    "clean or change the insert": "the return follows the head again within a day if the insert was at fault",
    "change the thermostatic head": "the room keeps its set value again within a day if the head was at fault",
    "compare head and flow with the maker's curve at full speed": "on the curve within 5 % if the pump is well",
    "listen for cavitation": "an even sound",
    "open and look": "impeller and wear rings as new",
    "listen to the bearings": "an even sound, no grinding",
    "feel the motor's temperature": "as warm as its equals",
    "close the valve by hand and feel whether the pipe behind it cools": BEHIND,
    "check the set screw": "at the mark of commissioning",
}


def with_reading(check: str) -> Message:
    """What to do and what it shows; without where the check says so already or nothing is known."""
    reading = READINGS.get(check)
    if reading is None and check.startswith("compare the sensor of room "):
        reading = READINGS["compare the sensor with a hand-held one"]
    return check_of(check, reading) if reading else check_of(*check.split(": ", 1))
