"""Years of a heated room whose heat loss changes: what re-identification must follow, and what it must not learn.

The truth is simulated exactly (one state, zero-order hold), apart from the project's own filters. Its thermal
resistance is R (1 + season) / (1 + fault): a season is a sine over the year, a fault grows or steps from its onset on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.models.zone import zone
from fdd.records import NANOSECONDS, FloatArray
from fdd.service.baselines.history import History
from fdd.service.site.plan import Component, Plan

STEP = 900
DAY = 86400
C, R, AREA, SIGMA, NOISE = 5e6, 5e-3, 4.0, 3e-4, 0.02
START = 1_760_054_400 * NANOSECONDS // (DAY * NANOSECONDS) * DAY * NANOSECONDS
POINTS = ("outside", "sun", "heat", "T")


@dataclass(frozen=True)
class Course:
    """How R changes: ``season`` is an amplitude, ``growth`` a share a month, ``step`` a share; the fault lowers R."""

    days: int
    season: float = 0.0
    growth: float = 0.0
    step: float = 0.0
    onset: float = 0.0

    def resistance(self) -> FloatArray:
        """R at every frame [K/W]."""
        day = np.arange(self.days * DAY // STEP) * STEP / DAY
        since = np.maximum(0.0, day - self.onset)
        fault = self.growth * since / (365.25 / 12) + self.step * (day >= self.onset)
        return np.asarray(R * (1 + self.season * np.sin(2 * np.pi * day / 365.25)) / (1 + fault))


def simulate(course: Course, seed: int) -> History:
    """What the room's points measured."""
    rng = np.random.default_rng(seed)
    n = course.days * DAY // STEP
    hour = np.arange(n) * STEP / 3600
    weather = np.repeat(rng.normal(0, 3, course.days + 1), DAY // STEP)[:n]
    outside = 5 + 4 * np.sin(hour * 2 * np.pi / 24) + weather
    sun = np.clip(300 * np.sin(hour * 2 * np.pi / 24 - 1.5), 0, None) * rng.uniform(0.1, 1, course.days).repeat(
        DAY // STEP
    )
    heat = np.repeat(rng.uniform(1000, 5000, n // 16 + 1), 16)[:n]
    resistance = course.resistance()
    a = np.exp(-STEP / (resistance * C))
    q = SIGMA * np.sqrt(resistance * C / 2 * (1 - a * a))
    steady = outside + resistance * (heat + AREA * sun)
    T, noise = np.empty(n), rng.standard_normal((2, n))
    T[0] = 18.0
    for k in range(n - 1):
        T[k + 1] = a[k] * T[k] + (1 - a[k]) * steady[k] + q[k] * noise[0, k]
    time = START + (1 + np.arange(n)) * STEP * NANOSECONDS
    return History(POINTS, time, np.column_stack([outside, sun, heat, T + NOISE * noise[1]]))


def plan(false_alarms_per_year: float = 1.0) -> Plan:
    """One room under one filter."""
    return Plan(
        site="room",
        step=STEP * NANOSECONDS,
        lateness=0,
        max_gap=4 * 3600 * NANOSECONDS,
        max_jump=7 * DAY * NANOSECONDS,
        hold=0,
        false_alarms_per_year=false_alarms_per_year,
        points=POINTS,
        derived=(),
        components=(Component("room", zone("Ti"), ("outside", "sun", "heat"), ("T",)),),
    )
