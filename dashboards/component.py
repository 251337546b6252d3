"""One component: measured against predicted, innovations, charts with limits, parameters with intervals, baselines."""

from __future__ import annotations

from grafana_foundation_sdk.builders.dashboard import Dashboard, Row

from dashboards import panels, variables
from dashboards.alarm_list import alarm_table
from dashboards.queries import COMPONENT, DOCUMENTS, SITE, rows, wide, windowed
from dashboards.settings import BAND_SD, INNOVATION_BAND, ORANGE

_HERE = f"r.component == {COMPONENT}"


def _named(variable: str) -> str:
    return f"{_HERE} and r.name == ${{{variable}:doublequote}}"


def predictions(where: str) -> str:
    """Measured and predicted with the band of the one-step prediction."""
    flux = windowed(rows("predictions", "measured", "predicted", "sd", where=where))
    flux += '\n  |> pivot(rowKey: ["_time"], columnKey: ["_field"], valueColumn: "_value")\n  |> group()\n'
    flux += "  |> filter(fn: (r) => exists r.predicted and exists r.sd)\n"
    lower, upper = (f"r.predicted {sign} {BAND_SD} * r.sd" for sign in "-+")
    flux += f"  |> map(fn: (r) => ({{r with lower: {lower}, upper: {upper}}}))\n"
    flux += '  |> keep(columns: ["_time", "measured", "predicted", "lower", "upper"])\n  |> sort(columns: ["_time"])'
    return flux


def baselines() -> str:
    """Every accepted baseline of the component, newest first; the text is the document."""
    return (
        f"from(bucket: {DOCUMENTS})\n  |> range(start: 0, stop: 1)\n"
        '  |> filter(fn: (r) => r._measurement == "baseline" and r._field == "body" and r.part == "0")\n'
        f"  |> filter(fn: (r) => r.site == {SITE})\n  |> group()\n"
        f'  |> filter(fn: (r) => strings.hasPrefix(v: r.key, prefix: {COMPONENT} + "/"))\n'
        '  |> keep(columns: ["key", "_value"])\n  |> rename(columns: {_value: "baseline"})\n'
        '  |> sort(columns: ["key"], desc: true)'
    )


def build() -> Dashboard:
    """The dashboard."""
    board = panels.dashboard("fdd-component", "Component", "Why the service thinks that a component is well, or not")
    streams = (
        variables.of_component("output", "Output", "predictions"),
        variables.of_component("stream", "Chart", "charts"),
        variables.of_component("parameter", "Parameter", "parameters"),
    )
    for variable in (variables.site(), variables.component(), *streams, variables.resolution(), *variables.links()):
        board.with_variable(variable)
    board.with_panel(alarm_table("Alarms of the component", f'{_HERE} and r.state != "cleared"', height=5))
    board.with_row(Row("Measured against predicted"))
    measured = panels.curves(
        "${output}: measured and predicted",
        f"The band is the filter's one-step prediction +- {BAND_SD:g} standard deviations, in the output's SI unit. "
        "Measurements that stay on one side of it are what innovations and charts pick up.",
        predictions(_named("output")),
    )
    board.with_panel(panels.repeated(panels.band(measured), "output"))
    innovation = panels.curves(
        "${output}: standardised innovations",
        "White with unit variance while the model holds: two thirds within 1, nearly all within "
        f"{INNOVATION_BAND:g}. A mean away from zero or slow waves mean that the component or the sensor has changed.",
        wide(windowed(rows("predictions", "innovation", where=_named("output"))), "innovation"),
        height=6,
    )
    innovation = innovation.thresholds(
        panels.thresholds([(None, ORANGE), (-INNOVATION_BAND, "transparent"), (INNOVATION_BAND, ORANGE)])
    )
    board.with_panel(panels.repeated(innovation, "output"))
    board.with_row(Row("Charts"))
    chart = panels.curves(
        "${stream}",
        "The statistic alarms when it reaches the limit; the limit follows from the plant's false-alarm budget.",
        wide(windowed(rows("charts", "statistic", "limit", where=_named("stream")), "max"), "statistic", "limit"),
        height=7,
    )
    board.with_panel(panels.repeated(panels.limit(chart, "limit"), "stream"))
    board.with_row(Row("Parameters"))
    estimate = panels.curves(
        "${parameter}",
        "Estimate with its 95 % interval, in the parameter's SI unit. Intervals that no longer overlap: real change.",
        wide(
            windowed(rows("parameters", "value", "lower", "upper", where=_named("parameter")), "last"),
            "value",
            "lower",
            "upper",
        ),
        height=7,
    )
    board.with_panel(panels.repeated(panels.band(estimate), "parameter"))
    board.with_row(Row("Baselines"))
    versions = 'import "strings"\n' + baselines()
    return board.with_panel(panels.listing("Baselines", "Every accepted baseline, newest first", versions, 7))
