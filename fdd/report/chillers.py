"""What the report says of each chiller: may its parameters be believed, what are they, how far is its power off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fdd.records import Baseline
from fdd.report.evidence import Evidence, Trace
from fdd.report.findings import Finding
from fdd.report.site import ComponentInfo, SiteInfo
from fdd.report.telling import Speaker
from fdd.report.words import DAY, in_words, interval, local_day, percent, quantity, sentence
from fdd.store.store import Store

MODEL = "gordon_ng"
"""Model of the baselines this page speaks of."""

LEVELS = {
    "all parameters": "All parameters can be told from its data and are watched week by week.",
    "internal loss and resistance, leak held": "Internal loss and resistance are watched week by week; "
    "the leak is held at its baseline",
    "power residual only": "Its parameters cannot be identified; its steady states are watched",
}


@dataclass(frozen=True, slots=True)
class ParameterLine:
    """One parameter: on the baseline and as last estimated, each with its 95 % interval."""

    meaning: str
    baseline: str
    baseline_interval: str
    latest: str
    latest_interval: str
    when: str


@dataclass(frozen=True, slots=True)
class ChillerSection:
    """One chiller in words."""

    component: str
    title: str
    state: str
    reasons: tuple[str, ...]
    parameters: tuple[ParameterLine, ...]
    residual: str
    last_day: str
    """Measured and expected power over the last day with points."""
    severity: str
    points: str
    charts: tuple[tuple[str, str], ...]
    """What each chart watches, and how far its statistic is from its limit."""
    cost: str


def chiller_section(
    store: Store,
    site: SiteInfo,
    baseline: Baseline,
    evidence: Evidence,
    findings: Sequence[Finding],
    start: int,
    end: int,
) -> ChillerSection:
    """Everything about one chiller in the period [start, end) [ns]; ``findings`` are its own."""
    name, info = baseline.component, site.component(baseline.component)
    level = str(baseline.diagnostics.get("level", ""))
    reasons = tuple(sentence(in_words(r, info)) for r in baseline.diagnostics.get("reasons", ()))
    trace = evidence.outputs.get("power")
    inside = None if trace is None else trace.between(start, end)
    return ChillerSection(
        component=name,
        title=info.title,
        state=sentence(LEVELS.get(level, level)),
        reasons=reasons,
        parameters=tuple(_line(s, info, baseline, evidence, site) for s in info.parameters if s in baseline.parameters),
        residual=_residual(inside),
        last_day=_last_day(inside, site),
        severity=next((f.severity for f in findings), ""),
        points=_points(store, name, inside, start, end),
        charts=tuple(_charts(site, evidence, start, end)),
        cost=next((f"{f.cost} ({f.cost_detail})" if f.cost_detail else f.cost for f in findings if f.cost), ""),
    )


def _line(symbol: str, info: ComponentInfo, baseline: Baseline, evidence: Evidence, site: SiteInfo) -> ParameterLine:
    described = info.parameters[symbol]
    value, error = baseline.parameters[symbol], baseline.standard_errors.get(symbol, float("nan"))
    spread = "held" if not np.isfinite(error) else _interval(value - 1.96 * error, value + 1.96 * error, described.unit)
    latest, latest_interval, when = "", "", ""
    trace = evidence.parameters.get(symbol)
    # The first row of a baseline repeats its own value; only later ones are estimates.
    newer = np.flatnonzero(trace.value != value) if trace is not None else np.zeros(0, dtype=np.int64)
    if trace is not None and len(newer):
        i = int(newer[-1])
        latest, when = quantity(float(trace.value[i]), described.unit), local_day(int(trace.time[i]), site.tz)
        latest_interval = _interval(float(trace.lower[i]), float(trace.upper[i]), described.unit)
    return ParameterLine(described.meaning, quantity(value, described.unit), spread, latest, latest_interval, when)


def _interval(low: float, high: float, unit: str) -> str:
    return interval(low, high, unit) if np.isfinite(low) and np.isfinite(high) else "not known"


def _residual(trace: Trace | None) -> str:
    """Median of measured over expected power, with the spread of the points."""
    if trace is None or not len(trace.time):
        return "no steady point in this period"
    share = 100 * (trace.measured / trace.predicted - 1)
    share = share[np.isfinite(share)]
    if not len(share):
        return "no steady point in this period"
    spread = 1.4826 * float(np.median(np.abs(share - np.median(share))))
    return f"{np.median(share):+.1f} % of the expected power (median; points scatter by {spread:.1f} %)"


def _last_day(trace: Trace | None, site: SiteInfo) -> str:
    """Mean power over the last day that had steady points, and what the healthy machine would have drawn."""
    if trace is None or not len(trace.time):
        return "no steady point in this period"
    last = trace.between(int(trace.time[-1]) + 1 - DAY, int(trace.time[-1]) + 1)
    both = np.isfinite(last.measured) & np.isfinite(last.predicted)
    if not both.any():
        return "no steady point in this period"
    measured, expected = float(last.measured[both].mean()), float(last.predicted[both].mean())
    return (
        f"{quantity(measured, 'W')} measured, {quantity(expected, 'W')} expected "
        f"(24 hours to {local_day(int(last.time[-1]), site.tz)}, {int(both.sum())} steady points)"
    )


def _points(store: Store, name: str, trace: Trace | None, start: int, end: int) -> str:
    table = store.read("gates", [f"{name}/steady"], start, end)
    points = 0 if trace is None else len(trace.time)
    if not len(table):
        return f"{points} steady points in this period"
    last = table.iloc[-1]
    kept, seen = float(last["kept"]), float(last["seen"])
    share = f"; {percent(kept / seen)} of all samples were steady since the service started" if seen > 0 else ""
    return f"{points} steady points in this period{share}"


def _charts(site: SiteInfo, evidence: Evidence, start: int, end: int) -> list[tuple[str, str]]:
    found = []
    for name, chart in evidence.charts.items():
        part = chart.between(start, end)
        good = np.flatnonzero(np.isfinite(part.statistic) & np.isfinite(part.limit))
        if len(good):
            ratio = float(part.statistic[good[-1]] / part.limit[good[-1]])
            words = "over its limit" if ratio >= 1 else f"{percent(ratio)} of its limit"
            found.append((sentence(Speaker(site).chart(name)).rstrip("."), words))
    return found
