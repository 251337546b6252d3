"""``fdd run``: the daemon as a process, with signals, logs and recovery."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from types import FrameType

import structlog

from fdd.config import Site
from fdd.service.checkpoint import Checkpoint
from fdd.service.daemon import Daemon
from fdd.service.errors import UsageError
from fdd.service.feed import Feed
from fdd.service.opened import open_site
from fdd.service.replay import ready_engine

log = structlog.get_logger()


def run_site(site_file: Path, *, until_end: bool, fresh: bool) -> Daemon:
    """Run a site until its sources end (``until_end``) or a signal comes; returns the daemon as it stopped.

    Raises
    ------
    UsageError : the site names no sources, or no component has a baseline
    """
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    opened = open_site(site_file)
    if not opened.site.sources:
        raise UsageError(f"{site_file}: the site names no sources; add one, or use `fdd replay SITE DATA` for a file")
    if fresh:
        for suffix in ("", "-wal", "-shm"):
            Path(f"{opened.checkpoint_path}{suffix}").unlink(missing_ok=True)
    engine = ready_engine(opened)
    site = _ending(opened.site) if until_end else opened.site
    checkpoint, store, feed = Checkpoint(opened.checkpoint_path), opened.store(), Feed(site)
    daemon = Daemon(engine, store, checkpoint)
    _stop_on_signals(feed)
    feed.open(daemon.recover() or None, patient=True)
    log.info("running", site=opened.site.name, watched=[c.name for c in engine.watched])
    try:
        daemon.run(feed)
        if until_end and not feed.stopped:
            daemon.finish()
        else:
            daemon.save()
        log.info("stopped", samples=daemon.samples, frames=daemon.frames, counts=engine.counts | feed.counters())
    finally:
        feed.close()
        store.close()
        checkpoint.close()
    return daemon


def _ending(site: Site) -> Site:
    """The site with live sources that stop where their stream says that it has ended."""
    sources = tuple(
        s.model_copy(update={"until_end": True}) if "until_end" in type(s).model_fields else s for s in site.sources
    )
    return site.model_copy(update={"sources": sources})


def _stop_on_signals(feed: Feed) -> None:
    def stop(number: int, _frame: FrameType | None) -> None:
        log.info("stopping", signal=signal.Signals(number).name)
        feed.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
