"""What to measure, and the reading to expect if this is the cause and if it is not: so that causes are told apart.

Each line reads ``what to do: what it shows``; reports split it there.
"""

from __future__ import annotations

from fdd.diagnosis.hypotheses import Hypothesis
from fdd.diagnosis.readings import with_reading
from fdd.evidence import Message, check

CHECKS: dict[str, tuple[str, ...]] = {
    "fouling": (
        "Compare primary return with secondary return at the exchanger: several kelvin apart if fouled, "
        "as at commissioning if an instrument is wrong",
        "Read the pressure drop of both sides at a known flow: above the data sheet if fouled, on it if not",
        "Compare the heat given off by the primary with that taken up by the secondary: equal within 3 % if fouled, "
        "apart if a meter or sensor is wrong",
    ),
    "air": (
        "Feel the top of the radiator: cold if there is air, warm all over if not",
        "Bleed it: air comes out, and the return is back at its expected reading within an hour; water at once if not",
        "Read the system pressure: below its set value where air is drawn in",
    ),
    "sludge": (
        "Feel the lower middle of the radiator: cold if there is sludge, warm if not",
        "Open the valve fully and read the flow: clearly below its design if there is sludge, at its design if not",
    ),
    "covered": ("Look whether furniture or curtains hinder the air: a hand's breadth is free all round if not",),
    "open-window": (
        "Look for windows and doors that stand open in the room: shut, if the envelope is not the cause",
        "Read the ventilation's schedule and supply temperature: as in the schedule, if it is not the cause",
    ),
    "heater": (
        "Compare the heat meter with flow and temperatures at the heater: equal within 5 % if the heater is well",
    ),
    "stuck": ("Warm the sensor with a hand: its reading follows within minutes unless it is stuck",),
}


def checks_of(name: str, declared: tuple[str, ...]) -> tuple[Message, ...]:
    """Checks of a component's fault, each with the reading to expect; ``declared`` are its model's own."""
    base = name.rpartition("-")[0] if name.startswith("open-window-") else name
    return _checks(base) or tuple(with_reading(c) for c in declared)


def _checks(name: str) -> tuple[Message, ...]:
    return tuple(check(*line.split(": ", 1)) for line in CHECKS.get(name, ()))


def advice(h: Hypothesis, size: float) -> tuple[Message, ...]:
    """Checks for one cause; ``size`` is its estimated extent in the hypothesis' unit."""
    if h.unit == "frozen":
        return _checks("stuck")
    if h.where and h.kind != "component":
        return (_instrument(h, size),)
    return checks_of(h.name, h.checks)


def _instrument(h: Hypothesis, size: float) -> Message:
    """The reading of a reference instrument, with how far off it should be."""
    side = "less" if size > 0 else "more"
    assert h.quantity is not None, h.name
    return Message.of(f"compare_{'meter' if h.unit == 'share' else 'sensor'}_{side}", what=h.quantity, size=abs(size))
