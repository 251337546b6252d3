"""Studies behind ``benchmarks.components``: threshold, hysteresis, measured pipes, large plant, faults."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from fdd.greybox.fit import fit
from fdd.greybox.inference import profile
from fdd.greybox.likelihood import Data
from fdd.models.registry import get_model
from fdd.plant.district import district_plant, outside
from fdd.plant.network import Network
from fdd.plant.simulate import Simulator
from fdd.records import FloatArray

# Paper C: where the threshold is


def threshold_profile(record: Data, quick: bool) -> dict[str, Any]:
    """Profile likelihood of the threshold's centre on a simulated record of the paper's rig, true centre Re 2130."""
    model = get_model("pipe_hydraulic")
    free = fit(model, record, errors="observed")
    found = profile(free, "Re_t", points=6 if quick else 8)
    k = int(np.clip(np.argmin(found.drop), 1, len(found.drop) - 2))
    a, b, _ = np.polyfit(found.values[k - 1 : k + 2], found.drop[k - 1 : k + 2], 2)
    return {
        "centre": float(-b / (2 * a)),
        "estimate": free.params["Re_t"],
        "error": free.bse["Re_t"],
        "interval": list(found.interval),
    }


# Paper F and B: time constants

# Andersen (2001), Paper F, Tab. 1, in kJ/(K h) and kJ/K; its eigenvalues give 33 and 57 min, 22.6 and 62.9 h.
TEST_HOUSE = {
    "B_out_south": 12.65, "B_boundary": 32.39, "B_south_north": 38.95, "B_floor_south": 542.18,
    "B_out_north": 28.35, "B_floor_north": 624.34,
    "C_air_south": 421.28, "C_floor_south": 1531.85, "C_air_north": 810.19, "C_floor_north": 3314.74,
}  # fmt: skip
PAPER_MINUTES = (33.0, 57.0, 22.6 * 60.0, 62.9 * 60.0)


def time_constants() -> FloatArray:
    """The four of the paper's two-room house with its Tab. 1 [min], from the shortest."""
    model = get_model("building", outside="each", boundary=True)
    p = {q.symbol: q.typical for q in model.parameters}
    p |= {s: v / 3.6 if s[0] == "B" else v * 1e3 for s, v in TEST_HOUSE.items()}
    u = SimpleNamespace(**dict.fromkeys(model.symbols["inputs"], 0.0))

    def rates(x: FloatArray) -> FloatArray:
        state = SimpleNamespace(**dict(zip(model.symbols["states"], x.tolist(), strict=True)))
        d = model.drift(state, u, SimpleNamespace(**p))
        return np.array([d[s] for s in model.symbols["states"]])

    jacobian = np.array([rates(e) for e in np.eye(len(model.states))]).T  # linear, and zero at zero
    return np.sort(-1.0 / np.linalg.eigvals(jacobian).real) / 60.0


# Paper E: Dahl against play against Bliman-Sorine

FRICTIONS = ("play", "dahl", "bliman-sorine")
# A slow friction that is not the fast one's shadow: it gives way over 2.5 K, the fast one over 0.2 K.
SLOW = {"sigma_slow": 0.2, "F_slow_max": 0.5}


def hysteresis(truth: str, rows: int = 3000, starts: int = 3, seed: int = 5) -> dict[str, float]:
    """Prediction-error variances [m^2] of the three friction models on a valve that has the friction ``truth``."""
    rng = np.random.default_rng(seed)
    gas, rate = _turning_temperature(rows, rng)
    u = np.column_stack([gas, rate, np.full(rows, 2e4), np.full(rows, 1.2e5)])
    record = Data(np.arange(rows) * 10.0, u, _openings(truth, u, rng))
    known = {"A_k": 52e-6, "A_s": 2.45e-6, "K_f": 0.0997}
    variances = {}
    for friction in FRICTIONS:
        model = get_model("thermostatic_valve", friction=friction)
        lowest = next(q.lower for q in model.parameters if q.symbol == "sigma")
        found = fit(model, record, fixed=known | {"sigma": lowest}, starts=starts, errors="fisher")
        variances[friction] = float(np.nanvar(record.y[100:] - found.paths()[0].predicted[100:]))
    return variances


def _turning_temperature(rows: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Temperature of the gas charge that rises and falls between 19 and 29 degC, and its rate, every 10 s."""
    jumps = rng.random(rows) < 1 / 60
    last = np.maximum.accumulate(np.where(jumps, np.arange(rows), 0))
    rate = rng.choice([-1.0, 1.0], rows)[last] * rng.uniform(2e-3, 8e-3, rows)[last]
    gas = np.empty(rows)
    gas[0] = 24.0
    for k in range(1, rows):
        if not 19.0 < gas[k - 1] + 10 * rate[k - 1] < 29.0:
            rate[k - 1 :] = np.where(np.arange(k - 1, rows) <= k - 1 + 40, -rate[k - 1], rate[k - 1 :])
        gas[k] = gas[k - 1] + 10 * rate[k - 1]
    return gas, rate


def _openings(truth: str, u: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Measured openings of a valve without process noise, its force by Euler steps of a second."""
    model = get_model("thermostatic_valve", friction=truth)
    values = {p.symbol: p.typical for p in model.parameters} | (SLOW if truth == "bliman-sorine" else {})
    p, state = SimpleNamespace(**values), {s.symbol: 0.0 for s in model.states}
    y = np.empty(len(u))
    for k, row in enumerate(u):
        now = SimpleNamespace(**dict(zip(model.symbols["inputs"], row.tolist(), strict=True)))
        y[k] = model.observe(SimpleNamespace(**state), now, p)["opening"]
        for _ in range(10):
            rates = model.drift(SimpleNamespace(**state), now, p)
            state = {s: v + rates[s] for s, v in state.items()}
    return np.asarray(y + values["noise"] * rng.standard_normal(len(u)))


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
