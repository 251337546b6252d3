"""Rows for the store from a chiller's outputs: steady power, parameters, charts, the steady-state gate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fdd.chiller_eiv.drift import DriftVerdict
from fdd.chiller_eiv.intervals import half_width
from fdd.chiller_eiv.online import ChillerMonitor, ChillerOutputs
from fdd.chiller_eiv.watch import VectorVerdict
from fdd.records import Rows
from fdd.residual_monitors.chart import Phase


def state_chart(name: str) -> str:
    """Name of the chart of the steady states."""
    return f"{name}/all:cluster"


def weekly_chart(name: str, parameter: str) -> str:
    """Name of a parameter's weekly chart."""
    return f"{name}/{parameter}:weekly"


def output_rows(monitor: ChillerMonitor, outputs: ChillerOutputs, version: int = 1) -> list[Rows]:
    """What one closed hour writes, keyed by (measurement, series, event time).

    Parameters
    ----------
    monitor : the chiller's, for its baseline and name
    outputs : of one closed hour
    version : of the baseline

    Returns
    -------
    ``predictions`` (series ``NAME/power``, one row a steady point), ``gates`` (``NAME/steady``, a day), ``charts``
    (``NAME/all:cluster``, ``NAME/dS:weekly`` ...) and ``parameters`` (``NAME/dS`` ..., each week's)
    """
    name = monitor.config.name
    rows = [_gate(name, outputs)] if outputs.closes_day else []
    rows += [_state(name, v) for v in outputs.states]
    if outputs.weekly is not None:
        rows += [*_weekly_charts(name, outputs.weekly), *_week(name, monitor, outputs.weekly, version)]
    if len(outputs.points):
        rows.append(_power(name, monitor, outputs))
    return rows


def baseline_rows(monitor: ChillerMonitor, time: int, version: int = 1) -> list[Rows]:
    """The baseline's parameters, as far as they may be believed, at a time [ns]."""
    b = monitor.baseline
    return [
        _interval(monitor.config.name, p, time, value, 1.96 * b.se.get(p, np.nan), version)
        for p, value in b.estimate.items()
    ]


def _one(measurement: str, series: str, time: int, fields: Mapping[str, float]) -> Rows:
    return Rows(
        measurement,
        (series,),
        np.zeros(1, dtype=np.int32),
        np.array([time], dtype=np.int64),
        {k: np.array([v], dtype=np.float64) for k, v in fields.items()},
    )


def _gate(name: str, o: ChillerOutputs) -> Rows:
    fields = {"open": float(o.judged > 0), "kept": float(o.kept), "seen": float(o.seen)}
    return _one("gates", f"{name}/steady", o.time, fields)


def _power(name: str, monitor: ChillerMonitor, o: ChillerOutputs) -> Rows:
    vector = monitor.baseline.vector
    i = vector.layout.features.index("power")
    sd = float(np.sqrt(vector.scatter[i, i] + vector.slow[i, i]))
    power = o.points.raw["power"] - vector.layout.auxiliary
    return Rows(
        "predictions",
        (f"{name}/power",),
        np.zeros(len(power), dtype=np.int32),
        np.asarray(o.points.time, dtype=np.int64),
        {
            "measured": power,
            "predicted": o.expected,
            "sd": sd * o.expected,
            "innovation": np.log(power / o.expected) / sd,
        },
    )


def _state(name: str, v: VectorVerdict) -> Rows:
    phase = Phase.ALARM if v.alarm else Phase.QUIET if v.judged else Phase.NO_DATA
    fields = {"statistic": v.statistic, "limit": v.limit, "phase": float(phase)}
    return _one("charts", state_chart(name), v.time, fields)


def _weekly_charts(name: str, w: DriftVerdict) -> list[Rows]:
    return [
        _one(
            "charts",
            weekly_chart(name, p),
            w.time,
            {"statistic": float(w.statistic[i]), "limit": float(w.limit[i]), "phase": float(w.phase[i])},
        )
        for i, p in enumerate(w.parameters)
    ]


def _week(name: str, monitor: ChillerMonitor, w: DriftVerdict, version: int) -> list[Rows]:
    if not np.isfinite(w.week.estimate).all() or monitor.baseline.drift is None:
        return []
    # As wide as the weeks of the baseline really scattered.
    half = half_width(w.week.se * monitor.baseline.drift.spread, float(w.week.points - len(w.parameters)))
    return [
        _interval(name, p, w.time, float(w.week.estimate[i]), float(half[i]), version)
        for i, p in enumerate(w.parameters)
    ]


def _interval(name: str, parameter: str, time: int, value: float, half: float, version: int) -> Rows:
    fields = {"value": value, "lower": value - half, "upper": value + half, "version": float(version)}
    return _one("parameters", f"{name}/{parameter}", time, fields)
