"""Plant overview: is the plant well, what stands open, where to look first."""

from __future__ import annotations

from grafana_foundation_sdk.builders.dashboard import Dashboard, Row

from dashboards import panels, variables
from dashboards.alarm_list import alarm_table
from dashboards.queries import count_alarms, rows, windowed
from dashboards.settings import BLUE, GREEN, GREY, ORANGE, PHASE_COLOURS, RED
from fdd.store.schema import PHASES

OPEN = 'r.state != "cleared"'
_LATEST_PHASE = rows("charts", "phase", long=False) + "\n  |> last()\n  |> group()"


def _open(where: str) -> str:
    return count_alarms(f"{OPEN} and {where}")


def _components_in(phase: str) -> str:
    """How many components have this as the worst phase of their charts."""
    code = float(PHASES.index(phase))
    return (
        # "r with": without it the server's map gives nulls for whole numbers.
        f'{_LATEST_PHASE}\n  |> group(columns: ["component"])\n  |> max()\n  |> group()\n'
        f"  |> map(fn: (r) => ({{r with _value: if r._value == {code} then 1.0 else 0.0}}))\n  |> sum()"
    )


def _health() -> str:
    ratio = "if exists r.limit and exists r.statistic and r.limit > 0.0 then r.statistic / r.limit else 0.0"
    return (
        f"{rows('charts', 'statistic', 'limit', 'phase', long=False)}\n  |> last()\n  |> group()\n"
        '  |> pivot(rowKey: ["component", "name"], columnKey: ["_field"], valueColumn: "_value")\n'
        f"  |> map(fn: (r) => ({{component: r.component, chart: r.name, phase: r.phase, ratio: {ratio}}}))\n"
        '  |> sort(columns: ["phase", "ratio"], desc: true)'
    )


def build() -> Dashboard:
    """The dashboard."""
    board = panels.dashboard("fdd-plant", "Plant overview", "Health of the plant and what stands open, by priority")
    for variable in (variables.site(), variables.resolution(), *variables.links()):
        board.with_variable(variable)
    some = [(None, GREEN), (1, ORANGE)]
    urgent = 'r.severity == "high" or r.severity == "critical"'
    board.with_panel(panels.number("Open alarms", "Alarms that are not cleared", _open("true"), some))
    board.with_panel(
        panels.number("High priority", "Open, high or critical", _open(f"({urgent})"), [(None, GREEN), (1, RED)])
    )
    board.with_panel(
        panels.number("Unacknowledged", "Raised, nobody has taken them", _open('r.state == "raised"'), some)
    )
    board.with_panel(
        panels.number("Quiet", "Components whose charts are all quiet", _components_in("quiet"), [(None, GREEN)])
    )
    board.with_panel(
        panels.number("Learning", "Components that are not judged yet", _components_in("learning"), [(None, BLUE)])
    )
    no_data = panels.number(
        "No data", "Components that cannot be judged", _components_in("no data"), [(None, GREEN), (1, GREY)]
    )
    board.with_panel(no_data)
    board.with_row(Row("Open alarms"))
    board.with_panel(alarm_table("Open alarms", OPEN, height=8))
    board.with_row(Row("Components"))
    timeline = windowed(rows("charts", "phase") + '\n  |> group(columns: ["component"])', "max")
    board.with_panel(panels.phases("Worst phase of each component", "Red: at least one chart is in alarm", timeline))
    worst = panels.listing(
        "Charts, nearest to their limit first",
        "Statistic over limit: at 1 the chart alarms. A ratio that has grown for weeks is worth a look before it does.",
        _health(),
    )
    worst = panels.coloured(worst, "phase", {p: PHASE_COLOURS[p] for p in PHASES}, coded=True)
    url = "/d/fdd-component?var-site=${site}&var-component=${__data.fields.component}&${__url_time_range}"
    board.with_panel(panels.linked(worst, "component", "Open the component", url))
    return board
