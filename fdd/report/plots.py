"""Evidence as pictures: SVG made without a screen, small, readable in print and by the colour-blind (Okabe-Ito)."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from zoneinfo import ZoneInfo

import matplotlib as mpl
import matplotlib.dates as mdates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fdd.evidence import parts_of
from fdd.records import NANOSECONDS, FloatArray, IntArray
from fdd.report.evidence import LEARNING, NO_DATA, ChartTrace, ParameterTrace, Trace
from fdd.report.findings import Finding
from fdd.report.site import SiteInfo
from fdd.report.words import DAY, HOUR, local, scale

BLUE, ORANGE, RED, GREY, INK = "#0072b2", "#e69f00", "#b3400a", "#8a949e", "#1f2a36"
BAND = "#cfe3f1"
HALF, TALL = (3.5, 1.65), (3.5, 2.0)
"""Sizes [inch]: half a page wide, readable on a telephone as well; with two pictures above each other."""
BINS = 210
"""Most points drawn of one line; more are averaged."""

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.titlesize": 8,
    "axes.edgecolor": "#9aa5b1",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.6,
    "xtick.color": "#56616c",
    "ytick.color": "#56616c",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 6.5,
    "svg.fonttype": "path",
    "lines.linewidth": 1.2,
}


@dataclass(frozen=True, slots=True)
class Plot:
    """A picture as a data address, and what it shows."""

    source: str
    title: str
    caption: str


def plots(finding: Finding, site: SiteInfo, start: int, end: int) -> list[Plot]:
    """The evidence of one finding; whatever has no rows is left out.

    Parameters
    ----------
    finding : with the rows of its component
    site : for units and the zone of the time axes
    start, end : the report's period [ns]
    """
    symbols = dict.fromkeys(parts_of(s.name)[0] for s in finding.signals)
    rang = [s for s in symbols if s in finding.evidence.outputs] or list(finding.evidence.outputs)
    near = (finding.since - 2 * DAY, min(end, max(finding.raised + 2 * DAY, finding.since + 3 * DAY)))
    shown = [finding.evidence.outputs[s].between(*near) for s in rang[:2]]
    made: list[Plot | None] = [_measured(finding, trace, site) for trace in shown]
    for signal in finding.signals[:2]:
        if signal.name in finding.evidence.charts:
            made.append(_chart(finding, finding.evidence.charts[signal.name].between(*near), signal.words, site))
    since = min(start, finding.since - 3 * DAY)
    made += [_trend(finding, finding.evidence.outputs[s].between(since, end), site) for s in rang[:2]]
    order = [s for s in symbols if s in finding.info.parameters]
    order += [s for s in finding.info.parameters if s not in order]
    moving = [finding.evidence.parameters[s] for s in order if s in finding.evidence.parameters]
    made += [_parameter(finding, p, site) for p in [p for p in moving if _has_history(p)][:4]]
    return _told_once([p for p in made if p is not None])


def _told_once(plots: list[Plot]) -> list[Plot]:
    """How to read a kind of picture is said under the first of its kind."""
    told: set[str] = set()
    found = []
    for p in plots:
        found.append(replace(p, caption="") if p.caption in told else p)
        told.add(p.caption)
    return found


def _draw(name: str, size: tuple[float, float], rows: int, paint: Callable[[list[Axes]], None], tz: ZoneInfo) -> str:
    """An SVG as a data address; the same data give the same bytes."""
    style: Any = {**STYLE, "svg.hashsalt": name}
    with mpl.rc_context(style):
        figure = Figure(figsize=size, layout="constrained")
        axes = list(np.atleast_1d(figure.subplots(rows, 1, sharex=True)))
        paint(axes)
        locator = mdates.AutoDateLocator(minticks=3, maxticks=5, tz=tz)  # type: ignore[no-untyped-call]
        axes[-1].xaxis.set_major_locator(locator)
        axes[-1].xaxis.set_major_formatter(_formatter(locator, tz))
        buffer = io.BytesIO()
        empty = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=empty)
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()


def _formatter(locator: mdates.AutoDateLocator, tz: ZoneInfo) -> mdates.ConciseDateFormatter:
    return mdates.ConciseDateFormatter(  # type: ignore[no-untyped-call]
        locator,
        tz=tz,
        formats=["%Y", "%b %Y", "%-d %b", "%H:%M", "%H:%M", "%H:%M"],
        zero_formats=["", "%Y", "%b %Y", "%-d %b", "%H:%M", "%H:%M"],
        offset_formats=["", "", "%Y", "%b %Y", "%-d %b %Y", "%-d %b %Y"],
    )


def _dates(time: IntArray) -> FloatArray:
    return np.asarray(time / (86400 * NANOSECONDS), dtype=np.float64)  # matplotlib: days since the epoch


def _marks(axes: Axes, finding: Finding) -> None:
    """Onset and alarm, where they lie inside the picture."""
    low, high = axes.get_xlim()
    for time, colour, style, word in (
        (finding.since, ORANGE, (0, (4, 2)), "onset"),
        (finding.raised, RED, "-", "alarm"),
    ):
        x = float(_dates(np.array([time]))[0])
        if low <= x <= high:
            axes.axvline(x, color=colour, linestyle=style, linewidth=1.3, zorder=3, label=word)


def _legend(axes: Axes) -> None:
    """Above the picture, in one line, where nothing is hidden."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=6, borderaxespad=0.1, handlelength=1.1, columnspacing=0.8,
        handletextpad=0.5,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Binned:
    time: IntArray
    measured: FloatArray
    predicted: FloatArray
    sd: FloatArray
    count: FloatArray
    width: int


def _binned(trace: Trace, bins: int = BINS) -> _Binned:
    """Means over equal spans; the scatter of a mean of n white residuals is sd / sqrt(n)."""
    n = len(trace.time)
    if n <= bins:
        return _Binned(trace.time, trace.measured, trace.predicted, trace.sd, np.ones(n), 0)
    span = int(trace.time[-1] - trace.time[0])
    width = max(HOUR // 4, -(-span // bins))
    width = next((w for w in (HOUR // 4, HOUR // 2, HOUR, 2 * HOUR, 3 * HOUR, 6 * HOUR, 12 * HOUR) if w >= width), DAY)
    group = (trace.time - trace.time[0]) // width
    good = np.isfinite(trace.measured) & np.isfinite(trace.predicted)
    index, inverse = np.unique(group[good], return_inverse=True)
    count = np.bincount(inverse).astype(np.float64)
    full = count >= 0.5 * np.median(count)  # the last span may hold few values, and would draw a spike in the band

    def mean(values: FloatArray) -> FloatArray:
        return (np.bincount(inverse, values[good]) / count)[full]

    middle = trace.time[0] + index[full] * width + width // 2
    return _Binned(middle, mean(trace.measured), mean(trace.predicted), mean(trace.sd), count[full], width)


def _gaps(time: IntArray, *values: FloatArray) -> tuple[FloatArray, ...]:
    """Times and values with a break wherever data were missing, so that no line is drawn across."""
    if len(time) < 3:
        return (_dates(time), *values)
    steps = np.diff(time)
    breaks = np.flatnonzero(steps > 3 * np.median(steps)) + 1
    return (np.insert(_dates(time), breaks, np.nan), *(np.insert(v, breaks, np.nan) for v in values))


def _measured(finding: Finding, trace: Trace, site: SiteInfo) -> Plot | None:
    output = finding.info.outputs.get(trace.symbol)
    b = _binned(trace)
    if output is None or len(b.time) < 2:
        return None
    largest = float(np.nanmax(np.abs(b.measured))) if np.isfinite(b.measured).any() else 1.0
    factor, unit = scale(output.unit, largest)
    _, difference_unit = scale(output.unit, largest, difference=True)
    band = 1.96 * b.sd / np.sqrt(b.count) * factor
    residual = (b.measured - b.predicted) * factor
    time, measured, predicted, half, off = _gaps(b.time, b.measured * factor, b.predicted * factor, band, residual)

    def paint(axes: list[Axes]) -> None:
        top, bottom = axes
        top.fill_between(time, predicted - half, predicted + half, color=BAND, linewidth=0, label="band")
        top.plot(time, predicted, color=BLUE, linewidth=1.0, label="expected")
        top.plot(time, measured, color=INK, linewidth=0.9, label="measured")
        top.set_ylabel(f"reading [{unit or '1'}]")
        top.margins(x=0.005)
        bottom.fill_between(time, -half, half, color=BAND, linewidth=0)
        bottom.axhline(0, color=BLUE, linewidth=0.8)
        bottom.plot(time, off, color=INK, linewidth=0.9)
        bottom.set_ylabel(f"difference\n[{difference_unit or '1'}]")
        for a in axes:
            _marks(a, finding)
        _legend(top)

    means = _width(b.width)
    return Plot(
        _draw(f"{finding.key}/{trace.symbol}/measured", TALL, 2, paint, site.tz),
        _title(output.meaning),
        f"Measured, and expected one step ahead{means}. While healthy, 95 of 100 values lie inside the band. "
        "Below: their difference.",
    )


def _width(width: int) -> str:
    if not width:
        return ""
    minutes = width // (60 * NANOSECONDS)
    span = f"{minutes}-minute" if minutes < 60 else "hourly" if minutes == 60 else f"{minutes // 60}-hour"
    return f" ({span} means)"


def _title(text: str) -> str:
    return text[:1].upper() + text[1:]


def _chart(finding: Finding, trace: ChartTrace, words: str, site: SiteInfo) -> Plot | None:
    if len(trace.time) < 2:
        return None
    keep = slice(None, None, max(1, len(trace.time) // (4 * BINS)))
    when, statistic, limit = _gaps(trace.time[keep], trace.statistic[keep], trace.limit[keep])

    def paint(axes: list[Axes]) -> None:
        (a,) = axes
        a.plot(when, statistic, color=INK, linewidth=1.1, label="statistic")
        a.plot(when, limit, color=RED, linestyle=(0, (5, 2)), linewidth=1.2, label="limit")
        a.set_ylim(0, None)
        a.margins(x=0.005)
        for phase, colour, word in ((LEARNING, "#f4ecd2", "learning"), (NO_DATA, "#eceff2", "no data")):
            _shade(a, trace, phase, colour, word)
        a.set_ylabel("chart statistic [1]")
        _marks(a, finding)
        _legend(a)

    return Plot(
        _draw(f"{trace.name}/chart", HALF, 1, paint, site.tz),
        words.rstrip("."),
        "Lasting departures add up; past the limit it alarms.",
    )


def _shade(axes: Axes, trace: ChartTrace, phase: int, colour: str, word: str) -> None:
    """Spans in one phase that last longer than an hour."""
    inside = np.concatenate([[False], trace.phase == phase, [False]])
    edges = np.flatnonzero(np.diff(inside.astype(np.int8)))
    label: str | None = word
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if trace.time[b - 1] - trace.time[a] > HOUR:
            first, last = _dates(trace.time[[a, b - 1]])
            axes.axvspan(first, last, color=colour, linewidth=0, zorder=0, label=label)
            label = None


def daily_means(trace: Trace, tz: ZoneInfo) -> tuple[IntArray, FloatArray, FloatArray]:
    """Mean standardised innovation of each local day and the number of values in it: (noon [ns], mean, count)."""
    good = np.isfinite(trace.innovation)
    if not good.any():
        return np.empty(0, dtype=np.int64), np.empty(0), np.empty(0)
    import pandas as pd

    stamps = pd.to_datetime(trace.time[good], unit="ns", utc=True).tz_convert(tz)
    days = stamps.normalize().tz_convert("UTC").as_unit("ns").asi8
    day, inverse = np.unique(days, return_inverse=True)
    count = np.bincount(inverse).astype(np.float64)
    return day + DAY // 2, np.bincount(inverse, trace.innovation[good]) / count, count


def _trend(finding: Finding, trace: Trace, site: SiteInfo) -> Plot | None:
    output = finding.info.outputs.get(trace.symbol)
    noon, mean, count = daily_means(trace, site.tz)
    if output is None or len(noon) < 2:
        return None
    half = 1.96 / np.sqrt(count)
    when = _dates(noon)

    def paint(axes: list[Axes]) -> None:
        (a,) = axes
        a.axhline(0, color=BLUE, linewidth=0.8)
        a.fill_between(when, -half, half, color=BAND, step="mid", linewidth=0, label="healthy band")
        out = np.abs(mean) > half
        a.plot(when, mean, color=GREY, linewidth=0.8, zorder=2)
        a.plot(when[~out], mean[~out], "o", markersize=3.2, color=BLUE, zorder=3)
        a.plot(when[out], mean[out], "s", markersize=3.4, color=RED, zorder=3, label="outside")
        a.set_ylabel("mean error [sd]")
        a.margins(x=0.02)
        _marks(a, finding)
        _legend(a)

    return Plot(
        _draw(f"{finding.key}/{trace.symbol}/trend", HALF, 1, paint, site.tz),
        f"Day by day: {output.meaning}",
        "Daily mean error of the prediction, in its own standard deviations (sd).",
    )


def _has_history(p: ParameterTrace) -> bool:
    return len(p.time) >= 2 or len(p.baselines) >= 2 or (len(p.time) >= 1 and len(p.baselines) >= 1)


def _parameter(finding: Finding, p: ParameterTrace, site: SiteInfo) -> Plot | None:
    described = finding.info.parameters[p.symbol]
    values = [*p.value[np.isfinite(p.value)], *(b[3] for b in p.baselines)]
    if not values:
        return None
    factor, unit = scale(described.unit, max(abs(v) for v in values))

    def paint(axes: list[Axes]) -> None:
        (a,) = axes
        if len(p.time):
            value, lower, upper = (v * factor for v in (p.value, p.lower, p.upper))
            reach = np.nan_to_num(np.clip([value - lower, upper - value], 0, None))
            a.errorbar(
                _dates(p.time), value, yerr=reach, fmt="o", markersize=3, color=INK, ecolor=GREY, elinewidth=0.9,
                capsize=1.5, label="estimate",
            )  # fmt: skip
        label: str | None = "baseline"
        for version, first, last, level, error in p.baselines:
            x = _dates(np.array([first, last]))
            half = 1.96 * error * factor if np.isfinite(error) else 0.0
            a.fill_between(x, level * factor - half, level * factor + half, color=BAND, linewidth=0)
            a.plot(x, [level * factor] * 2, color=BLUE, linewidth=1.6, label=label)
            a.annotate(
                f"v{version}",
                (x[0], level * factor),
                xytext=(2, 3),
                textcoords="offset points",
                fontsize=6.5,
                color=BLUE,
            )
            label = None
        a.set_ylabel(f"[{unit or '1'}]")
        a.margins(x=0.03, y=0.15)
        _marks(a, finding)
        _legend(a)

    return Plot(
        _draw(f"{finding.component}/{p.symbol}/parameter", HALF, 1, paint, site.tz),
        _title(described.meaning or p.symbol),
        "Estimates and baselines (v1, v2, ...), with 95 % intervals.",
    )


def alt(plot: Plot, finding: Finding, site: SiteInfo) -> str:
    """The picture in a sentence, for those who cannot see it."""
    return f"{plot.title}; estimated onset {local(finding.since, site.tz)}, alarm {local(finding.raised, site.tz)}"
