"""Charts of the model's health: does it still describe its component, whatever becomes of the plant?

Every output's innovations are tested day by day for memory (autocorrelation), colour at any frequency (cumulated
periodogram) and spread (dispersion). Hardly any model is white on its own baseline, and one that was accepted so must
not ring for it: a limit is what a further day of the baseline passes with the chance that the budget gives it, on a
scale on which days are normal. Where the baseline's days are within chance of those of white noise, that is what limits
are from; where they are beyond, they are Student's predictive ones from the days' own mean and spread. (From their own
four weeks alone the chance is kept on average over very many baselines: some would ring every month.)

What a model misses was there on the first days after the fit, too, and is nothing to ring for. How far those days go is
learned, and widens limits to what a further day of them passes with that chance: by a quarter at first.

A model whose parameters are still being learned is not judged: until then its innovations have its inputs' colour.

Their alarms are the model's, with a share of the budget of their own: they say that the component is to be identified
anew, not that it is broken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import lru_cache

import numpy as np
from scipy.stats import kstwo, norm
from scipy.stats import t as student

from fdd.evidence import AlarmKind
from fdd.records import NANOSECONDS, Baseline, FloatArray, JsonObject
from fdd.residual_monitors.autocorrelation import Autocorrelation
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.residual_monitors.dispersion import Dispersion
from fdd.residual_monitors.extremes import Extremes
from fdd.residual_monitors.periodogram import Periodogram
from fdd.residual_monitors.score import CHANCE
from fdd.residual_monitors.window import FILLING, blocks
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.baseline_uncertainty import shift_variance
from fdd.service.monitoring.chart_family import BoolArray, FamilyKind, Stream
from fdd.service.site.plan import Component, Plan

KIND = "health"
KINDS = ("autocorrelation", "periodogram", "dispersion")
# Centre and spread of a day's statistic, in its limit, before any day after the fit was seen.
CENTRE, SPREAD = 0.3, 0.2
# Share of the plant's false alarms that may be the models'.
SHARE = 0.1
DAY = 86400 * NANOSECONDS
# A window has at least this many values, with long frames it is longer than a day; and no more than so many, with short
# frames a value is the sum of several: what a chart keeps does not grow with the rate.
SHORTEST = 96
LONGEST = 288
LAGS = 12
# Version of the scale that statistics of windows are stored on; an older baseline's are not judged by.
SCALE = 2
# Fewer windows than this say nothing of how far a healthy day may go.
FEWEST = 6
# One wild value is a matter for the charts of the plant.
OUTLIER = 5.0
# Relative standard deviation from day to day of the innovations' variance, beyond chance, that is no fault of a model.
STEADY = 0.035
# Variance of the innovations' means by what parameters may be off by; colour of so little does not show in a day.
LEARNED = 0.02


def window_of(step: int) -> tuple[int, int]:
    """Values of a window and frames of a value at this length of a frame [ns]."""
    frames = max(SHORTEST, DAY // step)
    block = -(-frames // LONGEST)
    return frames // block, block


def window_statistics(white: FloatArray, window: int, block: int = 1) -> JsonObject:
    """What the tests say of the baseline's own windows: mean, standard deviation and number, by kind; plain data.

    Parameters
    ----------
    white : shape (n,), standardised and whitened innovations in order, without gaps
    window, block : see :func:`window_of`
    """
    values = blocks(np.clip(white, -OUTLIER, OUTLIER), block)
    values = values[: len(values) // window * window].reshape(-1, window)
    if len(values) < FEWEST:
        return {}
    one = np.ones(1)
    colour = Periodogram(one, window=window)
    found = {
        "autocorrelation": np.cbrt(Autocorrelation(one, window=window, lags=LAGS).statistics(values)),
        "periodogram": colour.straightened(colour.statistics(values)),
        "dispersion": Dispersion(one, window=window).scores(values),
    }
    if any(np.ptp(s) == 0 for s in found.values()):
        return {}  # days that are all the same say nothing of how far a healthy one may go
    spans = {"window": window, "block": block, "scale": SCALE}
    return spans | {k: [float(s.mean()), float(s.std(ddof=1)), len(s)] for k, s in found.items()}


class HealthCharts:
    """Three tests on the windows of every output; statistics count from the baseline's mean, on a normal scale."""

    kind = KIND

    def __init__(self, plan: Plan, groups: Sequence[FilterGroup], arl: Mapping[str, float]) -> None:
        self._groups = tuple(groups)
        self._window, self._block = window_of(plan.step)
        outputs = [(g, i, c, q.symbol) for g in groups for i, c in enumerate(g.components) for q in g.model.outputs]
        self._carried = np.array([c.carries("health", symbol) for _, _, c, symbol in outputs], dtype=np.bool_)
        self._outputs = [o for o, carried in zip(outputs, self._carried, strict=True) if carried]
        self.streams = tuple(
            Stream(f"{c.name}/{symbol}:{kind}", c.name, symbol, None, alarm=AlarmKind.MODEL)
            for kind in KINDS
            for _, _, c, symbol in self._outputs
        )
        self._chance = self._chances(arl)
        ones = np.ones(len(self._outputs))
        self._memory = Autocorrelation(ones, window=self._window, lags=LAGS, block=self._block)
        self._colour = Periodogram(ones, window=self._window, block=self._block)
        self._spread = Dispersion(ones, window=self._window, block=self._block)
        self._charts = (self._memory, self._colour, self._spread)
        n = len(self.streams)
        day = max(1, self._window * self._block)
        self._further = Extremes(n, day, centre=CENTRE, spread=SPREAD, logarithmic=False)
        self._held = np.zeros(n, dtype=np.bool_)
        self._recall(np.ones(n, dtype=np.bool_))

    def _recall(self, which: BoolArray) -> None:
        """Take from the baselines how far days of their probation went."""
        self._further.forget(which)
        for i, (g, row, _, symbol) in enumerate(self._outputs * len(KINDS)):
            known = g.baselines[row].diagnostics.get("probation", {}).get(KIND, {}).get(symbol, {})
            if which[i] and (kind := KINDS[i // len(self._outputs)]) in known:
                self._further.recall(i, known[kind])
        self._inform()

    def _chances(self, arl: Mapping[str, float]) -> FloatArray:
        """Chance of a false alarm that a window of each output may have."""
        return np.array([min(0.5, self._window * self._block / arl[c.name]) for _, _, c, _ in self._outputs])

    def hold(self, components: frozenset[str]) -> None:
        """Of these components nothing is learned."""
        self._held = np.array([s.component in components for s in self.streams], dtype=np.bool_)

    def allot(self, arl: Mapping[str, float]) -> None:
        """New limits."""
        self._chance = self._chances(arl)
        self._inform()

    def _inform(self) -> None:
        """Take centres and limits from the baselines; an output whose baseline was too short is not judged."""
        stored = [g.baselines[i].innovation.get(symbol, {}).get("windows", {}) for g, i, _, symbol in self._outputs]
        wanted = (self._window, self._block, SCALE)
        self._known = np.array([(s.get("window"), s.get("block"), s.get("scale")) == wanted for s in stored], np.bool_)
        p = self._chance
        memory, colour, spread = (
            _Reach.of(
                kind,
                [s[kind] if known else None for s, known in zip(stored, self._known, strict=True)],
                chance,
                self._window,
            )
            for kind, chance in zip(KINDS, (p, p, p / 2), strict=True)
        )
        # By how much limits are wider than the fit's own days ask for, a row a kind.
        self._factors = np.maximum(1.0, self._further.limit(np.tile(p, len(KINDS)))).reshape(len(KINDS), -1)
        for reach, factor in zip((memory, colour, spread), self._factors, strict=True):
            reach.reach = reach.reach * factor
        self._memory.set_limit(memory.limit**3)
        self._colour.set_limit(self._colour.bent(colour.limit))
        self._spread.centre = spread.centre
        self._spread.set_limit(spread.reach)
        self._reaches = (memory, colour, spread)

    def update(self, steps: Sequence[GroupStep]) -> Verdicts:
        """Feed the standardised innovations."""
        z = np.concatenate([np.empty(0), *(s.standardised.ravel() for s in steps)])[self._carried]
        off = [shift_variance(g, s, g.error) for g, s in zip(self._groups, steps, strict=True)]
        learned = np.concatenate([np.empty(0), *off])[self._carried] < LEARNED
        waiting = np.tile(self._known & ~learned & np.isfinite(z), len(KINDS))
        z = np.where(self._known & learned, np.clip(z, -OUTLIER, OUTLIER), np.nan)
        said = [chart.update(z) for chart in self._charts]
        memory, colour, spread = (v.statistic for v in said)
        with np.errstate(divide="ignore"):
            scaled = (np.cbrt(memory), self._colour.straightened(colour), spread + self._reaches[2].centre)
        away = [np.maximum(s - r.centre, 0.0) for s, r in zip(scaled, self._reaches, strict=True)]
        joined = {f.name: np.concatenate([getattr(v, f.name) for v in said]) for f in fields(Verdicts)}
        joined["phase"][waiting & (joined["phase"] == Phase.NO_DATA)] = Phase.LEARNING
        joined |= {"statistic": np.concatenate(away), "limit": np.concatenate([r.reach for r in self._reaches])}
        seen = np.tile(np.isfinite(z), len(KINDS)) & (joined["phase"] != Phase.NO_DATA)
        relative = joined["statistic"] / joined["limit"] * self._factors.ravel()
        if self._further.update(np.where(seen, relative, np.nan), ~self._held & (joined["phase"] != Phase.ALARM)):
            self._inform()
        return Verdicts(**joined)

    def taught(self) -> dict[str, dict[str, dict[str, list[float]]]]:
        """How far healthy days went, by component, output and test."""
        found: dict[str, dict[str, dict[str, list[float]]]] = {}
        for i, s in enumerate(self.streams):
            of = found.setdefault(s.component, {}).setdefault(s.symbol, {})
            of[KINDS[i // len(self._outputs)]] = self._further.knowledge(i)
        return found

    def rebase(self, components: set[str]) -> BoolArray:
        """Begin again with the new baselines' own limits: whiteness is that of one model, not of the plant."""
        which = np.array([s.component in components for s in self.streams], dtype=np.bool_)
        self._recall(which)
        self.reset(which)
        return which

    def reset(self, which: BoolArray) -> None:
        """Start these streams again."""
        for chart, rows in zip(self._charts, np.split(which, len(KINDS)), strict=True):
            chart.reset(rows)

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """A test says that the model no longer holds, not which parameter is to blame."""
        return {}

    def export_state(self) -> JsonObject:
        """The charts as plain data; the windows, which are the same for all of them, once."""
        states = [chart.export_state() for chart in self._charts]
        windows = {
            k: {n: v for n, v in s.items() if i == 0 or n not in FILLING}
            for i, (k, s) in enumerate(zip(KINDS, states, strict=True))
        }
        return {**windows, "further": self._further.export_state()}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        for kind, chart in zip(KINDS, self._charts, strict=True):
            chart.restore_state({n: state[KINDS[0]][n] for n in FILLING} | state[kind])
        self._further.restore_state(state["further"])
        self._inform()


class _Reach:
    """Centre of a statistic on the baselines and how far beyond it the limit lies, each (n,)."""

    def __init__(self, centre: FloatArray, reach: FloatArray) -> None:
        self.centre, self.reach = centre, reach

    @property
    def limit(self) -> FloatArray:
        """The limit itself."""
        return self.centre + self.reach

    @classmethod
    def of(cls, kind: str, found: Sequence[Sequence[float] | None], chance: FloatArray, window: int) -> _Reach:
        """From mean, standard deviation and number of windows, and the chance that a further one goes beyond."""
        mean, sd, count = np.array([f or (0.0, 1.0, 2.0) for f in found]).reshape(-1, 3).T
        centre, spread = white_days(kind, window)
        two_sided = kind == "dispersion"
        away = (mean - centre) * np.sqrt(count) / spread
        white = (np.abs(away) if two_sided else away) <= CHANCE
        white &= sd <= spread * (1 + CHANCE / np.sqrt(2 * (count - 1)))
        # The scale that spreads are told in is the baseline's own: as uncertain as their mean, and no steadier.
        unsteady = two_sided * (1 / count + np.square(STEADY) * (window - 1) / 2)
        known = norm.isf(chance) * spread * np.sqrt(1 + unsteady)
        own = student.isf(chance, count - 1) * sd * np.sqrt(1 + 1 / count)
        return cls(np.where(white, centre, mean), np.where(white, known, own))


@lru_cache
def white_days(kind: str, window: int) -> tuple[float, float]:
    """Mean and standard deviation of a test's statistic on windows of white noise, on the scale of the baselines."""
    match kind:
        case "autocorrelation":  # chi-square with LAGS degrees of freedom (Wilson and Hilferty 1931)
            root = float(np.cbrt(LAGS))
            return root * (1 - 2 / (9 * LAGS)), root * float(np.sqrt(2 / (9 * LAGS)))
        case "periodogram":  # Kolmogorov's distribution, by its quantiles
            quantiles = kstwo.ppf((np.arange(100) + 0.5) / 100, (window - 1) // 2 - 1)
            values = Periodogram(np.ones(1), window=window).straightened(quantiles)
            return float(values.mean()), float(values.std())
        case _:
            return 0.0, 1.0


def _carried(group: FilterGroup, component: Component) -> int:
    return len(KINDS) * sum(component.carries("health", q.symbol) for q in group.model.outputs)


def _used(component: Component, baseline: Baseline, arl: float) -> float:
    """Part of its outputs that a component's baseline is long enough to judge."""
    carried = [q.symbol for q in component.model.outputs if component.carries("health", q.symbol)]
    windows = [baseline.innovation.get(symbol, {}).get("windows", {}) for symbol in carried]
    return sum(bool(w.get("scale") == SCALE) for w in windows) / max(1, len(carried))


def _build(plan: Plan, groups: Sequence[FilterGroup], arl: dict[str, float]) -> list[HealthCharts]:
    return [HealthCharts(plan, groups, arl)]


HEALTH = FamilyKind(_carried, _build, SHARE, _used)
