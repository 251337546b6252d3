"""All charts of a site: which streams there are, what each is fed, and the limits that the budget gives them.

Every component carries two families: a CUSUM on the standardised innovations of each output, quick for faults that make
the filter mispredict at once, and a score chart for each physical parameter, for slow faults that a filter with honest
process noise would swallow. The plant's budget of false alarms is spread over components by weight, and within a
component evenly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fdd.models.declare import Parameter
from fdd.records import NANOSECONDS, Baseline, FloatArray, IntArray, JsonObject
from fdd.residual_monitors.budget import spread
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.score import ALLOWANCE, Score
from fdd.service.filters import FilterGroup, GroupStep
from fdd.service.plan import Component, Plan

BoolArray = NDArray[np.bool_]
# An innovation of so many standard deviations is a broken signal and says nothing of a parameter.
ABSURD = 100.0
# A statistic below this share of its limit says that what raised the alarm is gone (hysteresis).
NORMAL = 0.25
# Half the width of a 95 % interval, in standard errors.
NORMAL_95 = 1.96
# A parameter whose relative standard error is beyond this is not worth a point on a plot.
VAGUE = 0.5
# No model is right to better than a per cent: every physical parameter is granted this relative standard error for
# good, of which charts forgive ALLOWANCE times as much. This is the floor on the changes that are found.
MODEL_ERROR = 0.005
# A score block is longer than a filter's memory and shorter than the delay one wants.
SCORE_BLOCK = 6 * 3600 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Stream:
    """One chart: what it watches and where that is measured."""

    name: str
    component: str
    symbol: str
    point: str | None


@dataclass(frozen=True, slots=True)
class ChartStep:
    """What all charts said of one frame, (n_streams,); ``rang`` are the streams that have just passed their limits."""

    verdicts: Verdicts
    rang: IntArray
    normal: BoolArray


class Family(Protocol):
    """Charts of one kind, with their streams in order."""

    streams: tuple[Stream, ...]

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed one frame."""

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """Size of what the stream has found over its last ``updates``, as far as the chart can tell."""

    def export_state(self) -> JsonObject:
        """Plain data."""

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""


class InnovationCharts:
    """Two-sided CUSUM on every output's standardised innovation."""

    def __init__(self, groups: Sequence[FilterGroup], arl: dict[str, float]) -> None:
        self.streams = tuple(
            Stream(f"{c.name}/{q.symbol}:cusum", c.name, q.symbol, point)
            for g in groups
            for c in g.components
            for q, point in zip(g.model.outputs, c.outputs, strict=True)
            if c.carries("cusum", q.symbol)
        )
        carried = [c.carries("cusum", q.symbol) for g in groups for c in g.components for q in g.model.outputs]
        self._carried = np.flatnonzero(np.array(carried, dtype=np.bool_))
        self._chart = Cusum.design([arl[s.component] for s in self.streams])
        self._groups, self._physical = tuple(groups), [_physical(g) for g in groups]
        self.rebase()

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the standardised innovations; what the baselines' granted errors would move them by is forgiven."""
        forgiven = [self._forgiven(i, step) for i, step in enumerate(steps)]
        self._chart.forgive(np.concatenate([np.empty(0), *forgiven])[self._carried])
        return self._chart.update(
            np.concatenate([np.empty(0), *(s.standardised.ravel() for s in steps)])[self._carried]
        )

    def rebase(self) -> None:
        """Take from the groups' baselines what is granted to them."""
        self._granted = [np.stack([_granted(g, b) for b in g.baselines]) for g in self._groups]

    def _forgiven(self, index: int, step: GroupStep) -> FloatArray:
        """How far the means of a group's innovations may be off, a value an output [standard deviations]."""
        at = self._physical[index]
        information = np.nan_to_num(step.information[:, at[:, None], at])
        variance = np.einsum("njk,njk->n", information, self._granted[index])
        return np.repeat(ALLOWANCE * np.sqrt(np.maximum(variance, 0.0)), step.standardised.shape[1])

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""
        self._chart.reset(which)

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """An innovation chart says that something is wrong, not how large it is."""
        return {}

    def export_state(self) -> JsonObject:
        """The chart as plain data."""
        return self._chart.export_state()

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state)


class ScoreCharts:
    """A score chart for each physical parameter of one group of components."""

    def __init__(self, index: int, group: FilterGroup, plan: Plan, arl: dict[str, float]) -> None:
        self._index, self._group = index, group
        parameters = group.model.parameters
        self._physical = _physical(group)
        self._symbols = [parameters[i].symbol for i in self._physical]
        self._log = [parameters[i].transform == "log" for i in self._physical]
        self.streams = tuple(
            Stream(f"{c.name}/{symbol}:score", c.name, symbol, None)
            for c in group.components
            for symbol in self._symbols
        )
        wanted = [arl[s.component] for s in self.streams]
        self._chart = Score.design(
            wanted,
            parameters=len(self._symbols),
            block=max(1, SCORE_BLOCK // plan.step),
        )
        self._inform()

    def _inform(self) -> None:
        """Take from the baselines what each parameter's error and spread are, and which can be told."""
        baselines = self._group.baselines
        # A parameter that the baseline's data left open has no value to depart from.
        open_ = [{*b.diagnostics.get("unidentifiable", ()), *b.diagnostics.get("at_bound", ())} for b in baselines]
        self._told = np.array(
            [
                [s not in left and c.carries("score", s) for s in self._symbols]
                for c, left in zip(self._group.components, open_, strict=True)
            ]
        )
        self._chart.covariance = np.stack([_granted(self._group, b) for b in baselines])
        spreads = [b.diagnostics.get("score_spread", {}) for b in baselines]
        self._chart.presume([spread.get(s, 1.0) for spread in spreads for s in self._symbols])

    def rebase(self) -> None:
        """The group has new baselines; streams whose baseline changed are started again by :class:`Charts`."""
        self._inform()

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the group's scores; rows that may not be charted are hidden."""
        step = steps[self._index]
        with np.errstate(invalid="ignore"):
            hide = ~step.charted | (np.abs(step.standardised) > ABSURD).any(axis=1)
        score = np.where(self._told, step.score[:, self._physical], 0.0)
        information = step.information[:, self._physical[:, None], self._physical]
        information = information * self._told[:, :, None] * self._told[:, None, :]
        score[hide], information[hide] = np.nan, np.nan
        return self._chart.update_scores(score, information)

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""
        self._chart.reset(which)

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """Change of the parameter if it alone is responsible, with its standard error; a share where on a log scale."""
        component, j = divmod(stream, len(self._symbols))
        found = self._chart.estimate(component, updates)
        change, error = float(found.single[j]), float(found.single_error[j])
        if not np.isfinite(error):
            return {}
        scale = "relative" if self._log[j] else "absolute"
        return {"change": change, "standard_error": error, "scale": scale}

    def parameters(self, updates: int) -> list[tuple[str, float, float, float]]:
        """Every parameter that the last ``updates`` can tell: series, value, and the limits of its 95 % interval.

        All may have moved together; the interval holds the baseline's error too. Natural scale and unit.
        """
        found = []
        for i, (component, baseline) in enumerate(zip(self._group.components, self._group.baselines, strict=True)):
            change = self._chart.estimate(i, updates, self._chart.covariance[i])
            for j, symbol in enumerate(self._symbols):
                error = float(change.joint_error[j])
                if not self._told[i, j] or not np.isfinite(error) or (error > VAGUE and self._log[j]):
                    continue
                ends = float(change.joint[j]) + NORMAL_95 * error * np.array([0.0, -1.0, 1.0])
                at = baseline.parameters[symbol]
                value, low, high = (at * np.exp(ends) if self._log[j] else at + ends).tolist()
                found.append((f"{component.name}/{symbol}", value, low, high))
        return found

    def export_state(self) -> JsonObject:
        """The chart as plain data."""
        return self._chart.export_state()

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state)


class Charts:
    """Every chart of a site."""

    def __init__(self, plan: Plan, groups: Sequence[FilterGroup]) -> None:
        arl = _budget(plan, groups)
        self._families: list[Family] = [InnovationCharts(groups, arl)]
        self._families += [
            ScoreCharts(i, g, plan, arl)
            for i, g in enumerate(groups)
            if any(p.kind == "physical" for p in g.model.parameters)
        ]
        self.streams = tuple(s for f in self._families for s in f.streams)
        self._edges = np.cumsum([0, *(len(f.streams) for f in self._families)])
        self._phase = np.zeros(len(self.streams), dtype=np.uint8)
        self._standing = np.zeros(len(self.streams), dtype=np.bool_)

    def update(self, steps: Sequence[GroupStep]) -> ChartStep:
        """Feed one frame to every chart; say which have just passed their limits."""
        said = [f.update(steps) for f in self._families]
        verdicts = Verdicts(*(np.concatenate([getattr(v, f.name) for v in said]) for f in fields(Verdicts)))
        alarm = verdicts.phase == Phase.ALARM
        normal = ~alarm | (verdicts.statistic < NORMAL * verdicts.limit)
        # A chart stays in alarm until it is reset; one whose evidence was gone and has come back rings again.
        rang = alarm & (verdicts.statistic >= verdicts.limit) & ~self._standing
        self._standing = (self._standing | rang) & ~normal
        self._phase = verdicts.phase
        return ChartStep(verdicts, np.flatnonzero(rang), normal)

    @property
    def phases(self) -> dict[str, int]:
        """How many charts are in each phase."""
        return {p.name.lower().replace("_", " "): int((self._phase == p).sum()) for p in Phase}

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """Size of what a stream has found, where its chart can tell."""
        family = int(np.searchsorted(self._edges, stream, side="right")) - 1
        return self._families[family].estimate(stream - int(self._edges[family]), updates)

    def parameters(self, updates: int) -> list[tuple[str, float, float, float]]:
        """Estimates of every component's parameters from the last ``updates``; see :class:`ScoreCharts`."""
        return [row for f in self._families if isinstance(f, ScoreCharts) for row in f.parameters(updates)]

    def reset(self, component: str) -> None:
        """An operator has cleared the component's alarm."""
        which = np.array([s.component == component for s in self.streams])
        for family, start, stop in zip(self._families, self._edges, self._edges[1:], strict=False):
            family.reset(which[start:stop])
        self._phase = np.where(which, np.uint8(Phase.QUIET), self._phase)
        self._standing &= ~which

    def rebase(self, components: set[str]) -> None:
        """These components have new baselines.

        Their score charts start again: sums and history are departures from the old parameters and say nothing of the
        new ones. Innovation charts go on: a misprediction is one under any baseline, and where the new one predicts
        better their sums fall by themselves. So an alarm that an innovation chart holds stands until it is cleared.
        """
        for family, start, stop in zip(self._families, self._edges, self._edges[1:], strict=False):
            if isinstance(family, InnovationCharts | ScoreCharts):
                family.rebase()
            if isinstance(family, ScoreCharts):
                which = np.array([s.component in components for s in family.streams])
                family.reset(which)
                self._phase[start:stop] = np.where(which, np.uint8(Phase.QUIET), self._phase[start:stop])
                self._standing[start:stop] &= ~which

    def export_state(self) -> JsonObject:
        """The charts as plain data."""
        return {
            "families": [f.export_state() for f in self._families],
            "phase": self._phase.copy(),
            "standing": self._standing.copy(),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        for family, saved in zip(self._families, state["families"], strict=True):
            family.restore_state(saved)
        self._phase = np.array(state["phase"], dtype=np.uint8)
        self._standing = np.array(state["standing"], dtype=np.bool_)


def _physical(group: FilterGroup) -> IntArray:
    return np.flatnonzero([p.kind == "physical" for p in group.model.parameters])


def _granted(group: FilterGroup, baseline: Baseline) -> FloatArray:
    """Covariance granted to the physical parameters, on the estimation scale: the baseline's own, and the model's.

    A baseline that is known, not fitted, has none of its own.
    """
    at = _physical(group)
    own = np.zeros((len(at), len(at)))
    parameters = [group.model.parameters[i] for i in at]
    if baseline.covariance:
        order = [list(baseline.parameters).index(p.symbol) for p in parameters]
        own = np.nan_to_num(np.array(baseline.covariance))[np.ix_(order, order)]
    slopes = [_relative_slope(p, baseline.parameters[p.symbol]) for p in parameters]
    return np.asarray(own + np.diag(np.square(MODEL_ERROR * np.array(slopes))))


def _relative_slope(parameter: Parameter, value: float) -> float:
    """What a small relative change of a parameter is on its estimation scale."""
    match parameter.transform:
        case "log":
            return 1.0
        case "logit":
            lower, upper = parameter.lower, parameter.upper
            inside = max((value - lower) * (upper - value), 1e-6 * (upper - lower) ** 2)
            return abs(value) * (upper - lower) / inside
        case _:
            return abs(value)


def _budget(plan: Plan, groups: Sequence[FilterGroup]) -> dict[str, float]:
    """Mean number of frames between false alarms for each of a component's charts."""
    components = [(c, _charts_of(g, c)) for g in groups for c in g.components]
    weights = [c.weight / n for c, n in components for _ in range(n)]
    if not weights:
        return {}
    each = spread(plan.false_alarms_per_year, weights, plan.step / NANOSECONDS)
    starts = np.cumsum([0, *(n for _, n in components)])[:-1]
    return {c.name: float(each[i]) for (c, _), i in zip(components, starts, strict=True)}


def _charts_of(group: FilterGroup, component: Component) -> int:
    """How many charts share a component's budget; at least one, so that a component without charts divides nothing."""
    outputs = sum(component.carries("cusum", q.symbol) for q in group.model.outputs)
    parameters = sum(p.kind == "physical" and component.carries("score", p.symbol) for p in group.model.parameters)
    return max(1, outputs + parameters)
