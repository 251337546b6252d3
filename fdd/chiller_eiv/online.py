"""One chiller in the running service: samples in, steady points, daily and weekly verdicts out.

Functional core: no clock, no disk; everything follows from the samples' own times. Raw samples are gathered for a day
(UTC) and turned into steady points when the first sample of the next day arrives; weeks close the same way. The same
samples give the same verdicts in one batch or many, before or after a restart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import groupby

import numpy as np

from fdd.chiller_eiv.baseline import POWER, ChillerBaseline, learn_baseline
from fdd.chiller_eiv.checks import DailyChange, Finding, SensorCheck, check_balance, diagnose, diagnose_daily
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.cost import ExtraCost, extra_cost
from fdd.chiller_eiv.drift import WEEK, DriftMonitor, DriftVerdict
from fdd.chiller_eiv.errors import RAW_UNITS
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.power_residual import DAY, DailyMonitor, DailyVerdict, daily_medians
from fdd.chiller_eiv.steady_state import SteadyPoints, steady_points
from fdd.records import FloatArray, IntArray, JsonObject

SCHEMA = 2

RECENT_WEEKS = 8
"""Weeks of steady points kept for sensor checks and cost."""


@dataclass(frozen=True)
class ChillerOutputs:
    """What one closed day gave.

    Attributes
    ----------
    time : end of the day [ns]
    points : its steady points
    residual : relative power residual of each point; empty while the baseline is being learned
    rejected : raw samples by reason
    daily : verdict by series: the power residual and the approaches
    weekly : verdict of the parameter charts where a week ended with this day
    finding : words for what is in alarm: the parameter drift where there is one, otherwise the daily charts
    sensors : heat-balance check that goes with the finding
    cost : extra consumption over the last week, where any chart is in alarm
    learned : the baseline, on the day it was learned
    note : why there is no baseline yet, while there is none
    kept, seen : raw samples that became part of a point, and all of them, since the start
    """

    time: int
    points: SteadyPoints
    residual: FloatArray
    rejected: Mapping[str, int]
    daily: Mapping[str, DailyVerdict] = field(default_factory=dict)
    weekly: DriftVerdict | None = None
    finding: Finding | None = None
    sensors: SensorCheck | None = None
    cost: ExtraCost | None = None
    learned: ChillerBaseline | None = None
    note: str = ""
    kept: int = 0
    seen: int = 0

    @property
    def alarm(self) -> bool:
        """Whether any chart is in alarm."""
        return any(v.alarm for v in self.daily.values()) or (self.weekly is not None and self.weekly.alarm)


@dataclass
class ChillerMonitor:
    """Charts of one chiller.

    Parameters
    ----------
    config : its declaration
    baseline : where there is one; otherwise it is learned from the first ``config.baseline_days`` of samples
    """

    config: ChillerConfig
    baseline: ChillerBaseline | None = None

    def __post_init__(self) -> None:
        """Begin with nothing seen."""
        self._names = tuple(RAW_UNITS)
        self._rows: list[list[float]] = []
        self._times: list[int] = []
        self._settled = False
        self._first: int | None = None
        self._last: int | None = None
        self._points: list[SteadyPoints] = []
        self._hours: list[float] = []
        self._last_week = 0
        self._standing: Finding | None = None
        self._kept = 0
        self._seen = 0
        self._charts()

    def _charts(self) -> None:
        b, c = self.baseline, self.config
        self._daily: dict[str, DailyMonitor] = {}
        self._drift: DriftMonitor | None = None
        if b is None:
            return
        for name, reference in b.references.items():
            self._daily[name] = DailyMonitor(reference, c.residual_false_alarms, b.availability)
        if b.drift is not None:
            self._drift = DriftMonitor(b.drift, c.form(), c.drift)

    def update(self, time: int, values: Mapping[str, float]) -> tuple[ChillerOutputs, ...]:
        """Take one sample of every quantity.

        Parameters
        ----------
        time : event time [ns]; must not go back (the engine orders samples)
        values : raw quantities, names and units of ``errors.RAW_UNITS``; missing or NaN: nothing seen

        Returns
        -------
        The outputs of every day that this sample closed; mostly none
        """
        if self._last is not None and time <= self._last:
            raise ChillerError(
                f"chiller {self.config.name!r}: sample at {time} ns is not after the last one at {self._last} ns; "
                "order samples and drop duplicates before they come here"
            )
        out: tuple[ChillerOutputs, ...] = ()
        if self._times and time // DAY != self._times[0] // DAY:
            out = (self._close_day(),)
        if self._first is None:
            self._first = time
            self._last_week = time // WEEK
        self._last = time
        self._times.append(time)
        self._rows.append([float(values.get(k, np.nan)) for k in self._names])
        return out

    def finish(self) -> tuple[ChillerOutputs, ...]:
        """Close the last day at the end of a replay."""
        return (self._close_day(),) if self._times else ()

    def reset(self, baseline: ChillerBaseline | None = None) -> None:
        """Clear the alarms; with a new baseline after a repair."""
        if baseline is not None:
            self.baseline = baseline
            self._charts()
        for m in self._daily.values():
            m.reset()
        if self._drift is not None:
            self._drift.reset()
        self._standing = None

    def _close_day(self) -> ChillerOutputs:
        time = np.array(self._times, dtype=np.int64)
        table = np.array(self._rows)
        self._times, self._rows = [], []
        end = int(time[0] // DAY + 1) * DAY
        points, rejected, hours = self._steady(time, table)
        self._points = [*self._points, points]
        self._hours = [*self._hours, hours][-7:]
        self._kept += int(points.samples.sum())
        self._seen += len(time)
        if self.baseline is None:
            learned, note = self._learn(end)
            empty = np.zeros(0)
            return ChillerOutputs(
                end, points, empty, rejected, learned=learned, note=note, kept=self._kept, seen=self._seen
            )
        return self._watch(end, points, rejected)

    def _steady(self, time: IntArray, table: FloatArray) -> tuple[SteadyPoints, Mapping[str, int], float]:
        needed = self.config.instruments.needed()
        raw = {k: table[:, i] for i, k in enumerate(self._names) if k in needed or np.isfinite(table[:, i]).any()}
        on = ~(raw["power"] <= 0.01 * self.config.rated_load)
        points, report = steady_points(
            time,
            raw,
            self.config.instruments,
            rated_load=self.config.rated_load,
            limits=self.config.steady,
            running=on,
            settled=self._settled,
        )
        tail = time >= time[-1] - round(self.config.steady.settling * 1e9)
        self._settled = bool(on[tail].all() and tail.sum() > 1)
        return points, report.counts(), 24.0 * float(on.mean())

    def _learn(self, end: int) -> tuple[ChillerBaseline | None, str]:
        begin = 0 if self._first is None else self._first
        days = (end - begin) / DAY
        if days < self.config.baseline_days:
            return None, f"learning: {days:.0f} of {self.config.baseline_days:.0f} days"
        try:
            self.baseline, _ = learn_baseline(join(self._points), self.config)
        except ChillerError as e:
            return None, f"still learning: {e}"
        self._points = self._points[-7:]
        self._last_week = end // WEEK
        self._charts()
        return self.baseline, ""

    def _watch(self, end: int, points: SteadyPoints, rejected: Mapping[str, int]) -> ChillerOutputs:
        assert self.baseline is not None
        self._points = [p for p in self._points if len(p) and p.time[-1] > end - RECENT_WEEKS * WEEK]
        series = self.baseline.series(points, self.config) if len(points) else {}
        daily = {}
        for name, monitor in self._daily.items():
            _, medians = daily_medians(points.time, series[name]) if name in series else (None, np.zeros(0))
            daily[name] = monitor.update(end, float(medians[0]) if len(medians) else np.nan)
        weekly = self._close_weeks(end)
        finding, sensors = self._finding(end, weekly, daily)
        alarm = any(v.alarm for v in daily.values()) or (weekly is not None and weekly.alarm)
        cost = self._cost(end) if alarm else None
        return ChillerOutputs(
            end,
            points,
            series.get(POWER, np.zeros(0)),
            rejected,
            daily,
            weekly,
            finding,
            sensors,
            cost,
            kept=self._kept,
            seen=self._seen,
        )

    def _close_weeks(self, end: int) -> DriftVerdict | None:
        """Chart every week that ended since the last one charted; the verdict of the newest."""
        verdict = None
        for week in range(self._last_week + 1, end // WEEK + 1):
            self._last_week = week
            if self._drift is not None:
                verdict = self._chart_week(self._drift, week * WEEK)
        return verdict

    def _chart_week(self, drift: DriftMonitor, stop: int) -> DriftVerdict:
        week = join([p for p in self._points if len(p) and stop - WEEK < p.time[-1] <= stop])
        m = len(drift.form.measured)
        x, cov = np.zeros((0, m)), np.zeros((0, m, m))
        if len(week):
            x, cov = week.regressors(self.config.instruments, drift.form.measured)
        return drift.update(stop, x, cov)

    def _finding(
        self, end: int, weekly: DriftVerdict | None, daily: Mapping[str, DailyVerdict]
    ) -> tuple[Finding | None, SensorCheck | None]:
        """The parameter drift's words stand until the next week; without one, those of the daily charts."""
        alarmed = {k: v for k, v in daily.items() if v.alarm and v.onset is not None}
        if weekly is not None:
            self._standing = None
            if weekly.isolation is not None and weekly.onset is not None:
                sensors = self._balance_since(weekly.onset)
                sides = {k: self._mean_since(k, v) for k, v in alarmed.items() if k != POWER}
                self._standing = diagnose(weekly.isolation, _date(weekly.onset), sensors, sides)
                return self._standing, sensors
        if self._standing is not None:
            return self._standing, None
        if not alarmed:
            return None, None
        onset = min(int(v.onset or end) for v in alarmed.values())
        sensors = self._balance_since(onset)
        changes = tuple(DailyChange(k, self._mean_since(k, v), _date(int(v.onset or end))) for k, v in alarmed.items())
        return diagnose_daily(changes, POWER, sensors), sensors

    def _since(self, onset: int) -> SteadyPoints:
        return join([p for p in self._points if len(p) and p.time[-1] > onset])

    def _balance_since(self, onset: int) -> SensorCheck:
        assert self.baseline is not None
        return check_balance(self.baseline.balance, self._since(onset).balance)

    def _mean_since(self, series: str, verdict: DailyVerdict) -> float:
        """Median change of a series since its chart's onset, as far as points are kept."""
        assert self.baseline is not None
        points = self._since(int(verdict.onset or 0))
        change = self.baseline.series(points, self.config).get(series, np.zeros(0)) if len(points) else np.zeros(0)
        change = change[np.isfinite(change)]
        return float(np.median(change)) - self.baseline.references[series].mean if len(change) else verdict.value

    def _cost(self, end: int) -> ExtraCost | None:
        assert self.baseline is not None
        recent = [p for p in self._points if len(p) and p.time[-1] > end - WEEK]
        if not recent:
            return None
        power = self.baseline.power
        x, _ = join(recent).regressors(self.config.instruments, power.form.measured)
        reference = self.baseline.references[POWER]
        return extra_cost(
            power.form,
            power.machine,
            x,
            hours_a_day=float(np.mean(self._hours)),
            price=self.config.price,
            model_sd=reference.sd / np.sqrt(len(recent)),
        )

    def export_state(self) -> JsonObject:
        """Plain data: JSON scalars, lists and numpy arrays."""
        return {
            "schema": SCHEMA,
            "times": np.array(self._times, dtype=np.int64),
            "rows": np.array(self._rows).reshape(len(self._rows), len(self._names)),
            "settled": self._settled,
            "first": self._first,
            "last": self._last,
            "hours": list(self._hours),
            "points": export_points(self._points),
            "baseline": None if self.baseline is None else self.baseline.export_state(),
            "daily": {k: m.export_state() for k, m in self._daily.items()},
            "drift": None if self._drift is None else self._drift.export_state(),
            "last_week": self._last_week,
            "standing": None if self._standing is None else asdict(self._standing),
            "kept": self._kept,
            "seen": self._seen,
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where ``export_state`` was called.

        Raises
        ------
        ChillerError : state of another schema
        """
        if state.get("schema") != SCHEMA:
            raise ChillerError(
                f"chiller state has schema {state.get('schema')!r}, this version reads {SCHEMA}: start it anew"
            )
        self.baseline = None if state["baseline"] is None else ChillerBaseline.of_state(state["baseline"], self.config)
        self._charts()
        self._times = [int(t) for t in state["times"]]
        self._rows = [[float(v) for v in r] for r in np.asarray(state["rows"]).reshape(-1, len(self._names))]
        self._settled = bool(state["settled"])
        self._first = None if state["first"] is None else int(state["first"])
        self._last = None if state["last"] is None else int(state["last"])
        self._hours = [float(h) for h in state["hours"]]
        self._points = points_of_state(state["points"])
        for k, m in self._daily.items():
            m.restore_state(state["daily"][k])
        if self._drift is not None and state["drift"] is not None:
            self._drift.restore_state(state["drift"])
        self._last_week = int(state["last_week"])
        f = state["standing"]
        self._standing = None if f is None else Finding(**{**f, "checks": tuple(f["checks"])})
        self._kept, self._seen = int(state["kept"]), int(state["seen"])


def _date(time: int) -> str:
    return str(np.datetime64(time, "ns").astype("datetime64[D]"))


def join(parts: list[SteadyPoints]) -> SteadyPoints:
    """Points of several spans as one; quantities that not all have become NaN where missing."""
    filled = [p for p in parts if len(p)]
    if not filled:
        empty = np.zeros(0)
        return SteadyPoints(np.zeros(0, np.int64), np.zeros(0, np.int64), {k: empty for k in RAW_UNITS}, {}, empty)
    names = [k for k in RAW_UNITS if any(k in p.raw for p in filled)]

    def column(which: str, k: str) -> FloatArray:
        return np.concatenate([getattr(p, which).get(k, np.full(len(p), np.nan)) for p in filled])

    return SteadyPoints(
        np.concatenate([p.time for p in filled]),
        np.concatenate([p.samples for p in filled]),
        {k: column("raw", k) for k in names},
        {k: column("standard_error", k) for k in names},
        np.concatenate([p.balance for p in filled]),
    )


def export_points(parts: list[SteadyPoints]) -> list[JsonObject]:
    """Steady points as plain data; neighbours with the same quantities share arrays, so that a state stays small."""
    out = []
    for names, same in groupby(parts, key=lambda p: (tuple(p.raw), tuple(p.standard_error))):
        group = list(same)
        out.append(
            {
                "lengths": [len(p) for p in group],
                "raw_names": list(names[0]),
                "error_names": list(names[1]),
                "time": np.concatenate([p.time for p in group]),
                "samples": np.concatenate([p.samples for p in group]),
                "balance": np.concatenate([p.balance for p in group]),
                "raw": np.array([np.concatenate([p.raw[k] for p in group]) for k in names[0]]),
                "error": np.array([np.concatenate([p.standard_error[k] for p in group]) for k in names[1]]),
            }
        )
    return out


def points_of_state(state: list[JsonObject]) -> list[SteadyPoints]:
    """Steady points from plain data."""
    parts = []
    for g in state:
        ends = np.cumsum(g["lengths"])
        for start, stop in zip(ends - np.asarray(g["lengths"]), ends, strict=True):
            at = slice(int(start), int(stop))
            parts.append(
                SteadyPoints(
                    np.asarray(g["time"], dtype=np.int64)[at],
                    np.asarray(g["samples"], dtype=np.int64)[at],
                    {k: np.asarray(row, dtype=float)[at] for k, row in zip(g["raw_names"], g["raw"], strict=True)},
                    {k: np.asarray(row, dtype=float)[at] for k, row in zip(g["error_names"], g["error"], strict=True)},
                    np.asarray(g["balance"], dtype=float)[at],
                )
            )
    return parts
