"""The daemon: a source, the engine, a store, and what makes a crash harmless.

The loop is the imperative shell around the :class:`~fdd.service.engine.engine.Engine`: journal a batch, step the
engine, write the outputs, and every so often save the state together with the source's position.
"""

from __future__ import annotations

import os
import socket
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
import structlog

from fdd.records import NANOSECONDS, Alarm, Batch, JsonObject, Rows
from fdd.report.telling import Speaker
from fdd.service.alarms.authority import Authority
from fdd.service.alarms.book import AlarmError, Command
from fdd.service.baselines.versions import in_force, keep_again, versions_in_force
from fdd.service.daemon.checkpoint import Checkpoint, Entry, Rebase, TurnBack
from fdd.service.daemon.commands import DONE, Desk, StoredCommands
from fdd.service.daemon.health import Health
from fdd.service.daemon.metrics import MetricsServer
from fdd.service.daemon.schedule import JobRunner
from fdd.service.daemon.systemd import Watchdog
from fdd.service.daemon.trail import Trail
from fdd.service.engine.engine import Engine, EngineError, Outputs
from fdd.service.site.feed import Feed
from fdd.service.site.naming import speaker_of
from fdd.store.spool import SpooledStore, spool_rows
from fdd.store.store import Store, StoreError

log = structlog.get_logger()

# An operator waits no longer than this for a command to be seen.
POLL_SECONDS = 1.0
STATUS_SECONDS = 10.0
# New baselines are rare, and looking costs a read of every pointer.
BASELINE_SECONDS = 5.0
BLIND = 86_400 * NANOSECONDS
# So much of the journal calls for a checkpoint, however few frames have closed.
JOURNAL_BYTES = 32_000_000


def resident_bytes() -> int:
    """Resident memory of this process; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def _rates(budget: JsonObject) -> dict[str, float]:
    """The realised rate with its interval, and the promised one, for the dashboards."""
    alarms = budget.get("alarms")
    own = {"realised": alarms["per_year"], "low": alarms["low"], "high": alarms["high"]} if alarms else {}
    return {**own, "promised": budget["promised_per_year"]}


class Daemon:
    """Runs one site until its source ends or it is told to stop.

    Parameters
    ----------
    save_every : frames between two checkpoints
    watch : called after every batch, for progress and health
    now : wall clock in seconds, injected so that tests need not wait
    """

    def __init__(
        self,
        engine: Engine,
        store: Store,
        checkpoint: Checkpoint,
        *,
        save_every: int = 100,
        watch: Callable[[Daemon], None] | None = None,
        now: Callable[[], float] = clock.time,
        jobs: JobRunner | None = None,
        metrics: MetricsServer | None = None,
        desk: Desk | None = None,
        authority: Authority | None = None,
        trail: Trail | None = None,
        speaker: Speaker | None = None,
    ) -> None:
        self.engine, self._store, self._checkpoint = engine, store, checkpoint
        self._save_every, self._watch, self._now = save_every, watch, now
        self._position: JsonObject = {}
        self._speaker = speaker or speaker_of(engine.plan)
        self._commands, self._desk = StoredCommands(), desk
        self._authority, self._trail = authority or Authority(), trail
        self._blank = engine.export_state()
        self._failures: dict[str, int] = {}
        self._health = Health(engine.plan.step / NANOSECONDS, engine.plan.lateness / NANOSECONDS)
        self._unsaved = 0
        self._polled = 0.0
        self._compared = 0.0
        self._jobs, self._metrics = jobs, metrics
        self._watchdog = Watchdog()
        self._told = 0.0
        self._job_failures = 0
        self._rate = (now(), 0)
        self.reload: Callable[[Daemon], bool] | None = None
        self.reload_wanted = False
        self._refused: set[tuple[str, int]] = set()
        self._feed: Feed | None = None
        self._outcome = DONE
        self._store_problem = ""
        self._ended = False
        self.batch = False
        self.samples = 0
        self.frames = 0

    def recover(self) -> JsonObject:
        """Restore the last state, step again through what was journaled since, return the source's position.

        An entry that cannot be replayed is buried; then everything starts over without it, for it may have left the
        engine half way.
        """
        replayed = self._replay()
        while replayed is None:
            replayed = self._replay()
        if replayed:
            log.info("recovered", journal_entries=replayed, position=self._position)
        return self._position

    def _replay(self) -> int | None:
        """How many entries were stepped through; None where one was buried on the way."""
        state = self._checkpoint.load()
        if state is None:
            self.engine.restore_state(self._blank)
        else:
            self.engine.restore_state(state["engine"])
            self._position = state["position"]
            self._commands.restore_state(state["commands"])
            self.samples, self.frames = state["samples"], state["frames"]
            if self._jobs:
                self._jobs.restore(state.get("jobs", {}))
        replayed = 0
        for number, entry in self._checkpoint.numbered():
            if not self._do(number, entry):
                return None
            replayed += 1
        return replayed

    def _do(self, number: int, entry: Entry) -> bool:
        """Carry out a journaled entry; False where that was impossible, and it is buried."""
        try:
            if isinstance(entry, Batch):
                outputs = self.engine.step(entry)
            elif isinstance(entry, Rebase):
                self._rebase(entry, number)
                return True
            elif isinstance(entry, TurnBack):
                self._turn_back(entry, number)
                return True
            else:
                self._obey(entry, number)
                return True
        except (StoreError, OSError):
            raise  # not the entry's doing: the same entry succeeds when the store is back
        except Exception as error:  # whatever it is, it must not come again at every start
            self._checkpoint.bury(number, f"{type(error).__name__}: {error}")
            self._record_in_trail({"what": "buried", "reason": f"{type(error).__name__}: {error!s:.300}"}, number)
            return False
        self._position = entry.position
        self.samples += len(entry)
        self._tell_and_keep(outputs)
        return True

    @property
    def position(self) -> JsonObject:
        """Where the sources stand after the last batch."""
        return self._position

    def run(self, feed: Feed) -> bool:
        """Take batches until the sources end or are stopped; True where new sources are to be opened instead."""
        self._feed = feed
        for batch in feed.batches():
            if len(batch):
                self._take(batch)
            else:
                self._position = batch.position  # saved with the state; asking again for nothing costs nothing
            self._poll()
            if self.reload_wanted and self._reload():
                return True
            if self._unsaved >= self._save_every or self._checkpoint.unsaved_bytes > JOURNAL_BYTES:
                self.save()
            if self._watch:
                self._watch(self)
        return False

    def finish(self) -> None:
        """The stream has ended for good: close the open frames and save."""
        self._tell_and_keep(self.engine.flush())
        self.save()

    def save(self) -> None:
        """Save the state with the source's position; the journal starts afresh. Counts go to the store."""
        self._store_counts()
        self._checkpoint.save(
            {
                "engine": self.engine.export_state(),
                "position": self._position,
                "commands": self._commands.export_state(),
                "samples": self.samples,
                "frames": self.frames,
                "jobs": self._jobs.state if self._jobs else {},
                "trail": self._trail_head(),
            }
        )
        self._unsaved = 0

    def end(self) -> None:
        """The process is about to end: what it says last is that it has."""
        self._ended = True
        self._tell()

    def carry_out(self) -> None:
        """Carry out what operators have left in the store, and save: for who looks in while no daemon runs."""
        self._poll_commands()
        self.save()
        self.end()

    def _store_counts(self) -> None:
        counts = self.engine.counts | (self._feed.counters() if self._feed else {})
        if self.engine.time is None:
            return
        names = tuple(f"engine/{reason}" for reason in counts)
        n = len(names)
        self._store.write(
            Rows(
                measurement="counts",
                names=names,
                series=np.arange(n, dtype=np.int32),
                time=np.full(n, self.engine.time, dtype=np.int64),
                fields={"value": np.array(list(counts.values()), dtype=np.float64)},
            )
        )
        self._tell()

    def _take(self, batch: Batch) -> None:
        self._perform(batch)

    def _perform(self, entry: Entry) -> bool:
        """Journal an entry and carry it out; one that cannot be is buried, and the state from before it restored."""
        if self._do(self._checkpoint.journal(entry), entry):
            return True
        self.recover()
        return False

    def keep(self, outputs: Outputs) -> None:
        """What a step gave goes to the store."""
        self.frames += outputs.frames
        self._unsaved += outputs.frames
        if not outputs.rows and not outputs.alarms:
            return
        with self._store.transaction():
            self._store.write(outputs.rows)
            for alarm in outputs.alarms:
                self._store.put("alarm", alarm.key, self._speaker.stored(alarm))

    def _tell_and_keep(self, outputs: Outputs) -> None:
        """The same, and a line in the log for every alarm that has changed."""
        self.keep(outputs)
        for alarm in outputs.alarms:
            log.info("alarm", key=alarm.key, state=str(alarm.state), summary=self._speaker.summary(alarm))

    def _record_in_trail(self, content: JsonObject, number: int = 0) -> None:
        if self._trail:
            self._trail.add({"wall": round(self._now(), 3), **content}, number)

    def _trail_head(self) -> JsonObject:
        return {"lines": self._trail.head.lines, "seal": self._trail.head.seal} if self._trail else {}

    def _poll(self) -> None:
        """Now and then, look for what others left in the store."""
        now = self._now()
        if now - self._polled < POLL_SECONDS:
            return
        self._polled = now
        self._watchdog.alive()
        if self._metrics:
            self._metrics.alive()
        self._keep_store()
        self._guarded("commands", self._poll_commands)
        self._guarded("jobs", self._poll_jobs)
        if now - self._told >= STATUS_SECONDS:
            self._guarded("status", self._tell)
        if now - self._compared >= BASELINE_SECONDS:
            self._compared = now
            self._guarded("baselines", self._poll_baselines)

    def _guarded(self, what: str, turn: Callable[[], None]) -> None:
        """What is not detection may fail, and is counted: the samples go on."""
        try:
            turn()
        except (StoreError, OSError):
            raise
        except Exception as error:  # a document that somebody left, an answer that cannot be written
            self._failures[what] = self._failures.get(what, 0) + 1
            log.error("failed, going on", what=what, error=f"{type(error).__name__}: {error!s:.300}", exc_info=True)

    def _keep_store(self) -> None:
        """A store whose file was deleted or replaced: go on in a new one, with what is known of it."""
        problem = self._store.misplaced
        if not problem:
            return
        log.error("store lost, going on in a new one", reason=problem)
        self._store.renew()
        keep_again(self._store, self.engine.baselines.values())
        with self._store.transaction():
            for alarm in self.engine.alarms.open:
                self._store.put("alarm", alarm.key, self._speaker.stored(alarm))
        self._checkpoint.mishaps.append(f"{problem}: a new store was begun; restore the old one from a backup")
        self._record_in_trail({"what": "store lost", "reason": problem})
        self._store_problem = f"{problem}: results from before are gone; a new store was begun"
        self.recover()  # what was written since the checkpoint may have gone to the file without a name

    def _poll_jobs(self) -> None:
        if self._jobs and self.engine.time is not None:
            self._record(self._jobs.tick(self.engine.time))

    def _record(self, ended: list[JsonObject]) -> None:
        for document in ended:
            self._job_failures += document["state"] != "done"
            self._store.put("run", document["key"], document)

    def stop_jobs(self) -> None:
        """Stop the jobs that are running; they are done again when they are next due."""
        if self._jobs:
            self._record(self._jobs.stop())

    def status(self) -> JsonObject:
        """How the service stands, for ``fdd status``, the metrics and the dashboards."""
        now, time = self._now(), self.engine.time
        before, samples = self._rate
        spool = self._store.status if isinstance(self._store, SpooledStore) else None
        spool_problem = "" if spool is None else spool.problem
        counts = self.engine.counts | (self._feed.counters() if self._feed else {})
        return {
            "key": "daemon",
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "ended": self._ended,
            "batch": self.batch,
            "wall": now,
            "samples": self.samples,
            "frames": self.frames,
            "samples_per_second": round((self.samples - samples) / max(now - before, 1e-9), 1),
            "time": time,
            "lag_seconds": None if time is None else round(now - time / NANOSECONDS, 1),
            "open_alarms": len(self.engine.alarms.open),
            "budget": self.engine.realised_rate,
            "trust": self.engine.trust,
            "phases": self.engine.phases,
            "counts": counts,
            "problems": self._problems(now, counts, spool_problem),
            "spool_bytes": None if spool is None else spool.pending_bytes,
            "spool_problem": spool_problem,
            "baselines": self.engine.versions,
            "jobs_next": self._jobs.state if self._jobs else {},
            "job_failures": self._job_failures,
            "buried": self._checkpoint.buried,
            "dead": self._checkpoint.dead(),
            "mishaps": self._checkpoint.mishaps[-20:],
            "failures": dict(self._failures),
            "trail": self._trail_head() | ({"problem": self._trail.problem} if self._trail else {}),
            "journal_bytes": self._checkpoint.unsaved_bytes,
            "rss_bytes": resident_bytes(),
        }

    def _problems(self, now: float, counts: Mapping[str, int], spool_problem: str) -> list[JsonObject]:
        """What keeps this service from watching."""
        return self._health.look(
            now,
            frames=self.frames,
            samples=self.samples,
            counts=counts,
            heard=self._feed.heard if self._feed else {},
            blind=self.engine.blind(BLIND),
            store=spool_problem or self._store_problem,
            failures=sum(self._failures.values()) + self._checkpoint.buried + (self._desk.dropped if self._desk else 0),
        )

    def _health_rows(self, status: JsonObject) -> list[Rows]:
        """The status as rows for the dashboards and their rules, at wall-clock time."""
        wall = round(status["wall"] * NANOSECONDS)
        gauges = {
            "problems": len(status["problems"]),
            "sample_rate": status["samples_per_second"],
            "lag": status["lag_seconds"],
            "rss": status["rss_bytes"],
            **{f"alarms_a_year_{k}": v for k, v in _rates(status["budget"]).items()},
        }
        known = {f"service/{name}": float(value) for name, value in gauges.items() if value is not None}
        rows = Rows(
            measurement="health",
            names=tuple(known),
            series=np.arange(len(known), dtype=np.int32),
            time=np.full(len(known), wall, dtype=np.int64),
            fields={"value": np.array(list(known.values()))},
        )
        spool = spool_rows(self._store.status, wall) if isinstance(self._store, SpooledStore) else []
        return [rows, *spool]

    def _tell(self) -> None:
        status = self.status()
        self._told = self._now()
        self._rate = (self._told, self.samples)
        self._store.put("run", "daemon", status)
        self._store.write(self._health_rows(status))
        if self._metrics:
            self._metrics.publish(status)

    def _reload(self) -> bool:
        """Read the site file again; True where the sources are others and have to be opened anew."""
        self.reload_wanted = False
        return bool(self.reload and self.reload(self))

    def adopt(self, engine: Engine, jobs: JobRunner) -> None:
        """Go on with another engine, made of a new site file, from the state of the present one.

        Raises
        ------
        EngineError
            The new site has other equipment; the present engine stays.
        """
        engine.restore_state(self.engine.export_state())
        if self._jobs:
            jobs.restore(self._jobs.state)
            self.stop_jobs()
        self.engine, self._jobs = engine, jobs
        self.save()  # what is journaled belongs to the site as it was

    def _poll_baselines(self) -> None:
        """Take up baselines that a job or a person has put in force."""
        running = self.engine.versions
        pointers = versions_in_force(self._store)
        wanted = {name: pointers.get(name, version) for name, version in running.items()}
        changed = [n for n, v in wanted.items() if v != running[n] and (n, v) not in self._refused]
        first = [(name, pointers[name]) for name in self.engine.plan.baseline_names if name in pointers]
        first = [f for f in first if f[0] not in running and f not in self._refused]
        if first:
            log.info("first baseline", components=[name for name, _ in first])
            self._refused.update(first)  # asked for once: what a new engine will not take stays out
            self.reload_wanted = True
        if changed:
            self._perform(Rebase(tuple(in_force(self._store, changed).values())))

    def _rebase(self, entry: Rebase, number: int = 0) -> None:
        for b in entry.baselines:
            try:
                self.engine.rebase({b.component: b})
                log.info("baseline in force", component=b.component, version=b.version, reason=b.reason)
                told = {"component": b.component, "version": b.version, "reason": b.reason}
                self._record_in_trail({"what": "baseline in force", **told}, number)
            except EngineError as error:
                self._refused.add((b.component, b.version))
                log.warning("baseline refused", component=b.component, version=b.version, reason=str(error))

    def _poll_commands(self) -> None:
        for command in self._commands.new(self._store, self._authority):
            self._perform(command)
        if self._desk:
            wall = round(self._now() * NANOSECONDS)
            self._desk.serve(wall, self._alarm_documents, self._carry_out, self._refused_at_desk)

    def _refused_at_desk(self, who: str, why: str) -> None:
        self._record_in_trail({"what": "refused", "who": who, "through": "zenoh", "outcome": f"refused: {why}"})

    def _carry_out(self, command: Command) -> tuple[str, JsonObject | None]:
        """Journal a command, obey it, and give the outcome with the alarm as it then stands."""
        self._outcome = "refused: it could not be carried out, and is kept for a person to look at"
        self._perform(command)
        alarm = self._store.get("alarm", command.alarm)
        return self._outcome, None if alarm is None else self._speaker.told(Alarm.read(alarm))

    def _alarm_documents(self, every: bool) -> list[JsonObject]:
        if every:
            found = [Alarm.read(d) for d in self._store.list("alarm")]
            return [self._speaker.told(a) for a in sorted(found, key=lambda a: a.raised)]
        return [self._speaker.told(a) for a in self.engine.alarms.open]

    def _obey(self, command: Command, number: int = 0) -> None:
        try:
            outputs = self.engine.command(command)
        except AlarmError as error:
            log.warning("command refused", **asdict(command), reason=str(error))
            outputs, self._outcome = Outputs(), f"refused: {error}"
        else:
            self._outcome = DONE
        told = {"what": command.action, "alarm": command.alarm, "who": command.actor, "through": command.through}
        self._record_in_trail({**told, "comment": command.comment, "outcome": self._outcome}, number)
        self._tell_and_keep(outputs)
        self._commands.close(self._store, command, self._outcome)

    def _turn_back(self, entry: TurnBack, number: int = 0) -> None:
        self.engine.turn_back(entry.time)
        log.warning("event time set back", time=entry.time, by=entry.by)
        self._record_in_trail({"what": "event time set back", "who": entry.by, "time": entry.time}, number)
        self._commands.close(self._store, entry, DONE)
