"""Fault-free years of many simulated plants through one whole engine: what was kept of the promised false alarms.

Every plant has its own weather, occupants, process and sensor noise, lost samples, hours of silence and restarts. It is
watched several times over, by sets of filters that differ in what their baselines know:

known      the true physical parameters
fitted     fitted by maximum likelihood to its first four weeks
model_off  the true physical parameters, each wrong by a random 1 % (standard deviation)
default    as fitted, at the budget of a default site

Alarms are cleared as soon as they are seen, so that rates can be counted; each counts for the chart that rang first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fdd.plant.district import TRUTH
from fdd.plant.scenario import Scenario, pieces
from fdd.plant.site import demo_site
from fdd.records import NANOSECONDS, Alarm, Baseline, Batch, FloatArray, IntArray
from fdd.residual_monitors.budget import YEAR
from fdd.service.alarms.book import Command
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify, innovation_statistics, score_diagnostics
from fdd.service.engine.engine import Engine
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.baseline_uncertainty import baseline_covariance
from fdd.service.monitoring.flatline_charts import SHARE as FLATLINE_SHARE
from fdd.service.monitoring.flatline_charts import charted as flatline_charted
from fdd.service.monitoring.flatline_charts import used as flatline_used
from fdd.service.monitoring.health_charts import KINDS
from fdd.service.monitoring.health_charts import SHARE as HEALTH_SHARE
from fdd.service.site.plan import Component, Plan
from fdd.service.site.site_context import open_site

LEARNING = 28.0  # days
SAMPLES_A_DAY = 288
MODEL_ERROR = 0.01
LOST, SILENCES, SILENCE = 0.005, 12.0, (0.2, 12.0)  # share of samples; a year; shortest and longest [h]
ROWS = 72  # frames a batch


@dataclass(frozen=True)
class Fleet:
    """Plants side by side: ``values`` (n, plants, points) with what was lost as NaN."""

    plan: Plan
    time: IntArray
    values: FloatArray

    @property
    def plants(self) -> int:
        """How many."""
        return int(self.values.shape[1])

    @property
    def learning(self) -> int:
        """Frames that baselines may see."""
        return round(LEARNING * SAMPLES_A_DAY)

    def history(self, plant: int) -> History:
        """The learning weeks of one plant."""
        values = self.plan.derive(self.values[: self.learning, plant])
        return History(self.plan.columns, self.time[: self.learning], values)


def simulated(plants: int, days: float, seed: int) -> Fleet:
    """Simulate a fleet without faults."""
    with TemporaryDirectory() as folder:
        plan = open_site(demo_site(Path(folder))).plan
    tables, time = [], np.empty(0, dtype=np.int64)
    for plant in range(plants):
        parts = list(pieces(Scenario(days=days, seed=1000 * seed + plant)))
        time = np.concatenate([p.time for p in parts])
        values = np.concatenate([p.values for p in parts])
        tables.append(_lossy(values, np.random.default_rng([seed, plant])))
    return Fleet(plan, time, np.stack(tables, axis=1))


def _lossy(values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Lose single samples, and all of them for minutes or hours: a gap after which filters start afresh."""
    values = np.where(rng.random(values.shape) < LOST, np.nan, values)
    hours = len(values) * 24 / SAMPLES_A_DAY
    for _ in range(rng.poisson(SILENCES * hours / 8766.0)):
        start = rng.integers(len(values))
        length = np.exp(rng.uniform(*np.log(SILENCE))) * SAMPLES_A_DAY / 24
        values[start : start + max(1, round(length))] = np.nan
    return values


def fit_all(fleet: Fleet) -> list[dict[str, Baseline]]:
    """Baselines of every plant from its learning weeks, searched from the nameplates' figures."""
    found = []
    for plant in range(fleet.plants):
        history = fleet.history(plant)
        found.append({c.name: identify(fleet.plan, c, history)[0] for c in fleet.plan.components})
    return found


def known(fitted: dict[str, Baseline]) -> dict[str, Baseline]:
    """The true physical parameters, without error; noise as fitted, since the sensors' errors of inputs are in it."""
    return {
        name: replace(b, parameters={**b.parameters, **_physical(b, TRUTH[name])}, covariance=[], standard_errors={})
        for name, b in fitted.items()
    }


def _physical(baseline: Baseline, truth: dict[str, float]) -> dict[str, float]:
    return {s: v for s, v in truth.items() if s in baseline.parameters and not s.startswith("sigma")}


def disturbed(true: dict[str, Baseline], rng: np.random.Generator) -> dict[str, Baseline]:
    """Every physical parameter wrong by chance, 1 % standard deviation."""
    found = {}
    for name, b in true.items():
        wrong = {
            s: v * float(np.exp(MODEL_ERROR * rng.standard_normal())) for s, v in _physical(b, TRUTH[name]).items()
        }
        found[name] = replace(b, parameters={**b.parameters, **wrong})
    return found


def settled(fleet: Fleet, sets: list[dict[str, Baseline]]) -> list[dict[str, Baseline]]:
    """Each plant's baselines with what the learning weeks say of their innovations and scores.

    What given parameters are off by is learned by the engine and goes away; so what is left is taken from filters that
    have been moved by it.
    """
    done: list[dict[str, Baseline]] = [{} for _ in sets]
    for kind in fleet.plan.components:
        bare = {f"{plant}/{kind.name}": replace(own[kind.name], innovation={}) for plant, own in enumerate(sets)}
        moved = _learned(_group(fleet, kind, bare), _learning_steps(fleet, _group(fleet, kind, bare)))
        steps = _learning_steps(fleet, moved)
        for plant, baseline in enumerate(bare.values()):
            own = [_only(s, plant) for s in steps]
            spread = {**baseline.diagnostics, **score_diagnostics(fleet.plan, kind, own)}
            statistics = innovation_statistics(kind, own, fleet.plan.step)
            done[plant][kind.name] = replace(baseline, innovation=statistics, diagnostics=spread)
    return done


def _group(fleet: Fleet, kind: Component, baselines: dict[str, Baseline]) -> FilterGroup:
    """One component of every plant, in filters that have not begun."""
    members = [_prefixed(kind, name, str(plant)) for plant, name in enumerate(baselines)]
    plan = _plan(fleet, members, 1.0)
    return FilterGroup(members, baselines, plan.columns, hold=plan.hold, max_gap=plan.max_gap)


def _learning_steps(fleet: Fleet, group: FilterGroup) -> list[GroupStep]:
    values = fleet.values[: fleet.learning].reshape(fleet.learning, -1)
    return [group.step(t, row) for t, row in zip(fleet.time[: fleet.learning].tolist(), values, strict=True)]


def _learned(group: FilterGroup, steps: Sequence[GroupStep]) -> FilterGroup:
    """The group, moved by what the scores of all steps say of its parameters, given the error that is granted to them.

    The mean of normal parameters after a normal prior of mean 0 (Gelman et al. 2013, Bayesian Data Analysis, 3.5).
    """
    at = group.physical
    charted = np.array([s.charted & np.isfinite(s.score).all(axis=1) for s in steps])
    score = np.array([s.score[:, at] for s in steps])
    information = np.array([s.information[:, at[:, None], at] for s in steps])
    score = np.where(charted[:, :, None], score, 0.0).sum(axis=0)
    information = np.where(charted[:, :, None, None], information, 0.0).sum(axis=0)
    error = np.stack([baseline_covariance(group, b) for b in group.baselines])
    by = np.zeros((len(score), len(group.model.parameters)))
    # (P^-1 + I)^-1 s without the inverse of P.
    by[:, at] = np.linalg.solve(np.eye(len(at)) + error @ information, (error @ score[:, :, None]))[:, :, 0]
    group.move(np.arange(len(score)), by)
    return group


def _only(step: GroupStep, row: int) -> GroupStep:
    return GroupStep(*(getattr(step, name)[row : row + 1] for name in GroupStep.__slots__))


def _prefixed(component: Component, name: str, plant: str, weight: float = 1.0) -> Component:
    def at(points: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(f"{plant}/{p}" for p in points)

    return replace(
        component,
        name=name,
        inputs=at(component.inputs),
        outputs=at(component.outputs),
        weight=weight,
        start_up=3600 * NANOSECONDS,
    )


def _plan(fleet: Fleet, components: Sequence[Component], budget: float) -> Plan:
    points = tuple(f"{plant}/{p}" for plant in range(fleet.plants) for p in fleet.plan.points)
    return replace(fleet.plan, points=points, derived=(), components=tuple(components), false_alarms_per_year=budget)


def engine_of(fleet: Fleet, sets: dict[str, list[dict[str, Baseline]]], budget: dict[str, float]) -> Engine:
    """One engine over all plants and sets; component ``set/plant/name``; a set's budget is each of its plants'."""
    components, baselines = [], {}
    n = len(fleet.plan.components)
    for which, table in sets.items():
        for plant, own in enumerate(table):
            for c in fleet.plan.components:
                name = f"{which}/{plant}/{c.name}"
                components.append(_prefixed(c, name, str(plant), budget[which] / n))
                baselines[name] = replace(own[c.name], component=name)
    total = fleet.plants * sum(budget[which] for which in sets)
    return Engine(_plan(fleet, components, total), baselines)


def batches(fleet: Fleet, start: int) -> Iterator[Batch]:
    """The fleet's samples from frame ``start`` on."""
    names = tuple(f"{plant}/{p}" for plant in range(fleet.plants) for p in fleet.plan.points)
    for first in range(start, len(fleet.time), ROWS):
        values = fleet.values[first : first + ROWS].reshape(-1, len(names))
        yield Batch.of_table(names, fleet.time[first : first + ROWS], values)


def watching(fleet: Fleet, engine: Engine) -> Iterator[tuple[int, list[Alarm]]]:
    """Frames watched so far and the alarms first seen since the last step; alarms are cleared as soon as they are."""
    seen: set[str] = set()
    frames = 0
    for batch in batches(fleet, fleet.learning):
        said = engine.step(batch)
        new = {a.key: a for a in said.alarms if a.key not in seen}
        seen |= set(new)
        while engine.alarms.open:  # one of the plant takes that of its model with it
            engine.command(Command(engine.alarms.open[0].key, "clear", "benchmark", 0))
        frames += said.frames
        yield frames, list(new.values())


def promises(fleet: Fleet, table: Sequence[dict[str, Baseline]], budget: float) -> dict[str, float]:
    """Each kind of chart's share of a plant's budget [1/a], on average over the plants' baselines.

    Components share evenly, and so do the charts of a component as far as each gives alarms of its own; what frozen
    readings cannot use goes to the others.
    """
    n = len(fleet.plan.components)
    shares = {"cusum": 0.0, "score": 0.0, "flatline": 0.0, **dict.fromkeys(KINDS, HEALTH_SHARE / len(KINDS))}
    for c in fleet.plan.components:
        physical = sum(p.kind == "physical" for p in c.model.parameters)
        frames = YEAR * NANOSECONDS / fleet.plan.step * n / (FLATLINE_SHARE * budget) * len(flatline_charted(c))
        for own in (baselines[c.name] for baselines in table):
            still = FLATLINE_SHARE * flatline_used(c, own, frames)
            plain = 1.0 - HEALTH_SHARE - still
            cusum = plain * len(c.outputs) / (physical * own.diagnostics["effective_share"] + len(c.outputs))
            for kind, share in (("cusum", cusum), ("score", plain - cusum), ("flatline", still)):
                shares[kind] += share / (n * len(table))
    return shares


def kind_of_chart(alarm: Alarm) -> str:
    """The kind of the chart that rang first."""
    return alarm.charts[0].rpartition(":")[2]
