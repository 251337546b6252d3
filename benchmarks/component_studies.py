"""Studies behind ``benchmarks.components``: balances, threshold, hysteresis, measured pipes, large plant, faults."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data
from fdd.greybox.results import FitResult
from fdd.greybox.simulate import simulate as simulate_fit
from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.plant.district import POINTS, TRUTH, district_plant, models, outside
from fdd.plant.faults import PlantFault
from fdd.plant.network import Network
from fdd.plant.scenario import Scenario, simulate
from fdd.plant.simulate import Simulator
from fdd.records import FloatArray

CP = 4186.0


# Energy balances


def balances() -> dict[str, float]:
    """Stored heat less heat in and out, as a share of the throughput, over an hour or a day of exact integration."""
    hx_in = {"m_flow_hot": 0.4, "m_flow_cold": 0.5, "T_hot_in": 75.0, "T_cold_in": 35.0}
    house_in = {"T_out": -3.0, "I_south": 300.0, "I_north": 50.0, "P_heat_south": 900.0, "P_heat_north": 700.0,
                "P_gain_south": 100.0, "P_gain_north": 150.0}  # fmt: skip

    def hx(x: FloatArray, p: Any) -> tuple[float, float, float]:
        stored = CP / 3 * (p.M_hot * x[:3].sum() + p.M_cold * x[3:].sum())
        return stored, CP * (0.4 * (75 - x[2]) + 0.5 * (35 - x[5])), CP * 0.4 * 40

    def radiator(x: FloatArray, p: Any) -> tuple[float, float, float]:
        share = 0.02 + 0.96 / (1 + np.exp(-x[3]))
        stored = p.C * (share * x[0] + (1 - share) * x[1]) + p.C_air * x[2]
        return stored, CP * 0.05 * (60 - x[1]) - p.B_air * (x[2] - 20), CP * 0.05 * 40

    def building(x: FloatArray, p: Any) -> tuple[float, float, float]:
        stored = p.C_air_south * x[0] + p.C_floor_south * x[1] + p.C_air_north * x[2] + p.C_floor_north * x[3]
        gains = 1850.0 + p.A_south * 300 + p.A_north * 50
        return stored, gains - p.B_out_south * (x[0] + 3) - p.B_out_north * (x[2] + 3), gains

    def pipe(x: FloatArray, p: Any) -> tuple[float, float, float]:
        return p.C / 12 * x.sum(), CP * 0.5 * (60 - x[-1]) - p.UA / 12 * (x - 15).sum(), CP * 0.5 * 45

    def coil(x: FloatArray, p: Any) -> tuple[float, float, float]:
        # In units of the coil's heat capacity: water gives, air takes up from its section to behind the coil.
        valve = p.leak_heat + (1 - p.leak_heat) * ((0.5 + 1e-4) ** p.gamma_heat - 1e-4**p.gamma_heat)
        behind = x[0] + p.e_heat * (x[1] - x[0])
        given = p.g * valve * (p.T_hot - x[1])
        return x[1], given - p.r * 0.8 * (behind - x[0]) - p.k_0 * (x[1] - x[0]), given

    coil_in = {"T_out": 0.0, "T_return": 22.0, "damper": 0.4, "fan": 0.8, "cool": 0.0, "heat": 0.5}
    room = {"T_supply": 60.0, "T_room": 20.0, "m_flow": 0.05}
    pipe_in = {"T_in": 60.0, "m_flow": 0.5, "T_around": 15.0}
    return {
        "heat exchanger": _closure(get_model("heat_exchanger"), hx_in, [70, 60, 50, 38, 45, 50], 120.0, hx),
        "radiator": _closure(get_model("radiator"), room, [55, 40, 25, -0.5], 3600.0, radiator),
        "building": _closure(get_model("building"), house_in, [19, 17, 21, 20], 86400.0, building),
        "heating coil": _closure(get_model("air_handler"), coil_in, [15.0, 25.0, 18.0, 0.0], 1800.0, coil),
        "pipe": _closure(get_model("pipe_thermal"), pipe_in, [30.0] * 12, 600.0, pipe),
    }


def _closure(
    model: ComponentModel,
    u: Mapping[str, float],
    x0: list[float],
    end: float,
    energy: Callable[[FloatArray, Any], tuple[float, float, float]],
) -> float:
    p = SimpleNamespace(**{q.symbol: q.typical for q in model.parameters})
    names = [s.symbol for s in model.states]

    def rates(_: float, z: FloatArray) -> FloatArray:
        x = SimpleNamespace(**dict(zip(names, map(float, z), strict=False)))
        d = model.drift(x, SimpleNamespace(**u), p)
        _, net, through = energy(z[: len(names)], p)
        return np.array([*(d[s] for s in names), net, through])

    done = solve_ivp(rates, (0.0, end), [*x0, 0.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-11).y[:, -1]
    change = energy(done[: len(names)], p)[0] - energy(np.array(x0, dtype=float), p)[0]
    return float(abs(change - done[-2]) / done[-1])


# Paper C: where the threshold is


def threshold_profile(record: Data, quick: bool) -> dict[str, float]:
    """Profile likelihood of the threshold's centre on a simulated record of the paper's rig, true centre Re 2130."""
    model = get_model("pipe_hydraulic")
    free = fit(model, record, errors="observed")
    grid = free.params["Re_t"] + free.bse["Re_t"] * np.linspace(-4.0, 4.0, 5 if quick else 13)
    profile = [-fit(model, record, start=free, fixed={"Re_t": c}, errors="fisher").llf for c in grid]
    k = int(np.clip(np.argmin(profile), 1, len(grid) - 2))
    a, b, _ = np.polyfit(grid[k - 1 : k + 2], profile[k - 1 : k + 2], 2)
    return {"centre": float(-b / (2 * a)), "estimate": free.params["Re_t"], "error": free.bse["Re_t"]}


# Paper E: Dahl against play


def hysteresis_ratio(seed: int = 5, rows: int = 3000, starts: int = 3) -> float:
    """Ratio of the prediction-error variances of the play and the Dahl model on a valve with Dahl's hysteresis."""
    rng = np.random.default_rng(seed)
    jumps = rng.random(rows) < 1 / 60
    last = np.maximum.accumulate(np.where(jumps, np.arange(rows), 0))
    rate = rng.choice([-1.0, 1.0], rows)[last] * rng.uniform(2e-3, 8e-3, rows)[last]
    gas = np.empty(rows)
    gas[0] = 24.0
    for k in range(1, rows):
        if not 19.0 < gas[k - 1] + 10 * rate[k - 1] < 29.0:
            rate[k - 1 :] = np.where(np.arange(k - 1, rows) <= k - 1 + 40, -rate[k - 1], rate[k - 1 :])
        gas[k] = gas[k - 1] + 10 * rate[k - 1]
    u = np.column_stack([gas, rate, np.full(rows, 2e4), np.full(rows, 1.2e5)])
    dahl = get_model("thermostatic_valve")
    values = {p.symbol: p.typical for p in dahl.parameters}
    force, y = 0.0, np.empty(rows)
    for k in range(rows):
        p, now = SimpleNamespace(**values), SimpleNamespace(T_gas=u[k, 0], rate=u[k, 1], dp_k=u[k, 2], dp_s=u[k, 3])
        y[k] = dahl.observe(SimpleNamespace(F=force), now, p)["opening"]
        for _ in range(10):
            force += dahl.drift(SimpleNamespace(F=force), now, p)["F"]
    y += values["noise"] * rng.standard_normal(rows)
    record = Data(np.arange(rows) * 10.0, u, y)
    known = {"A_k": 52e-6, "A_s": 2.45e-6, "K_f": 0.0997}
    variances = []
    for friction in ("play", "dahl"):
        model = get_model("thermostatic_valve", friction=friction)
        lowest = next(q.lower for q in model.parameters if q.symbol == "sigma")
        found = fit(model, record, fixed=known | {"sigma": lowest}, starts=starts, errors="fisher")
        variances.append(float(np.nanvar(record.y[100:] - found.paths()[0].predicted[100:])))
    return variances[0] / variances[1]


# Measured pipes


def measured_pipes() -> dict[str, Any] | None:
    """Thermal pipe fitted to one measured step, cross-validated by simulation on the other runs of the rig."""
    folder = Path(os.environ.get("FDD_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "data/modelica_pipe"
    files = sorted(folder.glob("PipeDataULg*.mos"))
    if not files:
        return None
    model = get_model("pipe_thermal", compartments=12)
    records = {f.stem.removeprefix("PipeDataULg"): _pipe_record(f, model) for f in files}
    first = next(iter(records))
    found = fit(model, records[first], start={"C": 4.5e5}, errors="fisher")
    errors = {}
    for name, record in records.items():
        simulated = simulate_fit(found, record)[:, 0]
        errors[name] = (float(np.sqrt(np.mean((record.y[:, 0] - simulated) ** 2))), float(np.ptp(record.y)))
    return {"C": found.params["C"], "fitted": first, "errors": errors}


def _pipe_record(path: Path, model: ComponentModel) -> Data:
    """Columns: time, flow, wall at the outlet, water at the outlet, wall at the inlet, water at the inlet."""
    lines = [line.strip().rstrip(";") for line in path.read_text().splitlines()]
    table = np.array(
        [[float(v) for v in line.split(",")] for line in lines if re.match(r"^-?\d", line) and "," in line]
    )
    table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0])]
    n = len(model.states)
    u = np.column_stack([table[:, 5], table[:, 1], np.full(len(table), 18.0)])
    x0 = np.full(n, table[0, 3])
    return Data(table[:, 0], u, table[:, 3], hold="first", x0=x0, P0=np.eye(n) * 1e-4, name=path.stem)


# A large plant


def large_plant(houses: int = 13) -> Network:
    """Many copies of the demonstration plant under one weather: four components and seven blocks each."""
    base, big = district_plant(), Network()
    big.signals = dict(base.signals)

    def mine(name: str, i: int) -> str:
        if name in base.signals:
            return name
        return f"measured h{i}-{name[9:]}" if name.startswith("measured ") else f"h{i}-{name}"

    for i in range(houses):
        for c in base.components.values():
            big.components[f"h{i}-{c.name}"] = replace(c, name=f"h{i}-{c.name}")
        for b in base.controllers.values():
            big.controllers[f"h{i}-{b.name}"] = replace(b, name=f"h{i}-{b.name}")
        for s in base.sensors.values():
            big.sensors[f"h{i}-{s.point}"] = replace(s, point=f"h{i}-{s.point}", source=mine(s.source, i))
        big.wires |= {f"h{i}-{t}": mine(s, i) for t, s in base.wires.items()}
    return big


def large_plant_seconds(days: float, plain: bool) -> tuple[float, int]:
    """Seconds for a year at 10 min, from ``days`` of it after the kernels are warm; and the number of components."""
    plant = large_plant()
    time_ns = 1_704_067_200_000_000_000 + np.arange(round(days * 144) + 20, dtype=np.int64) * 600_000_000_000
    signals = outside(time_ns, np.random.default_rng(1))
    list(Simulator(plant, 600.0, 1, plain=plain).run({k: v[:20] for k, v in signals.items()}))
    simulator = Simulator(plant, 600.0, 1, plain=plain)
    begin = time.perf_counter()
    for block in simulator.run({k: v[20:] for k, v in signals.items()}):
        assert np.isfinite(block.measured).all()
    return (time.perf_counter() - begin) * 365.0 / days, len(plant.components)


# Faults against parameters

FAULTS = {
    "fouling of the heat exchanger, 5 %": PlantFault("fouling", "hx", 0.0, 0.05),
    "air in radiator south, 10 %": PlantFault("air", "radiator-south", 0.0, 0.1),
    "sludge in radiator north, 20 %": PlantFault("sludge", "radiator-north", 0.0, 0.2),
    "primary return sensor, 0.3 K": PlantFault("bias", "hx.T_hot_out", 0.0, 0.3),
    "room sensor south, 0.3 K": PlantFault("bias", "building.T_south", 0.0, 0.3),
    "flow meter secondary, 2 %": PlantFault("scaling", "hx.m_flow_cold", 0.0, 0.02),
    "valve south leaks, 20 %": PlantFault("leak", "valve-south", 0.0, 0.2),
    "valve north stuck": PlantFault("stuck", "valve-north", 0.0, 1.0),
}


def fault_matrix(quick: bool) -> dict[str, dict[str, float]]:
    """Shift of every physical parameter's estimate under every fault, in standard errors of the difference."""
    healthy = _fits(Scenario(days=14, seed=21), None)
    chosen = dict(list(FAULTS.items())[:2]) if quick else FAULTS
    matrix = {}
    for name, fault in chosen.items():
        faulty = _fits(Scenario(days=14, seed=22, faults=(fault,)), healthy)
        matrix[name] = {
            f"{c}.{s}": (faulty[c].params[s] - r.params[s]) / float(np.hypot(r.bse[s], faulty[c].bse[s]))
            for c, r in healthy.items()
            for s in r.params
            if s in TRUTH[c] and not s.startswith("sigma") and np.isfinite(r.bse[s]) and np.isfinite(faulty[c].bse[s])
        }
    return matrix


def _fits(scenario: Scenario, start: Mapping[str, FitResult] | None) -> dict[str, FitResult]:
    frame = simulate(scenario)
    found = {}
    for name, model in models().items():
        u, y = (frame[[POINTS[name][s] for s in model.symbols[t]]].to_numpy() for t in ("inputs", "outputs"))
        rough = {s: v for s, v in TRUTH[name].items() if s in model.symbols["parameters"]}
        record = Data(np.arange(len(frame)) * scenario.step, u, y, name=name)
        found[name] = fit(model, record, start=start[name] if start else rough, errors="fisher")
    return found


def matrix_table(matrix: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown: faults down, parameters across, only shifts of at least four standard errors shown."""
    columns = list(next(iter(matrix.values())))
    lines = [f"| fault | {' | '.join(f'`{c}`' for c in columns)} |", f"|{'---|' * (len(columns) + 1)}"]
    for fault, row in matrix.items():
        cells = [f"{row[c]:+.0f}" if c in row and abs(row[c]) >= 4 else "." for c in columns]
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines)
