"""How far a healthy stream's statistic goes in a day, and a limit from it: for charts whose values nobody can model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.records import FloatArray, JsonObject
from fdd.residual_monitors.chart import StateError

DAYS, CENTRE, SPREAD = 14.0, float(np.log(4.0)), 0.4
"""Days that the prior is worth, and the mean and standard deviation of a day's logarithm of the maximum by it."""
LEAST = 0.5
"""Maxima below this are no smaller to the logarithm."""
ENOUGH = 364
"""Days after which nothing more is learned."""


class Extremes:
    """Daily maxima of n statistics, on a scale on which they are taken to be normal: ``logarithmic``, or their own.

    The limit is that which one further day passes with the given chance, by Student's predictive distribution: it is
    wide after a few days and narrows as they come. By the prior a day has this ``centre`` and ``spread`` there.
    """

    def __init__(
        self, n: int, block: int, *, centre: float = CENTRE, spread: float = SPREAD, logarithmic: bool = True
    ) -> None:
        self.block, self.centre, self.spread, self.logarithmic = int(block), float(centre), float(spread), logarithmic
        self.peak, self.count = np.zeros(n), np.zeros(n, dtype=np.int64)
        self.days, self.total = np.full(n, DAYS), np.full(n, DAYS * centre)
        self.squares = np.full(n, DAYS * (centre**2 + spread**2))

    def update(self, statistic: FloatArray, learn: NDArray[np.bool_]) -> bool:
        """Take a value a stream; NaN: nothing seen. Streams that may not ``learn`` forget their day.

        Returns
        -------
        Whether a day has taught something, so that limits are new.
        """
        seen = np.isfinite(statistic)
        self.peak = np.where(seen, np.maximum(self.peak, np.nan_to_num(statistic)), self.peak)
        self.count += seen
        self.peak[~learn], self.count[~learn] = 0.0, 0
        full = np.flatnonzero(self.count >= self.block)
        taught = full[self.days[full] < ENOUGH]
        value = self.peak[taught]
        value = np.log(np.maximum(value, LEAST)) if self.logarithmic else value
        self.days[taught] += 1.0
        self.total[taught] += value
        self.squares[taught] += value * value
        self.peak[full], self.count[full] = 0.0, 0
        return taught.size > 0

    def limit(self, chance: FloatArray) -> FloatArray:
        """What a further day passes with this chance, (n,)."""
        mean = self.total / self.days
        spread = np.sqrt(np.maximum(self.squares / self.days - mean * mean, 1e-6) * self.days / (self.days - 1.0))
        reach = student.isf(chance, self.days - 1.0) * np.sqrt(1.0 + 1.0 / self.days)
        most = np.minimum(mean + reach * spread, 50.0)
        return np.asarray(np.round(np.exp(most) if self.logarithmic else most, 6))

    def forget(self, rows: NDArray[np.bool_]) -> None:
        """Begin these streams anew."""
        fresh = Extremes(
            len(self.days), self.block, centre=self.centre, spread=self.spread, logarithmic=self.logarithmic
        )
        for name in fresh.export_state():
            getattr(self, name)[rows] = getattr(fresh, name)[rows]

    def knowledge(self, stream: int) -> list[float]:
        """What was learned of a stream."""
        return [float(self.days[stream]), float(self.total[stream]), float(self.squares[stream])]

    def recall(self, stream: int, knowledge: list[float]) -> None:
        """Take up what :meth:`knowledge` gave."""
        self.days[stream], self.total[stream], self.squares[stream] = knowledge

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {name: getattr(self, name).copy() for name in ("peak", "count", "days", "total", "squares")}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood.

        Raises
        ------
        StateError
            The state is of another number of streams.
        """
        for name, own in self.export_state().items():
            value = np.array(state[name], dtype=own.dtype)
            if value.shape != own.shape:
                raise StateError(f"daily maxima: saved {name!r} has shape {value.shape}, needs {own.shape}")
            setattr(self, name, value)
