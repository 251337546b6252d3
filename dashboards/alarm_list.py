"""Alarm list: every alarm of the site with its story, its report and its page in the runbook."""

from __future__ import annotations

from grafana_foundation_sdk.builders import table
from grafana_foundation_sdk.builders.dashboard import Dashboard

from dashboards import panels, variables
from dashboards.queries import alarms, count_alarms, flux_list
from dashboards.settings import GREEN, ORANGE, SEVERITY_COLOURS, STATE_COLOURS
from fdd.report.render import page_of
from fdd.store.schema import ALARM_STATES, SEVERITIES

_COLUMNS = ("priority", "state", "component", "summary", "since", "raised", "updated", "key")


def _rank(column: str, order: tuple[str, ...]) -> str:
    """A number for each word, the last the highest."""
    chain = " else ".join(f'if r.{column} == "{word}" then {i}' for i, word in enumerate(order))
    return f"{chain} else -1"


def listing(where: str) -> str:
    """Alarms, the most urgent first."""
    times = ", ".join(f"{c}: time(v: r.{c})" for c in ("since", "raised", "updated"))
    return (
        f"{alarms(where)}\n"
        f"  |> map(fn: (r) => ({{r with priority: r.severity, rank: {_rank('severity', SEVERITIES)}, "
        f"standing: {_rank('state', ALARM_STATES)}, {times}}}))\n"
        '  |> sort(columns: ["rank", "standing", "raised"], desc: true)\n'
        f"  |> keep(columns: {flux_list(_COLUMNS)})"
    )


def alarm_table(title: str, where: str, height: int = 18) -> table.Panel:
    """A table of alarms with links to component, report and runbook."""
    panel = panels.listing(
        title, "Most urgent first; follow the links for evidence and first checks", listing(where), height
    )
    panel = panels.coloured(panel, "priority", SEVERITY_COLOURS)
    panel = panels.coloured(panel, "state", STATE_COLOURS)
    panel = panels.linked(
        panel, "component", "Open the component", "/d/fdd-component?var-site=${site}&var-component=${__value.raw}"
    )
    panel = panels.linked(panel, "summary", "What to do", "${runbook}#alarms")
    return panels.linked(panel, "key", "Open the report", "${reports}/" + page_of("${__value.raw:percentencode}"))


def build() -> Dashboard:
    """The dashboard."""
    board = panels.dashboard(
        "fdd-alarms", "Alarms", "Every alarm of the site: open, shelved, suppressed, cleared", "now-1y"
    )
    for variable in (variables.site(), *variables.links()):
        board.with_variable(variable)
    for state, meaning in (
        ("raised", "Nobody has taken them yet"),
        ("acknowledged", "Somebody is at it"),
        ("shelved", "Put off until a given time"),
        ("suppressed by design", "Explained by another alarm, a stop or known work"),
        ("returned to normal", "The signs have gone; clear them once understood"),
        ("cleared", "Understood and done with"),
    ):
        steps = [(None, GREEN)] if state in ("cleared", "suppressed by design") else [(None, GREEN), (1, ORANGE)]
        board.with_panel(panels.number(state.capitalize(), meaning, count_alarms(f'r.state == "{state}"'), steps))
    return board.with_panel(alarm_table("Alarms", "true"))
