"""Which fault moves which estimate: measured in simulation for every model, and for the house as a whole.

    python -m benchmarks.fault_matrix --write    # measure docs/models/faults/matrix.json anew and make its page
    python -m benchmarks.fault_matrix --write tank    # this model only; the others stay as they are
    python -m benchmarks.fault_matrix --check    # measure it anew and compare; fails where it is stale

Every model is fitted to a healthy record and to one with the fault (another seed); a cell is the difference of an
estimate in standard errors of the difference. ``mean of OUTPUT`` is the mean innovation of the healthy fit on the
faulty record, in standard errors of a mean of white noise.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.component_cases import CASES, Case, experiment
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.results import FitResult
from fdd.models.declare import ComponentModel
from fdd.models.registry import MODELS, get_model
from fdd.plant.district import POINTS, TRUTH, models
from fdd.plant.faults import PlantFault
from fdd.plant.scenario import Scenario, simulate
from fdd.records import FloatArray

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "models" / "faults"
SHOWN = 4.0
"""Shifts below so many standard errors are a dot in the page."""
HEALTHY_SEED, FAULTY_SEED = 31, 32
Row = dict[str, float]
Reading = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Fault:
    """A fault of a model's table, as it is simulated: true parameters times factors, or a reading that is wrong."""

    name: str
    size: str
    factors: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    point: str = ""
    reading: Reading | None = None


def _less(name: str, size: str, *symbols: str, by: float) -> Fault:
    return Fault(name, size, factors=dict.fromkeys(symbols, by))


def _bias(name: str, point: str, by: float, unit: str = "K") -> Fault:
    return Fault(name, f"{point} {by:+g} {unit}", point=point, reading=lambda v: v + by)


def _share(name: str, point: str, by: float) -> Fault:
    return Fault(name, f"{point} reads {by - 1:+.0%}", point=point, reading=lambda v: by * v)


def _frozen(values: FloatArray) -> FloatArray:
    """From the middle on the last value is kept."""
    half = len(values) // 2
    return np.where(np.arange(len(values)) < half, values, values[half])


# Where the case for recovery holds a parameter that a fault moves, the matrix lets it free.
OPEN: dict[str, dict[str, Any]] = {
    "control_valve": {
        "options": {}, "true": {"leak": 0.02}, "inputs": {"opening": (-0.3, 1.0), "dp": (5e3, 6e4)}, "rows": 2000,
    },
    "relief_valve": {"options": {}, "true": {"leak": 0.02}, "inputs": {"dp": (2e3, 3e4)}, "rows": 2000},
}  # fmt: skip

FAULTS: dict[str, tuple[Fault, ...]] = {
    "radiator": (
        Fault("air", "20 % of the surface, 10 % of the water", factors={"H": 0.8, "C": 0.9}),
        Fault("sludge", "10 % of the surface", factors={"H": 0.9}),
        Fault("covered", "15 % of the transfer", factors={"H": 0.85}),
        _bias("bias", "T_return", 0.5),
    ),
    "heat_exchanger": (
        _less("fouling", "5 % of both films", "C_hot", "C_cold", by=0.95),
        _bias("bias", "T_hot_out", 0.3),
        _share("scaling", "m_flow_hot", 1.05),
    ),
    "building": tuple(
        f
        for r in ("south", "north")
        for f in (
            Fault(f"open-window-{r}", "30 % more conductance", factors={f"B_out_{r}": 1.3}),
            _bias(f"bias-{r}", f"T_{r}", 0.5),
        )
    ),
    "zone": (
        Fault("open-window", "30 % less resistance", factors={"R_ea": 0.7}),
        _share("heater", "P_heat", 1.15),
        _bias("bias", "T_room", 0.5),
        Fault("stuck", "from the middle on", point="T_room", reading=_frozen),
    ),
    "pipe_hydraulic": (
        Fault("blocked", "three times the minor losses", factors={"psi": 3.0}),
        _share("scaling", "m_flow", 1.05),
    ),
    "pipe_thermal": (Fault("insulation", "30 % more loss", factors={"UA": 1.3}), _bias("bias", "T_out", 0.3)),
    "thermostatic_valve": (
        Fault("sticking", "twice the friction", factors={"F_max": 2.0}),
        Fault("gas charge lost", "2 kPa", values={"p_set": 79.6e3}),
    ),
    "pump": (
        _less("wear", "5 % of the head", "p_0", by=0.95),
        _less("bearing", "10 % of the efficiency", "eta", by=0.9),
    ),
    "control_valve": (
        Fault("leak", "2 % to 5 %", values={"leak": 0.05}),
        _less("blocked", "10 % of both", "kv", "kv_circuit", by=0.9),
    ),
    "relief_valve": (
        Fault("weak spring", "opens 10 % earlier", factors={"p_set": 0.9}),
        Fault("leak", "2 % to 5 %", values={"leak": 0.05}),
    ),
    "air_handler": (
        Fault("heating valve leaks", "2 % to 5 %", values={"leak_heat": 0.05}),
        Fault("cooling valve leaks", "2 % to 5 %", values={"leak_cool": 0.05}),
        _less("cooling coil fouled or short of cold water", "20 %", "n_cool", by=0.8),
        _less("heating coil fouled or short of hot water", "20 %", "g", by=0.8),
        Fault("outdoor air damper stuck or leaking", "closes to 20 % instead of 10 %", values={"s_min": 0.2}),
        _bias("mixed air sensor biased", "T_mixed", 0.5),
        _bias("supply air sensor biased", "T_supply", 0.5),
    ),
}  # fmt: skip

HOUSE = {
    "fouling of the heat exchanger, 5 %": PlantFault("fouling", "hx", 0.0, 0.05),
    "air in radiator south, 10 %": PlantFault("air", "radiator-south", 0.0, 0.1),
    "sludge in radiator north, 20 %": PlantFault("sludge", "radiator-north", 0.0, 0.2),
    "primary return sensor, 0.3 K": PlantFault("bias", "hx.T_hot_out", 0.0, 0.3),
    "room sensor south, 0.3 K": PlantFault("bias", "building.T_south", 0.0, 0.3),
    "flow meter secondary, 2 %": PlantFault("scaling", "hx.m_flow_cold", 0.0, 0.02),
    "valve south leaks, 20 %": PlantFault("leak", "valve-south", 0.0, 0.2),
    "valve north stuck": PlantFault("stuck", "valve-north", 0.0, 1.0),
}


def case_of(name: str) -> Case:
    """The experiment that a model's faults are measured in."""
    return replace(CASES[name], **OPEN.get(name, {}))


def measured(name: str) -> dict[str, Row]:
    """Shifts of one model's physical estimates and mean innovations under each of its faults."""
    case = case_of(name)
    model, record, truth = experiment(case, HEALTHY_SEED)
    healthy = fit(model, record, start=truth, errors="fisher")
    return {f.name: _row(model, healthy, faulty_record(case, truth, f)) for f in FAULTS[name]}


def faulty_record(case: Case, truth: Mapping[str, float], fault: Fault) -> Data:
    """Another record of the same component with the fault in it."""
    changed = {s: truth[s] * k for s, k in fault.factors.items()} | dict(fault.values)
    model, record, _ = experiment(replace(case, true={**case.true, **changed}), FAULTY_SEED)
    if fault.reading is None:
        return record
    u, y = record.u.copy(), record.y.copy()
    for table, kind in ((u, "inputs"), (y, "outputs")):
        if fault.point in model.symbols[kind]:
            j = model.symbols[kind].index(fault.point)
            table[:, j] = fault.reading(table[:, j])
    return replace(record, u=u, y=y)


def _row(model: ComponentModel, healthy: FitResult, record: Data) -> Row:
    found = fit(model, record, start=healthy, errors="fisher")
    row = _shifts({p.symbol for p in model.parameters if p.kind == "physical"}, healthy, found)
    values = np.array([healthy.params[s] for s in model.symbols["parameters"]])
    z = Likelihood(model, record).paths(values)[0].standardised[20:]
    means = z.mean(axis=0) * np.sqrt(len(z))
    return row | {f"mean of {q.symbol}": round(float(m), 2) for q, m in zip(model.outputs, means, strict=True)}


def _shifts(symbols: set[str], healthy: FitResult, faulty: FitResult) -> Row:
    """Differences of estimates in standard errors of the difference, where both were told."""
    return {
        s: round((faulty.params[s] - healthy.params[s]) / float(np.hypot(healthy.bse[s], faulty.bse[s])), 2)
        for s in healthy.params
        if s in symbols and np.isfinite(healthy.bse[s]) and np.isfinite(faulty.bse[s])
    }


def measured_house(which: Mapping[str, PlantFault] = HOUSE) -> dict[str, Row]:
    """The same in the demonstration house: every estimate of every component, under faults anywhere in it."""
    healthy = _house_fits(Scenario(days=14, seed=21), None)
    matrix = {}
    for name, fault in which.items():
        faulty = _house_fits(Scenario(days=14, seed=22, faults=(fault,)), healthy)
        matrix[name] = {
            f"{c}.{s}": z
            for c, r in healthy.items()
            for s, z in _shifts({s for s in TRUTH[c] if not s.startswith("sigma")}, r, faulty[c]).items()
        }
    return matrix


def _house_fits(scenario: Scenario, start: Mapping[str, FitResult] | None) -> dict[str, FitResult]:
    frame = simulate(scenario)
    found = {}
    for name, model in models().items():
        u, y = (frame[[POINTS[name][s] for s in model.symbols[t]]].to_numpy() for t in ("inputs", "outputs"))
        rough = {s: v for s, v in TRUTH[name].items() if s in model.symbols["parameters"]}
        record = Data(np.arange(len(frame)) * scenario.step, u, y, name=name)
        found[name] = fit(model, record, start=start[name] if start else rough, errors="fisher")
    return found


def matrix(only: Sequence[str] = ()) -> dict[str, Any]:
    """Everything, as it is stored; where models are named, all others as they were."""
    tables = dict(stored()["models"]) if only else {}
    for name in only or sorted(MODELS):
        tables[name] = {"version": get_model(name).version, "faults": measured(name)}
    house = stored()["house"] if only else measured_house()
    return {
        "made_by": "python -m benchmarks.fault_matrix --write",
        "models": dict(sorted(tables.items())),
        "house": house,
    }


def page(found: Mapping[str, Any]) -> str:
    """The page of a stored matrix."""
    parts = [
        "<!-- Made by python -m benchmarks.fault_matrix --write; do not edit. -->",
        "# Faults against parameters",
        f"Measured in simulation: every model is fitted to a healthy record and to one with the fault; a cell is the "
        f"shift of the estimate in standard errors of the difference, a dot where it is below {SHOWN:g}. `mean of ...` "
        "is the mean innovation of the healthy fit on the faulty record, in standard errors. The same numbers, all of "
        "them: [matrix.json](matrix.json). `python -m benchmarks.fault_matrix --check` measures them anew.",
    ]
    for name, table in found["models"].items():
        sizes = {f.name: f.size for f in FAULTS[name]}
        rows = {f"{fault} ({sizes[fault]})": row for fault, row in table["faults"].items()}
        parts += [f"## {get_model(name).title}", f"`{name}`, version {table['version']}.", _table(rows)]
    about = (
        "Two fortnights of the demonstration house, all components fitted to each: a fault moves the estimates of its "
        "own component. A leaking or stuck radiator valve moves none of them: flow is measured, and what a valve does "
        "with it is no parameter of a radiator; it shows in the room and in the flow itself."
    )
    return "\n\n".join([*parts, "## The house as a whole", about, _table(found["house"])]) + "\n"


def _table(rows: Mapping[str, Row]) -> str:
    columns = list(dict.fromkeys(c for row in rows.values() for c in row))
    lines = [f"| fault | {' | '.join(f'`{c}`' for c in columns)} |", f"|{'---|' * (len(columns) + 1)}"]
    for fault, row in rows.items():
        cells = [f"{row[c]:+.0f}" if c in row and abs(row[c]) >= SHOWN else "." for c in columns]
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines)


def stored() -> dict[str, Any]:
    """The committed matrix."""
    found: dict[str, Any] = json.loads((FOLDER / "matrix.json").read_text(encoding="utf-8"))
    return found


def differences(old: Mapping[str, Row], new: Mapping[str, Row], where: str) -> list[str]:
    """Cells that have moved by more than half a standard error and a twentieth, in words."""
    words = []
    for fault in {**old, **new}:
        a, b = old.get(fault, {}), new.get(fault, {})
        for symbol in {**a, **b}:
            before, now = a.get(symbol, np.nan), b.get(symbol, np.nan)
            if not abs(now - before) <= 0.5 + 0.05 * abs(before):
                words.append(f"{where}, {fault}, {symbol}: stored {before}, measured {now}")
    return words


def main() -> int:
    """Write, or check."""
    found = matrix([a for a in sys.argv[1:] if not a.startswith("-")])
    if "--check" in sys.argv:
        old = stored()
        words = differences(old["house"], found["house"], "house")
        for name, table in found["models"].items():
            words += differences(old["models"].get(name, {}).get("faults", {}), table["faults"], name)
        if (FOLDER / "matrix.md").read_text(encoding="utf-8") != page(old):
            words.append("docs/models/faults/matrix.md is not the page of matrix.json")
        print("\n".join(words) or "the stored matrix is what is measured")
        return 1 if words else 0
    (FOLDER / "matrix.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (FOLDER / "matrix.md").write_text(page(found), encoding="utf-8")
    print("written: docs/models/faults/matrix.json, matrix.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
