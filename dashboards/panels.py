"""Panels as the dashboards use them: each with a source, a unit and a sentence that says how to read it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from grafana_foundation_sdk.builders import common as common_builders
from grafana_foundation_sdk.builders import dashboard as builders
from grafana_foundation_sdk.builders import stat, statetimeline, table, timeseries
from grafana_foundation_sdk.models import common
from grafana_foundation_sdk.models.dashboard import (
    DashboardCursorSync,
    DashboardLinkType,
    DynamicConfigValue,
    FieldColorModeId,
    Threshold,
    ThresholdsMode,
    ValueMap,
    ValueMapping,
    ValueMappingResult,
)

from dashboards import settings
from dashboards.queries import SOURCE, Flux
from fdd.store.schema import PHASES

Steps = Sequence[tuple[float | None, str]]


def dashboard(uid: str, title: str, description: str, span: str = "now-7d") -> builders.Dashboard:
    """An empty dashboard with links to the others."""
    others = (
        builders.DashboardLink("Fault detection")
        .type(DashboardLinkType.DASHBOARDS)
        .tags(["fdd"])
        .as_dropdown(True)
        .include_vars(True)
        .keep_time(True)
    )
    return (
        builders.Dashboard(title)
        .uid(uid)
        .description(description)
        .tags(["fdd"])
        .time(span, "now")
        .refresh("1m")
        .timezone("browser")
        .tooltip(DashboardCursorSync.CROSSHAIR)
        .readonly()
        .link(others)
    )


def thresholds(steps: Steps) -> builders.ThresholdsConfig:
    """Colours from a value upwards; the first has no value."""
    return builders.ThresholdsConfig().mode(ThresholdsMode.ABSOLUTE).steps([Threshold(v, c) for v, c in steps])


def words(colours: Mapping[str, str], *, coded: bool = False) -> list[ValueMapping]:
    """Words in their colours; ``coded``: the field holds the word's number."""
    keys = [(str(i) if coded else word, word) for i, word in enumerate(colours)]
    options = {key: ValueMappingResult(text=word, color=colours[word], index=i) for i, (key, word) in enumerate(keys)}
    return [ValueMap(options)]


PHASE_WORDS = words({phase: settings.PHASE_COLOURS[phase] for phase in PHASES}, coded=True)


def number(title: str, description: str, flux: str, steps: Steps, unit: str = "short", empty: str = "0") -> stat.Panel:
    """One big number."""
    return (
        stat.Panel()
        .title(title)
        .description(description)
        .datasource(SOURCE)
        .with_target(Flux(flux))
        .unit(unit)
        .no_value(empty)
        .thresholds(thresholds(steps))
        .color_scheme(builders.FieldColor().mode(FieldColorModeId.THRESHOLDS))
        .reduce_options(common_builders.ReduceDataOptions().calcs(["lastNotNull"]).fields("").values(False))
        .height(4)
        .span(4)
    )


def curves(
    title: str, description: str, flux: str, unit: str = "none", *, height: int = 8, span: int = 12
) -> timeseries.Panel:
    """Curves over time; gaps stay gaps."""
    return (
        timeseries.Panel()
        .title(title)
        .description(description)
        .datasource(SOURCE)
        .with_target(Flux(flux))
        .unit(unit)
        .span_nulls(False)
        .show_points(common.VisibilityMode.AUTO)
        .legend(
            common_builders.VizLegendOptions()
            .display_mode(common.LegendDisplayMode.LIST)
            .placement(common.LegendPlacement.BOTTOM)
            .show_legend(True)
        )
        .height(height)
        .span(span)
    )


def style(**properties: Any) -> list[DynamicConfigValue]:
    """Properties of one curve: colour, dash, width, fill down to another curve, no legend entry."""
    paths = {
        "width": "custom.lineWidth",
        "below": "custom.fillBelowTo",
        "opacity": "custom.fillOpacity",
        "dash": "custom.lineStyle",
        "name": "displayName",
        "hide": "custom.hideFrom",
        "link": "links",
        "mappings": "mappings",
        "cell": "custom.cellOptions",
        "column": "custom.width",
        "unit": "unit",
    }
    values = []
    for key, value in properties.items():
        if key == "colour":
            values.append(DynamicConfigValue("color", {"mode": "fixed", "fixedColor": value}))
        else:
            values.append(DynamicConfigValue(paths[key], value))
    return values


def band(panel: timeseries.Panel, upper: str = "upper", lower: str = "lower") -> timeseries.Panel:
    """Fill between two curves of the panel."""
    edge = {"colour": "light-blue", "width": 0}
    return panel.override_by_name(upper, style(**edge, below=lower, opacity=20)).override_by_name(lower, style(**edge))


def limit(panel: timeseries.Panel, name: str) -> timeseries.Panel:
    """Draw a curve as a limit."""
    return panel.override_by_name(name, style(colour=settings.RED, dash={"fill": "dash", "dash": [8, 6]}))


def repeated(panel: timeseries.Panel, variable: str, direction: Literal["h", "v"] = "h") -> timeseries.Panel:
    """One panel for each value of a variable, two side by side."""
    return panel.span(24).repeat(variable).repeat_direction(direction).max_per_row(2)


def phases(title: str, description: str, flux: str, height: int = 8, span: int = 24) -> statetimeline.Panel:
    """Phases of charts as coloured bars."""
    return (
        statetimeline.Panel()
        .title(title)
        .description(description)
        .datasource(SOURCE)
        .with_target(Flux(flux))
        .unit("none")
        .mappings(PHASE_WORDS)
        .color_scheme(builders.FieldColor().mode(FieldColorModeId.THRESHOLDS))
        .display_name("${__field.labels.component}")
        .show_value(common.VisibilityMode.NEVER)
        .merge_values(True)
        .height(height)
        .span(span)
    )


def listing(title: str, description: str, flux: str, height: int = 9, span: int = 24) -> table.Panel:
    """A table of the query's columns."""
    return (
        table.Panel()
        .title(title)
        .description(description)
        .datasource(SOURCE)
        .with_target(Flux(flux))
        .unit("none")
        .filterable(True)
        .height(height)
        .span(span)
    )


def coloured(panel: table.Panel, column: str, colours: Mapping[str, str], *, coded: bool = False) -> table.Panel:
    """Words of a column on their colours."""
    cell = {"type": "color-background", "mode": "basic"}
    mappings = [m.to_json() for m in words(colours, coded=coded)]
    return panel.override_by_name(column, style(mappings=mappings, cell=cell))


def linked(panel: table.Panel, column: str, title: str, url: str) -> table.Panel:
    """A link on every cell of a column."""
    link = {"title": title, "url": url, "targetBlank": True}
    return panel.override_by_name(column, style(link=[link]))
