"""``fdd report``: what the report has to know of a site, from its file; and where the report goes."""

from __future__ import annotations

from pathlib import Path

from fdd.config import Site
from fdd.report.content import gather
from fdd.report.render import findings_csv, findings_json, write_report
from fdd.report.site import ComponentInfo, OutputInfo, ParameterInfo, SiteInfo
from fdd.service.errors import UsageError
from fdd.service.opened import Opened, open_site
from fdd.service.plan import Chiller, Component


def site_info(opened: Opened) -> SiteInfo:
    """Names, units, zone and budget, from the site file and the models."""
    site = opened.site
    return SiteInfo(
        name=site.name,
        zone=site.zone,
        false_alarms_per_year=site.false_alarms_per_year,
        components={c.name: _info(site, c) for c in opened.plan.watched},
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
    findings: Path | None = None,
    since: str | None = None,
    until: str | None = None,
) -> list[Path]:
    """Write the report from the store; returns every file that was written.

    Raises
    ------
    UsageError : findings are asked for in a form that is not known
    """
    opened = open_site(site_file)
    info = site_info(opened)
    start, end = opened.nanoseconds(since), opened.nanoseconds(until)
    store = opened.store(read_only=True)
    try:
        written = [write_report(store, info, out, start, end, pdf=pdf)]
        if findings:
            report = gather(store, info, start, end)
            match findings.suffix:
                case ".json":
                    text = findings_json(report)
                case ".csv":
                    text = findings_csv(report)
                case other:
                    raise UsageError(f"findings cannot be written as {other!r}; name a .json or a .csv file")
            findings.write_text(text, encoding="utf-8")
            written.append(findings)
    finally:
        store.close()
    return [*written, *([pdf] if pdf else [])]
