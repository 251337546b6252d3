"""Variables that dashboards share: site, component, resolution, and the streams of a component."""

from __future__ import annotations

from grafana_foundation_sdk.builders.dashboard import ConstantVariable, CustomVariable, QueryVariable
from grafana_foundation_sdk.models.dashboard import VariableOption, VariableRefresh, VariableSort

from dashboards import settings
from dashboards.queries import COMPONENT, SOURCE, tag_values

CHILLER_PARAMETER = "Q_leak"  # what only a chiller has


def _query(name: str, label: str, flux: str) -> QueryVariable:
    return (
        QueryVariable(name)
        .label(label)
        .datasource(SOURCE)
        .query(flux)
        .refresh(VariableRefresh.ON_TIME_RANGE_CHANGED)
        .sort(VariableSort.ALPHABETICAL_ASC)
    )


def site() -> QueryVariable:
    """Which site."""
    return _query("site", "Site", tag_values("charts", "site"))


def component() -> QueryVariable:
    """Which component of the site."""
    return _query("component", "Component", tag_values("charts", "component"))


def chiller() -> QueryVariable:
    """Which component, among those with a chiller's parameters."""
    return _query("component", "Chiller", tag_values("parameters", "component", f'r.name == "{CHILLER_PARAMETER}"'))


def of_component(name: str, label: str, measurement: str) -> QueryVariable:
    """Streams of the chosen component; panels repeat over them."""
    flux = tag_values(measurement, "name", f"r.component == {COMPONENT}")
    return _query(name, label, flux).multi(True).include_all(True).current(VariableOption(True, "All", "$__all"))


def resolution() -> CustomVariable:
    """Every point, or hourly values for long spans."""
    options = [VariableOption(True, "every point", "raw"), VariableOption(False, "hourly", "hourly")]
    return (
        CustomVariable("resolution")
        .label("Resolution")
        .values("every point : raw,hourly : hourly")
        .options(options)
        .current(options[0])
    )


def links() -> list[ConstantVariable]:
    """Where reports and the runbook are."""
    return [
        ConstantVariable(name).value(value)
        for name, value in (("reports", settings.REPORTS), ("runbook", settings.RUNBOOK))
    ]
