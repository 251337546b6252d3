"""Service health: does the service itself work, and how fresh is what it says."""

from __future__ import annotations

from grafana_foundation_sdk.builders.dashboard import Dashboard, Row

from dashboards import panels, variables
from dashboards.queries import SITE, condition, flux_list, rows, windowed
from dashboards.settings import BLUE, GREEN, LATE_SECONDS, ORANGE, PHASE_COLOURS, RED
from fdd.store.schema import PHASES

# Series of measurement "health": series name, title, unit, meaning.
GAUGES = (
    ("service/sample_rate", "Samples a second", "cps", "Samples taken in"),
    ("service/lag", "Lag", "s", "From a sample's event time to its verdict"),
    ("service/rss", "Memory", "bytes", "Resident memory of the daemon"),
    ("store/spool_bytes", "Waiting on disk", "bytes", "What waits while the database is away; zero is normal"),
)

BUDGET = (
    "All alarms that came, with their 95 % Poisson interval, against the false alarms that the budget promises; "
    "an alarm that was true counts too"
)


def gauge(series: str) -> str:
    """One gauge over time."""
    part, name = series.split("/")
    flux = rows("health", "value", where=f'r.component == "{part}" and r.name == "{name}"', long=False)
    return windowed(flux + '\n  |> group()\n  |> keep(columns: ["_time", "_value"])')


def kept() -> str:
    """Alarms a year: realised, the ends of the interval, and promised."""
    names = [f"alarms_a_year_{k}" for k in ("realised", "low", "high", "promised")]
    either = " or ".join(f'r.name == "{n}"' for n in names)
    flux = rows("health", "value", where=f'r.component == "service" and ({either})', long=False)
    return (
        windowed(flux, "last")
        + '\n  |> group()\n  |> pivot(rowKey: ["_time"], columnKey: ["name"], valueColumn: "_value")'
        + f"\n  |> keep(columns: {flux_list(('_time', *names))})"
        + '\n  |> sort(columns: ["_time"])'
    )


def newest() -> str:
    """Seconds since the event time of the newest verdict."""
    return (
        "from(bucket: v.defaultBucket)\n  |> range(start: v.timeRangeStart, stop: v.timeRangeStop)\n"
        f"  |> filter(fn: (r) => {condition('charts', ('phase',))} and r.site == {SITE})\n"
        "  |> last()\n  |> group()\n"
        '  |> max(column: "_time")\n'
        "  |> map(fn: (r) => ({_value: float(v: int(v: now()) - int(v: r._time)) / 1000000000.0}))"
    )


def in_phase(phase: str) -> str:
    """How many charts are in a phase, over time."""
    code = float(PHASES.index(phase))
    return (
        windowed(rows("charts", "phase", long=False), "last")
        + f"\n  |> map(fn: (r) => ({{r with _value: if r._value == {code} then 1.0 else 0.0}}))"
        + '\n  |> group(columns: ["_time"])\n  |> sum()\n  |> group()\n'
        + f'  |> rename(columns: {{_value: "{phase}"}})\n  |> sort(columns: ["_time"])'
    )


def counts() -> str:
    """What became of the samples, since the start."""
    return (
        rows("counts", "value", long=False)
        + '\n  |> last()\n  |> group()\n  |> rename(columns: {component: "part", name: "what", _value: "count"})'
        + '\n  |> keep(columns: ["part", "what", "count", "_time"])\n  |> sort(columns: ["part", "what"])'
    )


def build() -> Dashboard:
    """The dashboard."""
    board = panels.dashboard(
        "fdd-service", "Service health", "Rates, lag, spool and the phases of all charts", "now-24h"
    )
    for variable in (variables.site(), variables.resolution(), *variables.links()):
        board.with_variable(variable)
    age = [(None, GREEN), (LATE_SECONDS, RED)]
    board.with_panel(
        panels.number("Newest verdict", "Age of the newest event judged", newest(), age, "s", "none in range")
    )
    for series, title, unit, meaning in GAUGES:
        steps = [(None, GREEN), (1, ORANGE)] if series == "store/spool_bytes" else [(None, BLUE)]
        board.with_panel(panels.number(title, meaning, gauge(series) + "\n  |> last()", steps, unit, "no data"))
    board.with_row(Row("Over time"))
    for series, title, unit, meaning in GAUGES:
        board.with_panel(panels.curves(title, meaning, gauge(series), unit, height=6))
    board.with_row(Row("False-alarm budget"))
    board.with_panel(panels.curves("Alarms a year", BUDGET, kept(), "short", height=6))
    board.with_row(Row("Charts and samples"))
    for phase in PHASES:
        panel = panels.curves(f"Charts: {phase}", "How many of all charts", in_phase(phase), "short", height=6, span=6)
        board.with_panel(panel.override_by_name(phase, panels.style(colour=PHASE_COLOURS[phase])))
    return board.with_panel(panels.listing("What became of the samples", "Since the start of the daemon", counts(), 8))
