"""Write the site file of the demonstration plant: points, equipment, tariffs, and a source to taste."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from fdd.plant.district import EQUIPMENT, POINTS, SENSORS, TRUTH, WINGS, district_plant, models
from fdd.plant.scenario import Scenario

TITLES = {
    "hx": ("District heating exchanger", "basement, room 003"),
    "radiator-south": ("Radiator circuit south", "south wing"),
    "radiator-north": ("Radiator circuit north", "north wing"),
    "building": ("House", "both wings"),
}
MEANINGS = {
    "weather.T_out": "outdoor temperature",
    **{f"weather.I_{w}": f"sun on the {w} facade" for w in WINGS},
    **{f"occupancy.P_{w}": f"electricity used in the {w} wing" for w in WINGS},
    "hx.T_hot_in": "primary supply",
    "hx.T_hot_out": "primary return",
    "hx.T_cold_in": "secondary return",
    "hx.T_cold_out": "secondary supply",
    "hx.m_flow_hot": "primary flow",
    "hx.m_flow_cold": "secondary flow",
    **{f"radiator-{w}.m_flow": f"water flow of the {w} circuit" for w in WINGS},
    **{f"radiator-{w}.T_return": f"return of the {w} circuit" for w in WINGS},
    **{f"building.T_{w}": f"room temperature in the {w} wing" for w in WINGS},
}


def demo_site(
    folder: Path | str,
    *,
    name: str = "demo",
    false_alarms_per_year: float = 2.0,
    sources: Sequence[Mapping[str, Any]] | None = None,
    scenario: Scenario | None = None,
    store: Mapping[str, Any] | None = None,
) -> Path:
    """Write ``site.yaml`` of the demonstration plant into a folder and return its path.

    Parameters
    ----------
    folder : made where it is missing
    sources : the site's sources; by default the simulated plant itself with ``scenario``
    scenario : what the simulated plant does
    store : where results are kept; by default SQLite beside the site file
    """
    run = scenario or Scenario()
    site = {
        "name": name,
        "step": f"{run.step:g} s",
        "false_alarms_per_year": false_alarms_per_year,
        "tariffs": {"currency": "EUR", "heat": 0.09, "electricity": 0.28},
        "store": dict(store or {"kind": "sqlite", "path": f"{name}.sqlite"}),
        "sources": [dict(s) for s in sources] if sources is not None else [plant_source(run)],
        "points": _points(),
        "equipment": {n: _equipment(n) for n in EQUIPMENT},
    }
    path = Path(folder) / "site.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    yaml = YAML()
    yaml.width = 110
    with path.open("w", encoding="utf-8") as file:
        file.write("# A simulated, district-heated house of two wings; values of all points are in SI units.\n")
        yaml.dump(site, file)
    return path


def plant_source(scenario: Scenario) -> dict[str, Any]:
    """The table of a source of kind ``plant`` that runs a scenario."""
    table: dict[str, Any] = {
        "kind": "plant",
        "start": scenario.start,
        "length": f"{scenario.days:g} d",
        "step": f"{scenario.step:g} s",
        "seed": scenario.seed,
    }
    faults = [
        {
            "kind": f.kind,
            "target": f.target,
            "onset": f"{f.onset:g} s",
            "severity": f.severity,
            "shape": f.shape,
            "duration": f"{f.duration:g} s",
        }
        for f in scenario.faults
    ]
    return table | ({"faults": faults} if faults else {})


def _points() -> dict[str, dict[str, Any]]:
    table = {}
    for point, sensor in district_plant().sensors.items():
        noise, relative = SENSORS[point]
        # A relative error is given at a usual value of the flow.
        table[point] = {
            "unit": sensor.unit,
            "sensor_sd": noise or relative * 0.2,
            "description": MEANINGS[point],
        }
    return table


def _equipment(name: str) -> dict[str, Any]:
    kind, options = EQUIPMENT[name]
    model = models()[name]
    title, location = TITLES[name]
    roles = POINTS[name]
    own = {k: v for k, v in options.items() if k not in ("fixed", "tied")}
    known: dict[str, Any] = {s: {"initial": v, "fixed": True} for s, v in options.get("fixed", {}).items()}
    known |= {s: {"tied": other} for s, other in options.get("tied", {}).items()}
    known |= {
        s: _rough(v)
        for s, v in TRUTH[name].items()
        if s in {p.symbol for p in model.parameters if p.kind == "physical"}
    }
    table: dict[str, Any] = {
        "title": title,
        "location": location,
        "model": kind,
        "options": own,
        "inputs": {s: roles[s] for s in model.symbols["inputs"]},
        "outputs": {s: roles[s] for s in model.symbols["outputs"]},
        "parameters": known,
    }
    return table


def _rough(value: float) -> float:
    """What drawings and nameplates would tell: one figure."""
    return float(f"{value:.0e}")
