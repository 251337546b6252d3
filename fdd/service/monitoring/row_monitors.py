"""Equipment of a site watched by rows of expectations, inside the engine: judged when a day of the site's zone closes.

Nothing has to be fitted: a day is judged from the first one on, by declared accuracies. What ``fdd fit`` learns from a
healthy history sharpens that, and nothing else does, so that a standing fault cannot become normal. A finding belongs
to the place of its likeliest cause; another place on the same equipment is another finding. Equipment that fails is
counted and goes on with the next day; the others do not notice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np

from fdd.diagnosis.equipment import Knowledge, Verdict, examine, judge_day, row_message
from fdd.evidence import STEADY, AlarmKind, Cause, ChartEvidence, ChartKind, Message
from fdd.models.expectation import Day
from fdd.records import NANOSECONDS, Alarm, Baseline, FloatArray, IntArray, JsonObject, Rows
from fdd.residual_monitors.chart import Phase
from fdd.service.alarms.book import Ring
from fdd.service.site.plan import Plan, RowEquipment

SAME = 0.2
"""Probability that an open finding's place must still have for a new day to be its own."""
OTHER = "other"
"""Where findings belong that no known fault explains."""
SEVERE = 3.0
"""How many times its limit evidence must be for a finding to be of high severity."""


@dataclass(frozen=True, slots=True)
class RowsDay:
    """What one piece of equipment's closed day gave; ``time`` is that of its last frame."""

    name: str
    time: int
    rows: list[Rows]
    rings: list[Ring]


class RowMonitors:
    """All equipment of a site that is watched by rows, by name."""

    def __init__(self, plan: Plan, baselines: Mapping[str, Baseline]) -> None:
        columns = {name: i for i, name in enumerate(plan.columns)}
        self._watched = {
            e.name: _Watched(e, baselines.get(e.baseline), columns, plan.step, plan.hold) for e in plan.equipment
        }
        self._day = _DayBuffer(len(plan.columns), plan.step, ZoneInfo(plan.zone)) if self._watched else None
        self._failed: dict[str, int] = {}
        self.notes: dict[str, str] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._watched

    def __iter__(self) -> Iterator[RowEquipment]:
        return (w.equipment for w in self._watched.values())

    def __len__(self) -> int:
        return len(self._watched)

    @property
    def counts(self) -> dict[str, int]:
        """How often each failed, by the kind of error."""
        return dict(self._failed)

    def step(self, time: int, values: FloatArray) -> list[RowsDay]:
        """Feed one frame, (n_columns,); returns the verdicts of the days that it closed, mostly none."""
        if self._day is None:
            return []
        closed = self._close() if self._day.is_over(time) else []
        self._day.add(time, values)
        return closed + (self._close() if self._day.is_complete() else [])

    def flush(self) -> list[RowsDay]:
        """The stream has ended: judge what there is of the day."""
        return self._close() if self._day is not None else []

    def _close(self) -> list[RowsDay]:
        assert self._day is not None
        taken = self._day.take()
        if taken is None:
            return []
        time, values = taken
        days = []
        for name, watched in self._watched.items():
            try:
                days.append(watched.judge(time, values))
            except Exception as error:  # one machine's odd data must not stop the others
                what = f"equipment failed: {name} ({type(error).__name__})"
                self._failed[what] = self._failed.get(what, 0) + 1
                self.notes[name] = f"{name}: {error}"
        return days

    def explain(self, alarm: Alarm) -> Alarm:
        """The alarm in the words of the day's verdict."""
        return self._watched[alarm.component].explain(alarm)

    def owns(self, alarm: Alarm) -> bool:
        """Whether an alarm is a finding of rows."""
        return alarm.component in self._watched and alarm.evidence.kind is AlarmKind.PLACE

    def is_normal(self, alarm: Alarm) -> bool:
        """Whether the last day that could be judged had nothing of this finding."""
        return self._watched[alarm.component].is_normal(alarm.evidence.place)

    def reset(self, alarm: Alarm) -> None:
        """An operator has cleared the alarm: what is still there rings anew with the next day."""
        self._watched[alarm.component].reset(alarm.evidence.place)

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {
            "day": None if self._day is None else self._day.export_state(),
            "equipment": {name: w.export_state() for name, w in self._watched.items()},
            "failed": dict(self._failed),
            "notes": dict(self.notes),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        if self._day is not None:
            self._day.restore_state(state["day"])
        for name, watched in self._watched.items():
            watched.restore_state(state["equipment"][name])
        self._failed, self.notes = dict(state["failed"]), dict(state["notes"])


class _DayBuffer:
    """The frames of the present day of the site's zone."""

    def __init__(self, columns: int, step: int, zone: ZoneInfo) -> None:
        self._columns, self._step, self._zone = columns, step, zone
        self._time: list[int] = []
        self._values: list[FloatArray] = []
        self._end = 0

    def is_over(self, time: int) -> bool:
        """Whether a frame at this time belongs to another day than those that are held."""
        return bool(self._time) and time >= self._end

    def is_complete(self) -> bool:
        """Whether no further frame belongs to the day."""
        return bool(self._time) and self._time[-1] + self._step >= self._end

    def add(self, time: int, values: FloatArray) -> None:
        """Take one frame."""
        if not self._time:
            self._end = midnight_after(time, self._zone)
        self._time.append(time)
        self._values.append(values.copy())

    def take(self) -> tuple[IntArray, FloatArray] | None:
        """Times [ns], (m,), and values, (m, n_columns), of the day; the buffer is empty then."""
        if not self._time:
            return None
        time, values = np.array(self._time, dtype=np.int64), np.array(self._values)
        self._time, self._values = [], []
        return time, values

    def export_state(self) -> JsonObject:
        """Plain data."""
        values = np.array(self._values).reshape(len(self._time), self._columns)
        return {"time": np.array(self._time, dtype=np.int64), "values": values, "end": self._end}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._time = np.asarray(state["time"]).astype(np.int64).tolist()
        self._values = list(np.asarray(state["values"], dtype=np.float64).reshape(len(self._time), self._columns))
        self._end = int(state["end"])


def midnight_after(time: int, zone: ZoneInfo) -> int:
    """The first midnight of a zone after a time [ns]."""
    local = datetime.fromtimestamp(time // NANOSECONDS, UTC).astimezone(zone)
    following = datetime(local.year, local.month, local.day, tzinfo=zone) + timedelta(days=1)
    return int(following.timestamp()) * NANOSECONDS


def day_of(
    equipment: RowEquipment, columns: Mapping[str, int], time: IntArray, values: FloatArray, step: int, hold: int
) -> Day:
    """A day's frames as a piece of equipment sees them: held values stand in, closed gates hide."""
    seconds = time / NANOSECONDS
    picked = {role: values[:, columns[point]] for role, point in equipment.inputs.items()}
    if hold:
        picked = {role: _held(time, x, hold) for role, x in picked.items()}
    if equipment.when is not None:
        open_ = values[:, columns[equipment.when]] > 0.5
        picked = {role: np.where(open_, x, np.nan) for role, x in picked.items()}
    return Day(seconds, picked, step / NANOSECONDS)


def _held(time: IntArray, x: FloatArray, hold: int) -> FloatArray:
    seen = np.isfinite(x)
    last = np.maximum.accumulate(np.where(seen, np.arange(len(x)), -1))
    usable = (last >= 0) & (time - time[np.maximum(last, 0)] <= hold)
    return np.where(usable, x[np.maximum(last, 0)], np.nan)


@dataclass(frozen=True, slots=True)
class _Told:
    """What the last day that rang said of a place."""

    charts: Mapping[str, ChartEvidence]
    causes: tuple[Cause, ...]

    def document(self) -> JsonObject:
        """Plain data."""
        return {
            "charts": {name: c.document() for name, c in self.charts.items()},
            "causes": [c.document() for c in self.causes],
        }

    @classmethod
    def read(cls, document: JsonObject) -> _Told:
        """What :meth:`document` wrote."""
        charts = {name: ChartEvidence.read(name, c) for name, c in document["charts"].items()}
        return cls(charts, tuple(Cause.read(c) for c in document["causes"]))


class _Watched:
    """One piece of equipment, and what is remembered of its findings."""

    def __init__(
        self, equipment: RowEquipment, baseline: Baseline | None, columns: Mapping[str, int], step: int, hold: int
    ) -> None:
        self.equipment, self._columns, self._step, self._hold = equipment, columns, step, hold
        self._version = 0 if baseline is None else baseline.version
        self._knowledge = Knowledge() if baseline is None else Knowledge.of(baseline.diagnostics["rows"])
        # A place stands in the alarm's key, which is a word.
        self._place_of = {f.name: f.place.replace(" ", "-") for f in equipment.model.faults}
        self.places = {*self._place_of.values(), OTHER}
        # What the last day that rang said, by place; and the places that rang on the last day that was judged.
        self._told: dict[str, _Told] = {}
        self._ringing: set[str] = set()

    def judge(self, time: IntArray, values: FloatArray) -> RowsDay:
        """The verdict of one day."""
        e = self.equipment
        day = day_of(e, self._columns, time, values, self._step, self._hold)
        verdict = judge_day(e.model, examine(e.model, day), self._knowledge, e.false_alarms_per_year, e.errors)
        now = int(time[-1])
        if not verdict.judged:
            return RowsDay(e.name, now, [], [])
        rings = []
        place = self._place(verdict)
        if place is not None:
            since = min((int(t.statistic.at * NANOSECONDS) for t in verdict.ringing), default=int(time[0]))
            told = self._tell(verdict)
            self._told[place] = told
            rings = [
                Ring(e.name, name, None, max(since, int(time[0])), chart, AlarmKind.PLACE, place)
                for name, chart in told.charts.items()
            ]
        self._ringing = set() if place is None else {place}
        return RowsDay(e.name, now, _chart_rows(e.name, now, verdict), rings)

    def _place(self, verdict: Verdict) -> str | None:
        """Where the day's finding belongs: an open one's place while that is plausible, else the likeliest."""
        if not verdict.rings:
            return None
        chance: dict[str, float] = {}
        for c in verdict.causes:
            place = self._place_of.get(c.name, OTHER)
            chance[place] = chance.get(place, 0.0) + c.probability
        open_ = [p for p in self._told if chance.get(p, 0.0) >= SAME]
        return max(open_ or chance, key=lambda p: chance[p])

    def _tell(self, verdict: Verdict) -> _Told:
        rows = {r.name: r for r in self.equipment.model.rows}
        charts = {
            f"{self.equipment.name}/{t.statistic.key}": ChartEvidence(
                t.statistic.row,
                ChartKind.ROW,
                t.ratio,
                direction=t.statistic.side,
                words=row_message(rows[t.statistic.row], t),
            )
            for t in verdict.ringing
        }
        if verdict.bank_ratio is not None and verdict.bank_ratio >= 1.0:
            charts[f"{self.equipment.name}/{STEADY}"] = ChartEvidence(
                STEADY, ChartKind.STEADY, verdict.bank_ratio, direction=1, words=Message.of("settled_day")
            )
        return _Told(charts, tuple(c.told() for c in verdict.causes))

    def explain(self, alarm: Alarm) -> Alarm:
        """The alarm with the causes and checks of the last day that rang."""
        told = self._told.get(alarm.evidence.place)
        if told is None:
            return alarm
        days = self._knowledge.days
        basis = Message.of("rows_learned", days=days) if days else Message.of("rows_declared")
        return replace(
            alarm,
            severity="high" if max(c.statistic for c in told.charts.values()) >= SEVERE else "medium",
            causes=told.causes,
            checks=tuple(dict.fromkeys(check for c in told.causes[:3] for check in c.checks)),
            evidence=replace(alarm.evidence, notes={"watched_by": basis}),
        )

    def is_normal(self, place: str) -> bool:
        """Whether the last day that was judged had nothing of this place."""
        return place not in self._ringing

    def reset(self, place: str) -> None:
        """The finding has been cleared."""
        self._told.pop(place, None)
        self._ringing.discard(place)

    def export_state(self) -> JsonObject:
        """Plain data."""
        told = {place: t.document() for place, t in self._told.items()}
        return {"version": self._version, "told": told, "ringing": sorted(self._ringing)}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood; what the plant did does not hang on the baseline's version."""
        self._told = {p: _Told.read(t) for p, t in state["told"].items()}
        self._ringing = set(state["ringing"])


def _chart_rows(name: str, time: int, verdict: Verdict) -> list[Rows]:
    """Every test of the day as a chart: its statistic in limits."""
    told = [(f"{name}/{t.statistic.key}", t.ratio, t.rings) for t in verdict.tests]
    if verdict.bank_ratio is not None:
        told.append((f"{name}/{STEADY}", verdict.bank_ratio, verdict.bank_ratio >= 1.0))
    phase = [int(Phase.ALARM if rings else Phase.QUIET) for _, _, rings in told]
    return [
        Rows(
            "charts",
            tuple(n for n, _, _ in told),
            np.arange(len(told), dtype=np.int32),
            np.full(len(told), time, dtype=np.int64),
            {
                "statistic": np.array([max(r, 0.0) for _, r, _ in told]),
                "limit": np.ones(len(told)),
                "phase": np.array(phase),
            },
        )
    ]
