"""Charts of frozen readings: one for every output of a filter, and for every input that is a temperature.

A point that several components read is charted once, for the component whose output it is, else for the first that
reads it: the alarm's point suppresses what else is upset by it. What a point's healthy runs of equal readings are comes
with its component's baseline.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fdd.records import NANOSECONDS, Baseline, FloatArray, JsonObject
from fdd.residual_monitors.chart import Verdicts
from fdd.residual_monitors.flatline import Flatline, FlatRuns, flat_runs
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.chart_family import BoolArray, FamilyKind, Stream
from fdd.service.site.plan import Component, Plan

# Share of the plant's false alarms that frozen readings may give: runs get rare so fast that little is enough.
SHARE = 0.02
TEMPERATURE = "degC"
# What charts use of their share is rounded to a twentieth.
ROUND = 20
# What stands for the limit of a point without a baseline of its own; it is fed nothing.
UNKNOWN = FlatRuns(readings=1, runs=1, longest=0, tail=0, exceed=1, excess=0, low=-np.inf, high=np.inf)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a point's readings are: group, row, and column among its outputs or, after these, its inputs."""

    group: int
    row: int
    column: int
    symbol: str
    point: str


def flatline_statistics(component: Component, steps: Sequence[GroupStep]) -> dict[str, JsonObject]:
    """Runs of equal readings on a healthy history, by symbol; nothing for a point that never changes."""
    seen = np.array([s.running[0] for s in steps])
    table = np.array([_readings(s)[0] for s in steps])
    table = np.where(seen[:, None], table, np.nan)
    found = ((symbol, flat_runs(column)) for symbol, column in zip(_symbols(component), table.T, strict=True))
    return {symbol: s.document() for symbol, s in found if s is not None}


def _symbols(component: Component) -> tuple[str, ...]:
    return tuple(q.symbol for q in (*component.model.outputs, *component.model.inputs))


def _readings(step: GroupStep) -> FloatArray:
    return np.concatenate([step.measured, step.readings], axis=1)


class FlatlineCharts:
    """Unchanged readings of every point."""

    def __init__(self, plan: Plan, groups: Sequence[FilterGroup], arl: Mapping[str, float]) -> None:
        self._groups, self._step = tuple(groups), plan.step
        measured = set(plan.points)
        taken: set[str] = set()
        self._places: list[_Place] = []
        for place in sorted(_places(groups), key=lambda p: p.column >= len(groups[p.group].model.outputs)):
            component = groups[place.group].components[place.row]
            if place.point in measured and place.point not in taken and component.carries("flatline", place.symbol):
                taken.add(place.point)
                self._places.append(place)
        self._owners = owners = [groups[p.group].components[p.row].name for p in self._places]
        self.streams = tuple(
            Stream(f"{owner}/{p.symbol}:flatline", owner, p.symbol, p.point)
            for owner, p in zip(owners, self._places, strict=True)
        )
        self._arl = np.array([arl[owner] for owner in owners])
        self._chart = Flatline(np.ones(len(self._places)))
        self._inform()

    def hold(self, components: frozenset[str]) -> None:
        """Nothing is learned here."""

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits."""
        self._arl = np.array([arl[owner] for owner in self._owners])
        self._inform()

    def _inform(self) -> None:
        """Take limits and ranges from the baselines."""
        stored = [
            self._groups[p.group].baselines[p.row].diagnostics.get("flatline", {}).get(p.symbol) for p in self._places
        ]
        self._known = np.array([s is not None for s in stored], dtype=np.bool_)
        found = [UNKNOWN if s is None else FlatRuns(**s) for s in stored]
        self._chart.expect(self._arl, found)

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the readings as they came; nothing where the component rests."""
        tables = [np.where(s.running[:, None], _readings(s), np.nan) for s in steps]
        x = np.array([tables[p.group][p.row, p.column] for p in self._places])
        return self._chart.update(np.where(self._known, x, np.nan))

    def rebase(self, components: set[str]) -> BoolArray:
        """Go on: a frozen reading is frozen under any baseline."""
        self._inform()
        return np.zeros(len(self.streams), dtype=np.bool_)

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""
        self._chart.reset(which)

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """How long the reading has been the same."""
        return {"point": self._places[stream].point, "unchanged_seconds": updates * self._step / NANOSECONDS}

    def export_state(self) -> JsonObject:
        """The chart as plain data."""
        return self._chart.export_state()

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state)


def _places(groups: Sequence[FilterGroup]) -> Iterator[_Place]:
    for g, group in enumerate(groups):
        for row, c in enumerate(group.components):
            quantities = (*c.model.outputs, *c.model.inputs)
            for column, (q, point) in enumerate(zip(quantities, (*c.outputs, *c.inputs), strict=True)):
                if _moves(c, column):
                    yield _Place(g, row, column, q.symbol, point)


def _moves(component: Component, column: int) -> bool:
    """A temperature is never at rest; a power, a flow, an opening or the sun may well be, for days."""
    outputs = len(component.model.outputs)
    return column < outputs or component.model.inputs[column - outputs].unit == TEMPERATURE


def charted(component: Component) -> list[str]:
    """Symbols of a component whose readings have a chart."""
    symbols = enumerate(_symbols(component))
    return [symbol for column, symbol in symbols if _moves(component, column) and component.carries("flatline", symbol)]


def _carried(group: FilterGroup, component: Component) -> int:
    return len(charted(component))


def used(component: Component, baseline: Baseline, arl: float) -> float:
    """Part of its share that a component's limits can give: none where readings have noise in every digit.

    Limits are whole readings, and never below what a gateway may do: a run of a handful of readings that all differ by
    noise comes once in ages of the universe. Rounded, so that components that are alike have the same limits.
    """
    stored, symbols = baseline.diagnostics.get("flatline", {}), charted(component)
    found = [FlatRuns(**stored[symbol]) for symbol in symbols if symbol in stored]
    rings = sum(min(1.0, arl * s.rate(s.limit(arl))) for s in found)
    return round(ROUND * rings / max(1, len(symbols))) / ROUND


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[FlatlineCharts]:
    return [FlatlineCharts(plan, groups, arl)]


FLATLINE = FamilyKind(_carried, _build, SHARE, used)
