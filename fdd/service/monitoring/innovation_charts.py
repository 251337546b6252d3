"""A quick CUSUM on the innovations of every output, for gross faults: a signal that jumps, a pump that stops.

No distribution describes what a model that is a little wrong mispredicts in its worst hours, so that the limit comes
from the days that the chart has lived through: it is what the largest statistic of a further day passes as often as the
budget allows, and never less than white noise asks for. Slower faults are left to the charts of days.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fdd.records import NANOSECONDS, JsonObject
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.extremes import Extremes
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.chart_family import BoolArray, FamilyKind, Stream
from fdd.service.site.plan import Component, Plan

DAY = 86400 * NANOSECONDS
KIND = "cusum"
# Reference value in standard deviations of an innovation: what drifts by less is for the charts of days.
REFERENCE = 1.0
# Share of the plant's false alarms that gross faults may take.
SHARE = 0.05


class InnovationCharts:
    """Two-sided CUSUM on every output's standardised innovation, with limits from its own healthy days."""

    kind = KIND

    def __init__(self, plan: Plan, groups: Sequence[FilterGroup], arl: Mapping[str, float]) -> None:
        self._groups = tuple(groups)
        outputs = [
            (g, i, c, j) for g in groups for i, c in enumerate(g.components) for j in range(len(g.model.outputs))
        ]
        carried = [c.carries(KIND, g.model.outputs[j].symbol) for g, _, c, j in outputs]
        self._carried = np.flatnonzero(np.array(carried, dtype=np.bool_))
        self._places = [outputs[i] for i in self._carried]
        self.streams = tuple(
            Stream(f"{c.name}/{g.model.outputs[j].symbol}:{KIND}", c.name, g.model.outputs[j].symbol, c.outputs[j])
            for g, _, c, j in self._places
        )
        self._block = max(1, DAY // plan.step)
        self._chart = Cusum(np.ones(len(self.streams)), k=REFERENCE)
        self._extremes = Extremes(len(self.streams), self._block)
        self._held = np.zeros(len(self.streams), dtype=np.bool_)
        self._recall(np.ones(len(self.streams), dtype=np.bool_))
        self.allot(arl)

    def _recall(self, which: BoolArray) -> None:
        """Take from the baselines what their probation has taught."""
        self._extremes.forget(which)
        for i, (g, row, _, _) in enumerate(self._places):
            known = g.baselines[row].diagnostics.get("probation", {}).get(KIND, {})
            if which[i] and self.streams[i].symbol in known:
                self._extremes.recall(i, known[self.streams[i].symbol])

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the standardised innovations."""
        z = np.concatenate([np.empty(0), *(s.standardised.ravel() for s in steps)])[self._carried]
        verdicts = self._chart.update(z)
        calm = ~self._held & (verdicts.phase != Phase.ALARM)
        if self._extremes.update(np.where(np.isfinite(z), verdicts.statistic, np.nan), calm):
            self._limit()
        return verdicts

    def hold(self, components: frozenset[str]) -> None:
        """These components have an alarm: nothing is learned of them."""
        self._held = np.array([s.component in components for s in self.streams], dtype=np.bool_)

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits."""
        wanted = np.array([arl[s.component] for s in self.streams])
        self._chance = np.minimum(0.5, self._block / wanted)
        self._least = Cusum.design(wanted, k=REFERENCE).limit
        self._limit()

    def _limit(self) -> None:
        self._chart.set_limit(np.maximum(self._least, self._extremes.limit(self._chance)))

    def rebase(self, components: set[str]) -> BoolArray:
        """Go on: a misprediction is one under any baseline; what was learned of the old model's worst hours goes.

        So an alarm that an innovation chart holds stands until it is cleared.
        """
        self._recall(np.array([s.component in components for s in self.streams], dtype=np.bool_))
        self._limit()
        return np.zeros(len(self.streams), dtype=np.bool_)

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""
        self._chart.reset(which)

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """An innovation chart says that something is wrong, not how large it is."""
        return {}

    def taught(self) -> dict[str, dict[str, list[float]]]:
        """What healthy days have taught, by component and output."""
        found: dict[str, dict[str, list[float]]] = {}
        for i, s in enumerate(self.streams):
            found.setdefault(s.component, {})[s.symbol] = self._extremes.knowledge(i)
        return found

    def export_state(self) -> JsonObject:
        """The chart as plain data."""
        return {"chart": self._chart.export_state(), "extremes": self._extremes.export_state()}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state["chart"])
        self._extremes.restore_state(state["extremes"])
        self._limit()


def _carried(group: FilterGroup, component: Component) -> int:
    return sum(component.carries(KIND, q.symbol) for q in group.model.outputs)


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[InnovationCharts]:
    return [InnovationCharts(plan, groups, arl)]


INNOVATIONS = FamilyKind(_carried, _build, SHARE)
