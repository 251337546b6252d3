"""``fdd check``: is the site file right, and what is the quality of its data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from fdd.chiller_eiv.steady_state import SteadyPoints, steady_points
from fdd.config import Finding, Site, check_site, load_site
from fdd.records import JsonObject
from fdd.service.baselines.chiller_fit import chiller_data
from fdd.service.baselines.history import History, read_history, runs
from fdd.service.site.feed import FILES, Feed
from fdd.service.site.plan import Chiller
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.listing import show
from fdd.service.verbs.quality import RecordQuality, record_quality
from fdd.service.verbs.quality_page import write_quality
from ingest.source import Refused, missing_modules


@dataclass
class CheckResult:
    """Findings about the site, and a table of its points where data were given."""

    site: str
    findings: list[Finding]
    points: list[JsonObject] = field(default_factory=list)
    components: list[JsonObject] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    quality: RecordQuality | None = None
    context: SiteContext | None = None

    @property
    def exit_code(self) -> int:
        """1 where something must be mended, 3 where most of the data is lost, else 0."""
        return 1 if self.errors else 3 if self.quality is not None and self.quality.mostly_lost else 0

    @property
    def errors(self) -> list[Finding]:
        """What must be mended before the site can run."""
        return [f for f in self.findings if f.severity == "error"]

    def document(self) -> JsonObject:
        """For machines."""
        return {
            "site": self.site,
            "errors": [str(f) for f in self.errors],
            "warnings": [str(f) for f in self.findings if f.severity != "error"],
            "points": self.points,
            "components": self.components,
            "quality": self.quality.document(self.context.local) if self.quality and self.context else None,
            "counts": self.counts,
            "notes": self.notes,
        }

    def print(self, console: Console) -> None:
        """For people."""
        for finding in self.findings:
            console.print(str(finding), highlight=False, markup=False, soft_wrap=True)
        rounded = [{k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in p.items()} for p in self.points]
        show(rounded, console)
        for row in self.components:
            console.print(_row_words(row), highlight=False, soft_wrap=True)
        lost = {k: n for k, n in self.counts.items() if n and k != "accepted"}
        if lost:
            console.print("rejected or odd: " + ", ".join(f"{k} {n}" for k, n in lost.items()), highlight=False)
        for note in self.notes[:10]:
            console.print(f"  {note}", highlight=False, markup=False)
        self._print_quality(console)
        console.print(f"{self.site}: {len(self.errors)} error(s), {len(self.findings) - len(self.errors)} warning(s)")

    def _print_quality(self, console: Console) -> None:
        if self.quality is None:
            return
        q = self.quality
        for fault in q.faults:
            console.print(f"{fault.kind}: {fault.words}", highlight=False, markup=False, soft_wrap=True)
        verdict = "; MOST IS LOST, nothing should be learned from it" if q.mostly_lost else ""
        said = f"data: {q.used:.1%} of the samples and {q.span_used:.1%} of the span are used{verdict}"
        console.print(said, highlight=False, soft_wrap=True)


def check_all(site_file: Path, data: Path | None, html: Path | None = None) -> CheckResult:
    """Check a site file; with data, or files of its own, also how good these are; ``html`` is a page about them."""
    site = load_site(site_file)
    result = CheckResult(site.name, [*check_site(site), *_not_installed(site)])
    own = bool(site.sources) and all(s.kind in FILES for s in site.sources)
    if result.errors or (data is None and not own):
        return result
    context = open_site(site_file, data)
    feed = Feed(context.site)
    try:
        feed.open()
    except Refused as refused:
        if data is not None:
            raise
        result.findings.append(Finding("warning", "sources", f"no data were read: {refused}"))
        return result
    history, counts = read_history(context.plan, feed.batches())
    result.counts, result.notes = counts | feed.counters(), feed.notes()
    feed.close()
    result.context = context
    if len(history) == 0:
        lost = ", ".join(f"{k} {n}" for k, n in result.counts.items() if n)
        result.findings.append(Finding("error", "data", f"no frame holds a value; of the samples: {lost or 'none'}"))
        return result
    result.points = [_point_row(context, history, name) for name in context.plan.columns]
    result.components = _component_rows(context, history)
    result.quality = record_quality(context, history, result.counts)
    if html:
        write_quality(result.quality, context, html)
    return result


def _not_installed(site: Site) -> Iterator[Finding]:
    for source in site.sources:
        for module in missing_modules(source.kind):
            yield Finding(
                "error", f"sources.{source.label}", f"kind {source.kind} needs {module}, which is not installed",
                f"pip install 'hvac-fdd[{source.kind}]'.",
            )  # fmt: skip


def _point_row(context: SiteContext, history: History, name: str) -> JsonObject:
    values = history.of((name,))[:, 0]
    seen = values[np.isfinite(values)]
    frames = (int(history.time[-1]) - int(history.time[0])) // context.plan.step + 1
    still = float(np.mean(np.diff(seen) == 0)) if len(seen) > 1 else float("nan")
    return {
        "point": name,
        "unit": context.site.units.get(name, "1"),
        "seen": f"{len(seen) / frames:.1%}",
        "lowest": float(seen.min()) if len(seen) else float("nan"),
        "mean": float(seen.mean()) if len(seen) else float("nan"),
        "highest": float(seen.max()) if len(seen) else float("nan"),
        "unchanged": f"{still:.0%}",
    }


def _component_rows(context: SiteContext, history: History) -> list[JsonObject]:
    rows = []
    for component in context.plan.components:
        found = runs(context.plan, component, history)
        usable = sum(len(r.time) for r in found)
        rows.append({"equipment": component.name, "frames": len(history), "usable frames": usable, "runs": len(found)})
    return rows + [_chiller_row(context, chiller, history) for chiller in context.plan.chillers]


def _chiller_row(context: SiteContext, chiller: Chiller, history: History) -> JsonObject:
    data = chiller_data(context.plan, chiller, history)
    config = chiller.config
    limits = config.steady_for(data.time, data.raw)
    points, report = steady_points(data.time, data.raw, config.instruments, rated_load=config.rated_load, limits=limits)
    rejected = {k: n for k, n in report.counts().items() if n and k != "kept"}
    return {
        "equipment": chiller.name,
        "frames": len(history),
        "usable frames": int(points.samples.sum()),
        "steady points": len(points),
        "steady": {"window": limits.window, "settling": limits.settling},
        "odd": _implausible(points, chiller),
        "rejected": rejected,
    }


def _implausible(points: SteadyPoints, chiller: Chiller) -> list[str]:
    """Steady loads and powers that no machine of this rating has."""
    if not len(points):
        return []
    load, power = (float(v) for v in np.median(points.regressors(chiller.config.instruments)[0][:, 2:4], axis=0))
    rated, found = chiller.config.rated_load, []
    if not 0.1 * rated < load < 1.3 * rated:
        found.append(f"the median load is {load / 1e3:.4g} kW, rated {rated / 1e3:.4g} kW: check the flow's unit")
    if not 1.2 < load / power < 20:
        found.append(f"the median COP is {load / power:.3g}: check the units of power and flow")
    return found


def _row_words(row: JsonObject) -> str:
    usable = f"{row['equipment']}: {row['usable frames']} of {row['frames']} frames usable"
    if "runs" in row:
        return f"{usable}, in {row['runs']} run(s)"
    rejected = ", ".join(f"{k} {n}" for k, n in row["rejected"].items())
    steady = row["steady"]
    proposed = f"window {steady['window']:g} s, settling {steady['settling']:g} s"
    odd = "".join(f"; {words}" for words in row["odd"])
    return f"{usable}, in {row['steady points']} steady point(s) of {proposed}; rejected: {rejected or 'none'}{odd}"
