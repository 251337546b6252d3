"""A score chart for each physical parameter: slow faults that a filter with honest process noise would swallow.

Scores of a model that is a little wrong drift with its misfit: sums over a week vary several times as much as their
information says, and a fit makes its own weeks look right. All charts of a component therefore count in its largest
scale of weekly sums that the fit has not seen, from a prior that doubts; they rest where a day was unlike those seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fdd.models.declare import ComponentModel
from fdd.records import NANOSECONDS, Baseline, FloatArray, IntArray, JsonObject
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.residual_monitors.run_length import limit_for
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
KIND = "score"
# Share of the plant's false alarms that charts of parameters may give.
SHARE = 0.1
# Weekly sums vary by so much more than their information says before any was seen, and what that is worth in weeks.
DOUBT, WEEKS = 3.0, 4.0
# Weeks that the fit has not seen, in health, before a chart may ring.
HELD_OUT = 1.0
# A week of a score counts as at most so many of its scales.
OUTLIER = 3.0
# A parameter known no better than this is charted by nobody, relative standard error.
UNKNOWN = 0.5
# Limit of a chart that shall not ring.
NEVER = 500.0
LEARNED = ("sums", "blocks", "weekly", "weeks")
# A score block is longer than a filter's memory and shorter than the delay one wants.
SCORE_BLOCK = 6 * 3600 * NANOSECONDS
WEEK = 28  # blocks


class ScoreCharts:
    """A score chart for each physical parameter of one group of components."""

    kind = KIND

    def __init__(self, index: int, group: FilterGroup, plan: Plan, arl: dict[str, float]) -> None:
        self._index, self._group = index, group
        parameters = group.model.parameters
        self._physical = group.physical
        self._symbols = [parameters[i].symbol for i in self._physical]
        self._log = [parameters[i].transform == "log" for i in self._physical]
        rings = [s in accused(group.model) for s in self._symbols]
        self._ringing = np.flatnonzero(np.tile(np.array(rings, dtype=np.bool_), len(group.components)))
        self.streams = tuple(
            Stream(f"{c.name}/{symbol}:{KIND}", c.name, symbol, None)
            for c in group.components
            for symbol, rings_ in zip(self._symbols, rings, strict=True)
            if rings_
        )
        self._block = max(1, SCORE_BLOCK // plan.step)
        n, p = len(group.components), len(self._symbols)
        self._chart = Score(np.full((n, p), NEVER), block=self._block, enough=plan.learning / SCORE_BLOCK)
        self._deadband = plan.deadband
        self._sums, self._blocks = np.zeros((n, p)), np.zeros(n, dtype=np.int64)
        self._weekly, self._weeks = np.full((n, p), WEEKS * DOUBT**2), np.full(n, WEEKS)
        self._held = np.zeros(n, dtype=np.bool_)
        self.allot(arl)
        self._inform(np.ones(n, dtype=np.bool_))

    def _inform(self, rows: BoolArray) -> None:
        """Take from the baselines what each parameter's error and spread are, and which can be told."""
        baselines = self._group.baselines
        self._told = np.array([self._tells(c, b) for c, b in zip(self._group.components, baselines, strict=True)])
        error = np.stack([baseline_covariance(self._group, b) for b in baselines])
        self._chart.depart(rows, error * self._told[:, :, None] * self._told[:, None, :])
        self._group.error = self._chart.covariance
        self._chart.tolerate(self._deadband * relative_slopes(self._group) * self._told)
        self._sums[rows], self._blocks[rows] = 0.0, 0
        self._weekly[rows], self._weeks[rows] = WEEKS * DOUBT**2, WEEKS
        for i in np.flatnonzero(rows):
            known = baselines[i].diagnostics.get("probation", {}).get(KIND)
            if known and set(known["weekly"]) == set(self._symbols):
                self._weekly[i], self._weeks[i] = [known["weekly"][s] for s in self._symbols], known["weeks"]
        self._limit()
        self._presume(rows)

    def _tells(self, component: Component, baseline: Baseline) -> list[bool]:
        """Parameters that have a value to depart from: not left open, not at a bound, not vague."""
        left = {*baseline.diagnostics.get("unidentifiable", ()), *baseline.diagnostics.get("at_bound", ())}
        errors = np.sqrt(np.maximum(np.diagonal(baseline_covariance(self._group, baseline)), 0.0))
        vague = {s for s, e, log in zip(self._symbols, errors, self._log, strict=True) if log and e > UNKNOWN}
        return [s not in left | vague and component.carries(KIND, s) for s in self._symbols]

    @property
    def scale(self) -> FloatArray:
        """The scale that a component's scores are charted in, (n,): its largest of weekly sums, at least 1."""
        weekly = np.where(self._told, self._weekly, 0.0).max(axis=1, initial=0.0)
        return np.asarray(np.sqrt(np.maximum(1.0, weekly / self._weeks)))

    def _presume(self, rows: BoolArray) -> None:
        """Give the scale to the charts of these components; where blocks of the fit varied more, theirs."""
        stored = [b.diagnostics.get("score_spread", {}) for b in self._group.baselines]
        spread = np.array([[table.get(s, 1.0) for s in self._symbols] for table in stored])
        self._chart.presume(rows, np.maximum(spread, self.scale[:, None]), KNOWN)

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits, and what they add to the reference values."""
        self._arl = dict(arl)
        wanted = np.array([arl[s.component] for s in self.streams])
        self._wanted = np.full(self._chart.n, NEVER)
        self._wanted[self._ringing] = limit_for("cusum", wanted / self._block, k=self._chart.k)
        self._limit()

    def _limit(self) -> None:
        """No chart rings before a week that the fit has not seen has told how far weekly sums go."""
        untold = np.repeat(self._weeks < WEEKS + HELD_OUT, len(self._symbols))
        self._chart.set_limit(np.where(untold, NEVER, self._wanted))

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
            hide = ~step.charted | ~self._group.inside | (np.abs(step.standardised) > ABSURD).any(axis=1)
        score = np.where(self._told, step.score[:, self._physical], 0.0)
        information = step.information[:, self._physical[:, None], self._physical]
        information = information * self._told[:, :, None] * self._told[:, None, :]
        score[hide], information[hide] = np.nan, np.nan
        written = self._chart.written.copy()
        v = self._chart.update_scores(score, information)
        closed = np.flatnonzero(self._chart.written != written)
        if closed.size:
            self._learn(closed)
            self._adapt(closed)
        at = self._ringing
        learning = (self._chart.limit[at] >= NEVER) & (v.phase[at] == Phase.QUIET)
        phase = np.where(learning, np.uint8(Phase.LEARNING), v.phase[at])
        return Verdicts(phase, v.statistic[at], v.limit[at], v.direction[at], v.onset_age[at])

    def _learn(self, rows: IntArray) -> None:
        """Add full blocks to their weeks; weeks that are over teach the scale, unless the component has an alarm."""
        chart = self._chart
        last = (chart.written[rows] - 1) % chart.history
        own = np.diagonal(chart.past_information[rows, last], axis1=1, axis2=2)
        z = chart.past_score[rows, last] / np.sqrt(np.where(own > 0, own, np.inf))
        self._sums[rows] += z
        self._blocks[rows] += 1
        self._sums[self._held], self._blocks[self._held] = 0.0, 0
        over = self._blocks >= WEEK
        if over.any():
            most = OUTLIER**2 * np.maximum(1.0, self._weekly[over] / self._weeks[over, None])
            self._weekly[over] += np.minimum(np.square(self._sums[over]) / WEEK, most)
            self._weeks[over] += 1.0
            self._sums[over], self._blocks[over] = 0.0, 0
            self._limit()
            self._presume(over)

    def hold(self, components: frozenset[str]) -> None:
        """These components have an alarm: nothing is learned of their scale."""
        self._held = np.array([c.name in components for c in self._group.components], dtype=np.bool_)

    def taught(self) -> dict[str, JsonObject]:
        """What held-out weeks have taught, by component."""
        return {
            c.name: {"weekly": dict(zip(self._symbols, w.tolist(), strict=True)), "weeks": float(m)}
            for c, w, m in zip(self._group.components, self._weekly, self._weeks, strict=True)
        }

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
        """Start these streams again, and with the last of a component's those that cannot ring."""
        full = np.zeros(self._chart.n, dtype=np.bool_)
        full[self._ringing] = which
        p = len(self._symbols)
        rows = np.repeat((full | (self._chart.limit >= NEVER)).reshape(-1, p).all(axis=1), p)
        self._chart.reset(full | (rows & np.repeat(full.reshape(-1, p).any(axis=1), p)))

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """Change of the parameter if it alone is responsible, with its standard error; a share where on a log scale."""
        component, j = divmod(int(self._ringing[stream]), len(self._symbols))
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
        """The chart and what weeks have taught as plain data."""
        return {"chart": self._chart.export_state(), **{n: getattr(self, f"_{n}").copy() for n in LEARNED}}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._chart.restore_state(state["chart"])
        for name in LEARNED:
            own = getattr(self, f"_{name}")
            setattr(self, f"_{name}", np.array(state[name], dtype=own.dtype).reshape(own.shape))
        self._limit()
        self._group.error = self._chart.covariance


def accused(model: ComponentModel) -> frozenset[str]:
    """Physical parameters whose charts may ring: those that a fault of the model's table names; all where none does.

    The scores of others, such as a solar aperture, say how large a change is and take their part in estimates. What no
    fault explains is no reason to send somebody.
    """
    physical = {p.symbol for p in model.parameters if p.kind == "physical"}
    named = physical & {symbol for fault in model.faults for symbol in fault.shows}
    return frozenset(named or physical)


def _carried(group: FilterGroup, component: Component) -> float:
    """Charts of parameters, as far as each gives alarms of its own: some act so alike that they ring together."""
    charts = sum(component.carries(KIND, symbol) for symbol in accused(group.model))
    row = group.components.index(component)
    return charts * float(group.baselines[row].diagnostics.get("effective_share", 1.0))


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[ScoreCharts]:
    return [ScoreCharts(i, g, plan, arl) for i, g in enumerate(groups) if g.physical.size]


SCORES = FamilyKind(_carried, _build, SHARE)
