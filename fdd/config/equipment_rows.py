"""Equipment of the site file that is watched by rows of expectations: which, with which points, with what budget."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from fdd.config.schema import Equipment, Site
from fdd.models.equipment import KINDS
from fdd.models.equipment.rule import rule_model
from fdd.models.expectation import EquipmentModel, Role
from fdd.models.registry import MODELS, get_model
from fdd.units import conversion


def kind_of(equipment: Equipment) -> EquipmentModel | None:
    """The declaration by whose rows equipment is watched; None where its model has none."""
    return KINDS.get(equipment.model)


def points_of(equipment: Equipment, kind: EquipmentModel) -> dict[str, str]:
    """Role to point, whatever of a role's names the site uses; words that mean no role are left out."""
    given = {**equipment.inputs, **equipment.outputs}
    found = {kind.symbol_of(name): point for name, point in given.items()}
    return {symbol: point for symbol, point in found.items() if symbol is not None}


def has_filter(equipment: Equipment) -> bool:
    """Whether equipment is under a filter: beside rows where that is asked for and all quantities have points."""
    kind = kind_of(equipment)
    if kind is None:
        return True
    if equipment.model not in MODELS or not equipment.filter:
        return False
    model = get_model(equipment.model)
    return {q.symbol for q in (*model.inputs, *model.outputs)} <= points_of(equipment, kind).keys()


def missing_roles(equipment: Equipment, kind: EquipmentModel) -> Iterator[Role]:
    """Required roles without a point."""
    mapped = points_of(equipment, kind)
    yield from (r for r in kind.required if r.symbol not in mapped)


def sensor_errors(site: Site, equipment: Equipment, kind: EquipmentModel) -> Mapping[str, float]:
    """Standard deviations that the points' ``sensor_sd`` declares, by role, in SI."""
    found = {role: site.points[point].sensor_sd_si for role, point in points_of(equipment, kind).items()}
    return {role: sd for role, sd in found.items() if sd is not None}


def rows_budget(site: Site, name: str) -> float:
    """False alarms a year that the rows of a piece of equipment may give: its share, half of it beside a filter."""
    equipment = site.equipment[name]
    return site.false_alarms_per_year * equipment.weight / site.weights * (0.5 if has_filter(equipment) else 1.0)


def rows_share(site: Site) -> float:
    """The part of the site's budget that rows and rules take."""
    rules = sum(r.weight for r in site.rules.values()) / site.weights if site.rules else 0.0
    own = sum(rows_budget(site, name) for name, e in site.equipment.items() if kind_of(e) is not None)
    return own / site.false_alarms_per_year + rules


def rule_of(site: Site, name: str) -> tuple[EquipmentModel, float]:
    """A rule's declaration, and the false alarms a year that it may give."""
    rule, expression = site.rules[name], site.rule(name)[0]
    tolerance = rule.tolerance if rule.unit is None else _spread(rule.unit, rule.tolerance)
    model = rule_model(name, expression.unit, tolerance, rule.side, rule.held, rule.says or name, rule.checks)
    return model, site.false_alarms_per_year * rule.weight / site.weights


def tolerance_fits(site: Site, name: str) -> bool:
    """Whether a rule's tolerance is given in a unit that fits its expression."""
    unit = site.rules[name].unit
    wanted = site.rule(name)[0].unit
    return unit is None or conversion(unit).si == wanted or (conversion(unit).si == "degC" and wanted == "K")


def _spread(unit: str, tolerance: float) -> float:
    return conversion(unit).spread(tolerance)
