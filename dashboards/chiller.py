"""One chiller: Gordon-Ng parameters with intervals, the steady-state gate, the power residual, points kept."""

from __future__ import annotations

from grafana_foundation_sdk.builders.dashboard import Dashboard, Row

from dashboards import panels, variables
from dashboards.alarm_list import alarm_table
from dashboards.component import predictions
from dashboards.queries import COMPONENT, rows, wide, windowed
from dashboards.settings import BLUE, GREEN

_HERE = f"r.component == {COMPONENT}"
PARAMETERS = (
    ("dS", "W/K", "Internal entropy production: rises with compressor wear and low refrigerant charge"),
    ("Q_leak", "watt", "Heat leak: rises with by-passing vapour and damaged insulation"),
    ("R", "K/W", "Resistance of the heat exchangers: rises with fouling and with low water flow"),
)


def build() -> Dashboard:
    """The dashboard."""
    board = panels.dashboard(
        "fdd-chiller", "Chiller", "What the chiller's own physics say about its condition", "now-90d"
    )
    for variable in (variables.site(), variables.chiller(), variables.resolution(), *variables.links()):
        board.with_variable(variable)
    gate = rows("gates", "open", where=_HERE, long=False)
    share = f"{gate}\n  |> group()\n  |> mean()"
    kept = rows("gates", "kept", where=_HERE, long=False) + "\n  |> last()\n  |> group()\n  |> sum()"
    seen = rows("gates", "seen", where=_HERE, long=False) + "\n  |> last()\n  |> group()\n  |> sum()"
    board.with_panel(
        panels.number("Gate open", "Share of the time in steady state", share, [(None, BLUE)], "percentunit", "no data")
    )
    board.with_panel(panels.number("Points kept", "Steady-state points behind the estimates", kept, [(None, GREEN)]))
    board.with_panel(panels.number("Points seen", "Points before the gate", seen, [(None, BLUE)]))
    board.with_row(Row("Parameters"))
    for name, unit, meaning in PARAMETERS:
        flux = windowed(rows("parameters", "value", "lower", "upper", where=f'{_HERE} and r.name == "{name}"'), "last")
        panel = panels.curves(
            name, f"{meaning}. With 95 % interval.", wide(flux, "value", "lower", "upper"), unit, span=8
        )
        board.with_panel(panels.band(panel))
    board.with_row(Row("Power"))
    power = panels.curves(
        "Power: measured and predicted",
        "Above the band: the machine takes more power for this load and these temperatures than when it was well.",
        predictions(_HERE),
        "watt",
    )
    board.with_panel(panels.band(power))
    residual = wide(windowed(rows("predictions", "innovation", where=_HERE)), "innovation")
    board.with_panel(
        panels.curves("Power residual", "Standardised; its mean is zero while the machine is well", residual, "none")
    )
    board.with_row(Row("Steady-state gate"))
    opened = wide(windowed(rows("gates", "open", where=_HERE)), "open")
    board.with_panel(
        panels.curves(
            "Gate", "1 while points count, 0 while the machine is off or in transition", opened, "percentunit"
        )
    )
    points = wide(windowed(rows("gates", "kept", "seen", where=_HERE), "last"), "kept", "seen")
    board.with_panel(
        panels.curves(
            "Points kept and seen", "Estimates need points; a flat line means none pass the gate", points, "short"
        )
    )
    return board.with_panel(alarm_table("Alarms of the chiller", f'{_HERE} and r.state != "cleared"', height=6))
