"""The engine: samples in, verdicts out; no clock, no network, no disk.

The same samples give the same bytes of output, in one batch or many, live or replayed, before or after a restart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.cost import daily_cost, with_cost
from fdd.diagnosis.departure import Departure
from fdd.diagnosis.health import of_model, undiagnosed, with_frozen, without_frozen
from fdd.diagnosis.judged import judged_found
from fdd.diagnosis.ranking import diagnose
from fdd.evidence import AlarmKind, ChartEvidence, parts_of
from fdd.records import NANOSECONDS, Alarm, AlarmState, Baseline, Batch, FloatArray, JsonObject, Rows, concatenate
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import AlarmBook, Command, Ring, subject_of
from fdd.service.alarms.realised_rate import realised_rate
from fdd.service.engine.recent import Recent
from fdd.service.engine.trust import Trust
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.filtering.framing import Framer, Frames
from fdd.service.monitoring.charting import Charts, ChartStep
from fdd.service.monitoring.chillers import ChillerDay, Chillers
from fdd.service.monitoring.health_charts import KINDS as HEALTH_KINDS
from fdd.service.monitoring.row_monitors import RowMonitors, RowsDay
from fdd.service.site.plan import Chiller, Component, Plan, RowEquipment

SCHEMA = 12
DAY = 86400 * NANOSECONDS
REMEMBERED = 9 * DAY  # how long after its onset an alarm is diagnosed anew every day
_NONE = np.empty(0)  # what a site without filters concatenates


class EngineError(RuntimeError):
    """State that does not belong to this site; the text says which part and what to do."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """What a step gave: rows for the store, alarms that are new or have changed, and the frames that were closed."""

    rows: list[Rows] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)
    frames: int = 0


class Engine:
    """One site's filters, chillers, charts and alarms; what has no baseline is left out."""

    def __init__(self, plan: Plan, baselines: Mapping[str, Baseline]) -> None:
        self.plan = plan = plan.following(baselines)
        self._baselines = {name: b for name, b in baselines.items() if name in plan.baseline_names}
        self._framer = Framer(plan.points, plan.step, plan.lateness, plan.max_jump)
        self._groups = _group(plan, baselines)
        self._charts = Charts(plan, self._groups)
        self._chillers = Chillers(plan, baselines)
        self._rows = RowMonitors(plan, baselines)
        self._recent = Recent(self._groups, plan.columns)
        self._trust = Trust()
        reads = {c.name: frozenset(c.inputs) for c in plan.components}
        reads |= {c.name: frozenset(c.inputs.values()) for c in plan.chillers}
        reads |= {e.name: frozenset(e.inputs.values()) for e in plan.equipment}
        upstream = {e.name: e.upstream for e in plan.equipment} | {c.name: c.upstream for c in plan.watched}
        self.alarms = AlarmBook(reads, upstream)
        self._components = {c.name: c for c in plan.components}
        self._group_of = {c.name: g for g in self._groups for c in g.components}
        self._outputs = tuple(
            f"{c.name}/{q.symbol}" for g in self._groups for c in g.components for q in g.model.outputs
        )
        # A site of chillers alone has no such charts, and is watched all the time; one that only records is not.
        self._idle = float(len(self.watched) > 0)
        self._time: int | None = None
        # Frames in which charts could judge, each counted by their share; a score chart that learns may ring, too.
        self._judged = 0.0
        self._undiagnosed: dict[str, int] = {}

    @property
    def watched(self) -> list[Component | Chiller | RowEquipment]:
        """Components and chillers that have a baseline, and equipment watched by rows alone, in the engine's order."""
        fitted = [*(c for g in self._groups for c in g.components), *self._chillers]
        return [*fitted, *(e for e in self._rows if e.name not in {c.name for c in fitted})]

    @property
    def counts(self) -> dict[str, int]:
        """What became of the samples, how often filters were started afresh and chillers failed, by reason."""
        restarts: dict[str, int] = {}
        for g in self._groups:
            for reason, n in g.restarts.items():
                restarts[f"restart: {reason}"] = restarts.get(f"restart: {reason}", 0) + n
        failed = {**self._chillers.counts, **self._rows.counts, **self._undiagnosed}
        return {**self._framer.counts, **restarts, **failed}

    @property
    def phases(self) -> dict[str, int]:
        """How many charts of filters are in each phase."""
        return self._charts.phases

    def blind(self, since: int) -> tuple[str, ...]:
        """Components that should run, and whose filters have not for so long [ns] of event time."""
        if self._time is None:
            return ()
        return tuple(name for g in self._groups for name in g.idle(self._time - since))

    @property
    def realised_rate(self) -> JsonObject:
        """What was kept of the budget of false alarms; see :func:`fdd.service.alarms.realised_rate.realised_rate`."""
        seconds = self._judged * self.plan.step / NANOSECONDS
        return realised_rate(self.alarms.tally, self.alarms.open, seconds, self.plan.false_alarms_per_year)

    @property
    def promised(self) -> dict[tuple[str, str], float]:
        """False alarms a year that each component, and each kind of its charts, may give; rows and chillers as one."""
        rows = {(e.name, "rows"): e.false_alarms_per_year for e in self._rows}
        left = self.plan.apart_per_year - sum(rows.values())
        chillers = {(c.name, "chiller"): left / len(self.plan.chillers) for c in self._chillers}
        return {**self._charts.promised, **chillers, **rows}

    @property
    def trust(self) -> JsonObject:
        """By component: days closed and judged since its baseline came in force, in words how it stands, its power.

        ``state`` is ``calibrating`` (only gross faults ring), ``watching``, ``outside`` (yesterday was unlike all days
        seen: not judged), or ``void`` (it rang too often to be believed; ``reason`` says how often).
        """
        found: JsonObject = {}
        promised, power, standing = self._promised_of_plant(), self._charts.foretold(), self._charts.standing()
        for name, (closed, judged) in self._charts.days().items():
            calibrating, inside = standing[name]
            why = self._trust.void(name, judged, promised[name])
            state = "calibrating" if calibrating else "void" if why else "watching" if inside else "outside"
            foretold = [f.document() for f in power.get(name, ())]
            found[name] = {"state": state, "reason": why, "days": closed, "judged": judged, "foretold": foretold}
        return found

    @property
    def baselines(self) -> Mapping[str, Baseline]:
        """The baselines that components and chillers run on."""
        return self._baselines

    @property
    def notes(self) -> list[str]:
        """The last failure of each chiller, and of each piece of equipment watched by rows, in words."""
        return [*self._chillers.notes.values(), *self._rows.notes.values()]

    @property
    def time(self) -> int | None:
        """Event time of the last closed frame [ns]."""
        return self._time

    def step(self, batch: Batch) -> Outputs:
        """Take samples in; return what the frames that they closed gave."""
        return self._run(self._framer.add(batch))

    def flush(self) -> Outputs:
        """The stream has ended: close the frames that are open, and the day."""
        ended = self._run(self._framer.flush())
        days = self._rows.flush()
        alarms = self._findings(days)
        rows = concatenate([r for d in days for r in d.rows])
        return Outputs([*ended.rows, *(r for r in rows if len(r))], [*ended.alarms, *alarms], ended.frames)

    def command(self, command: Command) -> Outputs:
        """Carry out an operator's command at the engine's present event time.

        Raises
        ------
        AlarmError
            The alarm is not open, or its state does not allow the action.
        """
        now = command.time if self._time is None else self._time
        changed = self.alarms.command(command, now)
        if command.action == "clear":
            self._reset(changed[0])
            if judged_found(changed[0]):
                self._trust.found(changed[0].component)
        return Outputs(alarms=changed)

    def _reset(self, alarm: Alarm) -> None:
        if self._rows.owns(alarm):
            self._rows.reset(alarm)
        elif alarm.component in self._chillers:
            self._chillers.reset(alarm.component)
        else:
            self._charts.reset(alarm.component, alarm.evidence.kind)
            self._recent.forget(alarm.component)

    @property
    def versions(self) -> dict[str, int]:
        """The version of the baseline that each component or chiller runs on."""
        return {name: b.version for name, b in self._baselines.items()}

    def rebase(self, baselines: Mapping[str, Baseline]) -> None:
        """Put new baselines under what is running, between two frames and without missing one.

        Raises
        ------
        EngineError
            A baseline is of something that is not watched, or of another model than the site's.
        """
        running = {c.name: c for g in self._groups for c in g.components}
        models = {name: c.model.name for name, c in running.items()}
        for name, b in baselines.items():
            if name not in self._baselines:
                raise EngineError(f"{name} is not watched; restart the service with --fresh to take it up")
            if models.get(name, b.model) != b.model:
                raise EngineError(
                    f"baseline version {b.version} of {name} is of model {b.model}, the site says {models[name]}; "
                    "fit it anew"
                )
            if name in running and running[name].following(b) is not running[name]:
                raise EngineError(
                    f"baseline version {b.version} of {name} is of another variant of {b.model} than the one that runs "
                    f"({b.options}); restart the service with --fresh to take it up"
                )
        self._baselines |= baselines
        rebased = {name for g in self._groups for name in g.rebase(baselines)}
        self._charts.rebase(rebased)
        for name in rebased:
            self._trust.forget(name)
            self._recent.forget(name)
        if any(e.baseline in baselines for e in self._rows):
            kept = self._rows.export_state()
            self._rows = RowMonitors(self.plan, self._baselines)
            self._rows.restore_state(kept)
        if any(name in self._chillers for name in baselines):
            state = self._chillers.export_state()
            self._chillers = Chillers(self.plan, self._baselines)
            self._chillers.restore_state(state)

    def turn_back(self, time: int) -> None:
        """Set event time back to ``time`` [ns], after a clock was wrong: filters start afresh, charts and alarms stand.

        Frames after ``time`` may come again; what they give takes the place of what they gave.
        """
        self._framer.turn_back(time)
        for g in self._groups:
            g.restart()
            for c in g.components:
                self._recent.forget(c.name)
        self._chillers = Chillers(self.plan, self._baselines)
        if self._time is not None:
            self._time = min(self._time, time)

    def departure(self, component: str, since: int, until: int) -> Departure:
        """How a component has departed from its baseline since an onset, both in ns; ten days are remembered."""
        return self._recent.departure(component, since, until)

    def _run(self, frames: Frames) -> Outputs:
        if len(frames) == 0:
            return Outputs()
        values = self.plan.derive(frames.values)
        steps: list[list[GroupStep]] = []
        charted: list[ChartStep] = []
        days: list[Rows] = []
        alarms: list[Alarm] = []
        for time, row in zip(frames.time.tolist(), values, strict=True):
            group_steps = [g.step(time, row) for g in self._groups]
            self._recent.update(time, row, group_steps)
            chart_step = self._charts.update(group_steps)
            # A site of chillers alone has no such charts, and is watched all the time.
            phase = chart_step.verdicts.phase
            self._judged += float(np.mean(phase > Phase.NO_DATA)) if phase.size else self._idle
            closed = self._chillers.step(time, row)
            judged = self._rows.step(time, row)
            alarms += self._findings(judged)
            alarms += self._alarm(time, chart_step, closed)
            days += [rows for day in closed for rows in day.rows] + [rows for day in judged for rows in day.rows]
            steps.append(group_steps)
            charted.append(chart_step)
            if self._time is not None and time // DAY > self._time // DAY:
                days.append(self._parameter_rows(time))
                alarms += self._revisited(time)
            self._time = time
        rows = [
            self._sample_rows(frames, values),
            self._prediction_rows(frames, steps),
            self._chart_rows(frames, charted),
        ]
        return Outputs([r for r in (*rows, *concatenate(days)) if len(r)], alarms, len(frames))

    def _alarm(self, time: int, step: ChartStep, chillers: Sequence[ChillerDay]) -> list[Alarm]:
        rings = [self._ring(time, int(i), step) for i in step.rang] + [r for day in chillers for r in day.rings]
        rings = [r for ring in rings if (r := self._believed(ring)) is not None]
        changed = self.alarms.ring(time, rings) if rings else []
        for new in changed:
            if (
                new.component in self._group_of
                and new.evidence.kind is AlarmKind.PLANT
                and new.raised == time == new.updated
            ):
                self._trust.add(new.component)
        changed += [a for day in chillers if day.retold and (a := self.alarms.of(day.name))]
        if self.alarms.open:
            quiet = [subject_of(a) for a in self.alarms.open if self._is_normal(a, step)]
            changed += self.alarms.review(time, quiet)
        # An alarm that changed more than once in a frame is told as it now is.
        return [self._diagnosed(alarm) for alarm in {subject_of(a): a for a in changed}.values()]

    def _believed(self, ring: Ring) -> Ring | None:
        """A ring, or none where the component has rung too often to be believed."""
        name = ring.component
        if name not in self._group_of or not Trust.may_be_doubted(ring) or self.alarms.of(name):
            return ring
        _, judged = self._charts.days().get(name, (0, 0))
        why = self._trust.void(name, judged, self._promised_of_plant().get(name, 0.0), more=1)
        if not why:
            return ring
        self._charts.reset(name)
        self._trust.add(name)
        return None

    def _promised_of_plant(self) -> dict[str, float]:
        """False alarms a year that each component's charts of the plant may give."""
        found: dict[str, float] = {}
        for (component, kind), rate in self.promised.items():
            if kind not in HEALTH_KINDS:
                found[component] = found.get(component, 0.0) + rate
        return found

    def _findings(self, days: Sequence[RowsDay]) -> list[Alarm]:
        """What the verdicts of closed days make of the alarms, at the time of each day's last frame."""
        changed = [a for day in days if day.rings for a in self.alarms.ring(day.time, day.rings)]
        return [self._diagnosed(alarm) for alarm in {subject_of(a): a for a in changed}.values()]

    def _ring(self, time: int, i: int, step: ChartStep) -> Ring:
        stream = self._charts.streams[i]
        v = step.verdicts
        evidence = ChartEvidence(
            stream.symbol,
            parts_of(stream.name)[1],
            float(v.statistic[i]),
            float(v.limit[i]),
            int(v.direction[i]),
            **self._charts.estimate(i, int(v.onset_age[i])),
        )
        # A chart cannot have seen anything before its component was last started.
        judged = self._group_of[stream.component].judged_since(stream.component)
        since = max(time - int(v.onset_age[i]) * self.plan.step, judged)
        return Ring(stream.component, stream.name, stream.point, since, evidence, stream.alarm)

    def _is_normal(self, alarm: Alarm, step: ChartStep) -> bool:
        if self._rows.owns(alarm):
            return self._rows.is_normal(alarm)
        if alarm.component in self._chillers:
            return self._chillers.is_normal(alarm.component)
        return self._charts.is_normal(subject_of(alarm), step)

    def _revisited(self, time: int) -> list[Alarm]:
        """Once a day: what the days since the onset say of alarms that stand, while their onset is remembered."""
        return [
            self._diagnosed(replace(a, updated=time))
            for a in self.alarms.open
            if a.state is not AlarmState.RETURNED and self._is_revisited(a) and time - a.since < REMEMBERED
        ]

    def _is_revisited(self, alarm: Alarm) -> bool:
        """Whether days since the onset may tell more than its own day did: of filters alone."""
        return alarm.component in self._components and not self._rows.owns(alarm)

    def _diagnosed(self, alarm: Alarm) -> Alarm:
        """The alarm with its causes; a diagnosis that fails is counted and said, and never loses the alarm."""
        try:
            alarm = self._explained(replace(alarm, evidence=replace(alarm.evidence, not_diagnosed=None)))
        except Exception as error:  # whatever went wrong in explaining, the plant's alarm goes out
            what = f"not diagnosed: {alarm.component} ({type(error).__name__})"
            self._undiagnosed[what] = self._undiagnosed.get(what, 0) + 1
            alarm = undiagnosed(alarm, error)
        if self.alarms.of(subject_of(alarm)):
            self.alarms.annotate(alarm)
        return alarm

    def _explained(self, alarm: Alarm) -> Alarm:
        if self._rows.owns(alarm):
            alarm = self._rows.explain(alarm)
        elif alarm.component in self._chillers:
            alarm = self._chillers.explain(alarm)
        elif alarm.evidence.kind is AlarmKind.MODEL:
            alarm = of_model(alarm)
        else:
            model = self._components[alarm.component].model
            departure = self._recent.departure(alarm.component, alarm.since, alarm.updated)
            finding = diagnose(model, without_frozen(alarm), departure)
            operation = self._recent.operation(alarm.component, alarm.updated)
            cost = daily_cost(model, departure, operation, finding.causes, self.plan.tariffs)
            alarm = replace(
                alarm,
                evidence=replace(alarm.evidence, departure=departure.document(), cost=cost),
                severity=with_cost(finding.severity, cost, self.plan.tariffs),
                causes=finding.causes,
                checks=finding.checks,
            )
            alarm = with_frozen(alarm)
        return alarm

    def _sample_rows(self, frames: Frames, values: FloatArray) -> Rows:
        mask = np.isfinite(values)
        return _rows("samples", self.plan.columns, frames, mask, {"value": values})

    def _prediction_rows(self, frames: Frames, steps: Sequence[Sequence[GroupStep]]) -> Rows:
        def flat(name: str) -> FloatArray:
            return np.stack([np.concatenate([_NONE, *(getattr(s, name).ravel() for s in row)]) for row in steps])

        def running_of(row: Sequence[GroupStep]) -> list[NDArray[np.bool_]]:
            return [np.repeat(s.running, s.predicted.shape[1]) for s in row]

        running = np.stack([np.concatenate([_NONE.astype(bool), *running_of(row)]) for row in steps])
        fields = {
            "measured": flat("measured"),
            "predicted": flat("predicted"),
            "sd": flat("sd"),
            "innovation": flat("standardised"),
        }
        return _rows("predictions", self._outputs, frames, running & np.isfinite(fields["predicted"]), fields)

    def _chart_rows(self, frames: Frames, steps: Sequence[ChartStep]) -> Rows:
        fields: dict[str, NDArray[Any]] = {
            "statistic": np.stack([s.verdicts.statistic for s in steps]),
            "limit": np.stack([s.verdicts.limit for s in steps]),
            "phase": np.stack([s.verdicts.phase for s in steps]),
        }
        names = tuple(s.name for s in self._charts.streams)
        return _rows("charts", names, frames, np.ones((len(frames), len(names)), dtype=np.bool_), fields)

    def _parameter_rows(self, time: int) -> Rows:
        """Once a day: what the last day says of the physical parameters."""
        found = self._charts.parameters(DAY // self.plan.step)
        return Rows(
            measurement="parameters",
            names=tuple(name for name, *_ in found),
            series=np.arange(len(found), dtype=np.int32),
            time=np.full(len(found), time, dtype=np.int64),
            fields={
                "value": np.array([value for _, value, _, _ in found]),
                "lower": np.array([low for _, _, low, _ in found]),
                "upper": np.array([high for _, _, _, high in found]),
            },
        )

    def export_state(self) -> JsonObject:
        """The whole engine as plain data."""
        return {
            "schema": SCHEMA,
            "time": self._time,
            "judged": self._judged,
            "undiagnosed": dict(self._undiagnosed),
            "baselines": [{f: getattr(b, f) for f in Baseline.__slots__} for b in self._baselines.values()],
            "framer": self._framer.export_state(),
            "groups": [g.export_state() for g in self._groups],
            "charts": self._charts.export_state(),
            "chillers": self._chillers.export_state(),
            "rows": self._rows.export_state(),
            "recent": self._recent.export_state(),
            "trust": self._trust.export_state(),
            "alarms": self.alarms.export_state(),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood.

        Raises
        ------
        EngineError
            The state is of another version, or of a site with other equipment.
        """
        if state["schema"] != SCHEMA:
            raise EngineError(f"engine state has schema {state['schema']}, this version reads {SCHEMA}; start afresh")
        fitted = [*(name for g in state["groups"] for name in g["components"]), *state["chillers"]["chillers"]]
        saved = [*fitted, *(name for name in state["rows"]["equipment"] if name not in fitted)]
        here = [c.name for c in self.watched]
        if saved != here and set(saved) < set(here):
            self._continue_with_more(state)
            return
        if saved != here:
            raise EngineError(
                f"engine state is of the components {', '.join(saved)}; the site has {', '.join(here)}; "
                "start afresh with --fresh"
            )
        saved_baselines = {d["component"]: Baseline(**d) for d in state["baselines"]}
        self.rebase({n: b for n, b in saved_baselines.items() if b.version != self._baselines[n].version})
        self._time, self._judged = state["time"], state["judged"]
        self._undiagnosed = dict(state["undiagnosed"])
        self._framer.restore_state(state["framer"])
        for group, saved_group in zip(self._groups, state["groups"], strict=True):
            group.restore_state(saved_group)
        self._charts.restore_state(state["charts"])
        self._recent.restore_state(state["recent"])
        self._trust.restore_state(state["trust"])
        self._chillers.restore_state(state["chillers"])
        self._rows.restore_state(state["rows"])
        self.alarms.restore_state(state["alarms"])

    def _continue_with_more(self, state: JsonObject) -> None:
        """Equipment has got its first baseline: time, open frames and alarms go on, all filters and charts start."""
        self._time, self._judged = state["time"], state["judged"]
        self._undiagnosed = dict(state["undiagnosed"])
        self._framer.restore_state(state["framer"])
        self.alarms.restore_state(state["alarms"])


def _group(plan: Plan, baselines: Mapping[str, Baseline]) -> list[FilterGroup]:
    """One group for each model with its options; components keep the order of the site file within it."""
    groups: dict[str, list[Component]] = {}
    for c in plan.components:
        if c.name in baselines:
            groups.setdefault(f"{c.model.name} {sorted(c.model.options.items())}", []).append(c)
    return [
        FilterGroup(members, baselines, plan.columns, hold=plan.hold, max_gap=plan.max_gap)
        for members in groups.values()
    ]


def _rows(
    measurement: str,
    names: tuple[str, ...],
    frames: Frames,
    mask: NDArray[np.bool_],
    fields: Mapping[str, NDArray[Any]],
) -> Rows:
    """Rows from matrices (frames, series), where ``mask`` is true."""
    at, series = np.nonzero(mask)
    return Rows(
        measurement=measurement,
        names=names,
        series=series.astype(np.int32),
        time=frames.time[at],
        fields={name: matrix[at, series] for name, matrix in fields.items()},
    )
