"""The rows behind a finding: what was measured and expected, what the charts said, how parameters moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from fdd.evidence import has_kind
from fdd.records import Baseline, FloatArray, IntArray
from fdd.report.words import DAY
from fdd.store.store import Store

NO_DATA, LEARNING, QUIET, ALARM = range(4)  # fdd.store.schema.PHASES


@dataclass(frozen=True, slots=True)
class Trace:
    """One output of a component, in SI; all of shape (n,)."""

    symbol: str
    time: IntArray
    measured: FloatArray
    predicted: FloatArray
    sd: FloatArray
    innovation: FloatArray

    def between(self, start: int, end: int) -> Trace:
        """The part with start <= time < end."""
        a, b = np.searchsorted(self.time, [start, end])
        part = slice(int(a), int(b))
        return Trace(
            self.symbol,
            self.time[part],
            self.measured[part],
            self.predicted[part],
            self.sd[part],
            self.innovation[part],
        )


@dataclass(frozen=True, slots=True)
class ChartTrace:
    """One chart of a component; all of shape (n,)."""

    name: str
    time: IntArray
    statistic: FloatArray
    limit: FloatArray
    phase: IntArray

    def between(self, start: int, end: int) -> ChartTrace:
        """The part with start <= time < end."""
        a, b = np.searchsorted(self.time, [start, end])
        part = slice(int(a), int(b))
        return ChartTrace(self.name, self.time[part], self.statistic[part], self.limit[part], self.phase[part])


@dataclass(frozen=True, slots=True)
class ParameterTrace:
    """Estimates of one parameter with 95 % intervals, and the baseline versions it was given; SI, shape (n,)."""

    symbol: str
    time: IntArray
    value: FloatArray
    lower: FloatArray
    upper: FloatArray
    baselines: tuple[tuple[int, int, int, float, float], ...] = ()
    """(version, start [ns], end [ns], value, standard error)"""


@dataclass(frozen=True, slots=True)
class Evidence:
    """All rows of one component in the time that was asked for."""

    outputs: Mapping[str, Trace] = field(default_factory=dict)
    charts: Mapping[str, ChartTrace] = field(default_factory=dict)
    parameters: Mapping[str, ParameterTrace] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Series of a store by component, looked up once."""

    predictions: Mapping[str, tuple[str, ...]]
    charts: Mapping[str, tuple[str, ...]]
    parameters: Mapping[str, tuple[str, ...]]

    @classmethod
    def of(cls, store: Store) -> Catalogue:
        """Group the names of all series by component."""
        return cls(*(_by_component(store.series(m)) for m in ("predictions", "charts", "parameters")))


def _by_component(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.rpartition("/")[0], []).append(name)
    return {component: tuple(members) for component, members in groups.items()}


def load(
    store: Store, catalogue: Catalogue, component: str, start: int, end: int, baselines: Sequence[Baseline]
) -> Evidence:
    """Rows of one component with start <= time < end; parameters over their whole history up to ``end``."""
    outputs = {
        name.rpartition("/")[2]: Trace(
            name.rpartition("/")[2],
            block["time"].to_numpy(dtype=np.int64),
            *(block[f].to_numpy(dtype=np.float64) for f in ("measured", "predicted", "sd", "innovation")),
        )
        for name, block in _blocks(store, "predictions", catalogue.predictions.get(component, ()), start, end)
    }
    charts = {
        name: ChartTrace(
            name,
            block["time"].to_numpy(dtype=np.int64),
            block["statistic"].to_numpy(dtype=np.float64),
            block["limit"].to_numpy(dtype=np.float64),
            block["phase"].fillna(NO_DATA).to_numpy(dtype=np.int64),
        )
        for name, block in _blocks(store, "charts", catalogue.charts.get(component, ()), start, end)
        if has_kind(name)
    }
    return Evidence(outputs, charts, _parameters(store, catalogue.parameters.get(component, ()), end, baselines))


def _blocks(
    store: Store, measurement: str, names: Sequence[str], start: int | None, end: int
) -> list[tuple[str, pd.DataFrame]]:
    if not names:
        return []
    frame = store.read(measurement, names, start, end)
    return [(str(name), block) for name, block in frame.groupby("series", sort=False)]


def _parameters(
    store: Store, names: Sequence[str], end: int, baselines: Sequence[Baseline]
) -> dict[str, ParameterTrace]:
    rows = {
        name.rpartition("/")[2]: block.drop_duplicates("time", keep="last")
        for name, block in _blocks(store, "parameters", names, None, end)
    }
    symbols = dict.fromkeys([*rows, *(s for b in baselines for s in b.parameters)])
    empty = pd.DataFrame({"time": np.empty(0, dtype=np.int64), "value": [], "lower": [], "upper": []}, dtype=float)
    traces = {}
    for symbol in symbols:
        block = rows.get(symbol, empty)
        value, lower, upper = (block[f].to_numpy(dtype=np.float64) for f in ("value", "lower", "upper"))
        given = tuple(
            (b.version, b.start, b.end, b.parameters[symbol], b.standard_errors.get(symbol, float("nan")))
            for b in baselines
            if symbol in b.parameters
        )
        traces[symbol] = ParameterTrace(symbol, block["time"].to_numpy(dtype=np.int64), value, lower, upper, given)
    return traces


def latest(store: Store, catalogue: Catalogue) -> int | None:
    """Event time of the newest prediction [ns], None in an empty store.

    Three components are read in full, the others only from there on: a year of a large plant need not be read.
    """
    first = [names[0] for names in catalogue.predictions.values()]
    newest: int | None = None
    for names in (first[:3], first[3:]):
        if names:
            times = store.read("predictions", names, newest)["time"]
            newest = max([int(times.max())] if len(times) else [], default=newest)
    return newest


def step_of(evidence: Evidence) -> int:
    """Time between frames [ns]: the shortest between two rows, as every row stands on a frame; a day without rows."""
    times = [c.time for c in evidence.charts.values()] + [t.time for t in evidence.outputs.values()]
    return min((int(np.diff(time).min()) for time in times if len(time) > 1), default=DAY)
