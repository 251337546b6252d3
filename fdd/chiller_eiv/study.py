"""The stand-alone study of one chiller: from raw data to points, estimates side by side, charts and a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fdd.chiller_eiv.baseline import POWER, ChillerBaseline, learn_baseline
from fdd.chiller_eiv.calibration import Calibration, calibrate_errors
from fdd.chiller_eiv.checks import DailyChange, Finding, SensorCheck, check_balance, diagnose, diagnose_daily
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.cost import ExtraCost, extra_cost
from fdd.chiller_eiv.drift import WEEK, DriftMonitor, DriftVerdict
from fdd.chiller_eiv.fit import ChillerFit, fit_by_every_estimator
from fdd.chiller_eiv.gate import GateDecision, effective_size
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.power_residual import DAY, DailyMonitor, DailyVerdict, daily_medians
from fdd.chiller_eiv.steady_state import SteadyPoints, SteadyReport, steady_points
from fdd.records import FloatArray, IntArray

Progress = Callable[[str], None]
"""Called with the name of each stage, for a progress display."""


@dataclass(frozen=True)
class ChillerData:
    """Raw data of one chiller.

    Attributes
    ----------
    time : shape (N,), increasing [ns]
    raw : readings, shape (N,) each, units of ``errors.RAW_UNITS``; NaN is missing
    running, others_running : shape (N,), see :func:`steady_state.steady_points`
    """

    time: IntArray
    raw: Mapping[str, FloatArray]
    running: NDArray[np.bool_] | None = None
    others_running: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class StudyResult:
    """Everything a study found; :func:`study_report.write_html` makes a page of it.

    Attributes
    ----------
    config : the declaration
    points, report : steady points and what became of every raw sample
    fits : estimates by every estimator on the baseline's points; empty where there are too few
    calibration : what the baseline says about the declared sensor errors
    decision : the gate's answer on the baseline
    baseline : what later points are compared with
    daily : verdicts of each daily chart, baseline days included
    weekly : verdicts of the parameter charts after the baseline
    residual : relative power residual of every point, shape (n,)
    finding : words for what is in alarm at the end
    sensors : heat-balance check of the points after the baseline
    cost : extra consumption over the last four weeks, after the baseline
    verdict : the study in one paragraph
    """

    config: ChillerConfig
    points: SteadyPoints
    report: SteadyReport
    fits: Mapping[str, ChillerFit]
    calibration: Calibration
    decision: GateDecision
    baseline: ChillerBaseline
    daily: Mapping[str, tuple[DailyVerdict, ...]]
    weekly: tuple[DriftVerdict, ...]
    residual: FloatArray
    finding: Finding | None
    sensors: SensorCheck | None
    cost: ExtraCost | None
    verdict: str
    notes: tuple[str, ...] = field(default=())


def study(
    data: ChillerData, config: ChillerConfig, *, baseline_end: int | None = None, progress: Progress | None = None
) -> StudyResult:
    """Study one chiller.

    Parameters
    ----------
    data : raw data
    config : its declaration
    baseline_end : end of the healthy period [ns]; by default ``config.baseline_days`` after the first sample, or all of
        the data where they are not longer
    progress : told the name of each stage

    Raises
    ------
    ChillerError : no steady points, or too few to predict power; the text counts what was rejected
    """
    tell = progress or (lambda _: None)
    tell("steady points")
    points, report = steady_points(
        data.time,
        data.raw,
        config.instruments,
        rated_load=config.rated_load,
        limits=config.steady,
        running=data.running,
        others_running=data.others_running,
    )
    if not len(points):
        raise ChillerError(f"chiller {config.name!r}: no steady points; samples by reason: {report.counts()}")
    end = baseline_end if baseline_end is not None else int(data.time[0] + config.baseline_days * DAY)
    healthy = points.select(points.time <= end)
    tell("gate and baseline")
    baseline, decision = learn_baseline(healthy, config)
    x, cov = healthy.regressors(config.instruments, config.form().measured)
    tell("every estimator")
    fits = fit_by_every_estimator(x, cov, healthy.days(), config.fit_options())
    calibration = calibrate_errors(x, cov, config.form())
    tell("charts")
    series = baseline.series(points, config)
    daily = _daily(points, series, baseline, config)
    weekly = _weekly(points, baseline, config)
    later = points.select(points.time > end)
    finding, sensors = _finding(weekly, daily, baseline, later)
    result = StudyResult(
        config=config,
        points=points,
        report=report,
        fits=fits,
        calibration=calibration,
        decision=decision,
        baseline=baseline,
        daily=daily,
        weekly=weekly,
        residual=series[POWER],
        finding=finding,
        sensors=sensors,
        cost=_cost(later, data, baseline, config),
        verdict="",
    )
    return replace(result, verdict=_verdict(result))


def _daily(
    points: SteadyPoints, series: Mapping[str, FloatArray], baseline: ChillerBaseline, config: ChillerConfig
) -> dict[str, tuple[DailyVerdict, ...]]:
    out = {}
    for name, reference in baseline.references.items():
        monitor = DailyMonitor(reference, config.residual_false_alarms, baseline.availability)
        days, medians = daily_medians(points.time, series[name])
        out[name] = tuple(monitor.update(int(t), float(v)) for t, v in zip(days, medians, strict=True))
    return out


def _weekly(points: SteadyPoints, baseline: ChillerBaseline, config: ChillerConfig) -> tuple[DriftVerdict, ...]:
    if baseline.drift is None:
        return ()
    monitor = DriftMonitor(baseline.drift, config.form(), config.drift)
    x, cov = points.regressors(config.instruments, config.form().measured)
    week = points.time // WEEK
    first = int(baseline.end // WEEK) + 1
    return tuple(
        monitor.update((w + 1) * WEEK, x[week == w], cov[week == w]) for w in range(first, int(week.max()) + 1)
    )


def _finding(
    weekly: tuple[DriftVerdict, ...],
    daily: Mapping[str, tuple[DailyVerdict, ...]],
    baseline: ChillerBaseline,
    later: SteadyPoints,
) -> tuple[Finding | None, SensorCheck | None]:
    if not len(later):
        return None, None
    last = weekly[-1] if weekly else None
    if last is None or last.isolation is None or last.onset is None:
        sensors = check_balance(baseline.balance, later.balance)
        changes = tuple(
            DailyChange(k, _change(vs), date_of(vs[-1].onset))
            for k, vs in daily.items()
            if vs and vs[-1].alarm and vs[-1].onset is not None
        )
        return (diagnose_daily(changes, POWER, sensors) if changes else None), sensors
    sensors = check_balance(baseline.balance, later.balance[later.time > last.onset])
    sides = {k: v[-1].value for k, v in daily.items() if k != POWER and v and v[-1].alarm}
    return diagnose(last.isolation, date_of(last.onset), sensors, sides), sensors


def _change(verdicts: tuple[DailyVerdict, ...]) -> float:
    """Median of a daily series since its onset."""
    onset = verdicts[-1].onset
    return float(np.median([v.value for v in verdicts if onset is None or v.time > onset]))


def _cost(later: SteadyPoints, data: ChillerData, baseline: ChillerBaseline, config: ChillerConfig) -> ExtraCost | None:
    recent = later.select(later.time > int(data.time[-1]) - 4 * WEEK) if len(later) else later
    if len(recent) < 2:
        return None
    power = baseline.power
    x, _ = recent.regressors(config.instruments, power.form.measured)
    span = data.time > int(data.time[-1]) - 4 * WEEK
    on = data.running if data.running is not None else ~(data.raw["power"] <= 0.01 * config.rated_load)
    reference = baseline.references[POWER]
    return extra_cost(
        power.form,
        power.machine,
        x,
        hours_a_day=24.0 * float(np.mean(on[span])),
        price=config.price,
        model_sd=reference.sd / np.sqrt(reference.days),
        independent=effective_size(power.residual(x)) if len(x) > 3 else None,
    )


def _verdict(r: StudyResult) -> str:
    """One paragraph: what can be known, what was found, what it costs."""
    parts = [f"{r.config.name}: {len(r.points)} steady points.", f"Parameters are {r.decision.sentence()}."]
    if r.decision.level.value.startswith("power"):
        parts[1] = f"Parameters are {r.decision.sentence()}. The power residual is watched instead."
    if r.finding is not None:
        parts.append(f"Finding: {r.finding.sentence}.")
    alarmed = {k: next(v for v in vs if v.alarm) for k, vs in r.daily.items() if any(v.alarm for v in vs)}
    for name, v in alarmed.items():
        since = date_of(v.onset) if v.onset is not None else "?"
        size = f"{100 * v.value:+.1f} %" if name == POWER else f"{v.value:+.2f} K"
        parts.append(
            f"The {name} chart alarms on {date_of(v.time - 1)} ({size} that day, changed since about {since})."
        )
    if r.finding is None and not alarmed:
        parts.append("No chart is in alarm.")
    if r.cost is not None and (alarmed or r.finding):
        c = r.cost
        money = f", {c.money_day:.2f} {r.config.currency} a day" if np.isfinite(c.money_day) else ""
        parts.append(f"Extra energy {c.energy_day:.0f} +- {1.96 * c.energy_day_se:.0f} kWh a day{money}.")
    return " ".join(parts)


def date_of(time: int) -> str:
    """Date (UTC) of an event time [ns]."""
    return str(np.datetime64(int(time), "ns").astype("datetime64[D]"))
