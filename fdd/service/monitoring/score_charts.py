"""A score chart for each physical parameter: slow faults that a filter with honest process noise would swallow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fdd.records import NANOSECONDS, IntArray, JsonObject
from fdd.residual_monitors.chart import Verdicts
from fdd.residual_monitors.predictive import widened
from fdd.residual_monitors.score import KNOWN, Score
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.baseline_uncertainty import baseline_covariance, relative_slopes
from fdd.service.monitoring.chart_family import BoolArray, FamilyKind, Stream
from fdd.service.site.plan import Component, Plan

# An innovation of so many standard deviations is a broken signal and says nothing of a parameter.
ABSURD = 100.0
# Half the width of a 95 % interval, in standard errors.
NORMAL_95 = 1.96
# A parameter whose relative standard error is beyond this is not worth a point on a plot.
VAGUE = 0.5
# What scores learn of a baseline's error moves the filter once it would show in a block by this squared share.
WORTH = 0.01
# A score block is longer than a filter's memory and shorter than the delay one wants.
SCORE_BLOCK = 6 * 3600 * NANOSECONDS


class ScoreCharts:
    """A score chart for each physical parameter of one group of components."""

    def __init__(self, index: int, group: FilterGroup, plan: Plan, arl: dict[str, float]) -> None:
        self._index, self._group = index, group
        parameters = group.model.parameters
        self._physical = group.physical
        self._symbols = [parameters[i].symbol for i in self._physical]
        self._log = [parameters[i].transform == "log" for i in self._physical]
        self.streams = tuple(
            Stream(f"{c.name}/{symbol}:score", c.name, symbol, None)
            for c in group.components
            for symbol in self._symbols
        )
        wanted = [arl[s.component] for s in self.streams]
        self._block = max(1, SCORE_BLOCK // plan.step)
        self._chart = Score.design(
            wanted, parameters=len(self._symbols), block=self._block, enough=plan.learning / SCORE_BLOCK
        )
        self._deadband = plan.deadband
        self.allot(arl)
        self._inform(np.ones(len(group.components), dtype=np.bool_))

    def _inform(self, rows: BoolArray) -> None:
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
        error = np.stack([baseline_covariance(self._group, b) for b in baselines])
        self._chart.depart(rows, error * self._told[:, :, None] * self._told[:, None, :])
        self._group.error = self._chart.covariance
        self._chart.tolerate(self._deadband * relative_slopes(self._group) * self._told)
        spreads = [b.diagnostics.get("score_spread", {}) for b in baselines]
        blocks = [b.diagnostics.get("score_blocks", KNOWN) for b in baselines]
        self._chart.presume(rows, [[spread.get(s, 1.0) for s in self._symbols] for spread in spreads], blocks)

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits, and what they add to the reference values.

        The spread of the scores is known from the baseline's blocks and from those over which it goes on being learned.
        """
        self._arl = dict(arl)
        wanted = [arl[s.component] for s in self.streams]
        limit = Score.design(wanted, parameters=len(self._symbols), block=self._block).limit
        blocks = [b.diagnostics.get("score_blocks", KNOWN) + self._chart.enough for b in self._group.baselines]
        uncertain = np.repeat(2.0 / np.array(blocks), len(self._symbols))
        self._chart.set_limit(widened(limit, self._chart.k, uncertain))

    def rebase(self, components: set[str]) -> BoolArray:
        """Start again: sums and history are departures from the old parameters and say nothing of the new ones."""
        self.allot(self._arl)
        self._inform(np.array([c.name in components for c in self._group.components]))
        which = np.array([s.component in components for s in self.streams])
        self.reset(which)
        return which

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the group's scores; rows that may not be charted are hidden."""
        step = steps[self._index]
        with np.errstate(invalid="ignore"):
            hide = ~step.charted | (np.abs(step.standardised) > ABSURD).any(axis=1)
        score = np.where(self._told, step.score[:, self._physical], 0.0)
        information = step.information[:, self._physical[:, None], self._physical]
        information = information * self._told[:, :, None] * self._told[:, None, :]
        score[hide], information[hide] = np.nan, np.nan
        written = self._chart.written.copy()
        verdicts = self._chart.update_scores(score, information)
        self._adapt(np.flatnonzero(self._chart.written != written))
        return verdicts

    def _adapt(self, rows: IntArray) -> None:
        """Move filters to what full blocks have taught of their parameters, where it would show."""
        chart = self._chart
        last = chart.past_information[rows, (chart.written[rows] - 1) % chart.history]
        shown = np.einsum("ri,rij,rj->r", chart.offset[rows], last, chart.offset[rows])
        rows = rows[shown > WORTH]
        if rows.size:
            by = chart.offset[rows].copy()
            whole = np.zeros((rows.size, len(self._group.model.parameters)))
            whole[:, self._physical] = by
            self._group.move(rows, whole)
            chart.moved(rows, by)

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
        for i, (component, now) in enumerate(zip(self._group.components, self._group.parameters, strict=True)):
            change = self._chart.estimate(i, updates, self._chart.covariance[i])
            for j, symbol in enumerate(self._symbols):
                error = float(change.joint_error[j])
                if not self._told[i, j] or not np.isfinite(error) or (error > VAGUE and self._log[j]):
                    continue
                ends = float(change.joint[j]) + NORMAL_95 * error * np.array([0.0, -1.0, 1.0])
                at = now[self._physical[j]]
                value, low, high = (at * np.exp(ends) if self._log[j] else at + ends).tolist()
                found.append((f"{component.name}/{symbol}", value, low, high))
        return found

    def export_state(self) -> JsonObject:
        """The chart as plain data."""
        return self._chart.export_state()

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state)
        self._group.error = self._chart.covariance


def _carried(group: FilterGroup, component: Component) -> float:
    """Charts of parameters, as far as each gives alarms of its own: some act so alike that they ring together."""
    charts = sum(p.kind == "physical" and component.carries("score", p.symbol) for p in group.model.parameters)
    row = group.components.index(component)
    return charts * float(group.baselines[row].diagnostics.get("effective_share", 1.0))


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[ScoreCharts]:
    return [ScoreCharts(i, g, plan, arl) for i, g in enumerate(groups) if g.physical.size]


SCORES = FamilyKind(_carried, _build)
