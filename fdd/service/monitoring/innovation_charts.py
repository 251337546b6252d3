"""A CUSUM on the standardised innovations of every output: quick for faults that make the filter mispredict at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fdd.records import FloatArray, JsonObject
from fdd.residual_monitors.chart import Verdicts
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.predictive import Uncertainty, widened
from fdd.residual_monitors.score import KNOWN
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.baseline_uncertainty import relative_slopes, shift_variance
from fdd.service.monitoring.chart_family import BoolArray, FamilyKind, Stream
from fdd.service.site.plan import Component, Plan

# What a fit has made white is not quite so afterwards: sums over the hours in which a CUSUM grows vary from baseline
# to baseline as if it had one in so many independent samples (houses at five minutes, four weeks).
MEMORY = 16
# Variance of a scale from a baseline that is too short to say anything of it.
MOST = 0.02


class InnovationCharts:
    """Two-sided CUSUM on every output's standardised innovation."""

    def __init__(self, groups: Sequence[FilterGroup], arl: dict[str, float], deadband: float = 0.0) -> None:
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
        self._groups = tuple(groups)
        self._deadband = deadband
        self._apart = self._widened_by_deadband()
        self.allot(arl)

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the standardised innovations; the reference widens with what baselines may be off by without a fault."""
        errors = [shift_variance(self._groups[i], step, self._groups[i].error) for i, step in enumerate(steps)]
        allowance = self._uncertainty.extra(np.concatenate([np.empty(0), *errors])[self._carried])
        if self._deadband:
            apart = [shift_variance(self._groups[i], step, self._apart[i]) for i, step in enumerate(steps)]
            allowance = allowance + np.sqrt(np.concatenate([np.empty(0), *apart])[self._carried])
        self._chart.allow_bias(allowance)
        return self._chart.update(
            np.concatenate([np.empty(0), *(s.standardised.ravel() for s in steps)])[self._carried]
        )

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits, and what they add to the reference values."""
        self._arl = dict(arl)
        limit = Cusum.design([arl[s.component] for s in self.streams]).limit
        seen = [
            b.innovation.get(q.symbol, {}).get("samples", KNOWN) for g in self._groups for b in g.baselines
            for q in g.model.outputs
        ]  # fmt: skip
        uncertain = np.minimum(2.0 * MEMORY / np.array(seen, dtype=np.float64), MOST)[self._carried]
        self._chart.set_limit(widened(limit, self._chart.k, uncertain))
        self._uncertainty = Uncertainty(self._chart.limit, self._chart.k)

    def _widened_by_deadband(self) -> list[FloatArray]:
        """The squares of the changes for which no chart rings, as diagonal matrices (n, p, p) for each group."""
        slacks = [self._deadband * relative_slopes(g) for g in self._groups]
        return [np.asarray(np.square(deadband)[:, :, None] * np.eye(deadband.shape[1])) for deadband in slacks]

    def rebase(self, components: set[str]) -> BoolArray:
        """Go on: a misprediction is one under any baseline, and where the new one predicts better sums fall again.

        So an alarm that an innovation chart holds stands until it is cleared.
        """
        self.allot(self._arl)
        self._apart = self._widened_by_deadband()
        return np.zeros(len(self.streams), dtype=np.bool_)

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


def _carried(group: FilterGroup, component: Component) -> int:
    return sum(component.carries("cusum", q.symbol) for q in group.model.outputs)


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[InnovationCharts]:
    return [InnovationCharts(groups, arl, plan.deadband)]


INNOVATIONS = FamilyKind(_carried, _build)
