"""A site of two heated rooms whose truth is simulated here, exactly and apart from the project's own filters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np
import pytest

from fdd.models.zone import zone
from fdd.records import NANOSECONDS, Baseline, Batch, Sample
from fdd.service.site.plan import Component, Plan
from tests.report.lint import watching

STEP = 300
C, R, AREA, SIGMA, NOISE = 5e6, 5e-3, 4.0, 3e-4, 0.02
START = 1_760_000_000 * NANOSECONDS // (STEP * NANOSECONDS) * STEP * NANOSECONDS


@dataclass(frozen=True)
class Truth:
    """What the rooms did: points by name, each (n,)."""

    time: np.ndarray
    points: dict[str, np.ndarray]

    def batch(self, start: int = 0, stop: int | None = None) -> Batch:
        """Samples in order of time, points of one time together."""
        rows = range(start, len(self.time) if stop is None else stop)
        return Batch.of(Sample(p, int(self.time[k]), float(v[k])) for k in rows for p, v in self.points.items())


def simulate(n: int, seed: int, *, loss: float = 0.0, onset: int = 0) -> Truth:
    """Two rooms heated by chance; from ``onset`` on the south room loses ``loss`` watts that nobody measures."""
    rng = np.random.default_rng(seed)
    outside = 5 + 5 * np.sin(np.arange(n) * 2 * np.pi * STEP / 86400)
    sun = np.clip(200 * np.sin(np.arange(n) * 2 * np.pi * STEP / 86400 - 1.5), 0, None)
    points = {"outside": outside, "sun": sun}
    a = exp(-STEP / (R * C))
    q = SIGMA * sqrt(R * C / 2 * (1 - a * a))
    for room in ("south", "north"):
        heat = np.repeat(rng.uniform(1500, 4500, n // 24 + 1), 24)[:n]
        unseen = np.where((np.arange(n) >= onset) & (room == "south"), loss, 0.0)
        steady = outside + R * (heat + AREA * sun - unseen)
        T = np.empty(n)
        T[0] = 18.0
        for k in range(n - 1):
            T[k + 1] = a * T[k] + (1 - a) * steady[k] + q * rng.standard_normal()
        points[f"{room}.heat"] = heat
        points[f"{room}.T"] = T + NOISE * rng.standard_normal(n)
    return Truth(START + np.arange(n) * STEP * NANOSECONDS, points)


def plan(false_alarms_per_year: float = 2.0) -> Plan:
    """The site as its file would say."""
    model = zone("Ti")
    components = tuple(
        Component(room, model, ("outside", "sun", f"{room}.heat"), (f"{room}.T",)) for room in ("south", "north")
    )
    return Plan(
        site="rooms",
        step=STEP * NANOSECONDS,
        lateness=0,
        max_gap=3600 * NANOSECONDS,
        max_jump=7 * 86400 * NANOSECONDS,
        hold=0,
        false_alarms_per_year=false_alarms_per_year,
        points=("outside", "sun", "south.heat", "south.T", "north.heat", "north.T"),
        derived=(),
        components=components,
    )


def baselines() -> dict[str, Baseline]:
    """The truth as a baseline."""
    parameters = {"C_i": C, "R_ia": R, "A_w": AREA, "sigma_i": SIGMA, "noise_in": NOISE}
    return {
        room: Baseline(
            component=room,
            version=1,
            model="zone",
            model_version="1",
            options={"nodes": "Ti"},
            parameters=parameters,
            standard_errors={},
            covariance=[],
            start=0,
            end=0,
            samples=0,
            log_likelihood=0.0,
            innovation={"T_room": {"mean": 0.0, "sd": 1.0, "lag1": 0.0, "samples": 10**9}},
        )
        for room in ("south", "north")
    }


@pytest.fixture(scope="session")
def healthy() -> Truth:
    """A fortnight without a fault."""
    return simulate(14 * 288, seed=1)


@pytest.fixture(scope="session")
def faulty() -> Truth:
    """A fortnight in which the south room loses 900 W from the seventh day on."""
    return simulate(14 * 288, seed=2, loss=900.0, onset=7 * 288)


@pytest.fixture(scope="session", autouse=True)
def reports_are_read() -> Iterator[None]:
    """No report that a test of the service writes may contradict itself."""
    with watching():
        yield
