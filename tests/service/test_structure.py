"""What ``fdd fit`` chooses where the site leaves it open, and what it does not put in force."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fdd.greybox.likelihood import Data
from fdd.greybox.simulate import realise
from fdd.models.registry import get_model
from fdd.service.baselines.fitting import Fitted, fit_site
from fdd.service.baselines.versions import in_force, versions
from fdd.service.engine.engine import Engine, EngineError
from fdd.service.site.site_context import SiteContext, open_site

QUIET = Console(quiet=True)
SITE = """
name: Substation
zone: UTC
step: 5 min
source: {kind: csv, path: data.csv, time: {column: time}}
store: {kind: sqlite, path: site.sqlite}
points:
  T1: {unit: degC}
  T2: {unit: degC}
  T3: {unit: degC}
  T4: {unit: degC}
  m1: {unit: kg/s}
  m2: {unit: kg/s}
equipment:
  hx:
    model: heat_exchanger
    inputs: {T_hot_in: T1, T_cold_in: T3, m_flow_hot: m1, m_flow_cold: m2}
    outputs: {T_hot_out: T2, T_cold_out: T4}
"""
TRUE = {"UA": 3000.0, "balance": 1.0, "memory": 2e4, "wander": 0.02, "meter_hot": 2e-3, "meter_cold": 2e-3,
        "noise_hot": 0.05, "noise_cold": 0.05}  # fmt: skip


def site(folder: Path, more: str = "", balance: float = 1.0, days: int = 8) -> Path:
    """A substation's file and eight days of data from the law of a steady exchanger."""
    n, random = days * 288, np.random.default_rng(5)
    t = np.arange(n) * 300.0
    load = 0.6 + 0.3 * np.sin(2 * np.pi * t / 86400) + 0.05 * np.repeat(random.normal(size=n // 12), 12)
    u = np.column_stack([0.2 * load, 0.4 * load, 80 + 2 * np.sin(t / 2e5), 35 + 3 * load])
    m = get_model("heat_exchanger", dynamics="quasi-steady", flow_hot=0.12, flow_cold=0.24)
    values = np.array([{**TRUE, "balance": balance}[q.symbol] for q in m.parameters])
    y = realise(m, values, Data(t, u, np.full((n, 2), 50.0)), 1).y
    rows = np.column_stack([u[:, 2], y[:, 0], u[:, 3], y[:, 1], u[:, 0], u[:, 1]])
    with (folder / "data.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "T1", "T2", "T3", "T4", "m1", "m2"])
        start = np.datetime64("2026-01-01T00:00:00")
        writer.writerows([f"{start + int(s)}Z", *np.round(row, 5)] for s, row in zip(t, rows, strict=True))
    (folder / "site.yaml").write_text(SITE + more)
    return folder / "site.yaml"


def fitted(path: Path) -> tuple[SiteContext, Fitted]:
    (found,) = fit_site(path, None, since=None, until=None, only=None, html=None, starts=1, console=QUIET)
    assert isinstance(found, Fitted)
    return open_site(path), found


def test_an_exchanger_at_five_minutes_gets_steady_outlets_and_the_engine_runs_on_them(tmp_path: Path) -> None:
    context, found = fitted(site(tmp_path))
    assert found.baseline.options["dynamics"] == "quasi-steady"
    assert "do not tell its mass" in found.summary()
    assert found.summary().endswith("is in force")
    assert found.result.params["UA"] == pytest.approx(3000.0, rel=0.05)
    store = context.store(read_only=True)
    engine = Engine(context.plan, in_force(store, ["hx"]))
    store.close()
    (watched,) = engine.watched
    assert watched.model.symbols["parameters"] == tuple(found.baseline.parameters)  # type: ignore[union-attr]
    assert open_site(tmp_path / "site.yaml").plan.components[0].model.options["compartments"] == 3


def test_whoever_names_compartments_has_chosen(tmp_path: Path) -> None:
    context, found = fitted(site(tmp_path, "    options: {compartments: 1}\n", days=3))
    assert found.baseline.options["compartments"] == 1
    # Seconds of residence at five minutes: the water's mass cannot be told, and the baseline is not put in force.
    assert found.against
    assert "NOT in force" in found.summary()
    store = context.store(read_only=True)
    assert in_force(store, ["hx"]) == {}
    assert [b.diagnostics["proposed"] for b in versions(store, "hx")] == [True]
    store.close()


def test_heat_that_does_not_balance_keeps_a_baseline_out_of_force(tmp_path: Path) -> None:
    _, found = fitted(site(tmp_path, balance=1.3, days=4))
    assert any("heat of the cold side over that of the hot side is 1.3" in line for line in found.against)
    assert "flow meters" in found.summary()


def test_a_plate_value_is_a_prior_and_a_limit(tmp_path: Path) -> None:
    plate = (
        "    options: {dynamics: quasi-steady, flow_hot: 0.12, flow_cold: 0.24}\n    parameters: {UA: {plate: %s}}\n"
    )
    _, found = fitted(site(tmp_path, plate % 2800, days=4))
    assert found.against == ()
    assert "maximum a posteriori" in found.summary()
    _, wrong = fitted(site(tmp_path, plate % 10500, days=4))
    assert any("beyond a factor of 3 of its plate value" in line for line in wrong.against)


def test_another_variant_is_not_put_under_running_filters(tmp_path: Path) -> None:
    context, found = fitted(site(tmp_path, days=4))
    engine = Engine(context.plan, {"hx": found.baseline})
    other = fitted(site(tmp_path, "    options: {dynamics: quasi-steady, flow_hot: 0.1, flow_cold: 0.2}\n", days=4))[1]
    with pytest.raises(EngineError, match="another variant"):
        engine.rebase({"hx": other.baseline})


ROOM = """
name: Room
zone: UTC
step: 15 min
source: {kind: csv, path: room.csv, time: {column: time}}
store: {kind: sqlite, path: room.sqlite}
points:
  outside: {unit: degC}
  sun: {unit: W/m2}
  heat: {unit: W}
  T: {unit: degC}
equipment:
  room:
    model: zone
    inputs: {T_out: outside, I_solar: sun, P_heat: heat}
    outputs: {T_room: T}
"""


def room(folder: Path, more: str = "") -> Path:
    """Three weeks of a room with an envelope and a heater without any capacity of its own."""
    from benchmarks.identification import zone_set

    m, _, d = zone_set(3, 2000)
    columns = dict(zip(m.symbols["inputs"], d.u.T, strict=True))
    rows = np.column_stack([columns["T_out"], columns["I_solar"], columns["P_heat"], d.y[:, 0]])
    with (folder / "room.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "outside", "sun", "heat", "T"])
        start = np.datetime64("2026-01-01T00:00:00")
        writer.writerows([f"{start + int(s)}Z", *np.round(row, 5)] for s, row in zip(d.t, rows, strict=True))
    (folder / "site.yaml").write_text(ROOM + more)
    return folder / "site.yaml"


def test_a_room_gets_the_nodes_that_likelihood_ratio_and_held_out_data_ask_for(tmp_path: Path) -> None:
    _, found = fitted(room(tmp_path))
    assert found.baseline.options["nodes"] == "TiTe"
    text = found.summary()
    assert "chosen: TiTe" in text
    assert all(f"structure: {nodes}: log-likelihood" in text for nodes in ("Ti", "TiTe", "TiTh", "TiTeTh"))


def test_whoever_names_the_nodes_has_chosen(tmp_path: Path) -> None:
    _, found = fitted(room(tmp_path, "    options: {nodes: Ti}\n"))
    assert found.baseline.options["nodes"] == "Ti"
    assert "structure" not in found.baseline.diagnostics
