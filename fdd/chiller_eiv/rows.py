"""Rows for the store from a chiller's outputs: steady power, parameters, charts, the steady-state gate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fdd.chiller_eiv.baseline import POWER
from fdd.chiller_eiv.drift import DriftVerdict
from fdd.chiller_eiv.intervals import half_width
from fdd.chiller_eiv.online import ChillerMonitor, ChillerOutputs
from fdd.chiller_eiv.power_residual import DailyVerdict
from fdd.records import Rows

_SLUG = {POWER: "power"}


def stream_of(series: str) -> str:
    """A daily series' name as it stands in the store: ``power``, ``condenser_approach``."""
    return _SLUG.get(series, series.replace(" ", "_"))


def daily_chart(name: str, series: str) -> str:
    """Name of a daily chart."""
    return f"{name}/{stream_of(series)}:daily"


def weekly_chart(name: str, parameter: str) -> str:
    """Name of a parameter's weekly chart."""
    return f"{name}/{parameter}:weekly"


def output_rows(monitor: ChillerMonitor, outputs: ChillerOutputs, version: int = 1) -> list[Rows]:
    """What one closed day writes, keyed by (measurement, series, event time).

    Parameters
    ----------
    monitor : the chiller's, for its baseline and name
    outputs : of one closed day
    version : of the baseline

    Returns
    -------
    ``predictions`` (series ``NAME/power``, one row a steady point), ``gates`` (``NAME/steady``), ``charts``
    (``NAME/power:daily``, ``NAME/dS:weekly`` ...) and ``parameters`` (``NAME/dS`` ...: the baseline's when it was
    learned, each week's afterwards)
    """
    name = monitor.config.name
    rows = [_gate(name, outputs), *_charts(name, outputs)]
    if len(outputs.residual):
        rows.append(_power(name, monitor, outputs))
    rows += _parameters(name, monitor, outputs, version)
    return rows


def _one(measurement: str, series: str, time: int, fields: Mapping[str, float]) -> Rows:
    return Rows(
        measurement,
        (series,),
        np.zeros(1, dtype=np.int32),
        np.array([time], dtype=np.int64),
        {k: np.array([v], dtype=np.float64) for k, v in fields.items()},
    )


def _gate(name: str, o: ChillerOutputs) -> Rows:
    fields = {"open": float(len(o.points) > 0), "kept": float(o.kept), "seen": float(o.seen)}
    return _one("gates", f"{name}/steady", o.time, fields)


def _power(name: str, monitor: ChillerMonitor, o: ChillerOutputs) -> Rows:
    assert monitor.baseline is not None
    model = monitor.baseline.power
    x, _ = o.points.regressors(monitor.config.instruments, model.form.measured)
    predicted = model.predict(x)
    return Rows(
        "predictions",
        (f"{name}/power",),
        np.zeros(len(x), dtype=np.int32),
        np.asarray(o.points.time, dtype=np.int64),
        {
            "measured": x[:, 3],
            "predicted": predicted,
            "sd": model.spread * predicted,
            "innovation": o.residual / max(model.spread, 1e-9),
        },
    )


def _charts(name: str, o: ChillerOutputs) -> list[Rows]:
    rows = [_daily(name, series, v) for series, v in o.daily.items()]
    return rows + ([] if o.weekly is None else _weekly_charts(name, o))


def _daily(name: str, series: str, v: DailyVerdict) -> Rows:
    fields = {"statistic": v.statistic, "limit": v.limit, "phase": float(v.phase)}
    return _one("charts", daily_chart(name, series), v.time, fields)


def _weekly_charts(name: str, o: ChillerOutputs) -> list[Rows]:
    assert o.weekly is not None
    w = o.weekly
    return [
        _one(
            "charts",
            weekly_chart(name, p),
            w.time,
            {"statistic": float(w.statistic[i]), "limit": float(w.limit[i]), "phase": float(w.phase[i])},
        )
        for i, p in enumerate(w.parameters)
    ]


def _parameters(name: str, monitor: ChillerMonitor, o: ChillerOutputs, version: int) -> list[Rows]:
    if o.learned is not None:
        se = o.learned.se
        return [
            _interval(name, p, o.time, value, 1.96 * se.get(p, np.nan), version)
            for p, value in o.learned.estimate.items()
        ]
    return [] if o.weekly is None else _week(name, o.weekly, version)


def _week(name: str, w: DriftVerdict, version: int) -> list[Rows]:
    if not np.isfinite(w.week.estimate).all():
        return []
    half = half_width(w.week.se, float(w.week.points - len(w.parameters)))
    return [
        _interval(name, p, w.time, float(w.week.estimate[i]), float(half[i]), version)
        for i, p in enumerate(w.parameters)
    ]


def _interval(name: str, parameter: str, time: int, value: float, half: float, version: int) -> Rows:
    fields = {"value": value, "lower": value - half, "upper": value + half, "version": float(version)}
    return _one("parameters", f"{name}/{parameter}", time, fields)
