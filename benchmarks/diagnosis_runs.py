"""Faults on simulated plants, watched by the service's engine: what evidence each leaves behind.

The district-heated house gives exchanger, radiators and building. A fault begins
in the middle of the third day and stands; the evidence is what the engine remembers four and a half days later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fdd.config import load_site
from fdd.diagnosis.departure import Departure
from fdd.plant.district import POINTS, district_plant
from fdd.plant.faults import PlantFault
from fdd.plant.scenario import Factor, Scenario, pieces, points
from fdd.plant.site import demo_site
from fdd.records import NANOSECONDS, Alarm, Baseline, Batch, FloatArray
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.engine.engine import Engine
from fdd.service.site.plan import Plan, plan_of

DAY = 86400.0
DAYS, ONSET = 7.0, 2.5
LEARNING = 14.0


@dataclass(frozen=True)
class Case:
    """A fault of a plant.

    ``component`` is what is at fault and ``name`` the cause that its diagnosis shall name; ``point`` the measurement of
    a faulty instrument. ``change`` is a parameter that no kind of plant fault changes.
    """

    component: str
    name: str
    size: float
    unit: str
    fault: PlantFault | None = None
    change: str = ""

    @property
    def point(self) -> str:
        """The point of a faulty instrument, "" for the plant's own faults."""
        return self.fault.target if self.fault and self.fault.target in district_plant().sensors else ""


def _plant(kind: str, component: str, size: float) -> Case:
    return Case(component, kind, size, "share", PlantFault(kind, component, ONSET * DAY, size))


def _sensor(point: str, kind: str, size: float) -> list[Case]:
    owner = point.partition(".")[0]
    unit = "share" if kind == "scaling" else "K"
    return [Case(owner, kind, s, unit, PlantFault(kind, point, ONSET * DAY, s)) for s in (size, -size)]


def cases() -> list[Case]:
    """All faults of the house, both signs of an instrument's."""
    found = [_plant("fouling", "hx", s) for s in (0.1, 0.3)]
    for w in ("south", "north"):
        found += [_plant(k, f"radiator-{w}", 0.3) for k in ("air", "sludge")]
        found.append(Case("building", f"open-window-{w}", 0.3, "share", None, f"building.B_out_{w}"))
        found += _sensor(f"building.T_{w}", "bias", 0.5)
    found += [c for p in ("T_hot_out", "T_cold_out", "T_hot_in", "T_cold_in") for c in _sensor(f"hx.{p}", "bias", 0.8)]
    found += [c for p in ("m_flow_hot", "m_flow_cold") for c in _sensor(f"hx.{p}", "scaling", 0.05)]
    found += _sensor("radiator-south.T_return", "bias", 0.8)
    found += _sensor("radiator-south.m_flow", "scaling", 0.05)
    found += _sensor("weather.T_out", "bias", 1.5)
    return found


def house(seed: int, case: Case | None, days: float = DAYS) -> tuple[Scenario, FloatArray]:
    """Measured points of the house, (n, n_points)."""
    faults = () if case is None or case.fault is None else (case.fault,)
    scenario = Scenario(days=days, seed=seed, faults=faults)
    factors: dict[str, Factor] = {}
    if case is not None and case.change:
        size = case.size
        factors[case.change] = lambda seconds: 1 + size * (seconds >= ONSET * DAY)
    return scenario, np.concatenate([p.values for p in pieces(scenario, factors=factors)])


@cache
def learned(seed: int) -> tuple[Plan, dict[str, Baseline]]:
    """The house's plan, and baselines fitted to two weeks of its healthy life."""
    with TemporaryDirectory() as folder:
        plan = plan_of(load_site(demo_site(Path(folder))))
    scenario, values = house(seed, None, LEARNING)
    history = History(plan.columns, scenario.times(), plan.derive(values))
    return plan, {c.name: identify(plan, c, history)[0] for c in plan.components}


@dataclass(frozen=True)
class Seen:
    """What the engine made of a run: evidence by component, every alarm in its last state."""

    departures: dict[str, Departure]
    alarms: dict[str, Alarm]
    onset: int


def watch(seed: int, case: Case | None, baselines: int) -> Seen:
    """Simulate one case and run the engine over it."""
    plan, fitted = learned(baselines)
    scenario, values = house(seed, case)
    engine = Engine(plan, fitted)
    alarms: dict[str, Alarm] = {}
    for batch in batches(scenario.times(), values, points()):
        alarms |= {a.key: a for a in engine.step(batch).alarms}
    onset = scenario.first + round(ONSET * DAY * NANOSECONDS)
    end = int(scenario.times()[-1])
    seen = {c.name: engine.departure(c.name, onset, end) for c in plan.components}
    return Seen(seen, alarms, onset)


def batches(time: Any, values: FloatArray, names: Sequence[str]) -> list[Batch]:
    """Samples of half a day each."""
    return [Batch.of_table(names, time[i : i + 144], values[i : i + 144]) for i in range(0, len(time), 144)]


def where(component: str, point: str) -> str:
    """The symbol under which a component reads a point; "" where it does not."""
    return next((s for s, p in POINTS[component].items() if p == point), "")


def smaller(case: Case, share: float) -> Case:
    """The same fault, less of it."""
    fault = None if case.fault is None else replace(case.fault, severity=case.fault.severity * share)
    return replace(case, size=case.size * share, fault=fault)
