"""A source's samples become points in SI, each rejection counted by its reason.

==================  ================================================================================================
reason              what happens to the sample
==================  ================================================================================================
no value            the source gave none (NaN, infinite): kept as BAD without a value, so that time still moves on
missing value       one of the point's ``missing`` numbers: as above
out of range        outside the point's ``range``: as above
bad quality         the source says so: as above
unknown point       the site maps no point from it: dropped
==================  ================================================================================================

The outcome depends on the sample alone, so it is the same however the stream is cut and after any restart. Late,
repeated and backward times are the framer's business.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fdd.records import Batch, FloatArray, Quality
from fdd.units import Conversion

REASONS = ("no value", "missing value", "out of range", "bad quality", "unknown point")
_NAMES_KEPT = 1000
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _Columns:
    """Per name of a batch: which point, how to convert, what to reject; -1 for unknown names."""

    point: NDArray[np.int32]
    scale: FloatArray
    offset: FloatArray
    low: FloatArray
    high: FloatArray
    missing: FloatArray  # (k, n_names), NaN where a point has fewer than k
    ranged: bool


class MappedPoint(Protocol):
    """What mapping asks of a point; ``range`` and ``missing`` are in the source's unit."""

    @property
    def column(self) -> str:
        """What the source calls it; empty where that is the point's own name."""

    @property
    def range(self) -> tuple[float, float] | None:
        """Values outside are rejected."""

    @property
    def missing(self) -> tuple[float, ...]:
        """Numbers that mean that there is no value."""

    @property
    def conversion(self) -> Conversion:
        """From the source's unit to SI."""


class PointMap:
    """Maps one source's batches; keeps the counters."""

    def __init__(self, points: Mapping[str, MappedPoint]) -> None:
        """``points``: point name to its table of the site file, those of this source."""
        self.names = tuple(points)
        self._points = list(points.values())
        self._by_column = {p.column or name: i for i, (name, p) in enumerate(points.items())}
        self._cache: dict[tuple[str, ...], _Columns] = {}
        self._counts: dict[str, dict[str, int]] = {reason: {} for reason in REASONS}
        self.samples = 0

    @property
    def columns(self) -> tuple[str, ...]:
        """The source's names that points are mapped from."""
        return tuple(self._by_column)

    def __call__(self, batch: Batch) -> Batch:
        """The batch with points' names, SI values and qualities; same order, unknown names left out."""
        self.samples += len(batch)
        table = self._table(batch.names)
        at = batch.point
        point = table.point[at] if len(table.point) else np.empty(0, dtype=np.int32)
        known = point >= 0
        if not known.all():
            self._count("unknown point", at[~known], batch.names)
            batch = Batch(
                batch.names, at[known], batch.time[known], batch.value[known], batch.quality[known], batch.position
            )
            at, point = batch.point, point[known]
        bad = self._rejected(batch, table)
        with np.errstate(over="ignore"):  # beyond what SI can be written in: no value
            value = batch.value * table.scale[at] + table.offset[at] if len(at) else batch.value
        bad |= ~np.isfinite(value)
        value = np.where(bad, np.nan, value)
        quality = np.where(bad, np.uint8(Quality.BAD), batch.quality)
        return Batch(self.names, point, batch.time, value, quality, batch.position)

    def _rejected(self, batch: Batch, table: _Columns) -> BoolArray:
        raw, at = batch.value, batch.point
        bad: BoolArray = ~np.isfinite(raw)
        self._count("no value", at[bad], batch.names)
        for numbers in table.missing:
            hit = (raw == numbers[at]) & ~bad
            self._count("missing value", at[hit], batch.names)
            bad |= hit
        if table.ranged:
            hit = ((raw < table.low[at]) | (raw > table.high[at])) & ~bad
            self._count("out of range", at[hit], batch.names)
            bad |= hit
        hit = (batch.quality >= Quality.BAD) & ~bad
        self._count("bad quality", at[hit], batch.names)
        return bad | hit

    def _table(self, names: tuple[str, ...]) -> _Columns:
        if names not in self._cache:
            if len(self._cache) > 256:  # sources with ever-changing name lists must not fill the memory
                self._cache.clear()
            self._cache[names] = self._build(names)
        return self._cache[names]

    def _build(self, names: tuple[str, ...]) -> _Columns:
        index = np.array([self._by_column.get(n, -1) for n in names], dtype=np.int32)
        points = [self._points[i] if i >= 0 else None for i in index]
        deepest = max((len(p.missing) for p in points if p), default=0)
        missing = np.full((deepest, len(names)), np.nan)
        scale, offset = np.ones(len(names)), np.zeros(len(names))
        low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        for i, p in enumerate(points):
            if p is None:
                continue
            scale[i], offset[i] = p.conversion.scale, p.conversion.offset
            missing[: len(p.missing), i] = p.missing
            if p.range:
                low[i], high[i] = p.range
        ranged = bool(np.isfinite(low).any() or np.isfinite(high).any())
        return _Columns(index, scale, offset, low, high, missing, ranged)

    def _count(self, reason: str, at: NDArray[np.int32], names: tuple[str, ...]) -> None:
        if not len(at):
            return
        counts = self._counts[reason]
        numbers = np.bincount(at, minlength=len(names))
        for i in np.flatnonzero(numbers):
            # A flood of invented names must not fill the memory.
            name = names[i] if names[i] in counts or len(counts) < _NAMES_KEPT else "(others)"
            counts[name] = counts.get(name, 0) + int(numbers[i])

    def counters(self) -> dict[str, dict[str, int]]:
        """Rejected samples by reason, then by the source's name of the point."""
        return {reason: dict(by_name) for reason, by_name in self._counts.items() if by_name}

    def totals(self) -> dict[str, int]:
        """Rejected samples by reason."""
        return {reason: sum(by_name.values()) for reason, by_name in self.counters().items()}
