"""The primary charts of the plant: the day's sum of every output's innovations, judged by what held-out days showed.

A fit makes its own weeks white; only later days tell how wrong the model is, and how this moves with weather and load.
These are the days of *probation*: ``fdd fit`` takes them from the end of a long enough history, otherwise the engine
does from the first days that it sees. What was learned so far is kept with the baseline and goes on being learned by
the rules of :class:`fdd.residual_monitors.daily.Daily`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fdd.records import NANOSECONDS, JsonObject
from fdd.residual_monitors.chart import Verdicts
from fdd.residual_monitors.daily import Daily
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.chart_family import BoolArray, FamilyKind, Stream
from fdd.service.site.plan import Component, Plan

DAY = 86400 * NANOSECONDS
# Days that a chart learns from whatever they are like.
PROBATION = 28
KIND = "day"


class DayCharts:
    """A chart of days for every output of one group of components; conditions are the means of the inputs."""

    kind = KIND

    def __init__(self, index: int, group: FilterGroup, plan: Plan, arl: Mapping[str, float]) -> None:
        self._index, self._group = index, group
        outputs = [q.symbol for q in group.model.outputs]
        carried = [[c.carries(KIND, symbol) for symbol in outputs] for c in group.components]
        self._carried = np.flatnonzero(np.array(carried, dtype=np.bool_).ravel())
        self._rows = self._carried // len(outputs)
        self.streams = tuple(
            Stream(f"{c.name}/{outputs[j]}:{KIND}", c.name, outputs[j], c.outputs[j])
            for c, j in ((group.components[i // len(outputs)], i % len(outputs)) for i in self._carried)
        )
        self._chart = Daily.design(
            [arl[s.component] for s in self.streams],
            block=max(1, DAY // plan.step),
            conditions=len(group.model.inputs),
            probation=PROBATION,
        )
        self._held = np.zeros(len(self.streams), dtype=np.bool_)
        self._inform(np.ones(len(group.components), dtype=np.bool_), anew=True)

    def _inform(self, rows: BoolArray, *, anew: bool) -> None:
        """Take from the baselines where conditions lie, and what their probation has taught."""
        tables = [b.diagnostics.get("conditions", {}) for b in self._group.baselines]
        found = np.array([[t.get(q.symbol, (0.0, 0.0)) for q in self._group.model.inputs] for t in tables])
        found = found.reshape(len(tables), len(self._group.model.inputs), 2)[self._rows]
        self._chart.presume(rows[self._rows], found[:, :, 0], found[:, :, 1], anew=anew)
        for i, stream in enumerate(self.streams):
            known = self._group.baselines[self._rows[i]].diagnostics.get("probation", {}).get(KIND, {})
            if rows[self._rows[i]] and stream.symbol in known:
                self._chart.recall(i, known[stream.symbol])
        self._tell()

    def _tell(self) -> None:
        """Where the component's last day was in the range that has been seen; other charts rest where it was not."""
        inside = np.ones(len(self._group.components), dtype=np.bool_)
        np.logical_and.at(inside, self._rows, self._chart.inside)
        self._group.inside = inside

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed one frame."""
        step = steps[self._index]
        z = step.standardised.ravel()[self._carried]
        closed = self._chart.closed.copy()
        verdicts = self._chart.update_days(z, step.inputs[self._rows], self._held)
        if np.any(closed != self._chart.closed):
            self._tell()
        return verdicts

    def hold(self, components: frozenset[str]) -> None:
        """These components have an alarm: nothing is learned of them."""
        self._held = np.array([s.component in components for s in self.streams], dtype=np.bool_)

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits."""
        wanted = [arl[s.component] for s in self.streams]
        self._chart.set_limit(Daily.design(wanted, block=self._chart.block).limit)

    def rebase(self, components: set[str]) -> BoolArray:
        """Begin again: how the old model's errors moved says nothing of the new one's; how large they were does."""
        self._inform(np.array([c.name in components for c in self._group.components]), anew=False)
        which = np.array([s.component in components for s in self.streams], dtype=np.bool_)
        self.reset(which)
        return which

    def reset(self, which: BoolArray) -> None:
        """Start these streams again; what held-out days have taught stays."""
        self._chart.reset(which)

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """A chart of days says that something is wrong, not how large it is."""
        return {}

    def taught(self) -> dict[str, dict[str, JsonObject]]:
        """What held-out days have taught, by component and output."""
        found: dict[str, dict[str, JsonObject]] = {}
        for i, s in enumerate(self.streams):
            found.setdefault(s.component, {})[s.symbol] = self._chart.knowledge(i)
        return found

    def watched(self) -> dict[str, tuple[int, int]]:
        """Days that were closed by component, and how many of them were judged; of the output that was judged least."""
        found: dict[str, tuple[int, int]] = {}
        for i, s in enumerate(self.streams):
            now = int(self._chart.closed[i]), int(self._chart.judged[i])
            found[s.component] = min(now, found.get(s.component, now), key=lambda pair: pair[1])
        return found

    def standing(self) -> dict[str, tuple[bool, bool]]:
        """By component: whether a stream of it does not judge yet, and whether all their last days were in range."""
        found: dict[str, tuple[bool, bool]] = {}
        for s, ready, inside in zip(self.streams, self._chart.ready.tolist(), self._chart.inside.tolist(), strict=True):
            calibrating, all_inside = found.get(s.component, (False, True))
            found[s.component] = (calibrating or not ready, all_inside and inside)
        return found

    def scales(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Scale of a day in conditions seen, in that of white noise, and the limit, by component and output."""
        found: dict[str, dict[str, tuple[float, float]]] = {}
        for s, scale, limit in zip(self.streams, self._chart.scale.tolist(), self._chart.limit.tolist(), strict=True):
            found.setdefault(s.component, {})[s.symbol] = (scale, limit)
        return found

    def export_state(self) -> JsonObject:
        """The chart as plain data."""
        return self._chart.export_state()

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state)
        self._tell()


def _carried(group: FilterGroup, component: Component) -> int:
    return sum(component.carries(KIND, q.symbol) for q in group.model.outputs)


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[DayCharts]:
    return [DayCharts(i, g, plan, arl) for i, g in enumerate(groups)]


DAYS = FamilyKind(_carried, _build)
