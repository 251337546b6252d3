"""What every chart is: a vector of streams, a verdict for each, alarms that stand, and state as plain data.

A chart takes one standardised value a stream and an update (NaN: nothing seen) and returns :class:`Verdicts`. It never
resets itself, never learns while it tests, and holds its statistic through a gap. Streams do not know of each other, so
a chart of n streams gives the bytes of n charts of one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any, ClassVar

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray, JsonObject

CLIP = 1e3
"""Values beyond this many standard deviations, infinite ones too, are taken as this many: state stays finite."""
CAP = 2.0
"""A statistic is held below this multiple of its limit, so that it comes back soon after a repair."""
SCALE_FLOOR = 0.1
"""Least standard deviation a chart learns for values that should have about 1; less means a stuck signal."""


class Phase(IntEnum):
    """What a chart says of a stream; the order is that of urgency."""

    NO_DATA = 0
    LEARNING = 1
    QUIET = 2
    ALARM = 3


NO_DATA, LEARNING, QUIET, ALARM = (int(p) for p in Phase)


class Feed(Enum):
    """What a chart is fed, and by which method."""

    VALUES = "update(z), z of shape (n,)"
    READINGS = "update(x), x of shape (n,), readings as they come, not standardised"
    SCORES = "update_scores(score, information)"


class StateError(ValueError):
    """State that this chart cannot continue from; the text says which field and what to do."""


@dataclass(frozen=True, slots=True)
class Verdicts:
    """What a chart says after an update, one entry a stream.

    Attributes
    ----------
    phase : shape (n,), :class:`Phase`
    statistic : shape (n,), in the unit of ``limit``; held where nothing was seen
    limit : shape (n,), an alarm is raised when the statistic goes above it; read only
    direction : shape (n,), sign of the change the statistic points to: +1, -1, or 0 where it points nowhere
    onset_age : shape (n,), updates back to where the change is estimated to have begun; 0 where there is none
    """

    phase: NDArray[np.uint8]
    statistic: FloatArray
    limit: FloatArray
    direction: NDArray[np.int8]
    onset_age: IntArray


class Chart(ABC):
    """Streams under one rule.

    Parameters
    ----------
    limit : shape (n,) or scalar, decision limit of each stream, positive
    learn : number of values each stream takes to learn its own mean and standard deviation before it tests; 0 for
        streams that are standardised already. An estimated baseline shortens the run length:
        :func:`fdd.residual_monitors.run_length.baseline_effect`.

    Raises
    ------
    ValueError
        Where a limit is not positive and finite, or ``learn`` is 1 or negative.
    """

    kind: ClassVar[str]
    """Name in the registry and in exported state."""
    feed: ClassVar[Feed] = Feed.VALUES
    schema: ClassVar[int] = 2
    """Version of the exported state."""
    _state: ClassVar[tuple[str, ...]] = ()
    """Names of the arrays, first axis n, that make up the state of the rule."""
    _latch: ClassVar[tuple[str, ...]] = ("latched", "side", "onset", "seen", "mean", "m2")

    def __init__(self, limit: ArrayLike, *, learn: int = 0) -> None:
        self.limit = _limits(limit, self.kind)
        self.n = len(self.limit)
        if learn < 0 or learn == 1:
            raise ValueError(
                f"{self.kind} chart: learn is {learn}; give 0, or at least 2 values (100 or more are wise)"
            )
        self.learn = int(learn)
        self.latched = np.zeros(self.n, dtype=np.int8)
        self.side = np.zeros(self.n, dtype=np.int8)
        self.onset = np.zeros(self.n, dtype=np.int64)
        self.seen = np.zeros(self.n, dtype=np.int64)
        self.mean = np.zeros(self.n)
        self.m2 = np.zeros(self.n)

    @classmethod
    @abstractmethod
    def design(cls, arl: ArrayLike) -> Chart:
        """Charts with these mean numbers of updates between false alarms, shape (n,); options follow by keyword."""

    @abstractmethod
    def _step(self, z: FloatArray) -> Verdicts:
        """Take values that are standardised; NaN holds a stream."""

    @abstractmethod
    def _restart(self, rows: NDArray[np.bool_]) -> None:
        """Put the rule of these streams where a new chart stands."""

    def update(self, z: ArrayLike) -> Verdicts:
        """Take one value a stream.

        Parameters
        ----------
        z : shape (n,), standardised values (mean 0, standard deviation 1 while all is well); NaN: nothing seen

        Raises
        ------
        ValueError
            Where the shape is not that of the chart.
        """
        values = np.ascontiguousarray(z, dtype=np.float64)
        if values.shape != self._shape:
            raise ValueError(
                f"{self.kind} chart of {self.n} streams: update got shape {values.shape}, needs {self._shape}; "
                "give NaN for streams that saw nothing"
            )
        if not self.learn:
            return self._step(values)
        scaled, learning = _standardise(values, self.learn, self.seen, self.mean, self.m2)
        verdicts = self._step(scaled)
        verdicts.phase[learning & (verdicts.phase != ALARM)] = LEARNING
        return verdicts

    @property
    def _shape(self) -> tuple[int, ...]:
        return (self.n,)

    def reset(self, which: ArrayLike | None = None, *, relearn: bool = False) -> None:
        """Clear alarms and start again: the only way out of an alarm.

        Parameters
        ----------
        which : shape (n,), True for the streams to reset; None for all
        relearn : also forget the learned mean and standard deviation (after a repair, never under a standing fault)
        """
        rows = np.ones(self.n, dtype=np.bool_) if which is None else np.asarray(which, dtype=np.bool_)
        if rows.shape != (self.n,):
            raise ValueError(f"{self.kind} chart: reset got a mask of shape {rows.shape}, needs ({self.n},)")
        self.latched[rows] = 0
        self.side[rows] = 0
        self.onset[rows] = 0
        self._restart(rows)
        if relearn:
            self.seen[rows] = 0
            self.mean[rows] = 0.0
            self.m2[rows] = 0.0

    def set_limit(self, limit: ArrayLike) -> None:
        """Change the limits (a new budget); alarms that stand go on standing."""
        limits = _limits(limit, self.kind)
        if limits.shape != (self.n,):
            raise ValueError(f"{self.kind} chart: {limits.size} limits for {self.n} streams; give one a stream")
        self.limit = limits

    def export_state(self) -> JsonObject:
        """Everything :meth:`restore_state` needs, as arrays and JSON scalars; limits and settings are not state."""
        arrays = {name: getattr(self, name).copy() for name in (*self._latch, *self._state)}
        return {"kind": self.kind, "schema": self.schema, "n": self.n, **arrays}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where ``export_state`` was called; arrays may come as lists.

        Raises
        ------
        StateError
            Where the state is of another kind, schema or size, lacks a field, or is not finite. Nothing is changed.
        """
        for key, own in (("kind", self.kind), ("schema", self.schema), ("n", self.n)):
            if state.get(key) != own:
                raise StateError(
                    f"{self.kind} chart: saved state has {key} {state.get(key)!r}, this chart needs {own!r}; "
                    "start the chart anew (it begins quiet) or restore with the version that wrote it"
                )
        fields = {name: self._checked(name, state) for name in (*self._latch, *self._state)}
        for name, value in fields.items():
            setattr(self, name, value)

    def _checked(self, name: str, state: JsonObject) -> NDArray[Any]:
        own: NDArray[Any] = getattr(self, name)
        if name not in state:
            raise StateError(f"{self.kind} chart: saved state lacks {name!r}; start the chart anew")
        value = np.array(state[name], dtype=own.dtype, order="C")
        if value.shape != own.shape:
            raise StateError(
                f"{self.kind} chart: saved {name!r} has shape {value.shape}, this chart has {own.shape}; "
                "the settings changed, start the chart anew"
            )
        if not np.all(np.isfinite(value)):
            raise StateError(
                f"{self.kind} chart: saved {name!r} is not finite; the state is damaged, start the chart anew"
            )
        return value


def _limits(limit: ArrayLike, kind: str) -> FloatArray:
    """Own, contiguous, read-only limits."""
    limits = np.array(limit, dtype=np.float64, ndmin=1, order="C")
    if limits.ndim != 1 or not np.all(np.isfinite(limits) & (limits > 0)):
        raise ValueError(f"{kind} chart: limits must be a vector of positive finite numbers, got {limit!r}")
    limits.flags.writeable = False
    return limits


def per_stream(value: ArrayLike, n: int, name: str) -> FloatArray:
    """A setting given once or per stream, as an own array of shape (n,)."""
    array = np.array(value, dtype=np.float64)
    if array.shape not in ((), (n,)):
        raise ValueError(f"{name} has shape {array.shape}; give one number, or one for each of the {n} streams")
    return np.ascontiguousarray(np.broadcast_to(array, (n,))).copy()


@numba.njit(cache=True)
def _standardise(
    z: FloatArray, learn: int, seen: IntArray, mean: FloatArray, spread: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Learn by Welford's recursion from the first ``learn`` values, then standardise with what was learned."""
    out = np.full(z.shape[0], np.nan)
    learning = np.zeros(z.shape[0], dtype=np.bool_)
    for i in range(z.shape[0]):
        if np.isnan(z[i]):
            continue
        if seen[i] < learn:
            value = min(max(z[i], -CLIP), CLIP)
            seen[i] += 1
            step = value - mean[i]
            mean[i] += step / seen[i]
            spread[i] += step * (value - mean[i])
            learning[i] = True
        else:
            out[i] = (z[i] - mean[i]) / max(np.sqrt(spread[i] / (learn - 1)), SCALE_FLOOR)
    return out, learning


@numba.njit(cache=True, inline="always")
def conclude(
    i: int,
    seen: bool,
    statistic: float,
    direction: int,
    age: int,
    limit: float,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[int, int, int]:
    """Latch an alarm and give phase, direction and age of the onset; for the kernels of the charts."""
    if latched[i] == 1:
        onset[i] += 1
        return ALARM, side[i], onset[i]
    if seen and statistic > limit:
        latched[i] = 1
        side[i] = direction
        onset[i] = age
        return ALARM, direction, age
    return (QUIET if seen else NO_DATA), direction, age
