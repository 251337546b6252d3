"""What a fault costs a day: from the change of a physical parameter, over yesterday's hours, to energy and money.

A cost is told with its 95 % interval, which follows from the error of the parameter's change alone, and with the
assumption it rests on. Where no energy is lost it is told as comfort; where nothing can be said, why.

Heat exchangers by effectiveness and transfer units in counterflow (Incropera et al. 2007, ch. 11); a radiator is one
with a single fluid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fdd.diagnosis.departure import Departure, Operation
from fdd.evidence import Cause, Cost, Message
from fdd.models.declare import ComponentModel, Parameter
from fdd.records import FloatArray

CP = 4186.0  # water [J/(kg K)]
HOURS = 24.0
OUTSIDE = 15.0
"""How much colder than the room what it loses heat to is taken to be, where nobody measures it [K]."""

Tariffs = Mapping[str, float | str | None]


@dataclass(frozen=True, slots=True)
class Case:
    """What a cost is computed from: yesterday's hourly means by symbol, and the parameters' changes with errors."""

    model: ComponentModel
    hours: Mapping[str, FloatArray]
    value: Mapping[str, float]
    change: Mapping[str, float]
    error: Mapping[str, float]

    def at(self, symbol: str, errors: float) -> float:
        """A parameter's value now, so many standard errors from the estimate."""
        p = next(q for q in self.model.parameters if q.symbol == symbol)
        return natural(p, self.value[symbol], self.change[symbol] + errors * self.error[symbol])


@dataclass(frozen=True, slots=True)
class Loss:
    """Energy a day [kWh] at the estimate and at both ends of its interval; what it is, and what it rests on."""

    energy: tuple[float, float, float]
    carrier: str
    basis: Message
    comfort: bool = False
    degree_hours: float | None = None


def natural(parameter: Parameter, value: float, change: float) -> float:
    """A parameter's value after a change on its estimation scale."""
    match parameter.transform:
        case "log":
            return float(value * np.exp(np.clip(change, -5.0, 5.0)))
        case "logit":
            low, high = parameter.lower, parameter.upper
            odds = np.log((value - low) / (high - value)) + change
            return float(low + (high - low) / (1.0 + np.exp(-odds)))
        case _:
            return value + change


def daily_cost(
    model: ComponentModel, departure: Departure, operation: Operation, causes: tuple[Cause, ...], tariffs: Tariffs
) -> Cost:
    """The alarm's cost a day, or why there is none."""
    nothing = _unpriced(tariffs)
    if causes and causes[0].kind in ("sensor", "upstream"):
        return replace(nothing, why=Message.of("cost_wrong_reading"))
    rule = RULES.get(model.name)
    if rule is None:
        return replace(nothing, why=Message.of("cost_no_rule", model=Message.declared(model.title)))
    case = _case(model, departure, operation)
    loss = rule(case) if case is not None else None
    if loss is None:
        return replace(nothing, why=Message.of("cost_not_said"))
    return _priced(loss, tariffs)


GRADES = ("low", "medium", "high")


def with_cost(severity: str, cost: Cost, tariffs: Tariffs) -> str:
    """A severity by size and certainty, one class higher where the fault is dear, one lower where it is surely cheap.

    Dear: at least ``tariffs["dear"]`` a day, and surely more than nothing; cheap: the whole 95 % interval is below
    ``tariffs["cheap"]``. Without a price, size and certainty decide alone.
    """
    if cost.value is None or cost.lower is None or cost.upper is None:
        return severity
    dear, cheap = tariffs.get("dear"), tariffs.get("cheap")
    grade = GRADES.index(severity)
    if isinstance(dear, int | float) and cost.value >= dear and cost.lower > 0:
        grade += 1
    elif isinstance(cheap, int | float) and cost.upper < cheap:
        grade -= 1
    return GRADES[min(max(grade, 0), len(GRADES) - 1)]


def _unpriced(tariffs: Tariffs) -> Cost:
    """A cost of which nothing is known yet."""
    return Cost(currency=str(tariffs.get("currency") or "EUR"))


def no_price(carrier: str) -> Message:
    """Why a cost has no value although the energy is known."""
    return Message.of("cost_no_price", carrier=carrier)


def _case(model: ComponentModel, d: Departure, operation: Operation) -> Case | None:
    if not len(operation):
        return None
    found = d.changes()
    apart = np.isfinite(found.joint_error)
    size = np.where(apart, found.joint, found.single)
    error = np.where(apart, found.joint_error, found.single_error)
    seen = [(s, float(v), float(c), float(e)) for s, v, c, e in zip(d.symbols, d.values, size, error, strict=True)]
    told = [row for row in seen if np.isfinite(row[2]) and np.isfinite(row[3])]
    return Case(
        model,
        operation.hours,
        {s: v for s, v, _, _ in told},
        {s: c for s, _, c, _ in told},
        {s: e for s, _, _, e in told},
    )


def _priced(loss: Loss, tariffs: Tariffs) -> Cost:
    best, *ends = loss.energy
    told = replace(
        _unpriced(tariffs),
        energy=best,
        kind="comfort" if loss.comfort else "energy",
        degree_hours=loss.degree_hours,
        basis=loss.basis,
    )
    price = tariffs.get(loss.carrier)
    if loss.comfort:
        return replace(told, why=Message.of("cost_comfort"))
    if not isinstance(price, int | float):
        return replace(told, why=no_price(loss.carrier))
    return replace(told, value=best * price, lower=min(ends) * price, upper=max(ends) * price)


def _interval(energy: Callable[[float], float]) -> tuple[float, float, float]:
    return energy(0.0), energy(-1.96), energy(1.96)


def _exchanger(case: Case) -> Loss | None:
    """Heat that the clean exchanger would pass at the same flows and inlet temperatures."""
    films = [s for s in ("UA", "C", "C_hot", "C_cold", "K_hot", "K_cold") if s in case.change]
    h = case.hours
    if not films:
        return None
    low = CP * np.minimum(h["m_flow_hot"], h["m_flow_cold"])
    ratio = np.minimum(h["m_flow_hot"], h["m_flow_cold"]) / np.maximum(
        np.maximum(h["m_flow_hot"], h["m_flow_cold"]), 1e-9
    )
    drive = h["T_hot_in"] - h["T_cold_in"]
    heat = CP * h["m_flow_cold"] * (h["T_cold_out"] - h["T_cold_in"])
    works = (low > 0) & (drive > 1.0) & (heat > 0)
    if not works.any():
        return None
    low, ratio, drive, heat = (a[works] for a in (low, ratio, drive, heat))
    units = _units(np.clip(heat / (low * drive), 0.01, 0.99), ratio)

    def missing(errors: float) -> float:
        share = float(np.mean([case.at(s, errors) / case.value[s] for s in films]))
        clean = low * drive * _effectiveness(units / share, ratio)
        return float(np.sum(clean - heat)) / 1000.0 * HOURS / len(works)

    return Loss(_interval(missing), "heat", Message.of("cost_exchanger"))


def _units(effectiveness: FloatArray, ratio: FloatArray) -> FloatArray:
    c = np.minimum(ratio, 0.999)
    return np.asarray(np.log((1.0 - effectiveness * c) / (1.0 - effectiveness)) / (1.0 - c))


def _effectiveness(units: FloatArray, ratio: FloatArray) -> FloatArray:
    c = np.minimum(ratio, 0.999)
    grown = np.exp(-units * (1.0 - c))
    return np.asarray((1.0 - grown) / (1.0 - c * grown))


def _radiator(case: Case) -> Loss | None:
    """Heat that the radiator would give off as it was, at the same flow and supply temperature."""
    h = case.hours
    if "H" not in case.change:
        return None
    drive, drop = h["T_supply"] - h["T_room"], h["T_supply"] - h["T_return"]
    works = (h["m_flow"] > 0) & (drive > 1.0) & (drop > 0.1)
    if not works.any():
        return None
    flow, drive, drop = CP * h["m_flow"][works], drive[works], drop[works]
    units = -np.log(1.0 - np.clip(drop / drive, 0.01, 0.99))

    def missing(errors: float) -> float:
        share = case.at("H", errors) / case.value["H"]
        before = flow * drive * (1.0 - np.exp(-units / share))
        return float(np.sum(before - flow * drop)) / 1000.0 * HOURS / len(works)

    found = _interval(missing)
    given = float(np.sum(flow * drop)) / 1000.0 * HOURS / len(works)
    colder = OUTSIDE * found[0] / max(given + found[0], 1e-9)
    code = "cost_radiator_colder" if colder > 0 else "cost_radiator_warmer"
    basis = Message.of(code, energy=found[0], kelvin=abs(colder), outside=OUTSIDE)
    return Loss(found, "heat", basis, comfort=True, degree_hours=HOURS * colder)


def _building(case: Case) -> Loss | None:
    """Heat that leaves through what the envelope has become, above what left through it before."""
    lost = [s for s in case.change if s.startswith("B_out_") and f"T_{s.removeprefix('B_out_')}" in case.hours]
    if not lost:
        return None

    def extra(errors: float) -> float:
        return sum(
            (case.at(s, errors) - case.value[s])
            * float(np.mean(case.hours[f"T_{s.removeprefix('B_out_')}"] - case.hours["T_out"]))
            for s in lost
        ) / 1000.0 * HOURS  # fmt: skip

    return Loss(_interval(extra), "heat", Message.of("cost_envelope"))


def _zone(case: Case) -> Loss | None:
    series = [s for s in ("R_ia", "R_ie", "R_ea") if s in case.value]
    if not series or not any(s in case.change for s in series):
        return None
    drive = float(np.mean(case.hours["T_room"] - case.hours["T_out"]))
    healthy = 1.0 / sum(case.value[s] for s in series)

    def extra(errors: float) -> float:
        # A larger resistance loses less, so that the ends of the interval change places.
        return (1.0 / sum(case.at(s, -errors) for s in series) - healthy) * drive / 1000.0 * HOURS

    return Loss(_interval(extra), "heat", Message.of("cost_envelope"))


def _pipe(case: Case) -> Loss | None:
    if "UA" not in case.change:
        return None
    h = case.hours
    drive = float(np.mean(0.5 * (h["T_in"] + h["T_out"]) - h["T_around"]))

    def extra(errors: float) -> float:
        return (case.at("UA", errors) - case.value["UA"]) * drive / 1000.0 * HOURS

    return Loss(_interval(extra), "heat", Message.of("cost_pipe"))


def _pump(case: Case) -> Loss | None:
    if "eta" not in case.change:
        return None
    power = float(np.mean(case.hours["P_el"]))

    def extra(errors: float) -> float:
        return power * (1.0 - case.at("eta", errors) / case.value["eta"]) / 1000.0 * HOURS

    return Loss(_interval(extra), "electricity", Message.of("cost_pump"))


RULES: Mapping[str, Callable[[Case], Loss | None]] = {
    "heat_exchanger": _exchanger,
    "radiator": _radiator,
    "building": _building,
    "zone": _zone,
    "pipe_thermal": _pipe,
    "pump": _pump,
}
"""How a model's loss is computed, by its name in the registry."""
