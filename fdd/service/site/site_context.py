"""A site opened: its file checked, its plan resolved, its store at hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from zoneinfo import ZoneInfo

import pandas as pd
import structlog

from fdd.config import Site, check_site, load_site, with_data
from fdd.records import NANOSECONDS
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Plan, plan_of
from fdd.store.opening import open_store
from fdd.store.store import Store, StoreConfig

log = structlog.get_logger()


@dataclass(frozen=True)
class SiteContext:
    """A checked site and what follows from it."""

    site: Site
    plan: Plan

    def store(self, *, read_only: bool = False) -> Store:
        """The site's store; ``read_only`` never blocks the daemon."""
        return open_store(self._store_config(), read_only=read_only)

    def _store_config(self) -> StoreConfig:
        table = self.site.store.model_dump(exclude_none=True)
        for key in ("path", "token_file", "ca_file"):
            if key in table:
                table[key] = self.site.folder / table[key]
        if table["kind"] == "influx":
            table["path"] = self.state_folder / "spool"
        return StoreConfig.of({**table, "site": self.site.name})

    @property
    def state_folder(self) -> Path:
        """Where the daemon keeps its journal and checkpoint."""
        path = getattr(self.site.store, "path", None)
        return (self.site.folder / path).parent if path else self.site.folder

    @property
    def trail_path(self) -> Path:
        """The audit trail of what people asked; ``--fresh`` leaves it alone."""
        return self.state_folder / f"{self._file_name}.audit.jsonl"

    @property
    def checkpoint_path(self) -> Path:
        """The daemon's state file."""
        return self.state_folder / f"{self._file_name}.state.sqlite"

    @property
    def _file_name(self) -> str:
        """The site's name without what would lead to another folder."""
        return self.site.name.replace(" ", "-").replace("/", "-").lstrip(".")

    def nanoseconds(self, text: str | None) -> int | None:
        """A time as a user writes it, in the site's zone unless it names one.

        Raises
        ------
        UsageError
            The text is no time.
        """
        if text is None:
            return None
        try:
            time = pd.Timestamp(text)
        except ValueError:
            raise UsageError(f"{text!r} is no time; write it as 2026-03-01 or 2026-03-01T12:00") from None
        if time.tzinfo is None:
            time = time.tz_localize(ZoneInfo(self.site.zone))
        return int(time.tz_convert("UTC").timestamp() * NANOSECONDS)

    def local(self, time: int) -> str:
        """Event time in the site's zone, to the minute."""
        return str(pd.Timestamp(time, unit="ns", tz="UTC").tz_convert(self.site.zone).strftime("%Y-%m-%d %H:%M"))


def open_site(path: Path, data: Path | None = None) -> SiteContext:
    """Load and check a site file; ``data`` replaces the site's own sources.

    Raises
    ------
    ConfigError : the file cannot be used
    UsageError : the file is well formed, but the site cannot run
    """
    site = load_site(path)
    if data is not None:
        if not data.is_file():
            raise UsageError(f"data file {data} is not there; give the path of a CSV or Parquet file")
        site = with_data(site, data)
    for where, former, present in site.former:
        log.warning(f"{where}: {former!r} is called {present!r} now; the next version refuses the old word")
    errors = [str(f) for f in check_site(site) if f.severity == "error"]
    if errors:
        raise UsageError(f"{path}: {len(errors)} thing(s) to mend\n  " + "\n  ".join(errors))
    return SiteContext(site, plan_of(site))
