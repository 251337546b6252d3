"""The demonstration plant as a source of samples, like any other: SI values under the points' own names."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from fdd.plant.district import district_plant
from fdd.plant.faults import DAY, PlantFault, effects
from fdd.plant.network import PlantError
from fdd.plant.scenario import Piece, Scenario, pieces, points
from fdd.records import Batch, JsonObject
from fdd.tables import Duration, DurationOrZero, SourceOptions, Strict

if TYPE_CHECKING:
    from ingest.source import Context


class FaultOptions(Strict):
    """One fault of the plant."""

    kind: str = Field(description="fouling, air, sludge, leak, stick, stuck, hunting, bias, drift, noise, freeze, ...")
    target: str = Field(description="component, control block or point it acts on")
    onset: DurationOrZero = Field(default=0.0, description="when it begins, after the start")
    severity: float = Field(description="its final size: a share, or the point's unit for bias and drift")
    shape: Literal["step", "ramp", "intermittent"] = Field(default="step", description="how it comes")
    duration: Duration = Field(default=7 * DAY, description="how long a ramp grows, or one turn of an intermittent one")


class PlantOptions(SourceOptions):
    """Keys of a source of kind ``plant``."""

    kind: Literal["plant"] = Field(default="plant", description="plant")
    start: str = Field(default=Scenario.start, description="first sample, ISO date and time, UTC")
    length: Duration = Field(default=28 * DAY, description="how long it runs")
    step: Duration = Field(default=300.0, description="sampling interval")
    seed: int = Field(default=1, ge=0, description="everything random comes from it")
    faults: tuple[FaultOptions, ...] = Field(default=(), description="faults, by onset after the start")
    batch_rows: int = Field(default=288, ge=1, le=100_000, description="sampling times in one batch")

    def scenario(self) -> Scenario:
        """The same as a scenario."""
        faults = tuple(PlantFault(**f.model_dump()) for f in self.faults)
        return Scenario(self.start, self.length / DAY, self.step, self.seed, faults)


class PlantSource:
    """Simulated samples; a position is the number of the next sampling time."""

    options: ClassVar[type[SourceOptions]] = PlantOptions

    def __init__(self) -> None:
        self._scenario = Scenario()
        self._rows = 288
        self._next = 0
        self._stopped = False

    def configure(self, options: PlantOptions, context: Context) -> None:
        """Check the scenario and its faults.

        Raises
        ------
        Refused : a start, length or fault that cannot be
        """
        from ingest.source import Refused

        try:
            self._scenario = options.scenario()
            effects(district_plant(), self._scenario.faults, np.zeros(1))
        except (PlantError, ValueError) as error:
            raise Refused(f"the plant cannot be simulated: {error}") from error
        self._rows = options.batch_rows

    def open(self, position: JsonObject | None = None) -> None:
        """Start at a sampling time; what lies before is simulated again, so that the numbers are the same."""
        self._next = int(position["row"]) if position else 0
        self._stopped = False

    def batches(self) -> Iterator[Batch]:
        """All points at each sampling time."""
        names = tuple(points())
        for piece in pieces(self._scenario):
            for start in range(0, len(piece.time), self._rows):
                low, high = max(start, self._next - piece.first), min(start + self._rows, len(piece.time))
                if low >= high:
                    continue
                self._next = piece.first + high
                yield self._batch(names, piece, slice(low, high))
                if self._stopped:
                    return

    def _batch(self, names: tuple[str, ...], piece: Piece, rows: slice) -> Batch:
        return Batch.of_table(names, piece.time[rows], piece.values[rows], self.position())

    def position(self) -> JsonObject:
        """Number of the next sampling time."""
        return {"row": self._next}

    def counters(self) -> dict[str, int]:
        """Nothing is ever rejected."""
        return {}

    def notes(self) -> list[str]:
        """Nothing is ever rejected."""
        return []

    def stop(self) -> None:
        """End after the batch under way."""
        self._stopped = True

    def close(self) -> None:
        """Nothing to give up."""
