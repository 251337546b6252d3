"""What was watched, what was not and why, and whether the promise on false alarms was kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.judged import is_consequence, judged_false
from fdd.evidence import ChartKind, parts_of
from fdd.records import NANOSECONDS, Alarm, Baseline
from fdd.report.evidence import ALARM, LEARNING, QUIET, Evidence, step_of
from fdd.report.site import ComponentInfo, SiteInfo
from fdd.report.words import COUNTS, DAY, duration, local, percent, quantity
from fdd.residual_monitors.budget import Realised, realised
from fdd.store.store import Store

ENOUGH = 0.8
"""A component watched for less of the period than this is reported as not fully monitored."""


SLOW = {ChartKind.CLUSTER: DAY, ChartKind.WEEKLY: 7 * DAY}
"""How often charts judge that do not judge with every step, by kind [ns]."""


@dataclass(frozen=True, slots=True)
class Watch:
    """How far one component was watched in the period."""

    component: str
    info: ComponentInfo
    watched: float
    """Share of the period in which its charts could judge."""
    learning: float
    last: int | None
    """Event time of the last prediction [ns]."""
    fit: tuple[tuple[str, str], ...]
    """Each output's meaning, and its typical one-step error with unit."""
    patience: int = DAY
    """Silence longer than this is told [ns]; a chiller's day is judged when it is over."""


@dataclass(frozen=True, slots=True)
class Unmonitored:
    """What could not be monitored, why, and what would help."""

    title: str
    name: str
    what: str
    why: str
    remedy: str


@dataclass(frozen=True, slots=True)
class Budget:
    """False alarms promised and alarms that came."""

    raised: int
    judged_false: int
    consequences: int
    years: float
    """Time watched, all charts together taken as one plant [a]."""
    false: Realised | None
    """The alarms that somebody judged false against the budget."""
    most: Realised | None
    """All alarms, as if every one were false."""


@dataclass(frozen=True, slots=True)
class Count:
    """One data quality count since the service started."""

    words: str
    value: int


def watch(name: str, info: ComponentInfo, evidence: Evidence, start: int, end: int) -> Watch:
    """How far a component was watched from ``start`` to ``end`` [ns]."""
    if info.daily:
        return _watched_daily(name, info, evidence, start, end)
    judged, learning = [], []
    kinds = {name: parts_of(name)[1] for name in evidence.charts}
    for name_, chart in evidence.charts.items():
        interval = SLOW.get(kinds[name_], step_of(evidence))
        if interval > max(end - start, DAY):
            continue
        frames = max(1.0, (end - start) / interval)
        part = chart.between(start, end)
        learns = part.phase == LEARNING
        # A score chart that learns what its baseline is off by may ring meanwhile.
        waits = learns & (kinds[name_] is not ChartKind.SCORE)
        judged.append(np.count_nonzero(((part.phase == QUIET) | (part.phase == ALARM) | learns) & ~waits) / frames)
        learning.append(np.count_nonzero(waits) / frames)
    times = [int(t.time[-1]) for t in evidence.outputs.values() if len(t.time)]
    fit = []
    for symbol, output in info.outputs.items():
        if symbol in evidence.outputs:
            part_ = evidence.outputs[symbol].between(start, end)
            residual = part_.measured - part_.predicted
            if np.isfinite(residual).any():
                error = float(np.sqrt(np.nanmean(residual**2)))
                fit.append((output.meaning, quantity(error, output.unit, difference=True)))
    patience = 2 * DAY if ChartKind.CLUSTER in kinds.values() else DAY
    return Watch(name, info, _mean(judged), _mean(learning), max(times, default=None), tuple(fit), patience)


def _watched_daily(name: str, info: ComponentInfo, evidence: Evidence, start: int, end: int) -> Watch:
    """The same for equipment that is judged once a day: by the days that had a verdict."""
    parts = [chart.between(start, end) for chart in evidence.charts.values()]
    days = {int(t) for part in parts for t in part.time}
    share = min(1.0, len(days) / max(1.0, (end - start) / DAY))
    return Watch(name, info, share, 0.0, max(days, default=None), (), 2 * DAY)


def _mean(shares: Sequence[float]) -> float:
    return min(1.0, sum(shares) / len(shares)) if shares else 0.0


def unmonitored(w: Watch, baseline: Baseline | None, site: SiteInfo, start: int, end: int) -> list[Unmonitored]:
    """Why a component, or a part of it, was not watched; empty where all was well."""
    gaps = [
        Unmonitored(
            w.info.title,
            w.component,
            output.meaning,
            "no sensor is mapped to it",
            "Name its point under 'outputs' in the site file, or leave it so where there is no sensor.",
        )
        for output in w.info.outputs.values()
        if not output.point
    ]
    reason = _reason(w, baseline, site, start, end)
    if reason:
        gaps.insert(0, Unmonitored(w.info.title, w.component, *reason))
    return gaps


def _reason(w: Watch, baseline: Baseline | None, site: SiteInfo, start: int, end: int) -> tuple[str, str, str] | None:
    data = "Check the data connection, the sensors it reads and whether the machine was meant to be off."
    if w.info.daily and w.last is None:
        return "everything", "no day of this period allowed a judgement", data
    if w.info.daily:
        return None
    if baseline is None:
        fit = "Fit a baseline on a healthy stretch of data: fdd fit."
        return "everything", "it has no healthy baseline to compare with", fit
    if w.last is None:
        return "everything", "there were no usable data in this period: no reading could be predicted", data
    if w.watched == 0 and w.learning > 0:
        return "everything", "its charts are still learning what is normal", "Wait; nothing has to be done."
    if end - w.last > w.patience:
        silent = f"no usable data since {local(w.last, site.tz)} ({duration(end - w.last)})"
        return "the end of the period", silent, data
    if w.watched < ENOUGH:
        share = f"{percent(1 - w.watched)} of the period"
        parts = [f"{percent(w.learning)} of it its charts were learning"] if w.learning > 0.01 else []
        parts.append("readings were missing, or the machine was off or starting")
        return share, "; ".join(parts), data
    return None


def budget(alarms: Sequence[Alarm], watches: Sequence[Watch], site: SiteInfo, start: int, end: int) -> Budget:
    """Alarms raised in the period against the budget, over the time the charts could judge.

    An alarm counts as false where whoever closed it said so: its last comment begins with "false".
    """
    raised = [a for a in alarms if start <= a.raised < end]
    own = [a for a in raised if not is_consequence(a)]
    false = [a for a in own if judged_false(a)]
    seconds = (end - start) / NANOSECONDS * (sum(w.watched for w in watches) / len(watches) if watches else 0.0)

    def against(count: int) -> Realised | None:
        return realised(count, seconds, site.false_alarms_per_year) if seconds > 0 else None

    years = seconds / (365.25 * 86400)
    return Budget(len(own), len(false), len(raised) - len(own), years, against(len(false)), against(len(own)))


def counts(store: Store, end: int) -> tuple[Count, ...]:
    """The last value of every data quality count before ``end``, in words."""
    rows = store.read("counts", None, None, end)
    last = rows.groupby("series", sort=True).tail(1)
    return tuple(
        Count(_count_words(str(series)), int(value))
        for series, value in zip(last["series"], last["value"], strict=True)
        if np.isfinite(value)
    )


def _count_words(series: str) -> str:
    part, _, what = series.rpartition("/")
    if what.startswith("restart: "):
        return f"filters started afresh because {what.removeprefix('restart: ')}"
    words = COUNTS.get(what, what.replace("_", " "))
    return f"{words} ({part})" if part and part not in ("engine", "framer", "ingest") else words


def by_component(baselines: Sequence[Baseline]) -> Mapping[str, tuple[Baseline, ...]]:
    """All versions of each component's baseline, oldest first."""
    groups: dict[str, list[Baseline]] = {}
    for b in sorted(baselines, key=lambda b: b.version):
        groups.setdefault(b.component, []).append(b)
    return {name: tuple(versions) for name, versions in groups.items()}
