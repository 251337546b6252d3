"""``fdd chiller``: the stand-alone study of a site's chillers, on a screen, as a page and for machines."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from fdd.chiller_eiv.fit import ChillerFit
from fdd.chiller_eiv.study import StudyResult, date_of, study
from fdd.chiller_eiv.study_report import SHOWN, write_html
from fdd.records import JsonObject
from fdd.service.alarms.book import iso
from fdd.service.baselines.chiller_fit import chiller_data
from fdd.service.baselines.fitting import read_span
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Chiller
from fdd.service.site.site_context import SiteContext, open_site

# Reading, and the three stages of a study.
STAGES = 4


@dataclass(frozen=True)
class Study:
    """One chiller's study and where its page is."""

    result: StudyResult
    page: Path | None

    def document(self) -> JsonObject:
        """For machines."""
        r = self.result
        return {
            "chiller": r.config.name,
            "verdict": r.verdict,
            "points": len(r.points),
            "samples": r.report.counts(),
            "baseline": {"from": iso(r.baseline.start), "until": iso(r.baseline.end), "points": r.baseline.points},
            "gate": {
                "level": r.decision.level.value,
                "sentence": r.decision.sentence(),
                "measures": r.decision.measures,
            },
            "estimates": {name: _estimate(fit) for name, fit in r.fits.items()},
            "watched": {
                "features": list(r.baseline.vector.layout.features),
                "drivers": list(r.baseline.vector.layout.drivers),
                "clusters": r.baseline.vector.clusters,
                "power_cv": r.baseline.vector.power_cv,
                "judged": r.judged if np.isfinite(r.judged) else None,
                "notes": list(r.baseline.vector.notes),
            },
            "finding": None if r.finding is None else asdict(r.finding),
            "heat_balance": None if r.sensors is None else r.sensors.note,
            "cost": None if r.cost is None else asdict(r.cost),
            "alarms": [date_of(v.time - 1) for v in r.states if v.alarm][:1],
            "page": None if self.page is None else str(self.page),
        }

    def print(self, console: Console) -> None:
        """For people."""
        r = self.result
        console.print(f"[bold]{r.config.name}[/bold]")
        kept = ", ".join(f"{k} {n}" for k, n in r.report.counts().items() if n)
        console.print(f"{len(r.points)} steady points; samples: {kept}", highlight=False, soft_wrap=True)
        span = f"{date_of(r.baseline.start)} to {date_of(r.baseline.end)}"
        console.print(f"baseline: {r.baseline.points} points, {span}", highlight=False)
        if r.fits:
            console.print(_estimates(r))
        console.print(r.verdict, highlight=False, markup=False, soft_wrap=True)
        if self.page is not None:
            console.print(f"page with plots: {self.page}", highlight=False, soft_wrap=True)


def _estimate(fit: ChillerFit) -> JsonObject:
    intervals = dict(zip(fit.parameters, np.asarray(fit.interval()).tolist(), strict=True))
    return {
        "values": fit.values(),
        "intervals": intervals,
        "method": fit.interval_method,
        "residual_sd": fit.residual_sd,
        "positive_definite": bool(fit.positive_definite),
    }


def _estimates(r: StudyResult) -> Table:
    symbols = r.decision.fit.form.parameters
    table = Table("estimator", *(f"{p}, {SHOWN[p][1]}" for p in symbols), "residual", box=None)
    for name, fit in r.fits.items():
        table.add_row(name, *(_cell(fit, p) for p in symbols), f"{100 * fit.residual_sd:.2f} %")
    return table


def _cell(fit: ChillerFit, symbol: str) -> str:
    factor, _ = SHOWN[symbol]
    if symbol in fit.held:
        return f"{fit.held[symbol] * factor:.4g} (held)"
    i = fit.parameters.index(symbol)
    low, high = np.sort(np.asarray(fit.interval())[i] * factor)
    return f"{fit.estimate[i] * factor:.4g} ({low:.4g} to {high:.4g})"


def study_site(
    site_file: Path,
    data: Path | None,
    *,
    since: str | None,
    until: str | None,
    only: list[str] | None,
    html: Path | None,
    console: Console,
) -> list[Study]:
    """Study every chiller of a site, or those named.

    Parameters
    ----------
    since : leave out what is before
    until : end of the healthy period that the rest is compared with; by default each chiller's ``baseline_days``
    html : page of the study; with several chillers each has its own, ``NAME`` added to the file's name

    Raises
    ------
    UsageError : the site has no chiller, or none of that name
    ChillerError : no steady points, or too few to predict power
    """
    context = open_site(site_file, data)
    chosen = _chosen(context, only)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("reading", total=len(chosen) * (STAGES - 1) + 1)
        history = read_span(context, since, None)
        progress.advance(task)
        studies = []
        for chiller in chosen:

            def tell(stage: str, name: str = chiller.name) -> None:
                progress.update(task, description=f"{name}: {stage}")
                progress.advance(task)

            result = study(
                chiller_data(context.plan, chiller, history),
                chiller.config,
                baseline_end=context.nanoseconds(until),
                progress=tell,
            )
            page = None if html is None else write_html(result, _page(html, chiller, len(chosen)))
            studies.append(Study(result, page))
    return studies


def _page(html: Path, chiller: Chiller, studied: int) -> Path:
    html.parent.mkdir(parents=True, exist_ok=True)
    return html if studied == 1 else html.with_stem(f"{html.stem}-{chiller.name}")


def _chosen(context: SiteContext, only: list[str] | None) -> list[Chiller]:
    chillers = context.plan.chillers
    if not chillers:
        raise UsageError(
            f"{context.site.name} has no chiller; give a piece of equipment 'model: gordon_ng' (docs/site-file.md)"
        )
    names = [c.name for c in chillers]
    for name in only or ():
        if name not in names:
            raise UsageError(f"no chiller is named {name!r}; there are {', '.join(names)}")
    return [c for c in chillers if not only or c.name in only]
