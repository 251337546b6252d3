"""``fdd run``: the daemon as a process, with signals, logs and recovery."""

from __future__ import annotations

import logging
import os
import signal
import sys
from pathlib import Path
from types import FrameType

import structlog

from fdd.config import Site
from fdd.records import JsonObject
from fdd.service.alarms.authority import Authority
from fdd.service.baselines.learn import without_baseline
from fdd.service.daemon import systemd
from fdd.service.daemon.checkpoint import Checkpoint, files_of
from fdd.service.daemon.commands import Desk
from fdd.service.daemon.daemon import Daemon
from fdd.service.daemon.lock import StateLock
from fdd.service.daemon.metrics import MetricsServer
from fdd.service.daemon.ready import ready_engine
from fdd.service.daemon.schedule import JobRunner, jobs_of, learning_job
from fdd.service.daemon.trail import Trail
from fdd.service.site.errors import UsageError
from fdd.service.site.feed import Feed
from fdd.service.site.naming import speaker_of
from fdd.service.site.site_context import SiteContext, open_site

log = structlog.get_logger()


def run_site(site_file: Path, *, until_end: bool, fresh: bool) -> Daemon:
    """Run a site until its sources end (``until_end``) or a signal comes; returns the daemon as it stopped.

    SIGHUP reads the site file and the baselines again; a file that cannot be used is refused, and the service goes on
    as it was. SIGTERM and SIGINT stop it after the batch at hand.

    Raises
    ------
    UsageError : the site names no sources
    """
    _configure_log()
    os.umask(os.umask(0o077) | 0o027)  # what the plant does is nobody else's business
    context = _with_sources(site_file)
    lock = StateLock(context.checkpoint_path)  # before anything is changed: another daemon may stand on these files
    try:
        return _run(site_file, context, until_end=until_end, fresh=fresh)
    finally:
        lock.close()


def _run(site_file: Path, context: SiteContext, *, until_end: bool, fresh: bool) -> Daemon:
    if fresh:
        for file in files_of(context.checkpoint_path):
            file.unlink(missing_ok=True)
    engine = ready_engine(context, learning=True)
    checkpoint, store = Checkpoint(context.checkpoint_path), context.store()
    metrics, authority = _metrics(context), Authority.of(context.site)
    desk = Desk(context.site, authority) if context.site.operator else None
    trail = Trail(context.trail_path)
    jobs = _jobs(context, site_file)
    daemon = Daemon(
        engine,
        store,
        checkpoint,
        jobs=jobs,
        metrics=metrics,
        desk=desk,
        authority=authority,
        trail=trail,
        speaker=speaker_of(engine.plan, context.site),
    )
    service = _Service(site_file, context, daemon, until_end)
    daemon.reload = service.reload
    service.listen()
    try:
        service.open(daemon.recover())
        log.info("running", site=context.site.name, watched=[c.name for c in engine.watched])
        systemd.notify("READY=1")
        while daemon.run(service.feed):
            service.reopen()
        systemd.notify("STOPPING=1")
        daemon.stop_jobs()
        if until_end and not service.feed.stopped:
            daemon.finish()
        else:
            daemon.save()
        daemon.end()
        counts = daemon.engine.counts | service.feed.counters()
        log.info("stopped", samples=daemon.samples, frames=daemon.frames, counts=counts)
    finally:
        daemon.stop_jobs()
        service.feed.close()
        store.close()
        checkpoint.close()
        trail.close()
        if metrics:
            metrics.close()
        if desk:
            desk.close()
    return daemon


class _Service:
    """The feed of a running daemon, and what signals do to both."""

    def __init__(self, site_file: Path, context: SiteContext, daemon: Daemon, until_end: bool) -> None:
        self._site_file, self._context, self._daemon, self._until_end = site_file, context, daemon, until_end
        self.feed = self._feed()

    def _feed(self) -> Feed:
        return Feed(_ending(self._context.site) if self._until_end else self._context.site)

    def open(self, position: JsonObject) -> None:
        """Open the sources where the daemon stands."""
        self.feed.open(position or None, patient=True)

    def reopen(self) -> None:
        """The sources have changed: open the new ones where the daemon stands."""
        self.feed.close()
        self.feed = self._feed()
        self.open(self._daemon.position)

    def listen(self) -> None:
        """Take signals; the work is done by the loop."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        signal.signal(signal.SIGHUP, self._hang_up)

    def _stop(self, number: int, _frame: FrameType | None) -> None:
        log.info("stopping", signal=signal.Signals(number).name)
        self.feed.stop()

    def _hang_up(self, _number: int, _frame: FrameType | None) -> None:
        self._daemon.reload_wanted = True

    def reload(self, daemon: Daemon) -> bool:
        """Take up the site file as it is now; True where its sources or points are others than before."""
        systemd.reloading()
        before = self._context
        try:
            context = _with_sources(self._site_file)
            for key in ("name", "step", "store"):
                if getattr(context.site, key) != getattr(before.site, key):
                    raise UsageError(f"{key!r} has changed; that needs a restart of the service")
            daemon.adopt(ready_engine(context, learning=True), _jobs(context, self._site_file))
        except Exception as error:  # whatever is wrong with the new file, the plant is still watched by the old one
            log.error("reload refused, going on as before", reason=str(error))
            return False
        else:
            log.info("reloaded", watched=[c.name for c in daemon.engine.watched])
            self._context = context
            return (context.site.sources, context.site.points) != (before.site.sources, before.site.points)
        finally:
            systemd.notify("READY=1")


def _with_sources(site_file: Path) -> SiteContext:
    context = open_site(site_file)
    if not context.site.sources:
        raise UsageError(f"{site_file}: the site names no sources; add one, or use `fdd replay SITE DATA` for a file")
    return context


def _jobs(context: SiteContext, site_file: Path) -> JobRunner:
    store = context.store()
    waiting = without_baseline(context, store)
    store.close()
    if waiting:
        log.info("recording until there is enough to fit", components=[w.name for w in waiting])
    learning = [learning_job(context.site, site_file)] if waiting else []
    return JobRunner([*jobs_of(context.site, site_file), *learning], context.state_folder)


def _metrics(context: SiteContext) -> MetricsServer | None:
    if context.site.metrics is None:
        return None
    host, _, port = context.site.metrics.rpartition(":")
    try:
        return MetricsServer((host, int(port)))
    except OSError as problem:
        raise UsageError(f"metrics: cannot serve on {context.site.metrics}: {problem}; give another port") from problem


def _configure_log() -> None:
    """Lines for people on a terminal, JSON lines for a journal; always on stderr."""
    # Without the values of variables: a password may be among them.
    console = structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)
    renderer = console if sys.stderr.isatty() else structlog.processors.JSONRenderer()
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )


def _ending(site: Site) -> Site:
    """The site with live sources that stop where their stream says that it has ended."""
    sources = tuple(
        s.model_copy(update={"until_end": True}) if "until_end" in type(s).model_fields else s for s in site.sources
    )
    return site.model_copy(update={"sources": sources})
