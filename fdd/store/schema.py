"""What a store keeps: measurements with their fields, kinds of documents, and the limits on names.

A *measurement* is a table of time series. Its rows are keyed by (series, event time); every field is a double, a field
that was not given, is NaN or is infinite is missing. A *document* is a JSON object keyed by (kind, key). The same
schema holds for every store; ``docs/schema.md`` is the page for readers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fdd.records import IntArray, Rows

SCHEMA_VERSION = 1
MAX_NAME = 200
NO_COMPONENT = "-"
MAX_SERIES = 100_000

# Codes that fields hold in place of words.
PHASES: tuple[str, ...] = ("no data", "learning", "quiet", "alarm")
ALARM_STATES: tuple[str, ...] = (
    "cleared",
    "returned to normal",
    "suppressed by design",
    "shelved",
    "acknowledged",
    "raised",
)
SEVERITIES: tuple[str, ...] = ("info", "low", "medium", "high", "critical")


class StoreError(Exception):
    """Something the store refuses or cannot do; the text says what, where and the remedy."""


class SchemaError(StoreError, ValueError):
    """Rows or documents that do not fit the schema."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a measurement; ``hourly`` is what stands for an hour of it: its mean, its largest or last value."""

    name: str
    unit: str
    meaning: str
    hourly: Literal["mean", "max", "last"] = "mean"


@dataclass(frozen=True, slots=True)
class Measurement:
    """A table of time series; ``series`` says what one series is, ``bound`` how many there can be."""

    name: str
    series: str
    bound: str
    fields: tuple[Field, ...]

    @property
    def field_names(self) -> tuple[str, ...]:
        """Names of the fields, in order."""
        return tuple(f.name for f in self.fields)


MEASUREMENTS: dict[str, Measurement] = {
    m.name: m
    for m in (
        Measurement(
            "samples",
            "point",
            "points",
            (
                Field("value", "the point's SI unit", "value as received, converted to SI"),
                Field("quality", "code", "0 good, 1 uncertain, 2 bad", "max"),
            ),
        ),
        Measurement(
            "predictions",
            "component/output",
            "components x outputs",
            (
                Field("measured", "the output's SI unit", "measured value"),
                Field("predicted", "the output's SI unit", "one-step prediction of the filter"),
                Field("sd", "the output's SI unit", "standard deviation of the prediction error"),
                Field("innovation", "1", "(measured - predicted) / sd; white with unit variance while the model holds"),
            ),
        ),
        Measurement(
            "charts",
            "component/stream:chart",
            "components x streams x charts",
            (
                Field("statistic", "1", "what the chart accumulates"),
                Field("limit", "1", "value at which it alarms"),
                Field("phase", "code", "0 no data, 1 learning, 2 quiet, 3 alarm", "max"),
            ),
        ),
        Measurement(
            "parameters",
            "component/parameter",
            "components x parameters",
            (
                Field("value", "the parameter's SI unit", "estimate"),
                Field("lower", "the parameter's SI unit", "lower end of its 95 % interval"),
                Field("upper", "the parameter's SI unit", "upper end of its 95 % interval"),
                Field("version", "1", "version of the baseline it belongs to", "last"),
            ),
        ),
        Measurement(
            "scores",
            "component/parameter",
            "components x parameters",
            (
                Field("score", "1/transformed parameter", "sum of the log-likelihood's gradient over the interval"),
                Field("information", "1/transformed parameter^2", "Fisher information of the interval"),
            ),
        ),
        Measurement(
            "gates",
            "component/gate",
            "components x gates",
            (
                Field(
                    "open",
                    "0 or 1",
                    "1 while data pass the gate (steady state, machine on, inside the valid range)",
                    "max",
                ),
                Field("kept", "1", "points kept since the start", "last"),
                Field("seen", "1", "points seen since the start", "last"),
            ),
        ),
        Measurement(
            "counts",
            "part/what",
            "parts x reasons",
            (
                Field(
                    "value", "1", "how often since the start: samples received, late, duplicate, rejected, ...", "last"
                ),
            ),
        ),
        Measurement(
            "health",
            "part/what",
            "parts x gauges",
            (Field("value", "named by the gauge", "lag [s], samples a second, spool bytes, memory, ..."),),
        ),
    )
}

DOCUMENT_KINDS: dict[str, str] = {
    "alarm": "one alarm with its causes, evidence and history; key: the alarm's",
    "baseline": "parameters of a healthy component with data span and diagnostics; key: component/version",
    "state": "checkpoint of the engine with the source positions; key: the engine's",
    "command": "what an operator asked of an alarm, and the outcome; key: when/alarm/action",
    "run": "one run of a job: demo, fit, replay, re-identification, report; key: the run's",
}


def check_name(name: str, what: str) -> str:
    """Refuse a series name or document key that some store could not keep exactly."""
    if not name or len(name) > MAX_NAME:
        raise SchemaError(f"{what} {name[:40]!r} has {len(name)} characters; give it 1 to {MAX_NAME}")
    if name != name.strip() or not name.isprintable() or "\\" in name:
        raise SchemaError(f"{what} {name!r} has a control character, a backslash or a space at an end; rename it")
    if name.startswith(f"{NO_COMPONENT}/"):
        raise SchemaError(f"{what} {name!r}: the component {NO_COMPONENT!r} stands for none; rename it")
    return name


@lru_cache(maxsize=256)  # the same few tuples of names come again with every batch
def _check_series(names: tuple[str, ...]) -> None:
    for name in names:
        check_name(name, "series")


def measurement_of(name: str) -> Measurement:
    """The measurement of that name."""
    try:
        return MEASUREMENTS[name]
    except KeyError:
        raise SchemaError(f"no measurement {name!r}; there are {', '.join(MEASUREMENTS)}") from None


def check_kind(kind: str) -> str:
    """Refuse an unknown kind of document."""
    if kind not in DOCUMENT_KINDS:
        raise SchemaError(f"no kind of document {kind!r}; there are {', '.join(DOCUMENT_KINDS)}")
    return kind


@dataclass(frozen=True, slots=True)
class CheckedRows:
    """Rows that fit the schema, ordered by (series, time): the names in use, and columns as doubles."""

    measurement: Measurement
    names: tuple[str, ...]
    series: IntArray
    time: IntArray
    fields: dict[str, NDArray[np.float64]]

    def __len__(self) -> int:
        return len(self.time)


def _finite(values: NDArray[Any]) -> NDArray[np.float64]:
    """As doubles, with NaN for what no server keeps."""
    column = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(column), column, np.nan)


def check_rows(rows: Rows) -> CheckedRows:
    """Columns as every store wants them: known fields, doubles, used names only, rows without any value left out.

    Raises
    ------
    SchemaError : unknown measurement or field, columns of different lengths, a series index without a name
    """
    measurement = measurement_of(rows.measurement)
    n = len(rows.time)
    unknown = set(rows.fields) - set(measurement.field_names)
    if unknown:
        raise SchemaError(
            f"{measurement.name}: no field {', '.join(sorted(unknown))}; it has {', '.join(measurement.field_names)}"
        )
    columns = {k: _finite(v) for k, v in rows.fields.items()}
    index = np.asarray(rows.series, dtype=np.int64)
    shapes = {"series": index.shape} | {name: column.shape for name, column in columns.items()}
    for name, shape in shapes.items():
        if shape != (n,):
            raise SchemaError(f"{measurement.name}: column {name!r} has shape {shape}, time has ({n},)")
    if n and (index.min() < 0 or index.max() >= len(rows.names)):
        raise SchemaError(
            f"{measurement.name}: series index {index.min()}..{index.max()} outside the {len(rows.names)} names"
        )
    used, position = np.unique(index, return_inverse=True)
    _check_series(rows.names)
    names = rows.names if len(used) == len(rows.names) else tuple(rows.names[i] for i in used)
    time = np.asarray(rows.time, dtype=np.int64)
    order = np.lexsort((time, position))
    if columns:
        given = ~np.all([np.isnan(c) for c in columns.values()], axis=0)
        order = order[given[order]]
    else:
        order = order[:0]
    return CheckedRows(
        measurement, names, position[order], time[order], {k: column[order] for k, column in columns.items()}
    )


def as_sequence(rows: Rows | Sequence[Rows]) -> Sequence[Rows]:
    """One or many, as many."""
    return [rows] if isinstance(rows, Rows) else rows


def split_series(series: str) -> tuple[str, str]:
    """(component, name) of a series; one without a slash has none, written ``-``."""
    component, slash, name = series.partition("/")
    return (component, name) if slash and component and name else (NO_COMPONENT, series)


def join_series(component: str, name: str) -> str:
    """The series of a component and a name; inverse of :func:`split_series`."""
    return name if component == NO_COMPONENT else f"{component}/{name}"
