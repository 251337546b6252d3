"""The quality of a record as a page: what is there of each point and day, what is wrong, and the numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fdd.report.figures_page import Part, drawn, write_page
from fdd.service.site.site_context import SiteContext
from fdd.service.verbs.quality import RecordQuality

DAYS_SHOWN = 400


def write_quality(quality: RecordQuality, context: SiteContext, path: Path) -> Path:
    """Write the page."""
    told = [
        f"{quality.used:.1%} of the samples and {quality.span_used:.1%} of the span are used.",
        "Most is lost: nothing should be learned from this record." if quality.mostly_lost else "",
    ]
    faults = [[f.kind, f.words, "" if f.since is None else context.local(f.since)] for f in quality.faults] or [
        ["", "nothing was found", ""]
    ]
    rows = [
        [p.name, p.unit, f"{p.seen:.1%}", _duration(p.sampling), *(f"{v:.5g}" for v in (p.lowest, p.mean, p.highest)),
         f"{p.unchanged:.0%}" if np.isfinite(p.unchanged) else ""]
        for p in quality.points
    ]  # fmt: skip
    parts = [
        Part("What is there", figures=[drawn(lambda f: _draw(f, quality), "Share of each day with values, by point",
                                             (7.2, 1.0 + 0.22 * len(quality.points)))]),
        Part("What is wrong", ("kind", "what", "since"), faults),
        Part("Points", ("point", "unit", "seen", "sampling", "lowest", "mean", "highest", "unchanged"), rows),
    ]  # fmt: skip
    span = f"{context.local(quality.first)} to {context.local(quality.last)}"
    return write_page(
        path, f"{context.site.name}: data", f"Quality of the record · {span}", [t for t in told if t], parts
    )


def _duration(seconds: float) -> str:
    if not np.isfinite(seconds):
        return ""
    return (
        f"{seconds / 3600:g} h" if seconds >= 3600 else f"{seconds / 60:g} min" if seconds >= 60 else f"{seconds:g} s"
    )


def _draw(figure: Figure, quality: RecordQuality) -> None:
    """A strip for each point, a column for each day: dark is whole, white is nothing; faults are marked."""
    axes = figure.subplots()
    names = [p.name for p in quality.points]
    share = quality.present.T
    image = axes.imshow(share, aspect="auto", interpolation="nearest", cmap="Greens", vmin=0.0, vmax=1.0)
    axes.set_yticks(range(len(names)), names)
    days = quality.days
    ticks = np.unique(np.linspace(0, len(days) - 1, min(6, len(days))).astype(int))
    axes.set_xticks(ticks, [days[i] for i in ticks])
    figure.colorbar(image, ax=axes, label="share of the day", shrink=0.8)
