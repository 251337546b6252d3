"""The stand-alone study of one chiller: from raw data to points, estimates side by side, charts and a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fdd.chiller_eiv.baseline import ChillerBaseline, clusters_of, learn_from_samples
from fdd.chiller_eiv.calibration import Calibration, calibrate_errors
from fdd.chiller_eiv.checks import Finding, SensorCheck, check_balance, describe, diagnose, drift_words
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.cost import ExtraCost, extra_cost
from fdd.chiller_eiv.drift import WEEK, DriftMonitor, DriftVerdict
from fdd.chiller_eiv.fit import ChillerFit, fit_by_every_estimator
from fdd.chiller_eiv.gate import GateDecision, Level, effective_size
from fdd.chiller_eiv.steady_state import SteadyPoints, SteadyReport
from fdd.chiller_eiv.vector import DAY
from fdd.chiller_eiv.watch import VectorMonitor, VectorVerdict
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
    """

    time: IntArray
    raw: Mapping[str, FloatArray]


@dataclass(frozen=True)
class StudyResult:
    """Everything a study found; :func:`study_report.write_html` makes a page of it.

    Attributes
    ----------
    config : the declaration
    points, report : steady points and what became of every raw sample
    fits : estimates by every estimator on the baseline's points; none where the gate declines them
    calibration : what the baseline says about the declared sensor errors
    decision : the gate's answer on the baseline
    baseline : what later points are compared with
    states : verdicts of the clusters after the baseline
    judged : share of those clusters that lie within what was trained [1]; NaN without any
    weekly : verdicts of the parameter charts after the baseline
    expected : power of the healthy machine at every point [W], shape (n,); NaN outside what was trained
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
    states: tuple[VectorVerdict, ...]
    judged: float
    weekly: tuple[DriftVerdict, ...]
    expected: FloatArray
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
    ChillerError : no steady points, or too few; the text counts what was rejected
    """
    tell = progress or (lambda _: None)
    tell("steady points and baseline")
    end = baseline_end if baseline_end is not None else int(data.time[0] + config.baseline_days * DAY)
    baseline, decision, points, report = learn_from_samples(data.time, data.raw, config, end)
    healthy = points.select(points.time <= end)
    closing = healthy.closing(baseline.steady.balance)
    healthy = healthy.select(closing) if closing.any() else healthy
    x, cov = healthy.regressors(config.instruments, config.form().measured)
    tell("every estimator")
    fits: Mapping[str, ChillerFit] = {}
    if decision.level is not Level.RESIDUAL:
        options = replace(config.fit_options(), held=dict(decision.fit.held))
        fits = fit_by_every_estimator(x, cov, healthy.days(), options)
    calibration = calibrate_errors(x, cov, config.form())
    tell("charts")
    later = points.select(points.time > end)
    states, judged = _states(later, baseline, config, report.period)
    weekly = _weekly(points, baseline, config)
    finding, sensors = _finding(states, weekly, baseline, later)
    expected = baseline.expected_power(points, config)
    result = StudyResult(
        config=config,
        points=points,
        report=report,
        fits=fits,
        calibration=calibration,
        decision=decision,
        baseline=baseline,
        states=states,
        judged=judged,
        weekly=weekly,
        expected=expected,
        finding=finding,
        sensors=sensors,
        cost=_cost(later, data, baseline, config),
        verdict="",
    )
    return replace(result, verdict=_verdict(result))


def _states(
    later: SteadyPoints, baseline: ChillerBaseline, config: ChillerConfig, period: float
) -> tuple[tuple[VectorVerdict, ...], float]:
    if not len(later):
        return (), float("nan")
    window = round(max(3, round(baseline.steady.window / period)) * period * 1e9)
    clusters = clusters_of(later, config, window)
    monitor = VectorMonitor(baseline.vector, config.residual_false_alarms)
    verdicts = tuple(monitor.update(clusters.select(np.array([i]))) for i in range(len(clusters)))
    return verdicts, monitor.judged / max(monitor.seen, 1)


def _weekly(points: SteadyPoints, baseline: ChillerBaseline, config: ChillerConfig) -> tuple[DriftVerdict, ...]:
    if baseline.drift is None:
        return ()
    monitor = DriftMonitor(baseline.drift, config.form(), config.drift)
    points = points.select(np.isfinite(baseline.expected_power(points, config)))
    points = points.select(points.closing(baseline.steady.balance))
    x, cov = points.regressors(config.instruments, config.form().measured)
    week = points.time // WEEK
    first = int(baseline.end // WEEK) + 1
    if not len(week):
        return ()
    return tuple(
        monitor.update((w + 1) * WEEK, x[week == w], cov[week == w]) for w in range(first, int(week.max()) + 1)
    )


def _finding(
    states: tuple[VectorVerdict, ...],
    weekly: tuple[DriftVerdict, ...],
    baseline: ChillerBaseline,
    later: SteadyPoints,
) -> tuple[Finding | None, SensorCheck | None]:
    if not len(later):
        return None, None
    last = weekly[-1] if weekly else None
    isolated = last if last is not None and last.isolation is not None and last.onset is not None else None
    told = states[-1].finding if states else None
    sensors = check_balance(baseline.balance, later.balance)
    if told is not None:
        finding = describe(told, baseline.vector, date_of(told.onset))
        if isolated is not None and isolated.isolation is not None:
            drift = f"; weekly estimate: {drift_words(isolated.isolation)}"
            finding = replace(finding, sentence=finding.sentence + drift)
        return finding, sensors
    if isolated is None or isolated.isolation is None or isolated.onset is None:
        return None, sensors
    sensors = check_balance(baseline.balance, later.balance[later.time > isolated.onset])
    return diagnose(isolated.isolation, date_of(isolated.onset), sensors), sensors


def _cost(later: SteadyPoints, data: ChillerData, baseline: ChillerBaseline, config: ChillerConfig) -> ExtraCost | None:
    recent = later.select(later.time > int(data.time[-1]) - 4 * WEEK) if len(later) else later
    if not len(recent):
        return None
    vector = baseline.vector
    expected = baseline.expected_power(recent, config)
    good = np.isfinite(expected)
    if good.sum() < 2:
        return None
    power = (recent.raw["power"] - vector.layout.auxiliary)[good]
    span = data.time > int(data.time[-1]) - 4 * WEEK
    on = ~(data.raw["power"] <= 0.01 * config.rated_load)
    i = vector.layout.features.index("power")
    return extra_cost(
        power,
        expected[good],
        hours_a_day=24.0 * float(np.mean(on[span])),
        price=config.price,
        model_sd=float(np.sqrt(vector.slow[i, i] + vector.scatter[i, i] / vector.clusters)),
        independent=effective_size(power / expected[good] - 1) if len(power) > 3 else None,
    )


def _verdict(r: StudyResult) -> str:
    """One paragraph: what can be known, what was found, what it costs."""
    parts = [f"{r.config.name}: {len(r.points)} steady points.", f"Parameters are {r.decision.sentence()}."]
    parts += [f"{note[0].upper()}{note[1:]}." for note in r.baseline.vector.notes]
    if r.states:
        parts.append(
            f"{len(r.states)} later states, {100 * r.judged:.0f} % of them within what was learned and judged."
        )
    first = next((v for v in r.states if v.alarm), None)
    if r.finding is not None:
        parts.append(f"Finding: {r.finding.sentence}.")
    if first is not None:
        parts.append(f"The chart of steady states alarms on {date_of(first.time - 1)}.")
    if r.finding is None:
        parts.append("No chart is in alarm.")
    elif r.cost is not None:
        c = r.cost
        money = f", {c.money_day:.2f} {r.config.currency} a day" if np.isfinite(c.money_day) else ""
        parts.append(f"Extra energy {c.energy_day:.0f} +- {1.96 * c.energy_day_se:.0f} kWh a day{money}.")
    return " ".join(parts)


def date_of(time: int) -> str:
    """Date (UTC) of an event time [ns]."""
    return str(np.datetime64(int(time), "ns").astype("datetime64[D]"))
