"""Single zones with faults: which fault shows through what, and how often it is rightly named.

    python -m benchmarks.diagnosis_room [--quick] [--json]
    python -m benchmarks.diagnosis_room --write      # measure fdd/diagnosis/signatures-zone.yaml anew

Zones are simulated exactly (linear, zero-order hold; Van Loan 1978 for the covariance of the noise), apart from the
project's own filters. Signatures come from a light zone heated by a random sequence and a heavy one under a thermostat;
the naming is judged on a third zone, other weather and other seeds, heated both ways, at two thirds of the faults'
size, by the causes that the engine's alarm names after its last daily review.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from rich.progress import track
from scipy.linalg import expm

from benchmarks import drifting_room
from benchmarks.common import arguments, context, figure, report
from benchmarks.diagnosis_runs import batches
from benchmarks.signatures import Signature, signature, write
from fdd.diagnosis.departure import Departure
from fdd.evidence import AlarmKind
from fdd.models.zone import zone
from fdd.records import NANOSECONDS, Alarm, Baseline, FloatArray
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.engine.engine import Engine
from fdd.service.site.plan import Component, Plan

FILE = "signatures-zone.yaml"
STEP, DAY = 300, 86400
LEARNING, DAYS, ONSET = 14, 7, 2.5  # days: fitted, watched, and the fault's onset in the watched ones
START = 1_730_419_200 * NANOSECONDS
POINTS = drifting_room.POINTS
NODES = ("Ti", "TiTe", "TiTeTh")
SHARE = 2 / 3


@dataclass(frozen=True)
class House:
    """Physical parameters [SI], noise, and how it is heated."""

    C_i: float
    C_e: float
    R_ie: float
    R_ea: float
    C_h: float
    R_ih: float
    A_w: float
    sigma: float
    noise: float
    thermostat: bool


LIGHT = House(4e6, 1e7, 8e-4, 4.7e-3, 3e5, 2e-3, 6.0, 8e-4, 0.005, thermostat=False)
HEAVY = House(1.2e7, 6e7, 5e-4, 3e-3, 1e6, 1.5e-3, 10.0, 3e-4, 0.03, thermostat=True)
OTHER = House(7e6, 3e7, 6e-4, 3.5e-3, 6e5, 2e-3, 8.0, 5e-4, 0.015, thermostat=True)
TRAINING = ((LIGHT, 1), (HEAVY, 2))
JUDGED = ((OTHER, 11), (replace(OTHER, thermostat=False), 12))


@dataclass(frozen=True)
class Case:
    """One fault: what its diagnosis shall name, where, and of what kind."""

    name: str
    where: str
    kind: str
    size: float
    unit: str


CASES = (
    Case("open-window", "", "component", 0.3, "share"),
    Case("heater", "", "component", 0.2, "share"),
    *(Case("bias", "T_room", "sensor", s, "K") for s in (0.5, -0.5)),
    *(Case("upstream-T_out", "T_out", "upstream", s, "K") for s in (2.0, -2.0)),
    Case("stuck", "T_room", "sensor", 1.0, "frozen"),
)


def matrices(house: House, nodes: str, loss: float = 1.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (n, n), B (n, 3) of (outside, sun, heat), and diffusion (n,); ``loss`` multiplies the loss to the outside."""
    envelope, heater = "Te" in nodes, "Th" in nodes
    n = 1 + envelope + heater
    A, B = np.zeros((n, n)), np.zeros((n, 3))
    B[0, 1] = house.A_w / house.C_i
    if envelope:
        g, out = 1 / house.R_ie, loss / house.R_ea
        A[0, :2] += np.array([-g, g]) / house.C_i
        A[1, :2] += np.array([g, -g - out]) / house.C_e
        B[1, 0] = out / house.C_e
    else:
        A[0, 0] -= loss / (house.R_ea * house.C_i)
        B[0, 0] = loss / (house.R_ea * house.C_i)
    if heater:
        g = 1 / house.R_ih
        A[0, 0] -= g / house.C_i
        A[0, -1] += g / house.C_i
        A[-1, 0] += g / house.C_h
        A[-1, -1] -= g / house.C_h
        B[-1, 2] = 1 / house.C_h
    else:
        B[0, 2] = 1 / house.C_i
    diffusion = np.full(n, house.sigma)
    if envelope:
        diffusion[1] = house.sigma * house.C_i / house.C_e
    return A, B, diffusion


def discrete(A: FloatArray, B: FloatArray, diffusion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Transition, input and root of the noise's covariance over a step."""
    n, m = B.shape
    whole = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * STEP)
    pair = expm(np.block([[-A, np.diag(diffusion**2)], [np.zeros((n, n)), A.T]]) * STEP)
    step = pair[n:, n:].T
    root = np.linalg.cholesky(step @ pair[:n, n:] + 1e-18 * np.eye(n))
    return whole[:n, :n], whole[:n, n:], np.asarray(root, dtype=np.float64)


def simulate(house: House, nodes: str, seed: int, case: Case | None, days: int) -> History:
    """What the zone's points measured over so many days."""
    rng = np.random.default_rng([seed, days])
    n = days * DAY // STEP
    hour = np.arange(n) * STEP / 3600
    slow = np.interp(hour, np.arange(days * 4 + 1) * 6.0, np.cumsum(rng.normal(0, 1.0, days * 4 + 1)))
    outside = 4 + 4 * np.sin(2 * np.pi * (hour - 9) / 24) + slow
    clear = np.interp(hour, np.arange(days * 8 + 1) * 3.0, rng.uniform(0.1, 1.0, days * 8 + 1))
    sun = np.clip(400 * np.sin(2 * np.pi * (hour - 7) / 24), 0, None) * clear
    random = np.repeat(rng.integers(0, 2, n // 9 + 1), 9)[:n]
    onset = round(ONSET * DAY / STEP) if case else n
    healthy, faulty = (discrete(*matrices(house, nodes, x)) for x in (1.0, 1 + _size(case, "open-window")))
    given = 1 - _size(case, "heater")
    offset, wrong, frozen = _size(case, "bias"), _size(case, "upstream-T_out"), _size(case, "stuck")
    most = 25.0 / house.R_ea
    x = np.full(len(healthy[0]), 20.0)
    T, heat = np.empty(n), np.empty(n)
    noise, measured = rng.standard_normal((n, len(x))), house.noise * rng.standard_normal(n)
    for k in range(n):
        late = k >= onset
        T[k] = T[onset - 1] if late and frozen else x[0] + measured[k] + (offset if late else 0.0)
        goal = 21.0 if 6 <= hour[k] % 24 < 22 else 18.5
        heat[k] = np.clip(0.8 * (goal - T[k]), 0, 1) * most if house.thermostat else 1.2 * most * random[k]
        F, G, root = faulty if late else healthy
        x = F @ x + G @ np.array([outside[k], sun[k], heat[k] * (given if late else 1.0)]) + root @ noise[k]
    seen = outside + np.where(np.arange(n) >= onset, wrong, 0.0)
    time = START + STEP * NANOSECONDS * np.arange(1, n + 1)
    return History(POINTS, time, np.column_stack([seen, sun, heat, T]))


def _size(case: Case | None, name: str) -> float:
    return case.size if case is not None and case.name == name else 0.0


def plan(nodes: str) -> Plan:
    """One zone under one filter."""
    watched = Component("zone", zone(nodes), POINTS[:3], POINTS[3:])  # type: ignore[arg-type]
    return replace(drifting_room.plan(2.0), site="zone", step=STEP * NANOSECONDS, components=(watched,))


@cache
def learned(house: House, nodes: str, seed: int) -> Baseline:
    """A baseline fitted to two healthy weeks."""
    watched = plan(nodes)
    return identify(watched, watched.components[0], simulate(house, nodes, seed + 1000, None, LEARNING))[0]


def watch(house: House, nodes: str, seed: int, case: Case) -> tuple[Departure, Alarm | None]:
    """What the engine remembers of a fault after four and a half days, and its alarm, if one was raised."""
    history = simulate(house, nodes, seed, case, DAYS)
    engine = Engine(plan(nodes), {"zone": learned(house, nodes, seed)})
    onset = int(history.time[0]) + round(ONSET * DAY) * NANOSECONDS
    raised: dict[str, Alarm] = {}
    for batch in batches(history.time, history.values, POINTS):
        raised |= {a.key: a for a in engine.step(batch).alarms if a.evidence.kind is AlarmKind.PLANT}
    alarm = next((a for a in raised.values() if a.raised >= onset), None)
    return engine.departure("zone", onset, int(history.time[-1])), alarm


def measure() -> list[Signature]:
    """Signatures of every fault for every form of the model."""
    entries = []
    kinds = list(dict.fromkeys((c.name, c.where, c.kind, c.unit) for c in CASES))
    for nodes in NODES:
        for name, where, kind, unit in kinds:
            group = [c for c in CASES if (c.name, c.where) == (name, where)]
            tasks = [(h, s, c) for h, s in TRAINING for c in group]
            runs = [(c.size, watch(h, nodes, s, c)[0]) for h, s, c in track(tasks, f"{nodes}: {name}", transient=True)]
            options = {"nodes": nodes}
            signed = kind == "component" or unit == "frozen"
            entries.append(signature(name, where, kind, unit, runs, signed=signed, options=options))
    return entries


def judged(nodes: Sequence[str]) -> list[tuple[str, Case, Alarm | None]]:
    """Every fault on the zone that no signature has seen."""
    tasks = [
        (n, h, s, replace(c, size=c.size if c.unit == "frozen" else c.size * SHARE))
        for n in nodes
        for h, s in JUDGED
        for c in CASES
    ]
    return [(n, c, watch(h, n, s, c)[1]) for n, h, s, c in track(tasks, "judging", transient=True)]


def is_named(case: Case, alarm: Alarm) -> bool:
    """Whether the alarm's first cause is the fault; a frozen reading may be told by its own chart."""
    first = alarm.causes[0]
    if case.unit == "frozen":
        return first.name in ("stuck", "frozen")
    return first.name == case.name and first.where == case.where


def main() -> None:
    """Measure the signatures, or judge them."""
    if "--write" in sys.argv:
        write(FILE, "diagnosis_room", {"zone": measure()})
        return
    options = arguments(__doc__ or "")
    runs = judged(NODES[1:2] if options.quick else NODES)
    found = [(c, a) for _, c, a in runs if a is not None]
    right = sum(is_named(c, a) for c, a in found)
    figures = {
        "alarmed": figure(len(found), f"of {len(runs)} faults", "", None),
        "rightly_named": figure(right / max(1, len(found)), "of alarms", ">= 0.8", right >= 0.8 * len(found)),
    }
    for name in dict.fromkeys(c.name for c in CASES):
        mine = [(c, a) for c, a in found if c.name == name]
        wrong = [str(a.causes[0].name) for c, a in mine if not is_named(c, a)]
        named = f"{sum(is_named(c, a) for c, a in mine)} of {len(mine)}"
        figures[f"named: {name}"] = figure(named, f"instead: {', '.join(wrong) or '-'}", "", None)
    report(figures, context(seeds=[s for _, s in JUDGED], size=f"{SHARE:.2f} of the measured"), options.json)


if __name__ == "__main__":
    main()
