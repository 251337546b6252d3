"""Load: a plant of thousands of components sends over Zenoh from a process of its own; the daemon keeps everything.

Every component has five points and sends each of them once a second; frames are one second. A frame is closed by the
first sample of the next second: the latency is from the sending of that sample to the verdicts of the frame being in
the store (or its spool), over all frames. A point counts as lost unless its row is in the database itself afterwards.
"""

from __future__ import annotations

import multiprocessing
import socket
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from fdd.config import Equipment, Point, Site
from fdd.records import NANOSECONDS, Baseline, Batch, Quality
from fdd.service.daemon.checkpoint import Checkpoint
from fdd.service.daemon.daemon import Daemon, resident_bytes
from fdd.service.engine.engine import Engine
from fdd.service.site.feed import Feed
from fdd.service.site.plan import plan_of
from fdd.store.store import Store
from ingest.zenoh.options import ZenohOptions
from ingest.zenoh.publisher import ZenohPublisher

START = 1_760_054_400
PARAMETERS = {"C_i": 5e6, "R_ia": 5e-3, "A_w": 4.0, "sigma_i": 3e-4, "noise_in": 0.02}
ROLES = ("out", "sun", "heat", "T", "co2")
STEADY = (5.0, 0.0, 3000.0, 20.0, 600.0)
MESSAGES_A_SECOND = 10
# Allocations settle within the first minute, or third of a shorter run; what comes later is growth.
SETTLED_SECONDS = 60


def site_of(components: int, endpoint: str) -> Site:
    """Rooms with five points each, over Zenoh, in frames of a second."""
    names = [f"r{i:04d}" for i in range(components)]
    point = Point()
    return Site(
        name="load",
        step="1 s",  # type: ignore[arg-type]  # the file's own form
        lateness="0 s",  # type: ignore[arg-type]
        max_gap="1 min",  # type: ignore[arg-type]
        # 8 000 charts at one value a second: a smaller budget is beyond the longest run length that can be designed.
        false_alarms_per_year=4000.0,
        sources=(ZenohOptions(key="load/**", connect=(endpoint,), until_end=True),),
        points={f"{n}.{role}": point for n in names for role in ROLES},
        equipment={
            n: Equipment(
                model="zone",
                options={"nodes": "Ti"},
                inputs={"T_out": f"{n}.out", "I_solar": f"{n}.sun", "P_heat": f"{n}.heat"},
                outputs={"T_room": f"{n}.T"},
            )
            for n in names
        },
    )


def send(endpoint: str, names: tuple[str, ...], seconds: int, pace: float, back: Connection) -> None:
    """Every point once a second, ``pace`` seconds of wall clock to a second of event time; sends when each began."""
    rng = np.random.default_rng(1)
    steady = np.tile(STEADY, len(names) // len(ROLES))
    noise = np.tile((0.0, 0.0, 0.0, 0.02, 5.0), len(names) // len(ROLES))
    began = np.zeros(seconds)
    with ZenohPublisher(ZenohOptions(listen=(endpoint,)), "load/plant", cache=seconds * MESSAGES_A_SECOND + 10) as out:
        back.send("ready")
        out.wait_for_subscriber(120)
        first = time.monotonic()
        for k in range(seconds):
            values = steady + noise * rng.standard_normal(len(names))
            for j, part in enumerate(np.array_split(np.arange(len(names)), MESSAGES_A_SECOND)):
                time.sleep(max(0.0, first + (k + j / MESSAGES_A_SECOND) * pace - time.monotonic()))
                if j == 0:
                    began[k] = time.monotonic()
                own = tuple(names[part[0] : part[-1] + 1])
                at = np.full(len(part), (START + k) * NANOSECONDS, dtype=np.int64)
                quality = np.full(len(part), Quality.GOOD, dtype=np.uint8)
                out.publish(Batch(own, np.arange(len(part), dtype=np.int32), at, values[part], quality))
        out.end()
        back.send(began)
        back.recv()


def measure(
    store: Store, folder: Path, components: int, seconds: int, pace: float, stored: Callable[[], int]
) -> dict[str, Any]:
    """Stream for so long; rate, latencies, points that are not in the database, what the memory did.

    Parameters
    ----------
    seconds : of event time, each ``pace`` seconds of wall clock
    stored : how many samples the database itself holds; asked once the daemon has ended
    """
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    site = site_of(components, endpoint)
    plan = plan_of(site)
    engine = Engine(plan, {c.name: _known(c.name) for c in plan.components})
    here, there = multiprocessing.Pipe()
    sender = multiprocessing.get_context("spawn").Process(
        target=send, args=(endpoint, plan.points, seconds, pace, there)
    )
    sender.start()
    here.recv()
    done = np.full(seconds, np.nan)
    memory = np.zeros(seconds)

    def watch(daemon: Daemon) -> None:
        if daemon.engine.time is not None:
            k = daemon.engine.time // NANOSECONDS - START
            new = np.isnan(done[: k + 1])
            done[: k + 1][new] = time.monotonic()
            memory[: k + 1][new] = resident_bytes()

    feed, checkpoint = Feed(site), Checkpoint(folder / "state.sqlite")
    daemon = Daemon(engine, store, checkpoint, watch=watch, save_every=SETTLED_SECONDS // 2)
    feed.open(None, patient=True)
    daemon.run(feed)
    daemon.finish()
    watch(daemon)
    ended = time.monotonic()
    store.close()  # forwards what still waits
    drained = time.monotonic() - ended
    began = here.recv()
    here.send("done")
    sender.join()
    feed.close()
    checkpoint.close()
    latency = done[:-1] - began[1:]
    settled = min(SETTLED_SECONDS, seconds // 3)
    return {
        "rate": len(plan.points) * (seconds - 1) / (began[-1] - began[0]),
        "p99_ms": float(np.nanpercentile(latency, 99) * 1e3),
        "median_ms": float(np.nanmedian(latency) * 1e3),
        "worst_ms": float(np.nanmax(latency) * 1e3),
        "drained_seconds": drained,
        "lost": len(plan.points) * seconds - stored(),
        "growth_mb": float(memory[-settled:].max() - memory[:settled].max()) / 1e6,
        "memory_mb": [round(m / 1e6) for m in memory[:: max(1, seconds // 18)]],
        "settled": seconds >= 3 * SETTLED_SECONDS,  # a shorter run's growth is its first checkpoint
        "alarms": len(engine.alarms.open),
    }


def _known(name: str) -> Baseline:
    innovation = {"T_room": {"mean": 0.0, "sd": 1.0, "lag1": 0.0, "samples": 1}}
    return Baseline(name, 1, "zone", "1", {"nodes": "Ti"}, PARAMETERS, {}, [], 0, 0, 0, 0.0, innovation)


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])
