"""A chiller's verdict as the alarm tells it: the finding's sentence, its causes, what to check, what it costs a day."""

from __future__ import annotations

import numpy as np

from fdd.chiller_eiv.cost import ExtraCost
from fdd.chiller_eiv.online import ChillerOutputs
from fdd.diagnosis.cost import no_price, unpriced
from fdd.records import JsonObject

MEANINGS = {
    "heat-exchanger resistance": "fouled heat exchanger, or too little water through it",
    "internal loss (entropy or leak)": "internal loss: compressor, refrigerant charge or non-condensable gas",
    "sensor": "a flow meter or temperature sensor that reads wrongly",
    "power": "more power than the load explains; which part of the machine cannot be told from these measurements",
    "condenser side": "condenser side: fouled tubes, too little water, or non-condensable gas",
    "evaporator side": "evaporator side: fouled tubes, too little water, or too little refrigerant",
    "both side": "both heat exchangers: too little water on both sides, or a wrong sensor",
    "side side": "a heat exchanger; which one cannot be told",
    "refrigerant charge": "too little refrigerant, or a liquid line that flashes",
}
"""What the causes of :mod:`fdd.chiller_eiv.checks` mean to a technician."""

CHECKS = {
    "flow meter": "Compare the water flow meters with a clamp-on meter or the pump's curve: within 3 %",
    "chilled-water temperature sensors": "Compare the chilled-water sensors with a reference, or with each other while "
    "the machine rests: within 0.2 K",
    "power meter and auxiliaries on it": "Compare the power meter with a clamp meter, and look for auxiliaries that "
    "have been put on it: within 2 %",
    "condenser water flow and strainer": "Read the pressure drop over condenser and strainer: as in the "
    "commissioning report",
    "condenser tubes (fouling)": "Read the condenser approach at full load, open and brush the tubes where it is high: "
    "1 to 3 K when clean",
    "non-condensable gas": "Compare the condenser's pressure with the saturation temperature of its liquid, purge "
    "where it is higher: equal",
    "chilled-water flow": "Read the pressure drop over the evaporator: as in the commissioning report",
    "evaporator tubes": "Read the evaporator approach at full load: 1 to 3 K when clean",
    "refrigerant charge": "Look at the sight glass and the subcooling: no bubbles, as on the name plate",
    "refrigerant charge and non-condensables": "Read subcooling and condenser pressure at a known load: as on the "
    "name plate",
    "compressor, oil, bypass valve": "Look for a hot-gas bypass that is open, high oil temperature or wear: closed, "
    "as on the name plate",
}
"""What to do about the checks of :mod:`fdd.chiller_eiv.checks`, and what a healthy machine shows."""


def chiller_finding(outputs: ChillerOutputs, currency: str) -> JsonObject | None:
    """What is told of a chiller in alarm, plain data: ``summary``, ``causes``, ``checks``, ``evidence``.

    Parameters
    ----------
    outputs : of the day that has closed; None where nothing is in alarm
    currency : of the price
    """
    found = outputs.finding
    if found is None:
        return None
    checks = [CHECKS.get(c, c) for c in found.checks]
    cause: JsonObject = {
        "name": found.cause,
        "meaning": MEANINGS.get(found.cause, found.cause),
        "for": [found.sentence],
        "against": [],
        "checks": checks,
    }
    if found.probability is not None:
        cause["likelihood"] = round(found.probability, 3)
    evidence: JsonObject = {}
    if outputs.sensors is not None:
        evidence["heat_balance"] = outputs.sensors.note
    if outputs.cost is not None:
        evidence["cost_per_day"] = _cost(outputs.cost, currency)
    return {
        "summary": found.sentence,
        "causes": [cause],
        "checks": checks,
        "evidence": evidence,
    }


def _cost(cost: ExtraCost, currency: str) -> JsonObject:
    """The alarm's ``cost_per_day``, in the form of :func:`fdd.diagnosis.cost.daily_cost`."""
    half = 1.96 * cost.energy_day_se
    told = unpriced(currency) | {
        "kWh_per_day": cost.energy_day,
        "kWh_per_day_half_width": half,
        "kind": "energy",
        "basis": f"{cost.energy_day:.0f} kWh a day more than the healthy machine at the same load and temperatures "
        f"(give or take {half:.0f})",
    }
    if not np.isfinite(cost.money_day) or not cost.energy_day:
        return told | {"why": no_price("electricity")}
    price = cost.money_day / cost.energy_day
    return told | {
        "value": cost.money_day,
        "lower": cost.money_day - price * half,
        "upper": cost.money_day + price * half,
    }
