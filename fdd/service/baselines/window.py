"""Which part of the past a baseline may be identified from: nothing under alarms, recent, and informative."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fdd.evidence import AlarmKind, kind_of
from fdd.greybox.likelihood import Data, Likelihood
from fdd.records import NANOSECONDS, AlarmState, Baseline, FloatArray, JsonObject
from fdd.service.baselines.history import History, Run, runs
from fdd.service.site.plan import Component, Plan

DAY = 86400 * NANOSECONDS
# Onsets are estimates, and a machine that was just mended needs a day to be itself.
MARGIN = DAY
LENGTHS = (14, 21, 28)
OVER = (AlarmState.CLEARED, AlarmState.RETURNED)


@dataclass(frozen=True, slots=True)
class Window:
    """Event time [start, end) and why it was chosen."""

    start: int
    end: int
    reason: str


def avoided(alarms: Iterable[JsonObject], component: Component, margin: int = MARGIN) -> list[tuple[int, int | None]]:
    """Spans [start, end) under alarms of a component, or of a point that it reads; an open alarm has no end.

    Under an alarm of the model's health the plant is well: that is what a new baseline is to be identified from.
    """
    points = {*component.inputs, *component.outputs}
    return [
        (int(a["since"]) - margin, int(a["updated"]) + margin if a["state"] in OVER else None)
        for a in alarms
        if kind_of(a["evidence"])[0] is AlarmKind.PLANT
        and (a["component"] == component.name or points & set(a["evidence"].get("points", ())))
    ]


def without(history: History, spans: Sequence[tuple[int, int | None]]) -> History:
    """The frames outside all spans."""
    keep = np.ones(len(history), dtype=np.bool_)
    for start, end in spans:
        keep &= (history.time < start) | (False if end is None else history.time >= end)
    return History(history.columns, history.time[keep], history.values[keep])


def record(run: Run) -> Data:
    """A run as the likelihood wants it, time in seconds from its first frame."""
    return Data(t=(run.time - run.time[0]) / NANOSECONDS, u=run.u, y=run.y)


def days_of(history: History) -> list[int]:
    """Numbers of the days (UTC, since the epoch) that have frames."""
    return [int(d) for d in np.unique(history.time // DAY)]


def choose(
    plan: Plan, component: Component, history: History, current: Baseline, lengths: Sequence[int] = LENGTHS
) -> Window:
    """The latest, then shortest, window that says as much of the physical parameters as the baseline's own data did.

    Its measure is the determinant of Fisher's information of the physical parameters at the baseline in force, summed
    over days. Where no window says as much, the one that says most.
    """
    days = days_of(history)
    information = {d: _information(plan, component, history.between(d * DAY, (d + 1) * DAY), current) for d in days}
    wanted = _known(component, current)
    best: tuple[float, Window] | None = None
    for last in reversed([d for d in days if d > days[-1] - 7]):
        for length in lengths:
            total = sum((information[d] for d in days if last - length < d <= last), np.zeros_like(information[last]))
            size = _log_determinant(total)
            window = Window((last - length + 1) * DAY, (last + 1) * DAY, f"{length} days, log det I {size:.1f}")
            if size >= wanted:
                return window
            if best is None or size > best[0]:
                best = (size, window)
    if best is None:
        raise ValueError(f"{component.name}: no frames to choose a window from")
    return best[1]


def _physical(component: Component) -> list[int]:
    return [i for i, p in enumerate(component.model.parameters) if p.kind == "physical"]


def _information(plan: Plan, component: Component, day: History, current: Baseline) -> FloatArray:
    at = _physical(component)
    found = runs(plan, component, day)
    if not found:
        return np.zeros((len(at), len(at)))
    values = np.array([current.parameters[p.symbol] for p in component.model.parameters])
    everything = Likelihood(component.model, [record(r) for r in found]).evaluate(values).information
    return np.asarray(everything[np.ix_(at, at)])


def _known(component: Component, current: Baseline) -> float:
    """Log determinant of what the baseline's own data said; infinite where it was not fitted or left something open."""
    if not current.covariance:
        return np.inf
    at = _physical(component)
    covariance = np.array(current.covariance)[np.ix_(at, at)]
    size = _log_determinant(covariance)
    return -size if np.isfinite(size) else np.inf


def _log_determinant(matrix: FloatArray) -> float:
    sign, size = np.linalg.slogdet(matrix)
    return float(size) if sign > 0 and np.isfinite(size) else -np.inf
