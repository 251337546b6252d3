"""A stretch of the demonstration plant's life: when, how long, which faults; and its measured points as a table.

>>> frame = simulate(Scenario(days=1))
>>> frame.shape
(288, 17)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from fdd.plant.district import district_plant, outside
from fdd.plant.faults import PlantFault, effects
from fdd.plant.network import Network, PlantError
from fdd.plant.simulate import Change, Simulator
from fdd.records import NANOSECONDS, FloatArray, IntArray

WARM_UP = 3  # days before the start that are simulated and thrown away


@dataclass(frozen=True)
class Scenario:
    """What to simulate.

    Attributes
    ----------
    start : first sample, ISO date and time, UTC
    days : length
    step : sampling interval [s]
    seed : weather, occupants, process and sensor noise; the same seed gives the same numbers
    faults : onsets count from ``start``
    """

    start: str = "2024-10-07T00:00:00"
    days: float = 28.0
    step: float = 300.0
    seed: int = 1
    faults: tuple[PlantFault, ...] = field(default=())

    def __post_init__(self) -> None:
        if not 10.0 <= self.step <= 3600.0:
            raise PlantError(f"step {self.step} s is outside [10, 3600] s; buildings are sampled every 1 to 15 minutes")
        if not 0.0 < self.days <= 10 * 366:
            raise PlantError(f"{self.days} days is outside ]0, 3660]; simulate up to ten years at once")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return max(1, round(self.days * 86400.0 / self.step))

    @property
    def first(self) -> int:
        """Event time of the first sample [ns]."""
        return int(pd.Timestamp(self.start, tz="UTC").value)

    def times(self) -> IntArray:
        """Event times of the samples, (n,) [ns]."""
        return self.first + np.arange(self.samples, dtype=np.int64) * round(self.step * NANOSECONDS)


@dataclass(frozen=True, slots=True)
class Plant:
    """A plant that scenarios can run: how it is wired, and its outside signals at event times [ns]."""

    network: Callable[[], Network]
    outside: Callable[[IntArray, np.random.Generator], Mapping[str, FloatArray]]


HOUSE = Plant(district_plant, outside)


Factor = Callable[[FloatArray], ArrayLike]
"""What a parameter is multiplied by, by time since the first sample [s], which is negative while warming up."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive samples: number of the first, event times (n,) [ns], measured points (n, n_points)."""

    first: int
    time: IntArray
    values: FloatArray


def points(plant: Network | None = None) -> list[str]:
    """Names of the measured points, in order."""
    return list((plant or district_plant()).sensors)


def pieces(
    scenario: Scenario,
    progress: Callable[[int, int], None] | None = None,
    plant: Plant = HOUSE,
    factors: Mapping[str, Factor] | None = None,
) -> Iterator[Piece]:
    """Simulate in pieces of a week, SI units; the demonstration house, or another plant.

    ``factors`` : on parameters (``owner.symbol``) that no fault of the scenario changes

    Raises
    ------
    PlantError : a fault the plant cannot have
    """
    network = plant.network()
    warm = round(WARM_UP * 86400.0 / scenario.step)
    gap = round(scenario.step * NANOSECONDS)
    time = scenario.first + np.arange(-warm, scenario.samples, dtype=np.int64) * gap
    weather_seed, plant_seed = np.random.SeedSequence(scenario.seed).generate_state(2)
    seconds = (time - scenario.first) / NANOSECONDS
    changes, sensors = effects(network, scenario.faults, seconds)
    for target, factor in (factors or {}).items():
        owner, _, symbol = target.rpartition(".")
        value = network.components[owner].parameters[symbol]
        changes.append(Change(target, value * np.asarray(factor(seconds), dtype=np.float64)))
    simulator = Simulator(network, scenario.step, int(plant_seed))
    signals = plant.outside(time, np.random.default_rng(weather_seed))
    for block in simulator.run(signals, changes, sensors, progress=progress):
        keep = max(0, warm - block.start)
        if keep < len(block.measured):
            at = block.start + keep
            yield Piece(at - warm, time[at : block.start + len(block.measured)], block.measured[keep:])


def simulate(
    scenario: Scenario, progress: Callable[[int, int], None] | None = None, plant: Plant = HOUSE
) -> pd.DataFrame:
    """Measured points by event time (UTC), one column a point, SI units.

    Raises
    ------
    PlantError : a fault the plant cannot have
    """
    parts = list(pieces(scenario, progress, plant))
    index = pd.DatetimeIndex(pd.to_datetime(np.concatenate([p.time for p in parts]), utc=True), name="time")
    return pd.DataFrame(
        np.concatenate([p.values for p in parts]), index=index, columns=pd.Index(points(plant.network()))
    )
