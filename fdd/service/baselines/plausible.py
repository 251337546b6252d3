"""Whether estimates are those of equipment that can exist; what is not so is kept, but not put in force."""

from __future__ import annotations

from fdd.greybox.results import FitResult
from fdd.service.site.plan import Component


def objections(component: Component, result: FitResult) -> tuple[str, ...]:
    """What speaks against putting estimates in force, each with what to do; empty where nothing does.

    Equipment that is known by data sheets is judged: its physical parameters are told, inside their bounds, within a
    factor of their plate values, and the numbers that its kind is known by are within theirs. Parameters of other
    models that are not told are only not charted.
    """
    model = component.model
    if not (model.plausible or component.plates):
        return ()
    found = []
    for q in model.parameters:
        if q.kind != "physical":
            continue
        value, remedy = result.params[q.symbol], f"give it from the plate (parameters: {{{q.symbol}: {{plate: ...}}}})"
        if q.symbol in result.at_bound:
            found.append(f"{q.symbol} ({q.meaning}) ended at its bound {value:g} {q.unit}; {remedy}")
        elif q.symbol in result.unidentifiable:
            found.append(
                f"{q.symbol} ({q.meaning}) is not told by these data; {remedy}, or fit a span with more changes"
            )
        if q.symbol in component.plates:
            plate, factor = component.plates[q.symbol]
            if not plate / factor <= value <= plate * factor:
                found.append(
                    f"{q.symbol} is {value:.4g} {q.unit}, beyond a factor of {factor:g} of its plate value {plate:g}; "
                    "correct the plate value, or see which sensor stands for what"
                )
    for p in model.plausible:
        value = p.of(result.params)
        if not p.typical / p.factor <= value <= p.typical * p.factor:
            found.append(
                f"{p.meaning} is {value:.3g}{_unit(p.unit)}, beyond a factor of {p.factor:g} of the usual "
                f"{p.typical:g}; {p.remedy}"
            )
    return tuple(found)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
