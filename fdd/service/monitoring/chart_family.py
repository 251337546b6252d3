"""What a family of charts offers to the collection: streams, verdicts, resets, estimates and plain state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fdd.evidence import AlarmKind
from fdd.records import Baseline, JsonObject
from fdd.residual_monitors.chart import Verdicts
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.site.plan import Component, Plan

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Stream:
    """One chart: what it watches and where that is measured; ``alarm`` is the kind of alarm that it raises."""

    name: str
    component: str
    symbol: str
    point: str | None
    alarm: AlarmKind = AlarmKind.PLANT


class Family(Protocol):
    """Charts of one kind, with their streams in order."""

    streams: tuple[Stream, ...]

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed one frame."""

    def hold(self, components: frozenset[str]) -> None:
        """These components have an alarm of the plant: nothing is learned of their health."""

    def allot(self, arl: Mapping[str, float]) -> None:
        """Set limits for these mean numbers of frames between false alarms of each of a component's charts."""

    def rebase(self, components: set[str]) -> BoolArray:
        """These components have new baselines; returns the streams that were started again for it."""

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """Size of what the stream has found over its last ``updates``, as far as the chart can tell."""

    def export_state(self) -> JsonObject:
        """Plain data."""

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""


def _all(component: Component, baseline: Baseline, arl: float) -> float:
    return 1.0


@dataclass(frozen=True, slots=True)
class FamilyKind:
    """How a family comes into a site.

    ``carried(group, component)`` says how many charts a component has of it, those that ring together counted as far as
    each gives alarms of its own; every chart takes an equal share of the
    component's budget; ``build(plan, groups, arl)`` makes the family, or several, with the mean number of frames
    between false alarms of each of a component's charts in ``arl``. A family with a ``share`` above zero has so much of
    the plant's budget to itself, of which its limits may need less: ``used(component, baseline, arl)`` says what part,
    0 to 1, at this mean number of frames between false alarms of each of its charts. The others divide what is left.
    """

    carried: Callable[[FilterGroup, Component], float]
    build: Callable[[Plan, Sequence[FilterGroup], dict[str, float]], Sequence[Family]]
    share: float = 0.0
    used: Callable[[Component, Baseline, float], float] = _all
