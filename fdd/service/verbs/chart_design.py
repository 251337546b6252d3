"""``fdd charts design``: what a promised rate of false alarms makes of a chart's limit, and how soon it finds what."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from fdd.records import JsonObject
from fdd.report.figures_page import Part, picture, write_page
from fdd.residual_monitors.design import (
    QUANTILES,
    Design,
    baseline_table,
    design_chart,
    design_plot,
    design_table,
    duration,
    quantile_table,
    sampling_table,
)
from fdd.residual_monitors.run_length import Kind
from fdd.service.site.errors import UsageError

NOTE = (
    "Mean delay; nine of ten are found within the bracket. Shifts in standard deviations of a sample; "
    "samples are independent."
)

QUANTILE_NOTE = "Of a hundred charts, so many have rung by then: for nothing (no shift), or for a lasting shift."
SAMPLING_NOTE = (
    "The same lasting fault (half a standard deviation at the first interval), at the same false alarms a year."
)


def designs(
    kinds: Sequence[Kind],
    per_year: float,
    intervals: Sequence[float],
    *,
    baseline: int | None = None,
    availability: float = 1.0,
    k: float = 0.5,
    lam: float = 0.1,
    dimension: int = 2,
) -> list[Design]:
    """A design for each kind at each sampling interval [s].

    Raises
    ------
    UsageError : an unknown kind, or numbers for which no limit exists
    """
    unknown = [kind for kind in kinds if kind not in get_args(Kind)]
    if unknown:
        raise UsageError(f"no run lengths for a chart {unknown[0]!r}; --kind takes {', '.join(get_args(Kind))}")
    try:
        return [
            design_chart(
                kind,
                per_year,
                interval,
                baseline=baseline,
                availability=availability,
                k=k,
                lam=lam,
                dimension=dimension,
            )
            for kind in kinds
            for interval in intervals
        ]
    except ValueError as error:
        raise UsageError(f"charts design: {error}") from None


def document(found: Sequence[Design]) -> JsonObject:
    """For machines; times in seconds."""
    return {
        "designs": [
            {
                "kind": d.rule.kind,
                "name": d.name,
                "limit": d.limit,
                "interval_seconds": d.interval,
                "false_alarms_per_year": d.false_alarms_per_year,
                "shift_sd": list(d.shifts),
                "mean_delay_seconds": list(d.delay),
                "delay_90_percent_seconds": list(d.late),
                "quantile_levels": list(QUANTILES),
                "false_alarm_quantiles_seconds": d.quantiles(0.0),
                "delay_quantiles_seconds": [d.quantiles(s) for s in d.shifts],
            }
            for d in found
        ]
    }


def write_design_page(found: Sequence[Design], path: Path) -> Path:
    """Table and plot; quantiles of the run length, what sampling changes, and what a short baseline costs."""
    head, rows = design_table(found)
    parts = [Part("Delay against shift", head, rows, [picture(design_plot(found), "Delay against shift")], NOTE)]
    for d in found:
        which = f"{d.name}, every {duration(d.interval)}"
        parts.append(Part(f"{which}: how long until an alarm", *quantile_table(d), note=QUANTILE_NOTE))
        parts.append(Part(f"{which}: sampling interval", *sampling_table(d), note=SAMPLING_NOTE))
        if d.rule.kind in ("cusum", "ewma"):
            parts.append(Part(f"{which}: a short baseline", *baseline_table(d)))
    lines = ["Limits are such that each chart rings falsely as often as promised, and no more."]
    return write_page(path, "Chart design", "Control charts by their false alarms a year", lines, parts)
