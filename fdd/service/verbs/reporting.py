"""``fdd report``: what the report has to know of a site, from its file; and where the report goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from fdd.report.content import gather
from fdd.report.language import languages
from fdd.report.render import findings_csv, findings_json, write_gathered, write_pages
from fdd.report.words import DAY
from fdd.service.baselines.versions import in_force
from fdd.service.site.errors import UsageError
from fdd.service.site.naming import site_info
from fdd.service.site.site_context import open_site

Period = Literal["weekly", "monthly"]
PERIODS: dict[Period, int] = {"weekly": 7 * DAY, "monthly": 30 * DAY}
WRITERS = {".json": findings_json, ".csv": findings_csv}


def report_site(
    site_file: Path,
    out: Path,
    *,
    pdf: Path | None = None,
    findings: Sequence[Path] = (),
    period: Period = "weekly",
    pages: bool = True,
    language: str | None = None,
    since: str | None = None,
    until: str | None = None,
) -> list[Path]:
    """Write the report from the store, and a page ``KEY.html`` beside it for every alarm of the period.

    Returns every file that was written, the report first.

    Raises
    ------
    UsageError : findings are asked for in a form, or the report in a language, that is not known
    """
    if language is not None and language not in languages():
        raise UsageError(f"--language is {language!r}; give one of {', '.join(languages())}")
    for path in findings:
        if path.suffix not in WRITERS:
            raise UsageError(f"findings cannot be written as {path.suffix!r} ({path}); name a .json or a .csv file")
    context = open_site(site_file)
    store = context.store(read_only=True)
    try:
        baselines = in_force(store, [c.name for c in context.plan.components])
        info = site_info(context.plan.following(baselines), context.site)
        info = replace(info, language=language or info.language)
        report = gather(store, info, context.nanoseconds(since), context.nanoseconds(until), PERIODS[period])
    finally:
        store.close()
    written = [write_gathered(report, out, pdf=pdf), *([pdf] if pdf else [])]
    for path in findings:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(WRITERS[path.suffix](report), encoding="utf-8")
    return [*written, *findings, *(write_pages(report, out.parent) if pages else [])]
