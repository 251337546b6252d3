"""What of a site can only be checked with the component models at hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from fdd.config.equipment_rows import has_filter, kind_of, missing_roles, tolerance_fits
from fdd.config.schema import CHILLER, Equipment, Site
from fdd.models.declare import ComponentModel, ModelError, Quantity
from fdd.models.expectation import EquipmentModel
from fdd.models.registry import get_model
from fdd.tables import suggestion
from fdd.units import NAMES, UnitError, conversion


@dataclass(frozen=True, slots=True)
class Finding:
    """Something in a site that stops it (``error``) or that a reader should know (``warning``)."""

    severity: Literal["error", "warning"]
    key: str
    problem: str
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.severity}: {self.key}: {self.problem}" + (f". {self.remedy}" if self.remedy else "")


def component_model(equipment: Equipment, variant: Mapping[str, Any] | None = None) -> ComponentModel:
    """The model of a piece of equipment, its fixed and tied parameters taken out; ``variant`` has further options.

    Raises
    ------
    ModelError : unknown model or option, or a value that the model refuses.
    """
    options: dict[str, Any] = {**equipment.options, **(variant or {})}
    fixed = {s: p.initial for s, p in equipment.parameters.items() if p.fixed}
    tied = {s: p.tied for s, p in equipment.parameters.items() if p.tied}
    for key, table in (("fixed", fixed), ("tied", tied)):
        if table:
            options[key] = {**options.get(key, {}), **table}
    return get_model(equipment.model, **options)


def check_site(site: Site) -> list[Finding]:
    """Everything that is wrong or odd about a site whose file is well formed; errors first."""
    findings = [*_general(site), *_unused(site)]
    for name, equipment in site.equipment.items():
        findings += _equipment(site, name, equipment)
    for name in site.rules:
        findings += _rule(site, name)
    return sorted(findings, key=lambda f: f.severity)


def _general(site: Site) -> Iterator[Finding]:
    for where, former, present in site.former:
        problem = f"{former!r} is called {present!r} now"
        yield Finding("warning", where, problem, "Write the new word; the next version refuses the old one.")
    if not site.sources:
        yield Finding("warning", "sources", "no source is given", "Name a data file on the command line, or add one.")
    if not site.equipment and not site.rules:
        yield Finding("error", "equipment", "nothing is watched", "Add equipment; `fdd models` lists the models.")
    if site.max_gap < site.step:
        yield Finding(
            "error", "max_gap", f"{site.max_gap:g} s is shorter than the step of {site.step:g} s", "Lengthen it."
        )


def _unused(site: Site) -> Iterator[Finding]:
    used = {p for e in site.equipment.values() for p in (*e.inputs.values(), *e.outputs.values())}
    used |= {p for e in site.derived.values() for p in e.points}
    used |= {p for name in site.rules for e in site.rule(name) if e is not None for p in e.points}
    used |= {p for name in site.equipment if (gate := site.gate(name)) for p in gate.points}
    for name in site.points:
        if name not in used:
            yield Finding("warning", f"points.{name}", "is used by no equipment", "Map it to a role, or leave it out.")


def _equipment(site: Site, name: str, equipment: Equipment) -> Iterator[Finding]:
    key = f"equipment.{name}"
    if equipment.model == CHILLER:
        yield from _chiller(site, key, name)
        return
    kind = kind_of(equipment)
    if kind is not None:
        yield from _rows(site, name, kind)
        if not has_filter(equipment):
            yield from _no_filter(site, name)
            return
    try:
        model = component_model(equipment)
    except (ModelError, TypeError) as error:
        yield Finding("error", f"{key}.model", str(error))
        return
    if kind is None:
        yield from _roles(site, f"{key}.inputs", equipment.inputs, model.inputs)
        yield from _roles(site, f"{key}.outputs", equipment.outputs, model.outputs)
    yield from _parameters(key, equipment, model)


def _rule(site: Site, name: str) -> Iterator[Finding]:
    """What a rule expects to be zero must have a zero, and its tolerance the same dimension."""
    unit = site.rule(name)[0].unit
    if unit == "degC":
        problem = "is a temperature, which is not zero where all is well"
        yield Finding("error", f"rules.{name}.expect", problem, "Subtract what it should be, such as another point.")
    elif not tolerance_fits(site, name):
        problem = f"{site.rules[name].unit!r} does not fit the expression, which is in {unit}"
        yield Finding("error", f"rules.{name}.unit", problem, "Correct the unit or the expression.")
    for other in site.rules[name].upstream:
        if other not in site.equipment:
            remedy = suggestion(other, list(site.equipment))
            yield Finding("error", f"rules.{name}.upstream", f"no equipment is named {other!r}", remedy)


def _no_filter(site: Site, name: str) -> Iterator[Finding]:
    """What a site says of a filter that there is not."""
    equipment, key = site.equipment[name], f"equipment.{name}"
    if equipment.filter:
        problem = f"{equipment.model} has no filter, or the filter lacks points"
        yield Finding("error", f"{key}.filter", problem, "Map all of its roles (`fdd models`), or leave it out.")
    for word in ("parameters", "start_up"):
        if word in equipment.model_fields_set:
            yield Finding("warning", f"{key}.{word}", "is for a filter, and there is none", "Add `filter: true`.")


def _rows(site: Site, name: str, kind: EquipmentModel) -> Iterator[Finding]:
    """Roles of equipment that is watched by rows: any table, any of a role's names, and all but a few optional."""
    equipment, key = site.equipment[name], f"equipment.{name}"
    taken: dict[str, str] = {}
    for table in ("inputs", "outputs"):
        for word, point in getattr(equipment, table).items():
            place, symbol = f"{key}.{table}.{word}", kind.symbol_of(word)
            if symbol is None:
                known = [*kind.by_symbol, *(n for r in kind.roles for n in r.names)]
                yield Finding("error", place, "the model has no such role", suggestion(word, known))
            elif symbol in taken:
                problem = f"means the same role ({symbol}) as {taken[symbol]!r}"
                yield Finding("error", place, problem, "Keep one of the two.")
            else:
                taken[symbol] = word
                yield from _fit(site, place, point, kind.by_symbol[symbol])
    for role in missing_roles(equipment, kind):
        problem = f"role {role.symbol} ({role.meaning}) has no point"
        yield Finding("error", key, problem, f"Add `{role.symbol}: POINT` [{role.unit}].")
    left = [r for r in kind.rows if not set(r.needs) <= taken.keys()]
    if left:
        absent = sorted({symbol for r in left for symbol in r.needs if symbol not in taken})
        problem = f"{len(left)} of {len(kind.rows)} expectations cannot be judged without {', '.join(absent)}"
        yield Finding("warning", key, problem, "Map what the plant measures of these.")


# What a filter's equipment has and a chiller does not, with what stands in its place.
_NOT_A_CHILLERS = {
    "outputs": "Map every measured quantity under 'inputs'.",
    "parameters": "What is known of them is given as 'priors' and 'leak' under 'options'.",
    "charts": "A chiller's charts are fixed; 'options' has their limits.",
    "start_up": "Give 'steady: {settling: SECONDS}' under 'options'.",
}


def _chiller(site: Site, key: str, name: str) -> Iterator[Finding]:
    from fdd.chiller_eiv.model import ChillerError  # sites without a chiller need not load it
    from fdd.config import chiller

    equipment = site.equipment[name]
    for word, remedy in _NOT_A_CHILLERS.items():
        if word in equipment.model_fields_set:
            yield Finding("error", f"{key}.{word}", "a chiller has none", remedy)
    known = {q.symbol: q for q in chiller.ROLES}
    for role, point in equipment.inputs.items():
        if role in known:
            yield from _fit(site, f"{key}.inputs.{role}", point, known[role])
        else:
            yield Finding("error", f"{key}.inputs.{role}", "a chiller has no such role", suggestion(role, list(known)))
    try:
        config = chiller.chiller_config(site, name)
    except ChillerError as error:
        yield Finding("error", f"{key}.options", str(error), "docs/chiller.md lists the keys.")
        return
    for q in chiller.missing_roles(config, equipment.inputs):
        yield Finding(
            "error", key, f"role {q.symbol} ({q.meaning}) has no point", f"Add `{q.symbol}: POINT` [{q.unit}]."
        )
    for q in chiller.unknown_errors(config):
        remedy = f"Give its point a 'sensor_sd', or 'errors: {{{q.symbol}: {{random: ...}}}}' under 'options'."
        yield Finding(
            "error", f"{key}.options.errors", f"the sensor error of {q.symbol} ({q.meaning}) is not known", remedy
        )
    share = site.false_alarms_per_year * equipment.weight / site.weights
    own = chiller.false_alarms(config)
    if own > 1.001 * share:
        problem = f"its charts may give {own:.2g} false alarms a year; its share of the site's is {share:.2g}"
        remedy = "Leave residual_false_alarms and drift.false_alarms out, or raise false_alarms_per_year or its weight."
        yield Finding("warning", f"{key}.options", problem, remedy)


def _roles(site: Site, key: str, mapped: dict[str, str], roles: tuple[Quantity, ...]) -> Iterator[Finding]:
    known = {q.symbol: q for q in roles}
    for role, point in mapped.items():
        if role not in known:
            yield Finding("error", f"{key}.{role}", "the model has no such role", suggestion(role, list(known)))
            continue
        yield from _fit(site, f"{key}.{role}", point, known[role])
    for symbol, quantity in known.items():
        if symbol not in mapped:
            yield Finding(
                "error",
                key,
                f"role {symbol} ({quantity.meaning}) has no point",
                f"Add `{symbol}: POINT` [{quantity.unit}].",
            )


def _fit(site: Site, key: str, point: str, role: Quantity) -> Iterator[Finding]:
    """The point's SI unit must be the role's: models speak SI, so no factor is left to apply."""
    unit = site.units[point]
    if role.unit == "any" or conversion(role.unit).si == unit:
        return
    if unit == "1" and site.points[point].expression is None and "unit" not in site.points[point].model_fields_set:
        yield Finding("error", key, f"point {point!r} has no unit", f"Give it one that fits [{role.unit}].")
        return
    declared = site.points[point]
    try:
        conversion(declared.unit, role.unit, quantity=declared.quantity, fluid=declared.fluid)
        remedy = ""
    except UnitError as error:
        remedy = error.remedy
    problem = f"point {point!r} is a {NAMES.get(unit, unit)} [{unit}], the model needs {role.meaning} [{role.unit}]"
    yield Finding("error", key, problem, remedy)


def _parameters(key: str, equipment: Equipment, model: ComponentModel) -> Iterator[Finding]:
    known = {p.symbol: p for p in model.parameters}
    for symbol, given in equipment.parameters.items():
        if given.fixed or given.tied:
            continue
        place = f"{key}.parameters.{symbol}"
        if symbol not in known:
            yield Finding("error", place, "the model has no such parameter", suggestion(symbol, list(known)))
            continue
        own = known[symbol]
        for what in ("initial", "lower", "upper"):
            value = getattr(given, what)
            if value is not None and not own.lower <= value <= own.upper:
                limits = f"[{own.lower:g}, {own.upper:g}] {own.unit}"
                yield Finding("error", place, f"{what} {value:g} is outside the model's {limits}", "Check the unit.")
