"""What identification promises, counted: coverage, flat directions, foreign substations and a measured exchanger.

    python -m benchmarks.identification --json
    python -m benchmarks.identification --quick
    python -m benchmarks.identification --sets 60 --flat 40 --substations 10 --first 211

Simulated sets are drawn from the models themselves. Foreign substations are made by a script of their own (effects on)
and fitted by ``fdd fit`` as its site file stands; ``exchange`` of that script says what transfer the plates have at the
flows at which the fit tells it. Folders that are not there are said to be missing: ``FDD_SHARED`` names another.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.common import context, figure, report
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.simulate import sample
from fdd.models.declare import ComponentModel, Parameter, Quantity, State
from fdd.models.registry import get_model
from fdd.records import FloatArray
from fdd.service.baselines.fitting import Fitted, fit_site

ROOT = Path(os.environ.get("FDD_SHARED", Path(__file__).resolve().parents[2] / "shared"))
Z95 = 1.959964
FITTED_DAYS = 28
PROBABILITIES, HOURS = (0.8, 0.95), (1, 6, 24)
COLD = """
import time
from benchmarks.identification import radiator_set
from fdd import fit
model, truth, data = radiator_set(1)
import dataclasses
began = time.process_time()
result = fit(dataclasses.replace(model, name="brand-new"), data)
print(time.process_time() - began)
"""


def radiator_set(seed: int) -> tuple[ComponentModel, dict[str, float], Data]:
    """A radiator of one section, 500 samples at two minutes."""
    m = get_model("radiator", sections=1, surroundings=False)
    truth = {"C": 6e4, "H": 9.0, "sigma_T": 5e-3, "noise_return": 0.05}
    t, random = np.arange(500) * 120.0, np.random.default_rng([seed, 1])
    supply = 55 + 8 * np.repeat(random.normal(size=50), 10)
    u = np.column_stack([supply, 21 + 0 * t, 0.02 + 0.02 * np.repeat(random.random(50), 10)])
    return m, truth, _drawn(m, truth, t, u, 42.0, seed)


def zone_set(seed: int, n: int = 700) -> tuple[ComponentModel, dict[str, float], Data]:
    """A room with its envelope, ten days or more at quarters of an hour."""
    m = get_model("zone", nodes="TiTe")
    truth = {"C_i": 4e6, "C_e": 2e7, "R_ie": 3e-3, "R_ea": 6e-3, "A_w": 4.0}
    truth |= {"sigma_i": 3e-3, "sigma_e": 2e-3, "noise_in": 0.03}
    names = [q.symbol for q in m.parameters]
    truth = {q.symbol: truth.get(q.symbol, q.typical) for q in m.parameters if q.symbol in names}
    t, random = np.arange(n) * 900.0, np.random.default_rng([seed, 2])
    day = 2 * np.pi * t / 86400
    columns = {
        "T_out": 5 + 4 * np.sin(day - 2) + np.cumsum(0.1 * random.normal(size=n)),
        "I_solar": np.maximum(0.0, 400 * np.sin(day - 1.5)) * np.repeat(random.random(n // 8 + 1), 8)[:n],
        "P_heat": 3000.0 * np.repeat(random.integers(0, 2, n // 12 + 1), 12)[:n],
    }
    u = np.column_stack([columns[q.symbol] for q in m.inputs])
    return m, truth, _drawn(m, truth, t, u, 20.0, seed)


def exchanger_set(seed: int) -> tuple[ComponentModel, dict[str, float], Data]:
    """A plate exchanger with quasi-steady outlets, four days at five minutes."""
    m = get_model("heat_exchanger", dynamics="quasi-steady", flow_hot=0.15, flow_cold=0.3)
    truth = {"UA": 3000.0, "balance": 1.0, "memory": 1.5e4, "wander": 0.05}
    truth |= {"meter_hot": 4e-3, "meter_cold": 6e-3, "noise_hot": 0.05, "noise_cold": 0.08}
    t, random = np.arange(1200) * 300.0, np.random.default_rng([seed, 3])
    load = 0.7 + 0.3 * np.sin(2 * np.pi * t / 86400) + 0.1 * np.repeat(random.normal(size=100), 12)
    load = np.maximum(load, 0.2)
    u = np.column_stack([0.15 * load, 0.3 * load**0.7, 80 + np.cumsum(0.02 * random.normal(size=1200)), 35 + 4 * load])
    return m, truth, _drawn(m, truth, t, u, 50.0, seed)


def _drawn(
    m: ComponentModel, truth: Mapping[str, float], t: FloatArray, u: FloatArray, first: float, seed: int
) -> Data:
    """Outputs of the model itself by its own transitions, without Euler's error; ``first`` is about where it starts."""
    values = np.array([truth[q.symbol] for q in m.parameters])
    y = np.full((len(t), len(m.outputs)), np.nan)
    y[0] = first
    start = Likelihood(m, Data(t, u, y)).paths(values)[0].x[0]
    # Nothing is measured at the start; the last row only keeps the record from being empty.
    record = Data(t, u, y[::-1], x0=start)
    drawn = sample(Likelihood(m, record), values, 0, len(t) - 1, 1, seed)[1][0]
    return Data(t[1:], u[1:], drawn)


def coverage(sets: int) -> dict[str, dict[str, Any]]:
    """95 % intervals of physical parameters that are told, over sets of three models in turn."""
    makers = (radiator_set, zone_set, exchanger_set)
    inside = {f.__name__: [0, 0] for f in makers}
    for seed in track(range(sets), "coverage", console=Console(stderr=True)):
        maker = makers[seed % len(makers)]
        m, truth, data = maker(seed)
        result = fit(m, data, start=truth)
        for q in m.parameters:
            if q.kind == "physical" and np.isfinite(result.bse[q.symbol]):
                low, high = result.conf_int()[q.symbol]
                inside[maker.__name__][0] += low <= truth[q.symbol] <= high
                inside[maker.__name__][1] += 1
    hits, all_ = (sum(v[k] for v in inside.values()) for k in (0, 1))
    figures = {
        f"coverage: {name.removesuffix('_set')}": figure(100 * v[0] / max(1, v[1]), f"% of {v[1]}", "95", None)
        for name, v in inside.items()
    }
    share = 100 * hits / max(1, all_)
    chance = 300 * float(np.sqrt(0.95 * 0.05 / max(1, all_)))
    holds = abs(share - 95) <= max(2.0, chance if sets < 300 else 0.0)
    return figures | {"coverage of 95 % intervals": figure(share, f"% of {all_}", "93 .. 97 %", holds)}


def ahead(records: int) -> dict[str, dict[str, Any]]:
    """Forecasts of a room's temperature on data of the true model: shares within their intervals."""
    z: dict[int, list[float]] = {h: [] for h in HOURS}
    for seed in track(range(records), "forecasts", console=Console(stderr=True)):
        m, truth, data = zone_set(1000 + seed, 1400)
        result = fit(m, data, start=truth, errors="fisher")
        later = zone_set(5000 + seed, 1400)[2]
        rows = np.arange(100, 1399 - 4 * max(HOURS) - 1, 12)
        found = result.forecast(rows.tolist(), 4 * max(HOURS), later)
        for h in HOURS:
            k = 4 * h
            sd = np.sqrt(found.variance[:, k - 1, 0])
            z[h] += ((later.y[rows + k, 0] - found.y[:, k - 1, 0]) / sd).tolist()
    figures = {}
    for h, values in z.items():
        for probability, limit in zip(PROBABILITIES, (1.281552, Z95), strict=True):
            share = 100 * float(np.mean(np.abs(values) < limit))
            # Forecasts a day ahead from origins three hours apart share most of their errors.
            free = max(1.0, len(values) * 3.0 / max(3, h))
            chance = 300 * float(np.sqrt(probability * (1 - probability) / free))
            name = f"within {probability:.0%} intervals {h} h ahead"
            target = f"{100 * probability:.0f} +- 2"
            figures[name] = figure(share, "%", target, abs(share - 100 * probability) <= max(2.0, chance))
    return figures


def unknown_heater(seed: int) -> tuple[ComponentModel, Data, tuple[str, ...]]:
    """A room whose heater's power is not known: all capacities, areas and powers times c, all resistances over c."""
    random, n = np.random.default_rng([seed, 4]), 400
    sizes = {"C_i": 2.0, "C_w": 10.0, "A_w": 3.0, "W": 1.0, "R_iw": 0.5, "R_wa": 4.0}
    truth = {s: v * float(np.exp(0.3 * random.normal())) for s, v in sizes.items()} | {"sigma": 0.1, "noise": 0.05}
    m = ComponentModel(
        name="room of unknown heater",
        version="1",
        title="room",
        states=(State("T_i", "degC", "air", 1.0), State("T_w", "degC", "walls", 2.0)),
        inputs=tuple(Quantity(s, "1", s) for s in ("T_a", "sun", "heater")),
        outputs=(Quantity("T", "degC", "air"),),
        parameters=tuple(
            Parameter(s, "1", s, v, v / 1e3, v * 1e3, "", kind="physical" if s in sizes else "noise")
            for s, v in truth.items()
        ),
        drift=lambda x, u, p: {
            "T_i": ((x.T_w - x.T_i) / p.R_iw + p.A_w * u.sun + p.W * u.heater) / p.C_i,
            "T_w": ((x.T_i - x.T_w) / p.R_iw + (u.T_a - x.T_w) / p.R_wa) / p.C_w,
        },
        diffusion=lambda x, u, p: {"T_i": p.sigma, "T_w": p.sigma},
        observe=lambda x, u, p: {"T": x.T_i},
        noise=lambda x, u, p: {"T": p.noise},
        start=lambda y, u, p: {"T_i": y.T, "T_w": y.T},
    )
    t = np.arange(n) * 0.25
    sun, heater = np.maximum(0.0, np.sin(2 * np.pi * t / 24)), 10.0 * np.repeat(random.integers(0, 2, n // 10), 10)
    u = np.column_stack([5 * np.sin(2 * np.pi * t / 60), sun, heater])
    return m, _drawn(m, truth, t, u, 10.0, seed), tuple(sizes)


def flat(sets: int) -> dict[str, dict[str, Any]]:
    """Over-parameterised sets in which some parameter of the flat direction got a finite error."""
    finite = 0
    for seed in track(range(sets), "flat directions", console=Console(stderr=True)):
        m, data, moving = unknown_heater(seed)
        result = fit(m, data)
        finite += any(np.isfinite(result.bse[s]) for s in moving)
    return {"sets with an invented error": figure(finite, f"of {sets}", "0", finite == 0)}


def cold() -> dict[str, dict[str, Any]]:
    """Processor time of the first fit of a new model in a fresh process, kernels compiled."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "FDD_CACHE": folder, "OPENBLAS_NUM_THREADS": "1"}
        out = subprocess.run(
            [sys.executable, "-c", COLD], env=environment, check=True, capture_output=True, text=True
        ).stdout
    seconds = float(out.split()[-1])
    return {"cold fit of a new model, compiled": figure(seconds, "s CPU", "< 2", seconds < 2)}


def substations(first: int, count: int, folder: Path) -> dict[str, dict[str, Any]]:
    """Foreign substations by ``fdd fit`` with their own site file: what is in force, and how far from the truth."""
    script = ROOT / "foreign" / "make_substation.py"
    if not script.is_file() or not count:
        return {"foreign substations": figure("missing", "", "", None)}
    command = [sys.executable, str(script), "--seed", str(first), "--count", str(count), "--days", str(FITTED_DAYS)]
    subprocess.run([*command, "--out", str(folder)], check=True, stdout=subprocess.DEVNULL)
    truth = json.loads((folder / "truth.json").read_text())["plants"]
    began = time.process_time()
    console = Console(stderr=True, quiet=True)
    found = fit_site(
        folder / "site.yaml", None, since=None, until=None, only=None, html=None, starts=3, console=console
    )
    cpu = (time.process_time() - began) / count
    plant, off, impossible, kept = _module(script), [], 0, {"hx": 0, "rad": 0}
    for f in found:
        assert isinstance(f, Fitted)
        name, kind = f.baseline.component.split("-")
        if f.against:
            continue
        kept[kind] += 1
        if kind == "hx":
            off.append(f.result.params["UA"] / _transfer(plant, truth[name], f) - 1.0)
        else:
            capacity, true = f.result.params["C"], 2 * truth[name]["C"]
            impossible += not true / 5 < capacity < true * 5
        impossible += bool(set(f.result.at_bound) & {"UA", "balance", "C", "H"})
    within = sum(abs(x) <= 0.2 for x in off)
    return {
        "exchangers in force": figure(kept["hx"], f"of {count}", "said why not", None),
        "radiators in force": figure(kept["rad"], f"of {count}", "said why not", None),
        "in force with an impossible parameter": figure(impossible, f"of {sum(kept.values())}", "0", impossible == 0),
        "transfer at usual flows within 20 %": figure(within, f"of {len(off)}", "all", within == len(off)),
        "largest error of the transfer": figure(100 * max(map(abs, off), default=0.0), "%", "20", None),
        "exchanger and radiator, 28 days, default options": figure(cpu, "s CPU", "< 60", cpu < 60),
    }


def _module(path: Path) -> ModuleType:
    sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location("foreign_substation", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _transfer(plant: ModuleType, drawn: Mapping[str, float], found: Fitted) -> float:
    """What the script's own plates pass at the flows at which the fit tells its transfer [W/K]."""
    record = max(found.result.records, key=len)
    hot, cold = (float(found.baseline.options[k]) for k in ("flow_hot", "flow_cold"))
    p = {k: np.array([v]) for k, v in drawn.items()} | {"cp": np.array([plant.CP])}
    p |= {"m1": p["Q"] / plant.CP / 28, "m2": p["Q"] / plant.CP / 15}
    T1, T3 = (np.array([float(np.median(record.u[:, i]))]) for i in (2, 3))
    T2, T4 = plant.exchange(
        np.array([hot]), np.array([cold]), T1, T3, p, 0.0, p["uneven"], ("maldistribution", "viscosity")
    )
    ends = float((T1 - T4)[0]), float((T2 - T3)[0])
    mean = (ends[0] - ends[1]) / np.log(ends[0] / ends[1])
    return float(plant.CP * hot * (T1 - T2)[0] / mean)


def condat(days: int, folder: Path) -> dict[str, dict[str, Any]]:
    """The measured exchanger by ``fdd fit`` with its site file, its first days."""
    site = ROOT / "data" / "real2" / "sites" / "condat_5min.yaml"
    if not site.is_file() or not days:
        return {"measured exchanger": figure("missing", "", "", None)}
    text = site.read_text().replace("path: ../", f"path: {site.parent.parent}/")
    (folder / "condat.yaml").write_text(text)
    until = str(np.datetime64("2020-03-01") + np.timedelta64(days, "D"))
    console = Console(stderr=True, quiet=True)
    (found,) = fit_site(
        folder / "condat.yaml", None, since=None, until=until, only=None, html=None, starts=3, console=console
    )
    assert isinstance(found, Fitted)
    lag = max(abs(s["lag1"]) for s in found.baseline.innovation.values())
    bound = set(found.result.at_bound) & {"UA", "balance"}
    holds = bool(found.against) or not bound
    said = "out of force: " + found.against[0][:60] if found.against else "in force"
    return {
        "measured exchanger": figure(said, "", "possible, or out", holds),
        "measured exchanger: transfer": figure(found.result.params["UA"] / 1e3, "kW/K", "", None),
        "measured exchanger: heat balance": figure(found.result.params.get("balance", np.nan), "1", "0.96 .. 1", None),
        "measured exchanger: lag-one correlation": figure(lag, "1", "", None),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few sets of each, under two minutes")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--sets", type=int, help="simulated sets of three models (400)")
    parser.add_argument("--records", type=int, help="records that forecasts are counted on (30)")
    parser.add_argument("--flat", type=int, help="over-parameterised sets (200)")
    parser.add_argument("--substations", type=int, help="foreign substations (20)")
    parser.add_argument("--first", type=int, default=211, help="seed of the first of them (211)")
    parser.add_argument("--condat", type=int, help="days of the measured exchanger (28)")
    args = parser.parse_args()
    small = {"sets": 30, "records": 3, "flat": 10, "substations": 1, "condat": 15}
    full = {"sets": 400, "records": 30, "flat": 200, "substations": 20, "condat": 28}
    asked = {k: v for k in full if (v := getattr(args, k)) is not None}
    sizes = {**(small if args.quick else full), **asked}
    counted = {"sets": coverage, "records": ahead, "flat": flat}
    figures = cold()
    for name, count in counted.items():
        figures |= count(sizes[name]) if sizes[name] else {}
    with tempfile.TemporaryDirectory() as folder:
        figures |= substations(args.first, sizes["substations"], Path(folder) / "substations")
        figures |= condat(sizes["condat"], Path(folder))
    report(figures, context(sizes=sizes, seeds=f"sets from 0, substations from {args.first}"), args.json)


if __name__ == "__main__":
    main()
