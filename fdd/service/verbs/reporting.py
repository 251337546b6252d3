"""``fdd report``: what the report has to know of a site, from its file; and where the report goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from fdd.config import Site
from fdd.records import Baseline
from fdd.report.content import gather
from fdd.report.render import findings_csv, findings_json, write_gathered, write_pages
from fdd.report.site import ComponentInfo, OutputInfo, ParameterInfo, SiteInfo
from fdd.report.words import DAY
from fdd.service.baselines.versions import in_force
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Chiller, Component, RowEquipment
from fdd.service.site.site_context import SiteContext, open_site

Period = Literal["weekly", "monthly"]
PERIODS: dict[Period, int] = {"weekly": 7 * DAY, "monthly": 30 * DAY}
WRITERS = {".json": findings_json, ".csv": findings_csv}


def site_info(context: SiteContext, baselines: Mapping[str, Baseline] | None = None) -> SiteInfo:
    """Names, units, zone and budget, from the site file and the models as the baselines have them."""
    site, plan = context.site, context.plan.following(baselines or {})
    return SiteInfo(
        name=site.name,
        zone=site.zone,
        false_alarms_per_year=site.false_alarms_per_year,
        components={e.name: _rows_info(site, e) for e in plan.equipment}
        | {c.name: _info(site, c) for c in plan.watched},
        tariffs=site.tariffs.model_dump(),
    )


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


def _rows_info(site: Site, watched: RowEquipment) -> ComponentInfo:
    equipment = site.equipment.get(watched.name)
    title, place = (equipment.title, equipment.location) if equipment else ("", "")
    return ComponentInfo(title or watched.name, watched.model.title, {}, {}, place, daily=True)


def _info(site: Site, watched: Component | Chiller) -> ComponentInfo:
    return _chiller_info(site, watched) if isinstance(watched, Chiller) else _component_info(site, watched)


def _chiller_info(site: Site, chiller: Chiller) -> ComponentInfo:
    equipment = site.equipment[chiller.name]
    # "power" is its own meaning: findings say the word, which no symbol may replace.
    outputs = {"power": OutputInfo(chiller.inputs["power"], "W", "power")}
    return ComponentInfo(
        equipment.title or chiller.name, "Chiller (Gordon-Ng)", outputs, dict(_CHILLER), equipment.location
    )


def _component_info(site: Site, component: Component) -> ComponentInfo:
    equipment, model = site.equipment[component.name], component.model
    outputs = {
        q.symbol: OutputInfo(point, q.unit, site.points[point].description or q.meaning)
        for q, point in zip(model.outputs, component.outputs, strict=True)
    }
    parameters = {p.symbol: ParameterInfo(p.unit, p.meaning) for p in model.parameters if p.kind == "physical"}
    return ComponentInfo(equipment.title or component.name, model.title, outputs, parameters, equipment.location)


def report_site(
    site_file: Path,
    out: Path,
    *,
    pdf: Path | None = None,
    findings: Sequence[Path] = (),
    period: Period = "weekly",
    pages: bool = True,
    since: str | None = None,
    until: str | None = None,
) -> list[Path]:
    """Write the report from the store, and a page ``KEY.html`` beside it for every alarm of the period.

    Returns every file that was written, the report first.

    Raises
    ------
    UsageError : findings are asked for in a form that is not known
    """
    for path in findings:
        if path.suffix not in WRITERS:
            raise UsageError(f"findings cannot be written as {path.suffix!r} ({path}); name a .json or a .csv file")
    context = open_site(site_file)
    store = context.store(read_only=True)
    try:
        info = site_info(context, in_force(store, [c.name for c in context.plan.components]))
        report = gather(store, info, context.nanoseconds(since), context.nanoseconds(until), PERIODS[period])
    finally:
        store.close()
    written = [write_gathered(report, out, pdf=pdf), *([pdf] if pdf else [])]
    for path in findings:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(WRITERS[path.suffix](report), encoding="utf-8")
    return [*written, *findings, *(write_pages(report, out.parent) if pages else [])]
