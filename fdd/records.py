"""The plain records that travel between parts: samples, rows, baselines, alarms.

Every layer may use these; they know nothing of any layer. Times are integer nanoseconds since the Unix epoch, UTC,
and are always the *event's* time, never the clock's.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.evidence import Cause, Entry, Evidence, Message, messages
from fdd.evidence import JsonObject as JsonObject

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NANOSECONDS = 1_000_000_000


class Quality(IntEnum):
    """How far a sample can be trusted (the three words of OPC UA)."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2


@dataclass(frozen=True, slots=True)
class Sample:
    """One value of one point at one event time; ``None`` still moves time forward."""

    point: str
    time: int
    value: float | None
    quality: Quality = Quality.GOOD


@dataclass(frozen=True, slots=True)
class Batch:
    """Samples in order of arrival, by columns.

    Attributes
    ----------
    names : points the batch speaks of
    point : shape (n,), index into ``names``
    time : shape (n,), event time [ns since epoch, UTC]
    value : shape (n,), NaN where the source gave none
    quality : shape (n,), :class:`Quality`
    position : where the source stands after this batch; handing it back to the source resumes there
    """

    names: tuple[str, ...]
    point: NDArray[np.int32]
    time: IntArray
    value: FloatArray
    quality: NDArray[np.uint8]
    position: JsonObject = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def of(cls, samples: Iterable[Sample], position: JsonObject | None = None) -> Batch:
        """Columns from samples, keeping their order."""
        rows = list(samples)
        index: dict[str, int] = {}
        point = [index.setdefault(s.point, len(index)) for s in rows]
        value = [np.nan if s.value is None else s.value for s in rows]
        return cls(
            names=tuple(index),
            point=np.array(point, dtype=np.int32),
            time=np.array([s.time for s in rows], dtype=np.int64),
            value=np.array(value, dtype=np.float64),
            quality=np.array([s.quality for s in rows], dtype=np.uint8),
            position=dict(position or {}),
        )

    @classmethod
    def of_table(
        cls, names: Sequence[str], time: IntArray, values: FloatArray, position: JsonObject | None = None
    ) -> Batch:
        """Good samples of every point at every time, row by row: ``time`` (n,), ``values`` (n, len(names))."""
        return cls(
            names=tuple(names),
            point=np.tile(np.arange(len(names), dtype=np.int32), len(time)),
            time=np.repeat(time, len(names)),
            value=values.ravel(),
            quality=np.full(values.size, Quality.GOOD, dtype=np.uint8),
            position=dict(position or {}),
        )

    def slice(self, start: int, stop: int) -> Batch:
        """The samples ``start:stop``; the position stays that of the whole batch."""
        return replace(
            self,
            point=self.point[start:stop],
            time=self.time[start:stop],
            value=self.value[start:stop],
            quality=self.quality[start:stop],
        )

    def between(self, start: int | None, end: int | None) -> Batch:
        """The samples with event time in [start, end)."""
        keep = np.ones(len(self), dtype=np.bool_)
        if start is not None:
            keep &= self.time >= start
        if end is not None:
            keep &= self.time < end
        return replace(
            self, point=self.point[keep], time=self.time[keep], value=self.value[keep], quality=self.quality[keep]
        )


@dataclass(frozen=True, slots=True)
class Rows:
    """Time series output, by columns: what a store keeps, keyed by (measurement, series, time).

    Attributes
    ----------
    measurement : one of the measurements of :mod:`fdd.store.schema`
    names : series the rows speak of, for example ``"substation-hx/T_hot_out"``
    series : shape (n,), index into ``names``
    time : shape (n,), event time [ns]
    fields : name to values, each of shape (n,)
    """

    measurement: str
    names: tuple[str, ...]
    series: NDArray[np.int32]
    time: IntArray
    fields: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True)
class Baseline:
    """What a component looks like when it is healthy: the parameters a filter runs on, and where they come from.

    ``covariance`` is that of the parameters on their estimation scale, in the order of ``parameters``; empty where they
    are known. ``innovation`` holds, by output symbol, mean, sd and lag-one autocorrelation of the standardised
    innovations. ``diagnostics`` names parameters that the data left open (``unidentifiable``, ``at_bound``).
    """

    component: str
    version: int
    model: str
    model_version: str
    options: JsonObject
    parameters: dict[str, float]
    standard_errors: dict[str, float]
    covariance: list[list[float]]
    start: int
    end: int
    samples: int
    log_likelihood: float
    innovation: dict[str, JsonObject]
    diagnostics: JsonObject = field(default_factory=dict)
    reason: str = "fitted"


class AlarmState(StrEnum):
    """The life of an alarm, in the words of ISA-18.2 / IEC 62682."""

    RAISED = "raised"
    ACKNOWLEDGED = "acknowledged"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed by design"
    RETURNED = "returned to normal"
    CLEARED = "cleared"


@dataclass(frozen=True, slots=True)
class Alarm:
    """One fault, one alarm: what, where, since when, how sure, and what to check first.

    ``key`` is made of the component and the event time, so that a replay writes the same alarm again.
    """

    key: str
    component: str
    state: AlarmState
    since: int
    raised: int
    updated: int
    charts: tuple[str, ...]
    severity: str = "medium"
    causes: tuple[Cause, ...] = ()
    checks: tuple[Message, ...] = ()
    evidence: Evidence = field(default_factory=Evidence)
    history: tuple[Entry, ...] = ()

    def document(self) -> JsonObject:
        """Plain data, with codes in place of sentences."""
        return {
            "key": self.key,
            "component": self.component,
            "state": str(self.state),
            "since": self.since,
            "raised": self.raised,
            "updated": self.updated,
            "charts": list(self.charts),
            "severity": self.severity,
            "causes": [c.document() for c in self.causes],
            "checks": [m.document() for m in self.checks],
            "evidence": self.evidence.document(),
            "history": [e.document() for e in self.history],
        }

    @classmethod
    def read(cls, document: JsonObject) -> Alarm:
        """The alarm that :meth:`document` wrote, in this version or in one with sentences."""
        return cls(
            str(document["key"]),
            str(document["component"]),
            AlarmState(document["state"]),
            int(document["since"]),
            int(document["raised"]),
            int(document["updated"]),
            tuple(document.get("charts") or ()),
            str(document.get("severity", "medium")),
            tuple(Cause.read(c) for c in document.get("causes") or ()),
            messages(document.get("checks")),
            Evidence.read(document.get("evidence") or {}),
            tuple(Entry.read(e) for e in document.get("history") or ()),
        )


def concatenate(rows: Sequence[Rows]) -> list[Rows]:
    """Join rows of the same measurement and series names, keeping order."""
    groups: dict[tuple[str, tuple[str, ...]], list[Rows]] = {}
    for r in rows:
        groups.setdefault((r.measurement, r.names), []).append(r)
    return [
        Rows(
            measurement=measurement,
            names=names,
            series=np.concatenate([r.series for r in group]),
            time=np.concatenate([r.time for r in group]),
            fields={k: np.concatenate([r.fields[k] for r in group]) for k in group[0].fields},
        )
        for (measurement, names), group in groups.items()
    ]
