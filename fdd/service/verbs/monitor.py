"""``fdd.monitor``: fit, charts and alarms for one piece of equipment from a table, without a site file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from fdd.config import Equipment
from fdd.greybox.frame import Unit, bound, nanoseconds
from fdd.greybox.record_faults import DataError
from fdd.greybox.results import FitResult
from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.records import NANOSECONDS, Alarm, Baseline, Batch, Rows
from fdd.report.telling import Speaker
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.baselines.plausible import objections
from fdd.service.baselines.structure import choose
from fdd.service.engine.engine import Engine
from fdd.service.site.naming import speaker_of
from fdd.service.site.plan import Component, Plan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HOUR, DAY = 3600 * NANOSECONDS, 86400 * NANOSECONDS


@dataclass(frozen=True)
class Monitored:
    """What monitoring found.

    Attributes
    ----------
    result, baseline : the fit, and what the filters ran on
    reasons : why this variant of the model, where there was a choice
    against : why the baseline was not put in force; nothing was watched then
    charts : one row a chart and frame (time, chart, statistic, limit), after the fitted span
    alarms : one row an alarm (raised, since, state, severity, summary); ``records`` has them whole
    """

    result: FitResult
    baseline: Baseline
    reasons: tuple[str, ...]
    against: tuple[str, ...]
    charts: pd.DataFrame
    alarms: pd.DataFrame
    records: tuple[Alarm, ...] = field(default=(), repr=False)

    def summary(self) -> str:
        """The fit, and what was watched, in words."""
        lines = [self.result.summary(), "", *self.reasons]
        if self.against:
            return "\n".join([*lines, "not watched, because", *(f"  {reason}" for reason in self.against)])
        told = [f"  {row.raised}: {row.summary}" for row in self.alarms.itertuples()]
        return "\n".join([*lines, f"{self.charts['chart'].nunique()} charts, {len(told)} alarm(s)", *told])

    def plot(self) -> Figure:
        """Every chart over its limit, with alarms as bands."""
        from matplotlib.figure import Figure

        names = list(dict.fromkeys(self.charts["chart"]))
        figure = Figure(figsize=(9, 1.2 + 1.3 * max(1, len(names))), layout="constrained")
        for axes, name in zip(np.ravel(figure.subplots(max(1, len(names)), 1, sharex=True)), names, strict=False):
            rows = self.charts[self.charts["chart"] == name]
            axes.plot(rows["time"], rows["statistic"], lw=0.8)
            axes.plot(rows["time"], rows["limit"], lw=0.8, ls="--", color="#b3400a")
            for alarm in self.alarms.itertuples():
                axes.axvspan(alarm.since, self.charts["time"].max(), color="#b3400a", alpha=0.12)
            axes.set_title(name, fontsize=8, loc="left")
        return figure


def monitor(
    df: pd.DataFrame,
    model: ComponentModel | str,
    *,
    until: str | pd.Timestamp,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, Unit] | None = None,
    zone: str | None = None,
    false_alarms_per_year: float = 1.0,
    name: str = "equipment",
    starts: int = 1,
) -> Monitored:
    """Fit a model to the healthy rows before ``until``, and watch the rest with the service's own engine.

    Parameters
    ----------
    df : datetime index, columns bound by name as :meth:`fdd.Data.from_frame` does
    model : a component model, or the name of one, whose variant is then chosen as ``fdd fit`` does
    until : end of the healthy span
    columns, units, zone : as :meth:`fdd.Data.from_frame`
    false_alarms_per_year : the promise of the charts

    Raises
    ------
    DataError, IdentifyError : what cannot be used, with the remedy

    Examples
    --------
    >>> monitor(df, "radiator", until="2026-03-01", units={"m_flow": ("l/h", "water")}).alarms  # doctest: +SKIP
    """
    if not isinstance(df.index, pd.DatetimeIndex):
        raise DataError(f"{name}: monitoring needs a datetime index, not {df.index.dtype}")
    made = get_model(model) if isinstance(model, str) else model
    component = Component(
        name=name,
        model=made,
        inputs=made.symbols["inputs"],
        outputs=made.symbols["outputs"],
        equipment=Equipment(model=model) if isinstance(model, str) else None,
    )
    points = (*component.inputs, *component.outputs)
    time = nanoseconds(df.index, zone, name)
    step = int(np.median(np.diff(time)))
    plan = Plan(
        site=name, step=step, lateness=0, max_gap=max(HOUR, 3 * step), max_jump=3650 * DAY, hold=0,
        false_alarms_per_year=false_alarms_per_year, points=points, derived=(), components=(component,),
        zone=zone or "UTC",
    )  # fmt: skip
    history = History(points, time, np.column_stack(bound(df, made, columns, units, name)))
    end = int(nanoseconds(pd.DatetimeIndex([pd.Timestamp(until)]), zone, name)[0])
    healthy, rest = history.between(None, end), history.between(end, None)
    choice = choose(plan, component, healthy)
    baseline, result = identify(plan, choice.component, healthy, start=choice.start, starts=starts)
    against = objections(choice.component, result)
    charts: list[Rows] = []
    alarms: dict[str, Alarm] = {}
    if not against:
        engine = Engine(plan, {name: baseline})
        for outputs in (engine.step(_batch(rest)), engine.flush()):
            charts += [r for r in outputs.rows if r.measurement == "charts"]
            alarms.update({a.key: a for a in outputs.alarms})
    return Monitored(
        result,
        baseline,
        choice.reasons,
        against,
        _charts(charts),
        _alarms(alarms, speaker_of(plan)),
        tuple(alarms.values()),
    )


def _batch(history: History) -> Batch:
    """Frames as samples."""
    rows, points = np.nonzero(np.isfinite(history.values))
    return Batch(
        names=history.columns,
        point=points.astype(np.int32),
        time=history.time[rows],
        value=history.values[rows, points],
        quality=np.zeros(len(rows), dtype=np.uint8),
    )


def _charts(rows: list[Rows]) -> pd.DataFrame:
    parts = [
        pd.DataFrame(
            {
                "time": pd.to_datetime(r.time, utc=True),
                "chart": np.array(r.names)[r.series],
                "statistic": r.fields["statistic"],
                "limit": r.fields["limit"],
            }
        )
        for r in rows
    ]
    return pd.concat(parts) if parts else pd.DataFrame(columns=["time", "chart", "statistic", "limit"])


def _alarms(alarms: Mapping[str, Alarm], speaker: Speaker) -> pd.DataFrame:
    names = ["raised", "since", "state", "severity", "summary"]
    rows = [(a.raised, a.since, str(a.state), a.severity, speaker.summary(a)) for a in alarms.values()]
    table = pd.DataFrame(rows, columns=names)
    for column in ("raised", "since"):
        table[column] = pd.to_datetime(table[column], utc=True)
    return table
