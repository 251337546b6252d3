"""The components of one model type, stepped together: gates, gaps and held inputs around one filter bank.

=================  ==============================================================================
condition          outcome
=================  ==============================================================================
input missing      its last value is held for ``hold``, after that the component has no data; nobody knows what the
                   input does from there on until it is back: such steps are not judged, and the filter takes it that
                   the input has moved at any time between
output missing     the filter predicts; that output's charts see nothing
gate false         the machine is off: the filter rests, and starts afresh when it is on again
gap > ``max_gap``  the filter starts afresh from the next complete measurement
start              charts see nothing for the component's ``start_up``
filter breaks      the component starts afresh; the reason is counted
=================  ==============================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.greybox.filter_bank import BROKEN, STATUS, FilterBank
from fdd.records import NANOSECONDS, Baseline, FloatArray, IntArray, JsonObject
from fdd.residual_monitors.whiten import Whitener
from fdd.service.site.plan import Component

NEVER = np.iinfo(np.int64).min
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GroupStep:
    """One step of a group; arrays are (n, n_outputs) unless said.

    ``readings`` (n, n_inputs) are the inputs as they came, NaN where there was none, ``inputs`` with what was held in
    their place. ``standardised`` is NaN where
    charts shall see nothing; ``score`` (n, n_p) and ``information`` (n, n_p, n_p) are meant for the rows where
    ``charted`` (n,) is true.
    """

    predicted: FloatArray
    sd: FloatArray
    standardised: FloatArray
    measured: FloatArray
    readings: FloatArray
    inputs: FloatArray
    running: BoolArray
    charted: BoolArray
    score: FloatArray
    information: FloatArray


class FilterGroup:
    """All components that share one model, in one filter bank."""

    def __init__(
        self,
        components: Sequence[Component],
        baselines: Mapping[str, Baseline],
        columns: Sequence[str],
        *,
        hold: int,
        max_gap: int,
    ) -> None:
        self.baselines = [baselines[c.name] for c in components]
        self.components = tuple(components)
        self._row = {c.name: i for i, c in enumerate(components)}
        self.model = components[0].model
        column = {name: i for i, name in enumerate(columns)}
        self._inputs = np.array([[column[p] for p in c.inputs] for c in components], dtype=np.int64)
        self._outputs = np.array([[column[p] for p in c.outputs] for c in components], dtype=np.int64)
        self._gate = np.array([column[c.when] if c.when else -1 for c in components], dtype=np.int64)
        self._start_up = np.array([c.start_up for c in components], dtype=np.int64)
        self._hold, self._max_gap = hold, max_gap
        self._bank = FilterBank(self.model, self._parameters())
        # Positions of the physical parameters in the model.
        self.physical: IntArray = np.flatnonzero([p.kind == "physical" for p in self.model.parameters])
        # Covariance of the physical parameters' errors; the score charts say what is known of it.
        self.error = np.zeros((len(components), self.physical.size, self.physical.size))
        # Components whose last day was in the range that has been seen; the charts of days say so.
        self.inside: BoolArray = np.ones(len(components), dtype=np.bool_)
        self._whitener = _whitener(self.baselines, [o.symbol for o in self.model.outputs])
        n = len(components)
        self._last = np.full(n, NEVER, dtype=np.int64)
        self._quiet = np.full(n, NEVER, dtype=np.int64)
        self._held = np.full(self._inputs.shape, np.nan)
        self._held_at = np.full(self._inputs.shape, NEVER, dtype=np.int64)
        self._bridging: BoolArray = np.zeros(n, dtype=np.bool_)
        self.restarts: dict[str, int] = {}
        # When each component last ran, or had no reason to; of this process alone.
        self._attended = np.full(n, NEVER, dtype=np.int64)

    def _parameters(self) -> FloatArray:
        names = [p.symbol for p in self.model.parameters]
        return np.array([[b.parameters[s] for s in names] for b in self.baselines])

    def rebase(self, baselines: Mapping[str, Baseline]) -> set[str]:
        """Put new baselines under running filters; returns the components that have one.

        States and their covariances go on, so that not one sample is missed. The whitener takes up the new colour, mean
        and scale, and keeps the values it remembers.
        """
        rows = [i for i, c in enumerate(self.components) if c.name in baselines]
        if not rows:
            return set()
        for i in rows:
            self.baselines[i] = baselines[self.components[i].name]
        self._bank.set_parameters(rows, self._parameters()[rows])
        whitener = _whitener(self.baselines, [o.symbol for o in self.model.outputs])
        kept = min(whitener.recent.shape[1], self._whitener.recent.shape[1])
        whitener.recent[:, :kept] = self._whitener.recent[:, :kept]
        whitener.run[:] = self._whitener.run
        self._whitener = whitener
        return {self.components[i].name for i in rows}

    @property
    def parameters(self) -> FloatArray:
        """Parameters that the filters run on now, (n, n_p), natural scale."""
        return self._bank.parameters

    def move(self, rows: IntArray, by: FloatArray) -> None:
        """Move parameters of running filters by ``by`` (r, n_p) on their estimation scale, states with them."""
        self._bank.move(rows, by)

    def step(self, time: int, values: FloatArray) -> GroupStep:
        """Step every component whose data allow it; ``values`` is one frame, shape (n_columns,)."""
        u, has_inputs = self._hold_inputs(time, values)
        y = values[self._outputs]
        on = np.where(self._gate < 0, True, values[self._gate] > 0.5)
        self._rest(~on)
        stale = (self._last != NEVER) & (time - np.maximum(self._last, time - 2 * self._max_gap) > self._max_gap)
        self._rest(stale)
        starting = self._last == NEVER
        running = has_inputs & on & (~starting | np.isfinite(y).all(axis=1))
        # Up to the first value that is missing inputs are known, and the filter can follow.
        leaving = ~has_inputs & on & ~starting & ~self._bridging
        stepping = running | leaving
        self._quiet = np.where(starting & running, time + self._start_up, self._quiet)
        fresh = (self._held_at == time).all(axis=1)
        dt = np.where(starting, 0.0, (time - np.where(starting, time, self._last)) / NANOSECONDS)
        with np.errstate(all="ignore"):  # absurd values of one component overflow there and end in its status
            unseen = self._bridging & fresh & running & ~starting
            step = self._bank.step(dt, u, np.where(leaving[:, None], np.nan, y), stepping, unseen)
        broken = stepping & (step.status >= BROKEN)
        self._last = np.where(stepping & ~broken, time, np.where(broken, NEVER, self._last))
        self._count(step.status[broken])
        attended = (running & ~broken) | ~on | (self._attended == NEVER)
        self._attended = np.where(attended, time, self._attended)
        charted = running & ~broken & (time >= self._quiet) & ~self._bridging
        self._bridging = np.where(stepping, ~fresh, self._bridging | ~has_inputs)
        seen = np.where(charted[:, None], step.standardised, np.nan)
        white = self._whitener.update(seen.ravel()).reshape(seen.shape)
        return GroupStep(
            predicted=step.predicted,
            sd=np.sqrt(step.variance),
            standardised=white,
            measured=y,
            readings=values[self._inputs],
            inputs=self._held.copy(),
            running=running & ~broken,
            charted=charted,
            score=step.score,
            information=step.information,
        )

    def idle(self, before: int) -> list[str]:
        """Components whose gate is open, and whose filters have not run since an event time [ns]."""
        unseen = (self._attended != NEVER) & (self._attended < before)
        return [c.name for c, idle in zip(self.components, unseen, strict=True) if idle]

    def restart(self) -> None:
        """Start every filter afresh with the next frame: what is remembered may lie in its future."""
        self._rest(np.ones(len(self.components), dtype=np.bool_))
        self._held_at[:] = NEVER
        self._bridging[:] = False
        self._attended[:] = NEVER

    def judged_since(self, component: str) -> int:
        """Event time [ns] at which a component's charts last began to see."""
        return int(self._quiet[self._row[component]])

    def _hold_inputs(self, time: int, values: FloatArray) -> tuple[FloatArray, BoolArray]:
        fresh_values = values[self._inputs]
        fresh = np.isfinite(fresh_values)
        self._held = np.where(fresh, fresh_values, self._held)
        self._held_at = np.where(fresh, time, self._held_at)
        usable: BoolArray = np.all(self._held_at >= time - self._hold, axis=1)
        return self._held, usable

    def _rest(self, which: BoolArray) -> None:
        started = which & np.asarray(self._last != NEVER)
        if started.any():
            self._bank.reset(started)
            self._last[started] = NEVER

    def _count(self, status: IntArray) -> None:
        for code in status.tolist():
            self.restarts[STATUS[code]] = self.restarts.get(STATUS[code], 0) + 1

    def export_state(self) -> JsonObject:
        """The filters and what is remembered around them, as plain data."""
        return {
            "components": [c.name for c in self.components],
            "baselines": [b.version for b in self.baselines],
            "bank": self._bank.export_state(),
            "last": self._last.copy(),
            "quiet": self._quiet.copy(),
            "held": self._held.copy(),
            "held_at": self._held_at.copy(),
            "bridging": self._bridging.copy(),
            "whitener": self._whitener.export_state(),
            "restarts": dict(self.restarts),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._bank.restore_state(state["bank"])
        self._last = np.array(state["last"], dtype=np.int64)
        self._quiet = np.array(state["quiet"], dtype=np.int64)
        self._held = np.array(state["held"], dtype=np.float64)
        self._held_at = np.array(state["held_at"], dtype=np.int64)
        self._bridging = np.array(state["bridging"], dtype=np.bool_)
        self._whitener.restore_state(state["whitener"])
        self.restarts = dict(state["restarts"])


def _whitener(baselines: Sequence[Baseline], outputs: Sequence[str]) -> Whitener:
    """Takes out what colour, mean and scale the innovations had on their baselines; nothing where these are unknown.

    A mean under parameters that were given is what these are off by: filters learn that, and it goes away.
    """
    table = [
        {**b.innovation.get(symbol, {}), **({} if b.covariance else {"mean": 0.0})}
        for b in baselines
        for symbol in outputs
    ]
    order = max((len(s.get("ar", ())) for s in table), default=0)
    coefficients = np.zeros((len(table), order))
    for row, s in zip(coefficients, table, strict=True):
        row[: len(s.get("ar", ()))] = s.get("ar", ())
    return Whitener(coefficients, [s.get("mean", 0.0) for s in table], [s.get("sd", 1.0) for s in table])
