"""Fault-free air handlers that the rows were not written for, with what they leave out: quasi-steady, a day at once.

Stratified mixing that changes with the damper, dampers and valves that leak within tolerance, equal-percentage valves,
sensors with lags and errors for good, schedules that change, set points that are reset, controls that hunt. Every
number of a plant is drawn once; its weather and its noise go on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.models.expectation import Day
from fdd.records import FloatArray

STEP = 300.0
SAMPLES = int(86400 / STEP)
HOUR = np.arange(SAMPLES) * STEP / 3600


@dataclass(frozen=True)
class AirHandler:
    """One plant's own numbers."""

    curve: float
    low: float
    high: float
    least: float
    stratified: float
    hot: float
    cold: float
    heats: float
    cools: float
    leaks: tuple[float, float]
    fan: float
    bias: tuple[float, float, float, float]
    lag: float
    open: float
    shut: float
    room: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> AirHandler:
        """A plant within what installers accept: sensors within their tolerance, leaks below 1 %."""
        bias = rng.normal(0.0, [0.4, 0.7, 0.4, 0.5])
        return cls(
            curve=float(np.exp(rng.normal(np.log(1.4), 0.3))),
            low=float(rng.uniform(0.0, 0.06)),
            high=float(rng.uniform(0.9, 1.0)),
            least=float(rng.uniform(0.15, 0.45)),
            stratified=float(rng.normal(0.0, 0.5)),
            hot=float(rng.uniform(50.0, 75.0)),
            cold=float(rng.uniform(5.5, 8.5)),
            heats=float(rng.uniform(0.3, 0.6)),
            cools=float(rng.uniform(0.65, 0.9)),
            leaks=(float(rng.uniform(0, 0.005)), float(rng.uniform(0, 0.005))),
            fan=float(rng.uniform(0.5, 1.8)),
            bias=(float(bias[0]), float(bias[1]), float(bias[2]), float(bias[3])),
            lag=float(rng.uniform(60.0, 240.0)),
            open=float(rng.uniform(5.0, 8.0)),
            shut=float(rng.uniform(17.0, 21.0)),
            room=float(rng.uniform(20.0, 23.0)),
        )

    def day(self, number: int, rng: np.random.Generator) -> Day:
        """One day of the year."""
        season = -np.cos(2 * np.pi * (number - 15) / 365)
        out = 11 + 9 * season + rng.normal(0, 3) + (3 + season) * np.sin((HOUR - 9) / 24 * 2 * np.pi)
        weekend = number % 7 >= 5
        start, stop = (
            (24.0, 24.0) if weekend else (self.open + rng.choice([0, 0, 0, -1]), self.shut + rng.choice([0, 0, 0, 2]))
        )
        on = (start <= HOUR) & (stop > HOUR)
        back = self.room + 0.6 * season + 0.7 * np.sin((HOUR - 11) / 24 * 2 * np.pi)
        speed = np.clip(0.65 + 0.2 * np.maximum(season, 0) + 0.05 * rng.normal(size=SAMPLES).cumsum() / 8, 0.4, 1.0)
        wanted = 14.0 + np.clip((12 - out) / 6, 0, 2)
        heat, cool, damper, supply, mixed = self._control(out, back, speed, wanted, rng)
        command = {"heat": heat * on, "cool": cool * on, "damper": damper * on, "fan": speed * on}
        supply, mixed = self._standing(supply, on, out), self._standing(mixed, on, out)
        truth = {"T_supply": supply, "T_mixed": mixed, "T_return": back, "T_out": out}
        readings = {
            role: _lagged(x, self.lag) + off + 0.1 * rng.standard_normal(SAMPLES)
            for (role, x), off in zip(truth.items(), self.bias, strict=True)
        }
        time = number * 86400.0 + HOUR * 3600
        return Day(time, {**readings, **command, "T_supply_set": wanted}, STEP)

    def _control(
        self, out: FloatArray, back: FloatArray, speed: FloatArray, wanted: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, ...]:
        """Positions on a grid whose supply air comes nearest to the set point: heating, damper, cooling in sequence."""
        grid = np.linspace(0, 1, 101)
        hunting = 0.01 * rng.standard_normal(SAMPLES)
        free = np.where(out[:, None] < back[:, None], self.least + (1 - self.least) * grid, self.least)
        stratified = self.stratified * 4 * free * (1 - free)
        share = self.low + (self.high - self.low) * free**self.curve
        mixed = back[:, None] + share * (out - back)[:, None]
        target = wanted[:, None] - self.fan * speed[:, None] ** 2
        chosen = np.abs(mixed - target).argmin(axis=1)
        row = np.arange(SAMPLES)
        damper, before = free[row, chosen], mixed[row, chosen]
        seen = before + stratified[row, chosen]
        heat = self._position(grid, self.heats, self.hot - before, target[:, 0] - before)
        warmed = before + self.heats * _flow(heat, self.leaks[0]) * (self.hot - before) + self.fan * speed**2
        cool = self._position(grid, self.cools, warmed - self.cold, warmed - wanted)
        supply = warmed - self.cools * _flow(cool, self.leaks[1]) * (warmed - self.cold)
        cool = np.where(cool > 0, np.clip(cool + hunting, 0, 1), 0.0)
        return heat, cool, damper, supply, seen

    def _position(self, grid: FloatArray, share: float, span: FloatArray, needed: FloatArray) -> FloatArray:
        """Where a valve must stand for a change of temperature; 0 where none is needed."""
        reached = share * _flow(grid, 0.0) * span[:, None]
        at = grid[np.abs(reached - needed[:, None]).argmin(axis=1)]
        return np.where(needed > 0.2, at, 0.0)

    def _standing(self, x: FloatArray, on: np.ndarray, out: FloatArray) -> FloatArray:
        """While the fan stands a section drifts towards the room it is in."""
        found, now = x.copy(), self.room
        for k in range(SAMPLES):
            now = x[k] if on[k] else now + STEP / 7200.0 * (self.room + 0.1 * (out[k] - self.room) - now)
            found[k] = now
        return found


def _flow(position: FloatArray, leak: float) -> FloatArray:
    """Share of the coil's full effect: an equal-percentage valve before a coil that saturates."""
    water = leak + (1 - leak) * np.where(position > 0.005, 40.0 ** (position - 1), 0.0)
    return water / (0.25 + 0.75 * water)


def _lagged(x: FloatArray, lag: float) -> FloatArray:
    """A sensor of the first order."""
    a = np.exp(-STEP / lag)
    found = x.copy()
    for k in range(1, len(x)):
        found[k] = a * found[k - 1] + (1 - a) * x[k]
    return found
