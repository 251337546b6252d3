"""One chiller in the running service: samples in, steady points, verdicts of steady states and of weeks out.

Functional core: no clock, no disk; everything follows from the samples' own times. Samples are gathered for an hour and
turned into steady points when the first sample of the next hour arrives; clusters of points are judged as they end,
days and weeks (UTC) close the same way. The same samples give the same verdicts in one batch or many, before or after a
restart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import groupby

import numpy as np

from fdd.chiller_eiv.baseline import ChillerBaseline, with_load
from fdd.chiller_eiv.checks import Finding, SensorCheck, check_balance, describe, diagnose, drift_words
from fdd.chiller_eiv.clusters import HOUR, Clustering, point_rows
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.cost import ExtraCost, extra_cost
from fdd.chiller_eiv.drift import WEEK, DriftMonitor, DriftVerdict, Isolation
from fdd.chiller_eiv.errors import RAW_UNITS
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.steady_state import SteadyPoints, SteadyStream
from fdd.chiller_eiv.vector import DAY
from fdd.chiller_eiv.watch import VectorMonitor, VectorVerdict
from fdd.records import FloatArray, JsonObject

SCHEMA = 3

RECENT_WEEKS = 8
"""Weeks of steady points kept for sensor checks and cost."""


@dataclass(frozen=True)
class ChillerOutputs:
    """What one closed hour gave.

    Attributes
    ----------
    time : end of the hour [ns]
    points : its steady points
    expected : power that the healthy machine takes at each [W], shape (n,); NaN outside what was trained
    rejected : samples by reason, those that may still become part of a point left out
    states : verdicts of the clusters that ended
    weekly : verdict of the parameter charts where a week ended with this hour
    alarm : whether any chart is in alarm
    since : onset of what is in alarm [ns], where a cluster or a week has ended
    finding : words for it: of the steady states where they are in alarm, and of the parameter drift
    sensors : heat-balance check that goes with a drift
    cost : extra consumption since the onset, at most over the last week
    closes_day : whether a day (UTC) ended with this hour
    kept, seen : samples that became part of a point, and all of them, since the start
    judged, clusters : clusters within what was trained, and all of them, since the start
    """

    time: int
    points: SteadyPoints
    expected: FloatArray
    rejected: Mapping[str, int]
    states: tuple[VectorVerdict, ...] = ()
    weekly: DriftVerdict | None = None
    alarm: bool = False
    since: int | None = None
    finding: Finding | None = None
    sensors: SensorCheck | None = None
    cost: ExtraCost | None = None
    closes_day: bool = False
    kept: int = 0
    seen: int = 0
    judged: int = 0
    clusters: int = 0


class ChillerMonitor:
    """Charts of one chiller.

    Parameters
    ----------
    config : its declaration
    baseline : what it is compared with
    """

    def __init__(self, config: ChillerConfig, baseline: ChillerBaseline) -> None:
        self.config = config
        self._names = tuple(RAW_UNITS)
        self._rows: list[list[float]] = []
        self._times: list[int] = []
        self._last: int | None = None
        self._points: list[SteadyPoints] = []
        self._today: list[SteadyPoints] = []
        self._hours: list[float] = []
        self._last_week: int | None = None
        self._kept = 0
        self._seen = 0
        self._begin(baseline)

    def _begin(self, baseline: ChillerBaseline) -> None:
        self.baseline = baseline
        c = self.config
        self._stream = SteadyStream(c.instruments, c.rated_load, baseline.steady, baseline.period, baseline.tested)
        self._clustering = Clustering(c.rated_load)
        self._states = VectorMonitor(baseline.vector, c.residual_false_alarms)
        self._drift = None if baseline.drift is None else DriftMonitor(baseline.drift, c.form(), c.drift)
        self._isolated: tuple[Isolation, int] | None = None
        self._costs: ExtraCost | None = None

    def update(self, time: int, values: Mapping[str, float]) -> tuple[ChillerOutputs, ...]:
        """Take one sample of every quantity.

        Parameters
        ----------
        time : event time [ns]; must not go back (the engine orders samples)
        values : raw quantities, names and units of ``errors.RAW_UNITS``; missing or NaN: nothing seen

        Returns
        -------
        The outputs of the hour that this sample closed, if it did
        """
        if self._last is not None and time <= self._last:
            raise ChillerError(
                f"chiller {self.config.name!r}: sample at {time} ns is not after the last one at {self._last} ns; "
                "order samples and drop duplicates before they come here"
            )
        out: tuple[ChillerOutputs, ...] = ()
        if self._times and time // HOUR != self._times[0] // HOUR:
            out = (self._close(time),)
        if self._last_week is None:
            self._last_week = time // WEEK
        self._last = time
        self._times.append(time)
        self._rows.append([float(values.get(k, np.nan)) for k in self._names])
        return out

    def finish(self) -> tuple[ChillerOutputs, ...]:
        """Close the last hour, its cluster and its day at the end of the data."""
        if not self._times:
            return ()
        return (self._close((self._times[0] // DAY + 1) * DAY, last=True),)

    def reset(self, baseline: ChillerBaseline | None = None) -> None:
        """Clear the alarms; with a new baseline after a repair."""
        if baseline is not None:
            self._begin(baseline)
        self._states.reset()
        if self._drift is not None:
            self._drift.reset()
        self._isolated, self._costs = None, None

    def _close(self, now: int, last: bool = False) -> ChillerOutputs:
        """Close the hour of the samples held; ``now`` is when the next one came."""
        time, table = np.array(self._times, dtype=np.int64), np.array(self._rows)
        self._times, self._rows = [], []
        end = int(time[0] // HOUR + 1) * HOUR
        points, rejected = self._stream.take(time, table)
        power = table[:, self._names.index("power")]
        on = ~(power <= 0.01 * self.config.rated_load)
        self._hours = [*self._hours, float(on.mean())][-7 * 24 :]
        self._kept += int(points.samples.sum())
        self._seen += len(time)
        if len(points):
            self._today.append(points)
        closes_day = last or now // DAY != int(time[0]) // DAY
        if closes_day:
            recent = [p for p in self._points if p.time[-1] > end - RECENT_WEEKS * WEEK]
            self._points = [*recent, join(self._today)] if self._today else recent
            self._today = []
        states = self._judge(end, points, last)
        weekly = self._close_weeks(now)
        expected = self.baseline.expected_power(points, self.config) if len(points) else np.zeros(0)
        alarm = self._isolated is not None or self._states.finding is not None
        news = alarm and (bool(states) or weekly is not None)
        since, finding, sensors = self._finding() if news else (None, None, None)
        return ChillerOutputs(
            time=end,
            points=points,
            expected=expected,
            rejected=rejected,
            states=states,
            weekly=weekly,
            alarm=alarm,
            since=since,
            finding=finding,
            sensors=sensors,
            cost=self._cost(end, since, closes_day or weekly is not None) if news else None,
            closes_day=closes_day,
            kept=self._kept,
            seen=self._seen,
            judged=self._states.judged,
            clusters=self._states.seen,
        )

    def _judge(self, end: int, points: SteadyPoints, last: bool) -> tuple[VectorVerdict, ...]:
        """Verdicts of the clusters that these points, or the time without one, have ended."""
        found = []
        if len(points):
            rows = point_rows(points, with_load(points, self.config)["load"])
            found = [
                self._clustering.add(int(t), self._stream.length, r) for t, r in zip(points.time, rows, strict=True)
            ]
        found.append(self._clustering.finish() if last else self._clustering.tick(end))
        return tuple(self._states.update(c) for c in found if c is not None)

    def _close_weeks(self, end: int) -> DriftVerdict | None:
        """Chart every week that ended since the last one charted; the verdict of the newest."""
        assert self._last_week is not None
        verdict = None
        for week in range(self._last_week + 1, end // WEEK + 1):
            self._last_week = week
            if self._drift is not None:
                verdict = self._chart_week(self._drift, week * WEEK)
        if verdict is not None:
            self._isolated = None
            if verdict.isolation is not None and verdict.onset is not None:
                self._isolated = (verdict.isolation, verdict.onset)
        return verdict

    def _chart_week(self, drift: DriftMonitor, stop: int) -> DriftVerdict:
        """A week's points, those within what the machine was trained on."""
        week = join([*self._points, *self._today])
        week = week.select((week.time >= stop - WEEK) & (week.time < stop))
        m = len(drift.form.measured)
        x, cov = np.zeros((0, m)), np.zeros((0, m, m))
        if len(week):
            week = week.select(np.isfinite(self.baseline.expected_power(week, self.config)))
            week = week.select(week.closing(self.baseline.steady.balance))
            x, cov = week.regressors(self.config.instruments, drift.form.measured)
        return drift.update(stop, x, cov)

    def _finding(self) -> tuple[int, Finding, SensorCheck | None]:
        """The steady states' words, with the drift's where both speak; otherwise the drift's alone."""
        told = self._states.finding
        if told is None:
            assert self._isolated is not None
            isolation, onset = self._isolated
            sensors = check_balance(self.baseline.balance, self._since(onset).balance)
            return onset, diagnose(isolation, _date(onset), sensors), sensors
        finding = describe(told, self.baseline.vector, _date(told.onset))
        if self._isolated is not None:
            drift = f"; weekly estimate: {drift_words(self._isolated[0])}"
            finding = replace(finding, sentence=finding.sentence + drift)
        return told.onset, finding, None

    def _since(self, onset: int) -> SteadyPoints:
        points = join([p for p in (*self._points, *self._today) if p.time[-1] > onset])
        return points.select(points.time > onset)

    def _cost(self, end: int, since: int | None, anew: bool) -> ExtraCost | None:
        """Told anew once a day and with each week's verdict."""
        if anew or self._costs is None:
            self._costs = self._extra(end, since)
        return self._costs

    def _extra(self, end: int, since: int | None) -> ExtraCost | None:
        recent = self._since(max(end - WEEK, since or 0))
        if not len(recent):
            return None
        expected = self.baseline.expected_power(recent, self.config)
        good = np.isfinite(expected)
        if not good.any():
            return None
        vector = self.baseline.vector
        i = vector.layout.features.index("power")
        power = recent.raw["power"][good] - vector.layout.auxiliary
        return extra_cost(
            power,
            expected[good],
            hours_a_day=24.0 * float(np.mean(self._hours)),
            price=self.config.price,
            model_sd=float(np.sqrt(vector.slow[i, i] + vector.scatter[i, i] / vector.clusters)),
        )

    def export_state(self) -> JsonObject:
        """Plain data: JSON scalars, lists and numpy arrays."""
        return {
            "schema": SCHEMA,
            "times": np.array(self._times, dtype=np.int64),
            "rows": np.array(self._rows).reshape(len(self._rows), len(self._names)),
            "last": self._last,
            "hours": list(self._hours),
            "points": export_points(self._points),
            "today": export_points(self._today),
            "stream": self._stream.export_state(),
            "clustering": self._clustering.export_state(),
            "states": self._states.export_state(),
            "drift": None if self._drift is None else self._drift.export_state(),
            "last_week": self._last_week,
            "isolated": None if self._isolated is None else [asdict(self._isolated[0]), self._isolated[1]],
            "costs": None if self._costs is None else asdict(self._costs),
            "kept": self._kept,
            "seen": self._seen,
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where ``export_state`` was called, on the same baseline.

        Raises
        ------
        ChillerError : state of another schema
        """
        if state.get("schema") != SCHEMA:
            raise ChillerError(
                f"chiller state has schema {state.get('schema')!r}, this version reads {SCHEMA}: start it anew"
            )
        self._times = [int(t) for t in state["times"]]
        self._rows = [[float(v) for v in r] for r in np.asarray(state["rows"]).reshape(-1, len(self._names))]
        self._last = None if state["last"] is None else int(state["last"])
        self._hours = [float(h) for h in state["hours"]]
        self._points = points_of_state(state["points"])
        self._today = points_of_state(state["today"])
        self._stream.restore_state(state["stream"])
        self._clustering.restore_state(state["clustering"])
        self._states.restore_state(state["states"])
        if self._drift is not None and state["drift"] is not None:
            self._drift.restore_state(state["drift"])
        self._last_week = None if state["last_week"] is None else int(state["last_week"])
        self._isolated = None
        if state["isolated"] is not None:
            isolation, onset = state["isolated"]
            self._isolated = (Isolation(**isolation), int(onset))
        self._costs = None if state["costs"] is None else ExtraCost(**state["costs"])
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
