"""A simulated air handler watched by the service's engine: which faults ring, after how long, and what they are called.

    python -m benchmarks.air_plant [--quick] [--json]
    python -m benchmarks.air_plant --write      # measure fdd/diagnosis/signatures-air_handler.yaml anew

A baseline is fitted to a fortnight of healthy operation; then the engine watches another fortnight, in which a fault
begins at noon of the fourth day. Signatures are measured on seeds and sizes of their own; seeds of learning and of
watching differ.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.common import arguments, context, figure, report
from benchmarks.diagnosis_runs import batches
from benchmarks.signatures import Signature, signature, write
from fdd.diagnosis.departure import Departure
from fdd.evidence import AlarmKind
from fdd.plant.air_plant import AIR_POINTS, AIR_STEP, AIR_TRUTH, air_handler_model, air_outside, air_plant
from fdd.plant.faults import DAY, PlantFault
from fdd.plant.scenario import Plant, Scenario, points, simulate
from fdd.records import NANOSECONDS, Alarm, Baseline
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.engine.engine import Engine
from fdd.service.site.plan import Component, Plan

AIR = Plant(air_plant, air_outside)
START = "2024-04-22"
DAYS, ONSET = 14.0, 3.5
BUDGET = 2.0
"""False alarms a year"""


@dataclass(frozen=True)
class Case:
    """A fault of the air handler and the cause that the alarm shall name first; without a fault none."""

    title: str
    fault: PlantFault | None = None
    cause: str = ""


def _case(title: str, kind: str, target: str, severity: float, cause: str) -> Case:
    return Case(title, PlantFault(kind, target, ONSET * DAY, severity), cause)


LEAK, DAMPER = "heating valve leaks", "outdoor air damper stuck or leaking"
COIL, COLD = "cooling coil fouled or short of cold water", "cooling valve leaks"
CASES = (
    _case("heating valve leaks, 5 %", "leak", "ahu.leak_heat", 0.05, LEAK),
    _case("heating valve leaks, 2 %", "leak", "ahu.leak_heat", 0.02, LEAK),
    _case("heating valve leaks, 1 %", "leak", "ahu.leak_heat", 0.01, LEAK),
    _case("outdoor air damper stuck", "stuck", "damper", 1.0, DAMPER),
    _case("cooling coil fouled, 30 %", "fouling", "ahu", 0.3, COIL),
    _case("cooling coil fouled, 15 %", "fouling", "ahu", 0.15, COIL),
    _case("cooling valve leaks, 2 %", "leak", "ahu.leak_cool", 0.02, COLD),
    _case("mixed air sensor reads 1 K high", "bias", "ahu.T_mixed", 1.0, "mixed air sensor biased"),
    _case("supply air sensor reads 1 K low", "bias", "ahu.T_supply", -1.0, "supply air sensor biased"),
    Case("healthy"),
)

FILE = "signatures-air_handler.yaml"
TRAINING, LEARNED = (1, 2, 3), 900
# Cause, kind of hypothesis, unit, and the faults it is measured with: other sizes than those that are judged.
SIGNATURES: dict[str, tuple[str, str, tuple[PlantFault, ...]]] = {
    LEAK: ("component", "share", (PlantFault("leak", "ahu.leak_heat", ONSET * DAY, 0.03),)),
    COLD: ("component", "share", (PlantFault("leak", "ahu.leak_cool", ONSET * DAY, 0.03),)),
    COIL: ("component", "share", (PlantFault("fouling", "ahu", ONSET * DAY, 0.2),)),
    # Stuck at noon, in the evening while the fan stands, and in the morning: wide, middling and closed.
    DAMPER: (
        "component", "stuck",
        tuple(PlantFault("stuck", "damper", day * DAY, 1.0) for day in (ONSET, 1.95, 2.3)),
    ),
    "mixed air sensor biased": (
        "sensor", "K", tuple(PlantFault("bias", "ahu.T_mixed", ONSET * DAY, s) for s in (0.7, -0.7)),
    ),
    "supply air sensor biased": (
        "sensor", "K", tuple(PlantFault("bias", "ahu.T_supply", ONSET * DAY, s) for s in (0.7, -0.7)),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Found:
    """What the engine saw since the onset and said: the first alarm after it, and how many before."""

    departure: Departure
    alarm: Alarm | None
    delay: float
    before: int

    @property
    def named(self) -> str:
        """The cause that the alarm names first."""
        return str(self.alarm.causes[0].name) if self.alarm else ""


def plan() -> Plan:
    """The site of one air handler."""
    model = air_handler_model()
    inputs, outputs = (tuple(AIR_POINTS[s] for s in model.symbols[t]) for t in ("inputs", "outputs"))
    return Plan(
        site="air",
        step=round(AIR_STEP * NANOSECONDS),
        lateness=0,
        max_gap=3600 * NANOSECONDS,
        max_jump=7 * 86400 * NANOSECONDS,
        hold=0,
        false_alarms_per_year=BUDGET,
        points=tuple(points(air_plant())),
        derived=(),
        components=(Component("ahu", model, inputs, outputs),),
    )


@cache
def learned(seed: int) -> Baseline:
    """A baseline fitted to a healthy fortnight."""
    scenario, site = Scenario(START, DAYS, AIR_STEP, seed), plan()
    history = History(site.columns, scenario.times(), site.derive(simulate(scenario, plant=AIR).to_numpy()))
    return identify(site, site.components[0], history)[0]


def known() -> Baseline:
    """A baseline that is the truth, as if it had been fitted to endless data."""
    model = air_handler_model()
    parameters = {p.symbol: AIR_TRUTH.get(p.symbol, p.typical) for p in model.parameters}
    statistics = {q.symbol: {"mean": 0.0, "sd": 1.0, "lag1": 0.0, "samples": 1} for q in model.outputs}
    return Baseline(
        "ahu", 1, model.name, model.version, dict(model.options), parameters, {}, [], 0, 0, 0, 0.0, statistics
    )


def watch(case: Case, seed: int, baseline: Baseline, days: float = DAYS) -> Found:
    """Simulate one case and run the engine over it."""
    scenario = Scenario(START, days, AIR_STEP, seed, (case.fault,) if case.fault else ())
    engine = Engine(plan(), {"ahu": baseline})
    alarms: dict[str, Alarm] = {}
    frame = simulate(scenario, plant=AIR)
    for batch in batches(scenario.times(), frame.to_numpy(), list(frame.columns)):
        for alarm in engine.step(batch).alarms:
            alarms[alarm.key] = alarm
    onset = scenario.first + round((case.fault.onset if case.fault else ONSET * DAY) * NANOSECONDS)
    seen = engine.departure("ahu", onset, int(scenario.times()[-1]))
    own = sorted((a for a in alarms.values() if a.evidence.kind is AlarmKind.PLANT), key=lambda a: a.raised)
    after = [a for a in own if a.raised >= onset]
    delay = (after[0].raised - onset) / NANOSECONDS / DAY if after else np.inf
    return Found(seen, after[0] if after else None, delay, len(own) - len(after))


def measure() -> list[Signature]:
    """The signature of every cause, with its scatter over seeds and ways in which it comes."""
    baseline, entries = learned(LEARNED), []
    for name, (kind, unit, faults) in SIGNATURES.items():
        runs = [(f.severity, watch(Case(name, f), seed, baseline).departure) for f in faults for seed in TRAINING]
        entries.append(signature(name, "", kind, unit, runs, signed=kind == "component"))
    return entries


def main() -> None:
    """Measure the signatures, or every case on a few seeds."""
    if "--write" in sys.argv:
        write(FILE, "air_plant", {"air_handler": measure()})
        return
    options = arguments(__doc__ or "")
    seeds = (11,) if options.quick else (11, 12, 13)
    baseline = learned(5)
    runs = {case.title: [watch(case, seed, baseline) for seed in seeds] for case in CASES}
    faulty = [(case, f) for case in CASES if case.fault for f in runs[case.title]]
    false = sum(f.alarm is not None for f in runs["healthy"]) + sum(f.before for r in runs.values() for f in r)
    seen, named = (sum(g(c, f) for c, f in faulty) for g in (lambda c, f: f.alarm is not None, _named))
    figures = {
        "faults alarmed": figure(seen, f"of {len(faulty)}", "all", seen == len(faulty)),
        "causes rightly named": figure(named, f"of {seen}", ">= 0.8", named >= 0.8 * seen),
        "alarms without a fault": figure(false, "alarms", "<= 1", false <= 1),
    }
    about = {
        title: {
            "delay [d]": [round(f.delay, 2) if f.alarm else None for f in found],
            "named": [f.named for f in found],
        }
        for title, found in runs.items()
    }
    report(figures, context(seeds=list(seeds), **about), options.json)


def _named(case: Case, found: Found) -> bool:
    return found.named == case.cause


if __name__ == "__main__":
    main()
