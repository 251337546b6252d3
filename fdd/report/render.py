"""Writes a report: one HTML file that needs nothing else, and the same as PDF."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from fdd import __version__
from fdd.report.content import Report, ReportError, SiteInfo, gather
from fdd.report.export import findings_csv, findings_json
from fdd.report.findings import timing
from fdd.report.monitoring import ENOUGH
from fdd.report.plots import Plot, alt, plots
from fdd.report.words import duration, likely, local, local_day, percent
from fdd.store.store import Store

__all__ = ["findings_csv", "findings_json", "render_html", "write_gathered", "write_pages", "write_pdf", "write_report"]

MOST_ILLUSTRATED = 12
"""Findings with plots; the rest, less urgent, are in words only, so that a bad day's report stays small."""


def write_report(
    store: Store, site_info: SiteInfo, path: Path, start: int | None = None, end: int | None = None, *,
    pdf: Path | None = None,
) -> Path:  # fmt: skip
    """Gather a report and write it; see :func:`write_gathered`."""
    return write_gathered(gather(store, site_info, start, end), path, pdf=pdf)


def write_gathered(report: Report, path: Path, *, pdf: Path | None = None) -> Path:
    """Write a report as HTML, and as PDF where ``pdf`` names a file; returns the HTML's path.

    Parameters
    ----------
    report : what it says
    path : of the HTML file; its folder is made

    Raises
    ------
    ReportError : PDF is asked for and cannot be made
    """
    html = render_html(report)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(html, encoding="utf-8")
    if pdf is not None:
        write_pdf(html, pdf)
    return path


def render_html(report: Report, *, single: bool = False) -> str:
    """The report as one self-contained HTML document; ``single`` leaves out all but its findings."""
    site = report.site
    template, css = _template()
    return template.render(
        report=report,
        single=single,
        css=css,
        version=__version__,
        period=_period(report),
        watched=_watched(report),
        watched_time=duration(round(report.budget.years * 365.25 * 86400e9)) if report.budget else "",
        enough=percent(ENOUGH),
        unmonitored=_alike(report),
        figures=_figures(report),
        timing=lambda f: timing(f, site, report.end or 0),
        alt=lambda p, f: alt(p, f, site),
        day=lambda t: local_day(t, site.tz),
        when=lambda t: local(t, site.tz),
        number=_number,
    )


@cache
def _template() -> tuple[Template, Markup]:
    """The report's template and style sheet: read once, however many pages are written."""
    loader = PackageLoader("fdd.report", ".")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters["percent"] = percent
    environment.filters["likely"] = likely
    environment.filters["capfirst"] = lambda text: text[:1].upper() + text[1:]
    css = loader.get_source(environment, "style.css")[0]
    return environment.get_template("template.html.j2"), Markup(css)


def page_of(key: str) -> str:
    """Name of the page of an alarm; a dashboard's link asks for it with the key of a row, percent-encoded."""
    return f"{key}.html"


def write_pages(report: Report, folder: Path) -> list[Path]:
    """A page for every alarm of the period, ``KEY.html``: where dashboards and alarm lists link to."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for f in (*report.findings, *report.consequences, *report.closed, *report.models):
        path = folder / page_of(f.key)
        path.write_text(render_html(report.only(f), single=True), encoding="utf-8")
        written.append(path)
    return written


def _figures(report: Report) -> dict[str, list[list[Plot]]]:
    """The evidence of each finding in rows of two pictures."""
    if report.start is None or report.end is None:
        return {}
    illustrated = report.findings[:MOST_ILLUSTRATED]
    drawn = {f.key: _rows(plots(f, report.site, report.start, report.end)) for f in illustrated}
    return {f.key: drawn.get(f.key, []) for f in report.findings}


def _rows(pictures: list[Plot]) -> list[list[Plot]]:
    return [pictures[i : i + 2] for i in range(0, len(pictures), 2)]


def _alike(report: Report) -> dict[tuple[str, str, str], list[str]]:
    """Equipment that is not monitored for the same reason, together."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for u in report.unmonitored:
        groups.setdefault((u.what, u.why, u.remedy), []).append(u.title)
    return groups


def _period(report: Report) -> str:
    if report.start is None or report.end is None:
        return ""
    return f"{local(report.start, report.site.tz)} to {local(report.end, report.site.tz)}"


def _watched(report: Report) -> str:
    if report.end is None or not report.findings:
        return ""
    n = len(report.healthy)
    words = [f"{n} other component{'s are' if n != 1 else ' is'} healthy"] if n else []
    words += report.notes
    return "; ".join(words)


def _number(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def write_pdf(html: str, path: Path) -> Path:
    """The report's HTML as PDF (A4).

    Raises
    ------
    ReportError : WeasyPrint or the Pango library it needs is missing
    """
    try:
        import weasyprint
        from weasyprint.urls import URLFetcher
    except ImportError:
        raise ReportError(
            "PDF needs WeasyPrint, 68 or later, which is not installed; run: pip install 'hvac-fdd[pdf]'"
        ) from None
    except OSError as problem:
        raise ReportError(
            f"PDF needs the Pango library, which cannot be loaded ({problem}); "
            "on Debian or Ubuntu run: apt-get install libpangoft2-1.0-0; the HTML report needs nothing"
        ) from problem
    path.parent.mkdir(parents=True, exist_ok=True)
    # A report needs nothing from outside; whatever asks for it is refused.
    inside = URLFetcher(allowed_protocols={"data"}, fail_on_errors=True)
    weasyprint.HTML(string=html, url_fetcher=inside).write_pdf(path)
    return path
