"""All charts of a site: which streams there are, what each is fed, and the limits that the budget gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.records import NANOSECONDS, FloatArray, IntArray, JsonObject
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.residual_monitors.cusum import Cusum
from fdd.service.filters import FilterGroup, GroupStep
from fdd.service.plan import Plan

YEAR = 365.25 * 86400 * NANOSECONDS
# A statistic below this share of its limit says that what raised the alarm is gone (hysteresis).
NORMAL = 0.25


@dataclass(frozen=True, slots=True)
class Stream:
    """One chart: what it watches and where that is measured."""

    name: str
    component: str
    symbol: str
    point: str | None


@dataclass(frozen=True, slots=True)
class ChartStep:
    """What all charts said of one frame: verdicts and the value each was fed, (n_streams,)."""

    verdicts: Verdicts
    fed: FloatArray
    rang: IntArray
    normal: NDArray[np.bool_]


class Charts:
    """Two-sided CUSUM charts on the standardised innovations of every output of every component."""

    def __init__(self, plan: Plan, groups: Sequence[FilterGroup]) -> None:
        self.streams = tuple(
            Stream(f"{c.name}/{q.symbol}:cusum", c.name, q.symbol, point)
            for g in groups
            for c in g.components
            for q, point in zip(g.model.outputs, c.outputs, strict=True)
        )
        weights = np.array([c.weight for g in groups for c in g.components for _ in g.model.outputs])
        rate = plan.false_alarms_per_year * weights / weights.sum()
        self._chart = Cusum.design(YEAR / plan.step / rate)
        self._phase = np.zeros(len(self.streams), dtype=np.uint8)

    def update(self, steps: Sequence[GroupStep]) -> ChartStep:
        """Feed one frame's standardised innovations; say which charts have just passed their limits."""
        z = np.concatenate([s.standardised.ravel() for s in steps])
        verdicts = self._chart.update(z)
        alarm = verdicts.phase == Phase.ALARM
        rang = np.flatnonzero(alarm & (self._phase != Phase.ALARM))
        self._phase = verdicts.phase.copy()
        normal = ~alarm | (verdicts.statistic < NORMAL * verdicts.limit)
        return ChartStep(verdicts, z, rang, normal)

    def reset(self, component: str) -> None:
        """An operator has cleared the component's alarm."""
        which = np.array([s.component == component for s in self.streams])
        self._chart.reset(which)
        self._phase[which] = Phase.QUIET

    def export_state(self) -> JsonObject:
        """The charts as plain data."""
        names = [s.name for s in self.streams]
        return {"streams": names, "chart": self._chart.export_state(), "phase": self._phase.copy()}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state["chart"])
        self._phase = np.array(state["phase"], dtype=np.uint8)
