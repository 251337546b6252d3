"""Simulated experiments on single components: true parameters, exciting inputs, and what a fit finds again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.stats import chi2

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data
from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.plant.network import Network
from fdd.plant.simulate import Simulator
from fdd.records import FloatArray


@dataclass(frozen=True)
class Case:
    """An experiment: model with options, sampling, input ranges (low, high), true parameters beside the typical."""

    model: str
    options: Mapping[str, Any]
    step: float
    inputs: Mapping[str, tuple[float, float]]
    true: Mapping[str, float] = field(default_factory=dict)
    rows: int = 800
    dwell: int = 12


CASES = {
    "heat_exchanger": Case(
        "heat_exchanger",
        {"transfer": "flow", "fixed": {"noise_hot": 0.05, "noise_cold": 0.05}},
        2.0,
        {"m_flow_hot": (0.3, 0.7), "m_flow_cold": (0.3, 0.75), "T_hot_in": (70, 80), "T_cold_in": (30, 40)},
    ),
    "radiator": Case(
        "radiator",
        {"surroundings": False, "fixed": {"sigma_A": 1e-3}},
        60.0,
        {"T_supply": (45, 65), "T_room": (20, 22), "m_flow": (0.003, 0.04)},
        rows=1500,
    ),
    "building": Case(
        "building",
        {"rooms": ["south", "north"]},
        600.0,
        {"T_out": (-5, 10), "I_south": (0, 500), "I_north": (0, 150), "P_heat_south": (0, 4000),
         "P_heat_north": (0, 4000), "P_gain_south": (0, 500), "P_gain_north": (0, 500)},
        rows=2500, dwell=40,
    ),
    "zone": Case(
        "zone", {"nodes": "TiTe"}, 600.0, {"T_out": (-5, 12), "I_solar": (0, 500), "P_heat": (0, 6000)},
        rows=2500, dwell=30,
    ),
    "pipe_hydraulic": Case(
        "pipe_hydraulic", {}, 1.0, {"dp": (500, 30000), "T": (29, 31)}, {"Re_t": 2130.0, "noise": 2e-4}, dwell=25
    ),
    "pipe_thermal": Case(
        "pipe_thermal", {"compartments": 4}, 5.0, {"T_in": (30, 60), "m_flow": (0.3, 1.3), "T_around": (10, 20)},
        {"UA": 200.0},
    ),
    "thermostatic_valve": Case(
        "thermostatic_valve", {"fixed": {"A_s": 2.45e-6, "K_f": 0.0997}}, 10.0,
        {"T_gas": (18, 30), "rate": (-5e-3, 5e-3), "dp_k": (5e3, 5e4), "dp_s": (1e5, 1.5e5)}, {"sigma": 1e-2}, dwell=20,
    ),
    "pump": Case("pump", {"fixed": {"P_0": 5.0}}, 10.0, {"speed": (0.4, 1.0), "m_flow": (0.2, 1.8)}),
    "control_valve": Case("control_valve", {"fixed": {"leak": 1e-3}}, 5.0, {"opening": (0.05, 1.0), "dp": (5e3, 6e4)}),
    "relief_valve": Case("relief_valve", {"fixed": {"leak": 1e-3}}, 2.0, {"dp": (1e4, 3e4)}),
    # Below zero: the fan stands, a valve is closed. What a site knows from plates and drawings is given.
    "air_handler": Case(
        "air_handler",
        {"fixed": {"T_cold": 7.0, "T_hot": 60.0, "gamma_cool": 1.0, "gamma_heat": 2.0, "n_air": 2.0, "e_heat": 0.4,
                   "r": 0.02, "k_0": 2e-4, "k_h": 5e-4, "s_off": 0.1, "f_fan": 1.3, "tau_c": 7200.0, "sigma_c": 2e-3,
                   "bias_mixed": 0.0, "bias_supply": 0.0}},
        60.0,
        {"T_out": (-5, 30), "T_return": (21, 25), "damper": (0, 1), "fan": (-0.5, 1.0), "cool": (-1.0, 1.0),
         "heat": (-1.0, 1.0)},
        {"leak_heat": 0.02, "leak_cool": 0.02}, rows=3000, dwell=40,
    ),
}  # fmt: skip


def excitation(case: Case, model: ComponentModel, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Levels between the limits that change at random times; where the model does not hold, its own limit."""
    series = {}
    for q in model.inputs:
        low, high = case.inputs[q.symbol]
        jumps = rng.random(case.rows) < 1.0 / case.dwell
        last = np.maximum.accumulate(np.where(jumps, np.arange(case.rows), 0))
        series[q.symbol] = np.clip(
            rng.uniform(low, high, case.rows)[last], *model.valid.get(q.symbol, (-np.inf, np.inf))
        )
    return series


def experiment(case: Case, seed: int) -> tuple[ComponentModel, Data, dict[str, float]]:
    """Model, simulated record and true parameters."""
    model = get_model(case.model, **case.options)
    rng = np.random.default_rng(seed)
    series = excitation(case, model, rng)
    truth = {p.symbol: p.typical for p in model.parameters} | dict(case.true)
    plant = Network()
    plant.add("it", model, initial=_initial(model, case), **truth)
    for q in model.inputs:
        plant.signal(f"in.{q.symbol}", q.unit)
        plant.connect(f"in.{q.symbol}", f"it.{q.symbol}")
    for q in model.outputs:
        plant.sensor(f"it.{q.symbol}", noise=_noise(model, q.symbol, truth))
    outside = {f"in.{s}": v for s, v in series.items()}
    y = np.concatenate([b.measured for b in Simulator(plant, case.step, seed).run(outside)])
    skip = 50
    u = np.column_stack([series[q.symbol] for q in model.inputs])
    return model, Data(np.arange(len(y) - skip) * case.step, u[skip:], y[skip:]), truth


def _initial(model: ComponentModel, case: Case) -> dict[str, float]:
    """Temperatures in the middle of the temperatures that come in."""
    levels = [np.mean(limits) for s, limits in case.inputs.items() if s.startswith("T")]
    return {s.symbol: float(np.mean(levels)) for s in model.states if s.unit == "degC"} if levels else {}


def _noise(model: ComponentModel, output: str, truth: Mapping[str, float]) -> float:
    """The measurement error's standard deviation, from the model's own equation."""
    nothing = SimpleNamespace(**{q.symbol: 1.0 for q in (*model.states, *model.inputs)})
    parameters = SimpleNamespace(**truth, **dict(model.options.get("fixed", {})))
    return float(model.noise(nothing, nothing, parameters)[output])


def recover(name: str, seed: int, scatter: float = 0.2) -> dict[str, Any]:
    """Fit one simulated record from a scattered start.

    Returns counts of physical parameters inside their 95 % intervals, and whether the innovations pass for white.
    """
    case = CASES[name]
    model, data, truth = experiment(case, seed)
    rng = np.random.default_rng(seed + 1000)
    start = {
        p.symbol: float(
            np.clip(truth[p.symbol] * np.exp(scatter * rng.standard_normal()), p.lower * 1.01, p.upper * 0.99)
        )
        for p in model.parameters
    }
    found = fit(model, data, start=start, errors="observed")
    intervals = found.conf_int()
    inside = [
        low <= truth[p.symbol] <= high
        for p in model.parameters
        if p.kind == "physical" and p.symbol in intervals
        for low, high in [intervals[p.symbol]]
        if np.isfinite(low) and np.isfinite(high)
    ]
    z = found.paths()[0].standardised[20:]  # as the fit predicted, with its own substeps
    return {"inside": sum(inside), "of": len(inside), "white": white(z), "outputs": z.shape[1], "params": found.params}


def white(z: FloatArray, lags: int = 20) -> int:
    """Outputs whose innovations a Ljung-Box test at 1 % leaves standing."""
    n = len(z)
    r = np.array([(z[k:] * z[:-k]).mean(axis=0) for k in range(1, lags + 1)]) / (z**2).mean(axis=0)
    q = n * (n + 2) * (r**2 / (n - np.arange(1, lags + 1))[:, None]).sum(axis=0)
    return int((q < chi2.ppf(0.99, lags)).sum())
