"""A chiller's verdict as the alarm tells it: the finding's sentence, its causes, what to check, what it costs a day."""

from __future__ import annotations

import numpy as np

from fdd.chiller_eiv.checks import SENSOR_NAMES, Finding, checks_of
from fdd.chiller_eiv.cost import ExtraCost
from fdd.chiller_eiv.online import ChillerOutputs
from fdd.diagnosis.cost import no_price, unpriced
from fdd.records import JsonObject

MEANINGS = {
    "heat-exchanger resistance": "fouled heat exchanger, or too little water through it",
    "internal loss (entropy or leak)": "internal loss: compressor, refrigerant charge or non-condensable gas",
    "sensor": "a flow meter or temperature sensor that reads wrongly",
    "not known": "a change that no fault and no sensor's error among those compared explains",
    "non-condensable gas": "air or another gas in the condenser",
    "condenser fouling": "fouled or blocked condenser tubes",
    "evaporator fouling": "fouled or blocked evaporator tubes",
    "low condenser flow": "too little condenser water",
    "high condenser flow": "more condenser water than before",
    "low chilled-water flow": "too little chilled water",
    "high chilled-water flow": "more chilled water than before",
    "low charge": "too little refrigerant",
    "high charge": "too much refrigerant",
    "oil excess": "too much oil in the refrigerant",
    "compressor efficiency loss": "a compressor that takes more power for the same lift",
    "purged condenser": "less gas in the condenser than when it was learned",
    "cleaner condenser": "condenser tubes cleaner than when it was learned",
    "cleaner evaporator": "evaporator tubes cleaner than when it was learned",
    "better compressor": "a compressor that takes less power than when it was learned",
    "condenser side": "condenser side: gas, overcharge, fouling or too little water",
    "evaporator side": "evaporator side: fouling, undercharge, oil or too little water",
    "refrigerant or compressor": "refrigerant charge, oil or compressor",
    "water flow": "a water flow that changed",
    "condenser water flow or its meter": "condenser water flow, or the meter that reads it",
    "chilled-water flow or its meter": "chilled-water flow, or the meter that reads it",
    "better than when it was learned": "the machine is better than when it was learned",
    "a sensor": "one of several sensors reads wrongly",
    **{f"{k} sensor": f"the sensor of {words} ({k}) reads wrongly" for k, words in SENSOR_NAMES.items()},
}
"""What the causes of :mod:`fdd.chiller_eiv` mean to a technician."""

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
    "oil level": "Read the oil level at rest and at full load: between the marks of the sight glass",
    "water temperature sensors": "Compare the four water sensors with a reference, or with each other while the "
    "machine rests and the pumps run: within 0.2 K",
    "refrigerant temperature sensors": "Compare pressures and refrigerant temperatures with a gauge set: within 0.5 K",
    "maintenance log": "Ask what was done to the machine since it was learned; then fit it anew: fdd fit",
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
    evidence: JsonObject = {}
    if outputs.sensors is not None:
        evidence["heat_balance"] = outputs.sensors.note
    if outputs.cost is not None:
        evidence["cost_per_day"] = _cost(outputs.cost, currency)
    return {
        "summary": found.sentence,
        "causes": _causes(found, checks),
        "checks": checks,
        "evidence": evidence,
    }


def _causes(found: Finding, checks: list[str]) -> list[JsonObject]:
    """The cause or group that is named, then the single ones that were compared, most likely first."""
    table: list[JsonObject] = [_cause(found.cause, found.probability, [found.sentence], checks)]
    for name, probability in found.ranked:
        if name != found.cause and name in MEANINGS:
            table.append(_cause(name, probability, [], [CHECKS.get(c, c) for c in checks_of(name)]))
    return table


def _cause(name: str, probability: float | None, why: list[str], checks: list[str]) -> JsonObject:
    cause: JsonObject = {
        "name": name,
        "meaning": MEANINGS.get(name, name),
        "for": why,
        "against": [],
        "checks": checks,
    }
    if probability is not None:
        cause["likelihood"] = round(probability, 3)
    return cause


def _cost(cost: ExtraCost, currency: str) -> JsonObject:
    """The alarm's ``cost_per_day``, in the form of :func:`fdd.diagnosis.cost.daily_cost`."""
    half = 1.96 * cost.energy_day_se
    told = unpriced(currency) | {
        "kWh_per_day": cost.energy_day,
        "kWh_per_day_half_width": half,
        "kind": "energy",
        "basis": f"{abs(cost.energy_day):.0f} kWh a day {'more' if cost.energy_day > 0 else 'less'} than the healthy "
        f"machine at the same load and temperatures (give or take {half:.0f})",
    }
    if not np.isfinite(cost.money_day) or not cost.energy_day:
        return told | {"why": no_price("electricity")}
    price = cost.money_day / cost.energy_day
    return told | {
        "value": cost.money_day,
        "lower": cost.money_day - price * half,
        "upper": cost.money_day + price * half,
    }
