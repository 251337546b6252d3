"""Experiments that tell parameters apart: pseudo-random signals within constraints, and the D-optimal one of them."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import max_len_seq

from fdd.greybox.fit import Progress
from fdd.greybox.identifiability import identified
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.simulate import realise
from fdd.models.declare import ComponentModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]


class DesignError(ValueError):
    """A signal that cannot be made; the text names the constraint and the remedy."""


def prbs(stages: int, shift: int = 0) -> NDArray[np.int64]:
    """One period, 2**stages - 1, of a pseudo-random binary sequence of 0 and 1 from a maximal-length register.

    Taps are primitive polynomials (``scipy.signal.max_len_seq``): the feedback "modulo-2 sum of the last two stages" of
    Andersen (2001), Paper B, is maximal for 4, 6 and 7 stages only.
    """
    if not 2 <= stages <= 24:
        raise DesignError(f"a register of {stages} stages; give 2 to 24")
    return np.roll(max_len_seq(stages)[0].astype(np.int64), -shift)


def prms(stages: int, levels: int, shift: int = 0) -> NDArray[np.int64]:
    """One period of a pseudo-random sequence of ``levels`` (a power of two) levels, from one register.

    Successive words of log2(levels) bits are read at a spacing that is coprime to the period, so that the sequence of
    words has the period of the register and every level comes about equally often.
    """
    bits = round(math.log2(levels))
    if 2**bits != levels or bits < 1:
        raise DesignError(f"{levels} levels; a multi-level sequence needs a power of two (2, 4, 8, ...)")
    if bits >= stages:
        raise DesignError(f"{levels} levels need more than {bits} stages, not {stages}")
    sequence = prbs(stages)
    period = len(sequence)
    stride = next(s for s in range(bits, period) if math.gcd(s, period) == 1)
    index = (np.arange(period)[:, None] * stride + np.arange(bits)[None, :] + shift) % period
    return np.asarray(sequence[index] @ (1 << np.arange(bits)))


@dataclass(frozen=True, slots=True)
class Signal:
    """One input that may be moved in an experiment.

    ``levels`` allowed values [unit of the input]; ``dwell`` shortest time at a level [s]; ``largest_step`` largest
    change at once, None for any.
    """

    symbol: str
    levels: tuple[float, ...]
    dwell: float
    largest_step: float | None = None

    def __post_init__(self) -> None:
        if len(self.levels) < 2 or len(self.levels) & (len(self.levels) - 1):
            raise DesignError(f"{self.symbol}: {len(self.levels)} levels; give 2, 4, 8 or 16")
        if not self.dwell > 0:
            raise DesignError(f"{self.symbol}: dwell time {self.dwell} s; give a positive time")
        gaps = np.diff(np.sort(self.levels))
        if self.largest_step is not None and gaps.max() > self.largest_step:
            raise DesignError(
                f"{self.symbol}: neighbouring levels are {gaps.max():g} apart, more than the largest step "
                f"{self.largest_step:g}; add levels between them"
            )


@dataclass(frozen=True)
class Design:
    """An experiment: time (N,), inputs (N, n_u) in the model's order, and what it is good for.

    ``score`` is the log determinant of the Fisher information of the identifiable physical parameters on the transform
    scale; ``errors`` the standard errors that it promises, by symbol, transform scale (relative for log), infinite for
    what it does not show.
    """

    t: FloatArray
    u: FloatArray
    symbols: tuple[str, ...]
    moved: tuple[str, ...]
    score: float = -math.inf
    errors: Mapping[str, float] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)

    def correlation(self) -> float:
        """Largest absolute cross-correlation of two moved inputs, lags up to a tenth of the record (Eq. 2.4-2.7)."""
        most = len(self.t) // 10
        columns = [self.symbols.index(s) for s in self.moved]
        worst = 0.0
        for i, a in enumerate(columns):
            for b in columns[i + 1 :]:
                worst = max(worst, float(np.abs(cross_correlation(self.u[:, a], self.u[:, b], most)).max()))
        return worst

    def write_csv(self, path: Path) -> None:
        """Time [s] and moved inputs, a row a change."""
        columns = [self.symbols.index(s) for s in self.moved]
        changes = [0, *(np.flatnonzero(np.any(np.diff(self.u[:, columns], axis=0) != 0, axis=1)) + 1)]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["t_s", *self.moved])
            writer.writerows([self.t[i], *self.u[i, columns]] for i in changes)

    def plot(self) -> Figure:
        """The moved inputs over time."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9, 1.6 * len(self.moved) + 0.6), layout="constrained")
        axes = figure.subplots(len(self.moved), 1, squeeze=False, sharex=True)[:, 0]
        for a, s in zip(axes, self.moved, strict=True):
            a.step(self.t / 3600, self.u[:, self.symbols.index(s)], where="post")
            a.set_ylabel(f"{s} [{self.about['units'][s]}]" if "units" in self.about else s)
        axes[-1].set_xlabel("time [h]")
        return figure


def cross_correlation(u: FloatArray, v: FloatArray, most: int | None = None) -> FloatArray:
    """Cross-correlation at lags -most..most (Eq. 2.4 and 2.5), over the periodic continuation of the record."""
    a, b = u - u.mean(), v - v.mean()
    norm = math.sqrt(float(a @ a) * float(b @ b))
    if norm == 0:
        return np.zeros(1)
    full = np.fft.irfft(np.fft.rfft(a) * np.conj(np.fft.rfft(b)), len(a)) / norm
    return full if most is None else np.concatenate([full[-most:], full[: most + 1]])


def sequence(signal: Signal, t: FloatArray, shift: int, register: int = 0) -> FloatArray:
    """A signal over time: levels of a pseudo-random sequence, held for the dwell time, steps kept small enough."""
    slots = int((t[-1] - t[0]) // signal.dwell) + 1
    stages = max(register, 4, len(signal.levels).bit_length() + 1, math.ceil(math.log2(slots + 1)))
    levels = np.sort(signal.levels)
    rank = prms(stages, len(levels), shift)[np.arange(slots) % (2**stages - 1)]
    if signal.largest_step is not None:
        rank = _gentle(rank, levels, signal.largest_step)
    return np.asarray(levels[rank[((t - t[0]) // signal.dwell).astype(np.int64)]])


def _gentle(rank: NDArray[np.int64], levels: FloatArray, largest: float) -> NDArray[np.int64]:
    """Go as far towards the wanted level as one step may."""
    out = rank.copy()
    for i in range(1, len(out)):
        wanted, before = out[i], out[i - 1]
        way = 1 if wanted > before else -1
        while abs(levels[wanted] - levels[before]) > largest:
            wanted -= way
        out[i] = wanted
    return out


def candidates(
    model: ComponentModel, signals: Sequence[Signal], base: FloatArray, t: FloatArray, *, count: int = 12,
    seed: int = 0, limit: float = 0.3,
) -> list[Design]:  # fmt: skip
    """Designs that differ in shifts and dwell times, inputs uncorrelated with each other.

    Parameters
    ----------
    base : shape (N, n_u), what the inputs do where the experiment does not move them (weather, occupancy)
    limit : largest cross-correlation between two moved inputs that is accepted
    """
    names, random = model.symbols["inputs"], np.random.default_rng(seed)
    for s in signals:
        if s.symbol not in names:
            raise DesignError(f"{model.name} has no input {s.symbol!r}; known: {', '.join(names)}")
    units = {q.symbol: q.unit for q in model.inputs}
    out: list[Design] = []
    worst = math.inf
    for _ in range(40 * count):
        u, factors = base.copy(), {s.symbol: float(2.0 ** random.integers(0, 4)) for s in signals}
        for s in signals:
            slow = Signal(s.symbol, s.levels, s.dwell * factors[s.symbol], s.largest_step)
            u[:, names.index(s.symbol)] = sequence(slow, t, int(random.integers(0, 1 << 16)))
        design = Design(t, u, names, tuple(s.symbol for s in signals), about={"dwell factors": factors, "units": units})
        if any(np.ptp(u[:, names.index(s.symbol)]) == 0 for s in signals):
            continue
        correlation = design.correlation()
        worst = min(worst, correlation)
        if correlation <= limit:
            out.append(design)
        if len(out) == count:
            return out
    if not out:
        raise DesignError(
            f"no design keeps the inputs' correlation below {limit}; best {worst:.2f}. Make the experiment longer "
            "(more dwell times), or allow more correlation"
        )
    return out


def d_optimal(
    model: ComponentModel, designs: Sequence[Design], *, parameters: Mapping[str, float] | None = None,
    outputs: Mapping[str, float] | None = None, seed: int = 0,
    progress: Progress | None = None,
) -> list[Design]:  # fmt: skip
    """Designs with their score, best first: log determinant of the Fisher information of the physical parameters.

    The information is that of the filter on outputs the model itself gives under the design. It depends on the
    parameters; give the best knowledge there is. ``outputs`` are what is measured at the start (temperatures are
    20 degC unless said), from which the model's start values are made.
    """
    values = np.array([{**{q.symbol: q.typical for q in model.parameters}, **(parameters or {})}[q.symbol]
                       for q in model.parameters])  # fmt: skip
    physical = [k for k, q in enumerate(model.parameters) if q.kind == "physical"]
    names = [model.parameters[k].symbol for k in physical]
    first = [(outputs or {}).get(q.symbol, 20.0 if q.unit == "degC" else 0.0) for q in model.outputs]
    found = []
    for i, d in enumerate(designs):
        record = Data(d.t, d.u, np.tile(first, (len(d.t), 1)), name="design")
        measured = realise(model, values, record, seed)
        information = Likelihood(model, measured).evaluate(values).information[np.ix_(physical, physical)]
        inside = np.zeros(len(names), dtype=np.bool_)
        told = identified(information, None, inside, [model.parameters[k] for k in physical], values[physical])
        found.append((information, told.covariance, told.untold))
        if progress is not None:
            progress(i + 1, len(designs), math.nan)
    # Only what some design shows can be compared.
    seen = [k for k, name in enumerate(names) if any(name not in lost for _, _, lost in found)]
    scored = []
    for d, (information, covariance, lost) in zip(designs, found, strict=True):
        sign, score = np.linalg.slogdet(information[np.ix_(seen, seen)])
        errors = {n: math.inf if n in lost else math.sqrt(covariance[k, k]) for k, n in enumerate(names)}
        score = float(score) if sign > 0 and seen else -math.inf
        scored.append(Design(d.t, d.u, d.symbols, d.moved, score, errors, d.about))
    return sorted(scored, key=lambda d: -d.score)
