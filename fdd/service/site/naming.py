"""What people call the equipment of a site: for reports and for every line that names it."""

from __future__ import annotations

from fdd.config import Site
from fdd.report.site import ComponentInfo, OutputInfo, ParameterInfo, SiteInfo
from fdd.report.telling import Speaker
from fdd.service.site.plan import Chiller, Component, Plan, RowEquipment

# What the parameters of a chiller mean, with their SI unit.
_CHILLER = {
    "dS": ParameterInfo("W/K", "internal entropy production"),
    "Q_leak": ParameterInfo("W", "heat leak"),
    "R": ParameterInfo("K/W", "heat-exchanger resistance"),
    "R_flow": ParameterInfo("K/W", "part of the resistance that goes with the condenser flow"),
    "dS_speed": ParameterInfo("W/K", "part of the entropy production that goes with speed"),
    "condenser_approach": ParameterInfo("K", "condenser approach"),
    "evaporator_approach": ParameterInfo("K", "evaporator approach"),
}


def site_info(plan: Plan, site: Site | None = None) -> SiteInfo:
    """Names, units, zone and budget: from the plan's models, and from the site file what people call things."""
    components = {e.name: _rows_info(e, site) for e in plan.equipment} | {c.name: _info(c, site) for c in plan.watched}
    if site is None:
        return SiteInfo(plan.site, plan.zone, plan.false_alarms_per_year, components)
    return SiteInfo(
        name=site.name,
        zone=site.zone,
        false_alarms_per_year=site.false_alarms_per_year,
        components=components,
        tariffs=site.tariffs.model_dump(),
        language=site.language,
    )


def speaker_of(plan: Plan, site: Site | None = None) -> Speaker:
    """Who says in words what was found on a site."""
    return Speaker(site_info(plan, site))


def _called(name: str, site: Site | None) -> tuple[str, str]:
    """Title and location of equipment."""
    described = site.equipment.get(name) if site else None
    return (described.title or name, described.location) if described else (name, "")


def _rows_info(watched: RowEquipment, site: Site | None) -> ComponentInfo:
    title, location = _called(watched.name, site)
    return ComponentInfo(title, watched.model.title, {}, {}, location, daily=True)


def _info(watched: Component | Chiller, site: Site | None) -> ComponentInfo:
    title, location = _called(watched.name, site)
    if isinstance(watched, Chiller):
        # "power" is its own meaning: findings say the word, which no symbol may replace.
        outputs = {"power": OutputInfo(watched.inputs["power"], "W", "power")}
        return ComponentInfo(title, "Chiller (Gordon-Ng)", outputs, dict(_CHILLER), location)
    outputs = {
        q.symbol: OutputInfo(point, q.unit, (site.points[point].description if site else "") or q.meaning)
        for q, point in zip(watched.model.outputs, watched.outputs, strict=True)
    }
    parameters = {p.symbol: ParameterInfo(p.unit, p.meaning) for p in watched.model.parameters if p.kind == "physical"}
    return ComponentInfo(title, watched.model.title, outputs, parameters, location)
