"""What is silently wrong with a record: swapped columns, frozen readings, time in another unit, dead outputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fdd.greybox.equations import trace
from fdd.greybox.trace import Expr
from fdd.models.declare import ComponentModel

FloatArray = NDArray[np.float64]
BEYOND = 0.5  # share of a column outside its declared range from which the column is taken for another
MARGIN = 0.02  # share of the range by which a sensor may be off at its ends: pyranometers read below zero at night
ODD = 0.01  # share outside from which it is said
FROZEN = 0.25  # share of a record in which a reading that changes elsewhere stays exactly as it is
FEWEST = 20  # values from which something may be said of them
LONG_STEP = 1e6  # s: nobody samples every eleven days, but nanoseconds and milliseconds look so
SLOW_STEP = 1e5


class DataError(ValueError):
    """A record that cannot be used; the text names column, row, value and remedy."""


def time_faults(name: str, dt: FloatArray) -> list[str]:
    """Refuse nanoseconds for seconds; say where milliseconds may be meant.

    Raises
    ------
    DataError : a median step beyond ``LONG_STEP``
    """
    step = float(np.median(dt))
    if step > LONG_STEP:
        unit, size = ("nanoseconds", 1e9) if step > 1e8 else ("milliseconds", 1e3)
        raise DataError(
            f"{name}: the median step is {step:g}, which would be {step / 86400:.3g} days; "
            f"time is in seconds, and this looks like {unit}: divide by {size:g}"
        )
    if step > SLOW_STEP:
        return [f"{name}: the median step is {step / 86400:.2g} days; time is in seconds: are these milliseconds?"]
    return []


def range_faults(name: str, model: ComponentModel, u: FloatArray, y: FloatArray) -> list[str]:
    """Refuse columns that fit each other's declared range but not their own, and say what else lies outside.

    Raises
    ------
    DataError : most of a column is outside, and exchanging it with another brings both inside
    """
    columns = {**dict(zip(model.symbols["inputs"], u.T, strict=True)),
               **dict(zip(model.symbols["outputs"], y.T, strict=True))}  # fmt: skip
    warnings = []
    for symbol, (low, high) in model.valid.items():
        outside = _outside(columns[symbol], low, high) if symbol in columns else 0.0
        if outside > BEYOND:
            values = columns[symbol][np.isfinite(columns[symbol])]
            told = (
                f"{name}: {symbol} is {np.median(values):.4g} in the median and lies outside {low:g} to {high:g}, "
                f"where {model.name} holds, in {outside:.0%} of rows"
            )
            fits = [
                s
                for s, range_ in model.valid.items()
                if s != symbol
                and s in columns
                and _outside(columns[s], low, high) < ODD
                and _outside(columns[symbol], *range_) < ODD
            ]
            if fits:
                raise DataError(f"{told}; {', '.join(fits)} would fit: are columns swapped?")
            warnings.append(f"{told}; see its unit")
        elif outside > ODD:
            warnings.append(
                f"{name}: {outside:.0%} of {symbol} lies outside {low:g} to {high:g}, where {model.name} holds"
            )
    return warnings


def _outside(column: FloatArray, low: float, high: float) -> float:
    values, margin = column[np.isfinite(column)], MARGIN * (high - low)
    return float(np.mean((values < low - margin) | (values > high + margin))) if len(values) >= FEWEST else 0.0


def output_faults(name: str, model: ComponentModel, y: FloatArray, started: bool) -> None:
    """Refuse a first row without what the start value is made of.

    Raises
    ------
    DataError : with the column, and the row from which the record can be used
    """
    symbols = model.symbols["outputs"]
    needed = [] if started else sorted({s for e in trace(model).x0 for s in _measured(model, e)})
    lost = [s for s in needed if not np.isfinite(y[0, symbols.index(s)])]
    if lost:
        at = np.flatnonzero(np.isfinite(y[:, [symbols.index(s) for s in needed]]).all(axis=1))
        first = f"begin the record at row {at[0]}" if len(at) else "no row has them all"
        raise DataError(
            f"{name}: output {', '.join(lost)} is missing in the first row, and the start value is made of it; "
            f"{first}, or give x0"
        )


def dead_outputs(name: str, model: ComponentModel, records: Sequence[FloatArray]) -> None:
    """Refuse outputs that change in none of the records, (N, n_y) each.

    Raises
    ------
    DataError : with the column and its value
    """
    for symbol, column in zip(model.symbols["outputs"], np.vstack(records).T, strict=True):
        values = column[np.isfinite(column)]
        if len(values) >= FEWEST and np.ptp(values) == 0:
            raise DataError(
                f"{name}: output {symbol} is {values[0]:g} in every one of {len(values)} rows: a dead reading or a set "
                "point, from which nothing can be identified; see what the column holds"
            )


def _measured(model: ComponentModel, e: Expr) -> Iterator[str]:
    symbols = {y.index: q.symbol for y, q in zip(trace(model).y, model.outputs, strict=True)}
    return (symbols[i] for i in e.symbols if i in symbols)


def frozen(name: str, symbol: str, column: FloatArray, output: bool) -> list[str]:
    """Say where a reading that changes elsewhere stays exactly as it is for a quarter of the record or more.

    An input at its lowest or highest value may rest there: a valve that is shut, a sun that has set.
    """
    at = np.flatnonzero(np.isfinite(column))
    values = column[at]
    if len(values) < FEWEST or np.ptp(values) == 0:
        return []
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1, [len(values)]])
    longest = int(np.diff(edges).argmax())
    begin, end = edges[longest], edges[longest + 1]
    resting = values[begin] in (values.min(), values.max())
    if end - begin < FROZEN * len(values) or (resting and not output):
        return []
    return [
        f"{name}: {symbol} stays exactly {values[begin]:g} from row {at[begin]} to {at[end - 1]} "
        f"({(end - begin) / len(values):.0%} of the record): a frozen reading? cut the record there"
    ]
