"""A chiller's verdict as the alarm tells it: the finding's sentence, its causes, what to check, what it costs a day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fdd.chiller_eiv.checks import SENSOR_NAMES, Finding, checks_of
from fdd.chiller_eiv.cost import ExtraCost
from fdd.chiller_eiv.online import ChillerOutputs
from fdd.diagnosis.cost import no_price
from fdd.evidence import Cause, Cost, JsonObject, Message, check

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


@dataclass(frozen=True, slots=True)
class ChillerFinding:
    """Causes of a chiller's alarm, the likeliest first, its cost, and what else was found."""

    causes: tuple[Cause, ...]
    cost: Cost | None = None
    notes: Mapping[str, Message] = field(default_factory=dict)

    def document(self) -> JsonObject:
        """Plain data."""
        return {
            "causes": [c.document() for c in self.causes],
            "cost": None if self.cost is None else self.cost.document(),
            "notes": {k: m.document() for k, m in self.notes.items()},
        }

    @classmethod
    def read(cls, document: JsonObject) -> ChillerFinding:
        """What :meth:`document` wrote."""
        return cls(
            tuple(Cause.read(c) for c in document["causes"]),
            None if document["cost"] is None else Cost.read(document["cost"]),
            {k: Message.read(m) for k, m in document["notes"].items()},
        )


def chiller_finding(outputs: ChillerOutputs, currency: str) -> ChillerFinding | None:
    """What is told of a chiller in alarm.

    Parameters
    ----------
    outputs : of the day that has closed; None where nothing is in alarm
    currency : of the price
    """
    found = outputs.finding
    if found is None:
        return None
    notes = {} if outputs.sensors is None else {"heat_balance": Message.of("written", text=outputs.sensors.note)}
    return ChillerFinding(_causes(found), None if outputs.cost is None else _cost(outputs.cost, currency), notes)


def _causes(found: Finding) -> tuple[Cause, ...]:
    """The cause or group that is named, then the single ones that were compared, most likely first."""
    why = (Message.of("written", text=found.sentence),)
    others = [(n, p) for n, p in found.ranked if n != found.cause and n in MEANINGS]
    return (
        _cause(found.cause, found.probability, found.checks, why),
        *(_cause(name, probability, checks_of(name)) for name, probability in others),
    )


def _cause(name: str, probability: float | None, checks: Sequence[str], why: tuple[Message, ...] = ()) -> Cause:
    return Cause(
        name=name,
        meaning=Message.declared(MEANINGS.get(name, name)),
        likelihood=None if probability is None else round(probability, 3),
        speaks_for=why,
        checks=tuple(check(*CHECKS.get(c, c).split(": ", 1)) for c in checks),
    )


def _cost(cost: ExtraCost, currency: str) -> Cost:
    half = 1.96 * cost.energy_day_se
    code = "cost_chiller_more" if cost.energy_day > 0 else "cost_chiller_less"
    told = Cost(
        currency=currency,
        energy=cost.energy_day,
        half_width=half,
        kind="energy",
        basis=Message.of(code, energy=abs(cost.energy_day), half_width=half),
    )
    if not np.isfinite(cost.money_day) or not cost.energy_day:
        return replace(told, why=no_price("electricity"))
    price = cost.money_day / cost.energy_day
    lower, upper = cost.money_day - price * half, cost.money_day + price * half
    return replace(told, value=cost.money_day, lower=lower, upper=upper)
