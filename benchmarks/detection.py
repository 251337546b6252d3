"""Every fault of the simulated house at several sizes, under the service's own filters and charts: what is found when.

A run is three weeks of a house with one fault in a component from the third day on. Score charts, innovation charts and
charts of the model's health watch it side by side, each family with the same rate of false alarms for the component as
a whole, on two baselines:

fitted   by maximum likelihood to four weeks of another life of the house; errors of the baseline are allowed for
known    the true physical parameters, taken as known: what the run lengths of theory are about

A filter is driven by what is measured, so that a change of one component's parameters leaves the others healthy: one
simulated house carries a faulty parameter in each component. A house lives several lives, each with a weather and a
noise of its own, on the same baselines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import product

import numpy as np

from benchmarks import whole_engine
from fdd.plant.district import EQUIPMENT, district_plant, models
from fdd.plant.faults import PlantFault
from fdd.plant.scenario import Scenario, pieces
from fdd.records import NANOSECONDS, Baseline, FloatArray, IntArray
from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.service.baselines.history import History
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.chart_family import Family
from fdd.service.monitoring.health_charts import KINDS, HealthCharts, window_of
from fdd.service.monitoring.innovation_charts import InnovationCharts
from fdd.service.monitoring.score_charts import ScoreCharts
from fdd.service.site.plan import Component, Plan
from fdd.service.verbs.explain import explained_by

DAY = 86400.0
STEP = 300.0
FRAMES_A_DAY = round(DAY / STEP)
DAYS, ONSET = 23.0, 49 / 24  # the onset is the begin of a block of scores, an hour after the charts' own begin
SIZES = (0.05, 0.1, 0.2, 0.3)
RATE = 0.5
"""False alarms a year of each family of charts on a component."""
BLOCK = 72
BLOCK_DAYS = BLOCK * STEP / DAY
WINDOW = window_of(round(STEP * NANOSECONDS))[0]
SETTLED = round(2 * FRAMES_A_DAY)
"""Frames that charts have seen before the onset; the first hour they leave to the filters."""
COURSE = 7 * FRAMES_A_DAY
HEALTHY = "none"
"""Name of the fault of a house that has none, with the same weather and noise: what the others differ from."""
NAMED_AFTER = 2 * FRAMES_A_DAY
SETS = ("fitted", "known")
START = "2024-11-04T00:00:00"


@dataclass(frozen=True)
class Fault:
    """A fault of one component: a physical parameter lower by ``size``, or a fault of the plant by its kind."""

    component: str
    name: str
    size: float
    plant: PlantFault | None = None

    @property
    def symbol(self) -> str:
        """The parameter that has moved; "" where the fault is no change of one."""
        return "" if self.plant else self.name


@dataclass
class Watched:
    """What the charts of one component made of one run on one baseline; times in frames after the onset, NaN: never.

    ``early``: kinds of charts that rang before the onset. ``streams`` has the delay of every chart. ``span`` (frames of
    the run) reaches from the onset that the first score chart estimated until two days after it rang; ``named`` is the
    parameter that explains these frames best where each is refitted alone, ``scored`` the one that does so by the sums
    of scores. ``z`` (blocks, n_p) are the standardised block scores after the onset, ``information`` (blocks, n_p)
    their informations, ``innovation`` the sums, squares and counts of standardised innovations after the onset,
    (3, n_y). ``course`` (frames, n_y) has these innovations themselves for the first week after the onset of a fault of
    the plant. ``spread`` (2, n_y) is what a window's dispersion must pass: the least and the most that the chart takes
    for healthy.
    """

    fault: Fault
    seed: int
    life: int
    baseline: str
    streams: dict[str, float]
    early: set[str] = field(default_factory=set)
    named: str = ""
    scored: str = ""
    span: tuple[int, int] = (0, 0)
    z: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    information: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    innovation: FloatArray = field(default_factory=lambda: np.empty((3, 0)))
    course: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    spread: FloatArray = field(default_factory=lambda: np.empty((2, 0)))

    def delay(self, *kinds: str) -> float:
        """Of the first chart of these kinds (``score``, ``cusum``) [days]; inf: none by the last day, NaN: rang early.

        Early is a ring before the onset: what comes after it is no detection.
        """
        if not self.early.isdisjoint(kinds):
            return float("nan")
        return min((d for s, d in self.streams.items() if s.endswith(kinds)), default=np.inf) * STEP / DAY


def physical(component: str) -> list[str]:
    """Symbols of the physical parameters of a component."""
    true = district_plant().components[component].parameters
    return [p.symbol for p in models()[component].parameters if p.kind == "physical" and p.symbol in true]


def parameter_faults(sizes: Sequence[float] = SIZES) -> list[tuple[Fault, ...]]:
    """Houses with a faulty parameter in each component, so that every parameter has every size once."""
    columns = [[Fault(c, s, size) for s, size in product(physical(c), sizes)] for c in EQUIPMENT]
    most = max(map(len, columns))
    return [tuple(column[i] for column in columns if i < len(column)) for i in range(most)]


def plant_faults() -> list[tuple[Fault, ...]]:
    """A house for every kind of fault that the plant can have, at four severities where it has degrees."""
    onset = ONSET * DAY

    def table(component: str, kind: str, target: str, sizes: Sequence[float]) -> list[tuple[Fault, ...]]:
        def one(s: float) -> PlantFault:
            return PlantFault(kind, target, onset, s, "ramp" if kind == "drift" else "step", 14 * DAY)

        return [(Fault(component, kind, s, one(s)),) for s in sizes]

    return [
        tuple(Fault(c, HEALTHY, 0.0, PlantFault("bias", "hx.T_hot_in", onset, 0.0)) for c in EQUIPMENT),
        *table("hx", "fouling", "hx", SIZES),
        *table("radiator-south", "air", "radiator-south", SIZES),
        *table("radiator-south", "sludge", "radiator-south", SIZES),
        *table("hx", "bias", "hx.T_cold_out", (0.25, 0.5, 1.0, 2.0)),
        *table("radiator-south", "bias", "radiator-south.T_return", (0.25, 0.5, 1.0, 2.0)),
        *table("building", "bias", "building.T_south", (0.1, 0.25, 0.5, 1.0)),
        *table("hx", "drift", "hx.T_cold_out", (0.25, 0.5, 1.0, 2.0)),
        *table("radiator-south", "scaling", "radiator-south.m_flow", (0.02, 0.05, 0.1, 0.2)),
        *table("hx", "noise", "hx.T_hot_out", (0.25, 0.5, 1.0, 2.0)),
        *table("radiator-south", "freeze", "radiator-south.T_return", (1.0,)),
        *table("hx", "swap", "hx.T_hot_out | hx.T_cold_in", (1.0,)),
        *table("radiator-south", "leak", "valve-south", (0.05, 0.2)),
        *table("radiator-south", "stick", "valve-south", (0.05, 0.2)),
        *table("radiator-south", "stuck", "valve-south", (1.0,)),
        *table("hx", "hunting", "controller", (2.0, 5.0)),
    ]


def simulate(faults: Sequence[Fault], seed: int, days: float = DAYS) -> tuple[IntArray, FloatArray]:
    """Event times and measured points (n, n_points) of a house with these faults."""
    scenario = Scenario(start=START, days=days, seed=seed, faults=tuple(f.plant for f in faults if f.plant))
    lower = {f"{f.component}.{f.symbol}": partial(_lower, f.size) for f in faults if f.symbol}
    parts = list(pieces(scenario, factors=lower))
    return np.concatenate([p.time for p in parts]), np.concatenate([p.values for p in parts])


def _lower(size: float, seconds: FloatArray) -> FloatArray:
    return np.where(seconds >= ONSET * DAY, 1.0 - size, 1.0)


@cache
def baselines(seed: int, components: tuple[str, ...]) -> tuple[Plan, dict[str, dict[str, Baseline]]]:
    """The house's plan with these components, and baselines by set and component, from another life of the house."""
    fleet = whole_engine.simulated(1, whole_engine.LEARNING, seed)
    fleet = replace(
        fleet, plan=replace(fleet.plan, components=tuple(c for c in fleet.plan.components if c.name in components))
    )
    fitted = whole_engine.fit_all(fleet)
    true = whole_engine.settled(fleet, [whole_engine.known(b) for b in fitted])[0]
    return fleet.plan, {"fitted": fitted[0], "known": {n: _certain(b) for n, b in true.items()}}


def _certain(baseline: Baseline) -> Baseline:
    """Parameters, spreads and scales without error: as known as a number can be."""
    n = len(baseline.parameters)
    unsure = ("score_spread", "score_blocks")
    scales = {q: {k: v for k, v in of.items() if k != "samples"} for q, of in baseline.innovation.items()}
    known = {k: v for k, v in baseline.diagnostics.items() if k not in unsure}
    return replace(baseline, covariance=(1e-12 * np.eye(n)).tolist(), diagnostics=known, innovation=scales)


def watch(
    houses: Sequence[tuple[Fault, ...]],
    seed: int,
    sets: Sequence[str] = SETS,
    lives: Sequence[int] = (0,),
    components: Sequence[str] = (),
) -> list[Watched]:
    """Let the houses live these lives, each of one weather for all, and watch their faulty components side by side.

    ``components``: whose baselines are fitted, once a seed; by default those that are faulty.
    """
    plan, known = baselines(seed, tuple(components or sorted({f.component for house in houses for f in house})))
    plants = list(product(lives, houses))
    found = [simulate(house, 7919 + seed + 1000 * life) for life, house in plants]
    time = found[0][0]
    values = np.stack([v for _, v in found], axis=1)
    kinds = {c.name: c for c in plan.components}
    members: dict[str, list[Component]] = {}
    own: dict[str, Baseline] = {}
    runs: dict[str, Watched] = {}
    for (plant, (life, house)), which in product(enumerate(plants), sets):
        for f in house:
            name = f"{which}/{plant}/{f.component}"
            runs[name] = Watched(f, seed, life, which, {})
            component = whole_engine._prefixed(kinds[f.component], name, str(plant))
            members.setdefault(EQUIPMENT[f.component][0], []).append(component)
            own[name] = replace(known[which][f.component], component=name)
    points = tuple(f"{plant}/{p}" for plant in range(len(plants)) for p in plan.points)
    whole = replace(plan, points=points, derived=(), components=tuple(c for m in members.values() for c in m))
    for model in members.values():
        _watch(whole, model, own, runs, time, values.reshape(len(time), -1))
    for name, run in runs.items():
        if run.span[1]:
            history = History(plan.columns, time, plan.derive(values[:, int(name.split("/")[1])]))
            run.named = _refitted(plan, kinds[run.fault.component], history, run.span, own[name])
    return list(runs.values())


def _refitted(plan: Plan, component: Component, history: History, span: tuple[int, int], baseline: Baseline) -> str:
    """As ``fdd explain`` does it: the parameter that, refitted alone, explains these frames best."""
    first, last = span
    part = History(history.columns, history.time[first:last], history.values[first:last])
    found = explained_by(plan, component, part, baseline)
    return found[0].symbol if found else ""


def _watch(
    plan: Plan,
    members: list[Component],
    own: dict[str, Baseline],
    index: dict[str, Watched],
    time: IntArray,
    values: FloatArray,
) -> None:
    """Step the filters and charts of one model over all frames; fill in what they say."""
    group = FilterGroup(members, own, plan.columns, hold=plan.hold, max_gap=plan.max_gap)
    mean = YEAR / STEP / RATE
    parameters = sum(p.kind == "physical" for p in group.model.parameters)
    outputs = len(group.model.outputs)
    score = ScoreCharts(0, group, plan, {c.name: mean * parameters for c in members})
    innovations = InnovationCharts([group], {c.name: mean * outputs for c in members})
    health = HealthCharts(plan, [group], {c.name: mean * outputs * len(KINDS) for c in members})
    record = _Record(group, score, innovations, health, index)
    for frame, (t, row) in enumerate(zip(time.tolist(), values, strict=True)):
        step = group.step(t, row)
        record.take(frame, step, score.update([step]), innovations.update([step]), health.update([step]))
    record.finish()


class _Record:
    """Gathers what the charts of one group of components say."""

    def __init__(
        self,
        group: FilterGroup,
        score: ScoreCharts,
        innovations: InnovationCharts,
        health: HealthCharts,
        index: dict[str, Watched],
    ) -> None:
        self._score, self._index = score, index
        runs = self._runs = [index[c.name] for c in group.components]
        self._physical = np.flatnonzero([p.kind == "physical" for p in group.model.parameters])
        self._symbols = [group.model.parameters[i].symbol for i in self._physical]
        families: tuple[Family, ...] = (score, innovations, health)
        self._families = [(family, np.full(len(family.streams), np.nan)) for family in families]
        chart = health._spread
        limits = np.stack([chart.centre - chart.limit, chart.centre + chart.limit])
        for run, spread in zip(runs, limits.reshape(2, len(runs), -1).swapaxes(0, 1), strict=True):
            run.spread = spread
        n, p = len(runs), len(self._physical)
        self._sum, self._info, self._count = np.zeros((n, p)), np.zeros((n, p)), 0
        self._blocks: list[tuple[FloatArray, FloatArray]] = []
        self._innovation = np.zeros((3, n, len(group.model.outputs)))
        self._course: list[FloatArray] = []
        self._naming: dict[int, list[tuple[int, int]]] = {}
        self._onset, self._last = round(ONSET * FRAMES_A_DAY), 0

    def take(self, frame: int, step: GroupStep, *verdicts: Verdicts) -> None:
        """One frame, and what the families say of it: scores, innovations, health."""
        for (_, first), said in zip(self._families, verdicts, strict=True):
            first[np.isnan(first) & (said.phase == Phase.ALARM)] = frame
        self._last = frame
        self._name(frame, verdicts[0])
        if frame < self._onset:
            return
        z = step.standardised
        if len(self._course) < COURSE:
            self._course.append(z.copy())
        seen = np.isfinite(z)
        self._innovation += np.stack([np.where(seen, z, 0.0), np.where(seen, z * z, 0.0), seen])
        self._sum += np.nan_to_num(step.score[:, self._physical])
        self._info += np.nan_to_num(np.diagonal(step.information, axis1=1, axis2=2)[:, self._physical])
        self._count += 1
        if self._count == BLOCK:
            self._blocks.append((self._sum.copy(), self._info.copy()))
            self._sum[:], self._info[:], self._count = 0.0, 0.0, 0

    def _name(self, frame: int, said: Verdicts) -> None:
        """Two days after a component's first score chart rang, which parameter explains most."""
        first = self._families[0][1].reshape(len(self._runs), -1)
        new = (first == frame).any(axis=1) & ~((first < frame).any(axis=1))
        for i in np.flatnonzero(new).tolist():
            age = said.onset_age.reshape(first.shape)[i][first[i] == frame].max()
            self._naming.setdefault(frame + NAMED_AFTER, []).append((i, int(age)))
        for i, age in self._naming.pop(frame, []):
            self._named(i, age + NAMED_AFTER, frame)

    def _named(self, i: int, updates: int, frame: int) -> None:
        found = self._score._chart.estimate(i, updates)
        run = self._runs[i]
        run.scored = self._symbols[int(np.argmax(found.gain))]
        run.span = (max(0, frame + 1 - updates), frame + 1)

    def finish(self) -> None:
        """The runs are over."""
        for due, left in self._naming.items():
            for i, age in left:
                self._named(i, age + NAMED_AFTER - (due - self._last), self._last)
        for family, first in self._families:
            for i, stream in enumerate(family.streams):
                run, symbol = self._index[stream.component], stream.name.rpartition("/")[2]
                if first[i] < self._onset:
                    run.early.add(symbol.partition(":")[2])
                elif np.isfinite(first[i]):
                    run.streams[symbol] = first[i] - self._onset + 1
        s = np.array([b[0] for b in self._blocks])
        info = np.array([b[1] for b in self._blocks])
        z = np.where(info > 0, s / np.sqrt(np.where(info > 0, info, 1.0)), np.nan)
        for i, run in enumerate(self._runs):
            run.z, run.information, run.innovation = z[:, i], info[:, i], self._innovation[:, i]
            if run.fault.plant:
                run.course = np.array([c[i] for c in self._course])
