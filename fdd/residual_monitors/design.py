"""Chart design for people: false alarms a year in, limits and delays in hours out, as a table and as a plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.run_length import Kind, Rule, Start, arl, baseline_effect, limit_for, run_length_quantile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
TICKS = (1.0, 10.0, 60.0, 300.0, 900.0, 3600.0, 14_400.0, 86_400.0, 345_600.0, 1_382_400.0, 5_184_000.0, 4 * YEAR)
"""Times that an axis of delays is marked at [s]."""
SHIFTS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
Sampling = Literal["point", "mean"]


@dataclass(frozen=True, slots=True)
class Design:
    """One chart, ready to be judged.

    Attributes
    ----------
    rule, limit : the chart and its limit
    interval : time between samples [s]
    false_alarms_per_year : promised for this chart [1/a]
    shifts : standard deviations of a sample
    delay, late : mean and 90 % quantile of the time to detection for each shift [s], from a settled chart (MEWMA, EWMA
        with exact limits: from the start)
    begin : where the chart stands when the shift comes, see :mod:`fdd.residual_monitors.run_length`
    """

    rule: Rule
    limit: float
    interval: float
    false_alarms_per_year: float
    shifts: tuple[float, ...]
    delay: tuple[float, ...]
    late: tuple[float, ...]
    begin: Start = "steady"

    def quantiles(self, shift: float, levels: Sequence[float] = QUANTILES) -> list[float]:
        """Times within which an alarm comes with these probabilities [s]; at shift 0 those of false alarms."""
        return [self.interval * run_length_quantile(self.rule, self.limit, p, shift, self.begin) for p in levels]

    @property
    def name(self) -> str:
        """The chart with its constants, as people write it."""
        constants = {
            "cusum": f"k = {self.rule.k:g}, h",
            "ewma": f"lam = {self.rule.lam:g}, L",
            "mewma": f"lam = {self.rule.lam:g}, {self.rule.dimension} outputs, H",
            "shewhart": "L",
        }[self.rule.kind]
        return f"{self.rule.kind}, {constants} = {self.limit:.4g}"


def design_chart(
    kind: Kind,
    false_alarms_per_year: float,
    interval: float,
    *,
    availability: float = 1.0,
    shifts: Sequence[float] = SHIFTS,
    baseline: int | None = None,
    head_start: float = 0.0,
    **constants: float,
) -> Design:
    """Limit and delays of one chart.

    Parameters
    ----------
    kind : ``cusum``, ``ewma``, ``mewma`` or ``shewhart``
    false_alarms_per_year : for this chart [1/a]
    interval : time between samples [s]
    availability : share of the year with samples
    shifts : to tabulate, standard deviations of a sample (Mahalanobis distance for a MEWMA)
    baseline : samples the baseline's mean was estimated from; widens the limit
    head_start : of a CUSUM, share of the limit; delays are then those from the start
    constants : ``k``, ``lam``, ``dimension``, ``sided``, ``exact``

    Raises
    ------
    ValueError
        Where no limit can keep the promise.
    """
    if not (false_alarms_per_year > 0 and interval > 0 and 0 < availability <= 1):
        raise ValueError(
            f"false alarms a year {false_alarms_per_year}, interval {interval} s and availability {availability} "
            "must be positive, availability at most 1"
        )
    rule = Rule(kind, **constants)  # type: ignore[arg-type]  # the constants of a Rule
    wanted = availability * YEAR / interval / false_alarms_per_year
    limit = float(
        limit_for(
            kind, wanted, head_start=head_start, shift_sd=baseline**-0.5 if baseline else 0.0, k=rule.k, lam=rule.lam,
            sided=rule.sided, dimension=rule.dimension, exact=rule.exact,
        )
    )  # fmt: skip
    begin: Start = "zero" if rule.exact or kind in ("mewma", "shewhart") else "steady"
    if head_start:
        begin = head_start
    return Design(
        rule, limit, interval, false_alarms_per_year, tuple(shifts),
        tuple(interval * arl(rule, limit, s, begin) for s in shifts),
        tuple(interval * run_length_quantile(rule, limit, 0.9, s, begin) for s in shifts),
        begin,
    )  # fmt: skip


def design_table(designs: Sequence[Design]) -> tuple[list[str], list[list[str]]]:
    """Head and rows: a row a chart, and for each shift the mean delay (90 % are faster than the bracket)."""
    shifts = sorted({s for d in designs for s in d.shifts})
    head = ["chart", "samples every", "false alarms a year", *(f"{s:g} sd" for s in shifts)]
    rows = []
    for d in designs:
        at = {s: f"{duration(m)} ({duration(q)})" for s, m, q in zip(d.shifts, d.delay, d.late, strict=True)}
        rows.append([d.name, duration(d.interval), f"{d.false_alarms_per_year:g}", *(at.get(s, "") for s in shifts)])
    return head, rows


def quantile_table(design: Design, shifts: Sequence[float] | None = None) -> tuple[list[str], list[list[str]]]:
    """Head and rows: mean and quantiles of the time to an alarm, a row a shift; without one to a false one."""
    head = ["shift", "mean", *(f"{p:.0%} within" for p in QUANTILES)]
    rows = []
    for s in (0.0, *(design.shifts if shifts is None else shifts)):
        mean = design.interval * arl(design.rule, design.limit, s, design.begin)
        rows.append(["none" if s == 0 else f"{s:g} sd", duration(mean), *map(duration, design.quantiles(s))])
    return head, rows


def sampling_table(
    design: Design, shift: float = 0.5, every: Sequence[int] = (1, 3, 12)
) -> tuple[list[str], list[list[str]]]:
    """Head and rows: mean delay to the same fault where samples are taken more seldom, or averaged over longer."""
    head = ["samples every", "single values: limit", "mean delay", "means over the interval: limit", "mean delay"]
    constants = {"k": design.rule.k, "lam": design.rule.lam, "dimension": design.rule.dimension}
    intervals = [design.interval * n for n in every]
    kind, rate, base = design.rule.kind, design.false_alarms_per_year, design.interval
    columns = [
        sampling_effect(kind, rate, intervals, shift, base=base, sampling=s, **constants) for s in ("point", "mean")
    ]  # fmt: skip
    rows = [
        [duration(t), f"{p.limit:.4g}", duration(p.delay[0]), f"{m.limit:.4g}", duration(m.delay[0])]
        for t, p, m in zip(intervals, *columns, strict=True)
    ]
    return head, rows


def duration(seconds: float) -> str:
    """A time as people say it: 25 min, 3.2 h, 12 d."""
    for unit, size, next_size in (("s", 1.0, 120.0), ("min", 60.0, 7200.0), ("h", 3600.0, 172_800.0)):
        if seconds < next_size:
            return f"{seconds / size:.3g} {unit}"
    days = seconds / 86400.0
    return f"{days:.3g} d" if days < 1000 else f"{days / 365.25:.3g} a"


def design_plot(designs: Sequence[Design], path: Path | None = None) -> Figure:
    """Delay against shift, both on log scales; written to ``path`` (svg, png, pdf) where given."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for d in designs:
        hours = np.array(d.delay) / 3600
        (line,) = axes.loglog(d.shifts, hours, marker="o", ms=3, label=f"{d.name}, every {duration(d.interval)}")
        axes.fill_between(d.shifts, hours, np.array(d.late) / 3600, alpha=0.12, color=line.get_color())
    shifts = sorted({s for d in designs for s in d.shifts})
    axes.set_xticks(shifts, [f"{s:g}" for s in shifts])
    low, high = axes.get_ylim()
    marks = [t for t in TICKS if low <= t / 3600 <= high]
    axes.set_yticks([t / 3600 for t in marks], [duration(t) for t in marks])
    axes.minorticks_off()
    axes.set_xlabel("shift [standard deviations of a sample]")
    axes.set_ylabel("delay: mean (line) to 90 % found (band)")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    if path is not None:
        figure.savefig(path)
    return figure


def sampling_effect(
    kind: Kind,
    false_alarms_per_year: float,
    intervals: Sequence[float],
    shift: float,
    *,
    base: float,
    sampling: Sampling = "point",
    **constants: float,
) -> list[Design]:
    """The same fault watched at different sampling intervals, at the same false alarms a year.

    Parameters
    ----------
    shift : standard deviations of a sample taken every ``base`` seconds
    sampling : ``"point"``: a sample's noise does not depend on the interval; ``"mean"``: samples are means over the
        interval of white noise, so that the shift grows with the root of it
    """
    out = []
    for interval in intervals:
        own = shift * (np.sqrt(interval / base) if sampling == "mean" else 1.0)
        out.append(design_chart(kind, false_alarms_per_year, interval, shifts=(float(own),), **constants))  # type: ignore[arg-type]
    return out


def baseline_table(
    design: Design, samples: Sequence[int] = (30, 100, 300, 1000, 4000)
) -> tuple[list[str], list[list[str]]]:
    """What a baseline of so many samples does to the false alarms of a chart designed for a known one."""
    head = ["baseline samples", "median time between false alarms", "false alarms a year instead of one"]
    rows = []
    for m in samples:
        effect = baseline_effect(design.rule, design.limit, m, 100)
        per_year = effect.rate * YEAR / design.interval / design.false_alarms_per_year
        rows.append([str(m), duration(effect.median * design.interval), f"{per_year:.3g}"])
    return head, rows
