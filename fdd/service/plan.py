"""What the engine watches: a site file, resolved to columns of a frame.

Everything that can be wrong in a site is found here, before the first sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from fdd.models.declare import ComponentModel
from fdd.records import FloatArray


@dataclass(frozen=True, slots=True)
class Derived:
    """A point computed from others: ``compute`` takes columns by name, each (m,), and returns (m,)."""

    name: str
    compute: Callable[[Mapping[str, FloatArray]], FloatArray]


@dataclass(frozen=True, slots=True)
class Component:
    """One piece of equipment under a filter.

    ``inputs`` and ``outputs`` are point names in the order of the model; ``when`` names the column of its gate, which
    is 1 while the machine may be judged; ``start_up`` is how long its charts rest after a start [ns].
    """

    name: str
    model: ComponentModel
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    when: str | None = None
    start_up: int = 0
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class Plan:
    """All the engine needs to know; times in ns."""

    site: str
    step: int
    lateness: int
    max_gap: int
    max_jump: int
    hold: int
    false_alarms_per_year: float
    points: tuple[str, ...]
    derived: tuple[Derived, ...]
    components: tuple[Component, ...]
    meanings: Mapping[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of a frame's columns: the measured points, then the derived ones."""
        return (*self.points, *(d.name for d in self.derived))

    def derive(self, values: FloatArray) -> FloatArray:
        """Columns (m, n_columns) from the measured points' values (m, n_points)."""
        table = {name: values[:, i] for i, name in enumerate(self.points)}
        for derived in self.derived:
            table[derived.name] = np.broadcast_to(derived.compute(table), len(values))
        return np.column_stack([table[name] for name in self.columns])
