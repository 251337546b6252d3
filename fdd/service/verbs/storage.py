"""``fdd store``: copy a site's results to another store, or to files for analysis."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TaskID

from fdd.service.site.site_context import open_site
from fdd.store.transfer import export_parquet, migrate


def migrate_site(site_file: Path, target_file: Path, console: Console) -> str:
    """Copy everything in one site's store to the store that another site file names; may be repeated."""
    source, target = open_site(site_file).store(read_only=True), open_site(target_file).store()
    with Progress(console=console, transient=True) as progress:
        done = migrate(source, target, _report(progress))
    source.close()
    target.close()
    rows = ", ".join(f"{n} {name}" for name, n in done.rows.items()) or "nothing"
    return f"copied {rows}; {sum(done.documents.values())} documents"


def export_site(
    site_file: Path, folder: Path, console: Console, *, since: str | None = None, until: str | None = None
) -> list[Path]:
    """Write one Parquet file a measurement and one JSON file a kind of document."""
    context = open_site(site_file)
    store = context.store(read_only=True)
    with Progress(console=console, transient=True) as progress:
        written = export_parquet(
            store,
            folder,
            start=context.nanoseconds(since),
            end=context.nanoseconds(until),
            progress=_report(progress),
        )
    store.close()
    return written


def _report(progress: Progress) -> Callable[[str, int, int], None]:
    tasks: dict[str, TaskID] = {}

    def report(name: str, done: int, total: int) -> None:
        if name not in tasks:
            tasks[name] = progress.add_task(name, total=total)
        progress.update(tasks[name], completed=done)

    return report
