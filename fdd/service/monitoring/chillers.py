"""The chillers of a site inside the engine: fed with each frame, judged as its
steady states and weeks close.

A chiller runs on the baseline that ``fdd fit`` has put in force and never learns by itself, so that a standing fault
cannot become normal. One that fails is counted and goes on with the next sample; the others do not notice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fdd.chiller_eiv.baseline import ChillerBaseline
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.online import ChillerMonitor, ChillerOutputs
from fdd.chiller_eiv.rows import baseline_rows, output_rows, state_chart, weekly_chart
from fdd.diagnosis.chiller import ChillerFinding, chiller_finding
from fdd.diagnosis.cost import Tariffs, with_cost
from fdd.diagnosis.ranking import severity
from fdd.evidence import ChartEvidence, ChartKind
from fdd.records import Alarm, Baseline, FloatArray, JsonObject, Rows
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import Ring
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Chiller, Plan

NEVER = np.iinfo(np.int64).min
# A statistic below this share of its limit says that what raised the alarm is gone (hysteresis).
NORMAL = 0.25


@dataclass(frozen=True, slots=True)
class ChillerDay:
    """What a chiller's closed hour gave; ``retold`` where an open alarm's words have changed."""

    name: str
    rows: list[Rows]
    rings: list[Ring]
    retold: bool


class Chillers:
    """All chillers of a site that have a baseline, by name."""

    def __init__(self, plan: Plan, baselines: Mapping[str, Baseline]) -> None:
        columns = {name: i for i, name in enumerate(plan.columns)}
        self._watched = {
            c.name: _Watched(c, baselines[c.name], columns, plan.hold, plan.tariffs)
            for c in plan.chillers
            if c.name in baselines
        }
        self._failed: dict[str, int] = {}
        self.notes: dict[str, str] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._watched

    def __iter__(self) -> Iterator[Chiller]:
        return (w.chiller for w in self._watched.values())

    @property
    def counts(self) -> dict[str, int]:
        """How often each chiller failed, by the kind of error."""
        return dict(self._failed)

    def step(self, time: int, values: FloatArray) -> list[ChillerDay]:
        """Feed one frame, shape (n_columns,); returns the days that it closed, mostly none."""
        days = []
        for name, watched in self._watched.items():
            try:
                days += watched.step(time, values)
            except Exception as error:  # one machine's odd data must not stop the others
                what = f"chiller failed: {name} ({type(error).__name__})"
                self._failed[what] = self._failed.get(what, 0) + 1
                self.notes[name] = f"{name}: {error}"
        return days

    def explain(self, alarm: Alarm) -> Alarm:
        """The alarm with the finding's words, causes, checks and cost."""
        return self._watched[alarm.component].explain(alarm)

    def is_normal(self, name: str) -> bool:
        """Whether the evidence of every chart that rang is gone."""
        return self._watched[name].is_normal()

    def reset(self, name: str) -> None:
        """An operator has cleared the chiller's alarm."""
        self._watched[name].reset()

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {
            "chillers": {name: w.export_state() for name, w in self._watched.items()},
            "failed": dict(self._failed),
            "notes": dict(self.notes),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood; a chiller whose baseline is another since then starts its charts
        afresh."""
        for name, watched in self._watched.items():
            watched.restore_state(state["chillers"][name])
        self._failed, self.notes = dict(state["failed"]), dict(state["notes"])


class _Watched:
    """One chiller: its monitor, and what the engine remembers around it."""

    def __init__(
        self, chiller: Chiller, baseline: Baseline, columns: Mapping[str, int], hold: int, tariffs: Tariffs
    ) -> None:
        self.chiller, self._tariffs = chiller, tariffs
        self._version = baseline.version
        self._monitor = ChillerMonitor(chiller.config, chiller_baseline(chiller, baseline))
        self._quantities = tuple(chiller.inputs)
        self._columns = np.array([columns[p] for p in chiller.inputs.values()], dtype=np.int64)
        self._gate = columns[chiller.when] if chiller.when else -1
        self._hold = hold
        self._held = np.full(len(self._columns), np.nan)
        self._held_at = np.full(len(self._columns), NEVER, dtype=np.int64)
        self._ratios: dict[str, float] = {}
        self._told: ChillerFinding | None = None
        self._introduced = False

    def step(self, time: int, values: FloatArray) -> list[ChillerDay]:
        """Feed one frame."""
        seen = values[self._columns]
        fresh = np.isfinite(seen)
        self._held = np.where(fresh, seen, self._held)
        self._held_at = np.where(fresh, time, self._held_at)
        usable = np.where(self._held_at >= time - self._hold, self._held, np.nan)
        sample = dict(zip(self._quantities, usable.tolist(), strict=True))
        if self._gate >= 0 and not values[self._gate] > 0.5:
            sample["power"] = 0.0  # may not be judged: as if the machine were off
        return [self._close(time, outputs) for outputs in self._monitor.update(time, sample)]

    def _close(self, time: int, outputs: ChillerOutputs) -> ChillerDay:
        rings = self._rings(outputs)
        told = chiller_finding(outputs, self.chiller.config.currency)
        # Figures change a little with every cluster; a week's verdict or another cause is news.
        news = outputs.weekly is not None or _cause(told) != _cause(self._told)
        if told is not None and (rings or news):
            self._told = told
        rows = output_rows(self._monitor, outputs, self._version)
        if not self._introduced:
            # The store learns the baseline's parameters with the first hour, for the dashboard.
            rows += baseline_rows(self._monitor, outputs.time, self._version)
            self._introduced = True
        return ChillerDay(self.chiller.name, rows, rings, told is not None and news)

    def _rings(self, outputs: ChillerOutputs) -> list[Ring]:
        rings = []
        for chart, since, evidence in _verdicts(self.chiller.name, outputs):
            ratio = evidence.statistic / evidence.limit
            before = self._ratios.get(chart)
            if before is None or (before < NORMAL <= 1.0 <= ratio):
                rings.append(Ring(self.chiller.name, chart, None, since, evidence))
            self._ratios[chart] = ratio
        return rings

    def explain(self, alarm: Alarm) -> Alarm:
        """The alarm with the finding's causes, checks and cost."""
        if self._told is None:
            return alarm
        told = self._told
        grade = severity(list(alarm.evidence.charts.values()))
        return replace(
            alarm,
            severity=grade if told.cost is None else with_cost(grade, told.cost, self._tariffs),
            causes=told.causes,
            checks=told.causes[0].checks,
            evidence=replace(
                alarm.evidence,
                cost=told.cost or alarm.evidence.cost,
                notes=told.notes or alarm.evidence.notes,
            ),
        )

    def is_normal(self) -> bool:
        """Whether every chart that rang has come back."""
        return all(ratio < NORMAL for ratio in self._ratios.values())

    def reset(self) -> None:
        """Start the charts again."""
        self._monitor.reset()
        self._ratios, self._told = {}, None

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {
            "version": self._version,
            "monitor": self._monitor.export_state(),
            "held": self._held.copy(),
            "held_at": self._held_at.copy(),
            "ratios": dict(self._ratios),
            "told": None if self._told is None else self._told.document(),
            "introduced": self._introduced,
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._held = np.array(state["held"], dtype=np.float64)
        self._held_at = np.array(state["held_at"], dtype=np.int64)
        if state["version"] != self._version:
            return  # another baseline: its charts start afresh
        self._monitor.restore_state(state["monitor"])
        self._ratios = dict(state["ratios"])
        self._told = None if state["told"] is None else ChillerFinding.read(state["told"])
        self._introduced = bool(state["introduced"])


def chiller_baseline(chiller: Chiller, baseline: Baseline) -> ChillerBaseline:
    """What a chiller is compared with, from the document that ``fdd fit`` stored.

    Raises
    ------
    UsageError : the document is another model's, or does not fit the chiller's declaration any more
    """
    try:
        return ChillerBaseline.of_state(baseline.diagnostics["chiller"], chiller.config)
    except (KeyError, ChillerError) as error:
        raise UsageError(
            f"baseline version {baseline.version} of {chiller.name} cannot be used ({error}); "
            f"fit it anew: fdd fit SITE DATA --only {chiller.name}"
        ) from None


def _cause(told: ChillerFinding | None) -> str:
    return told.causes[0].name if told else ""


def _verdicts(name: str, outputs: ChillerOutputs) -> Sequence[tuple[str, int, ChartEvidence]]:
    """Every chart in alarm: its name, the estimated onset [ns] and the numbers behind it."""
    found = []
    for v in outputs.states:
        if v.finding is not None:
            numbers = ChartEvidence("all", ChartKind.CLUSTER, v.statistic, v.limit)
            found.append((state_chart(name), v.finding.onset, numbers))
    w = outputs.weekly
    if w is None:
        return found
    for i, p in enumerate(w.parameters):
        if w.phase[i] == Phase.ALARM:
            numbers = ChartEvidence(p, ChartKind.WEEKLY, float(w.statistic[i]), float(w.limit[i]))
            if w.isolation is not None and w.isolation.parameter == p:
                error = (w.isolation.high - w.isolation.low) / (2 * 1.96)
                numbers = replace(numbers, change=w.isolation.change, standard_error=abs(error), scale="relative")
            found.append((weekly_chart(name, p), w.onset or outputs.time, numbers))
    return found
