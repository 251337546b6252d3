"""Tables as records: columns bound by name, times and units turned into what a model takes."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.greybox.record_faults import DataError
from fdd.models.declare import ComponentModel
from fdd.units import UnitError, conversion

FloatArray = NDArray[np.float64]
Unit = str | tuple[str, str]


def seconds(index: pd.Index, zone: str | None, name: str) -> FloatArray:
    """Times (N,) [s] since the first row; a zone is for local times that name none.

    Raises
    ------
    DataError : times that occur twice when clocks go back, or an index that is no time
    """
    if isinstance(index, pd.DatetimeIndex):
        time = nanoseconds(index, zone, name)
        return np.asarray((time - time[0]) / 1e9)
    if pd.api.types.is_numeric_dtype(index.dtype):
        return np.asarray(index.to_numpy(dtype=np.float64) - float(index[0]))
    raise DataError(
        f"{name}: the index is {index.dtype}, no times; give a datetime index (df.set_index(pd.to_datetime(...))) "
        "or seconds"
    )


def nanoseconds(index: pd.DatetimeIndex, zone: str | None, name: str) -> NDArray[np.int64]:
    """Times (N,) [ns since epoch, UTC]."""
    if index.tz is None:
        try:
            index = index.tz_localize(ZoneInfo(zone) if zone else "UTC", ambiguous="infer")
        except ValueError as error:
            raise DataError(f"{name}: local times of {zone} cannot be told apart: {error}; give times in UTC") from None
    return np.asarray(index.tz_convert("UTC").as_unit("ns").asi8)


def bound(
    df: pd.DataFrame,
    model: ComponentModel,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, Unit] | None = None,
    name: str = "data",
) -> tuple[FloatArray, FloatArray]:
    """Inputs (N, n_u) and outputs (N, n_y) of a model, from columns of a table, in the model's units.

    Parameters
    ----------
    columns : model symbol to column; symbols that are not named are columns of that name
    units : model symbol to the unit of its column, with the fluid for volume flows: ``("l/h", "water at 70 degC")``

    Raises
    ------
    DataError : a column that is not there or holds no numbers, or a unit that does not fit
    """
    columns, units = dict(columns or {}), dict(units or {})
    known = {q.symbol: q.unit for q in (*model.inputs, *model.outputs)}
    for what, table in (("columns", columns), ("units", units)):
        for symbol in table:
            if symbol not in known:
                raise DataError(f"{name}: {what} names {symbol!r}; {model.name} has {', '.join(known)}")

    def values(symbol: str) -> FloatArray:
        column = columns.get(symbol, symbol)
        if column not in df.columns:
            near = get_close_matches(str(column), [str(c) for c in df.columns], n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise DataError(
                f"{name}: no column {column!r} for {symbol}{hint} Say columns={{{symbol!r}: ...}}; "
                f"there are {', '.join(map(str, df.columns))}"
            )
        numbers = pd.to_numeric(df[column], errors="coerce")
        if numbers.isna().all():
            raise DataError(f"{name}: column {column!r} for {symbol} holds no number")
        made = numbers.to_numpy(dtype=np.float64)
        if symbol not in units:
            return made
        given = units[symbol]
        unit, fluid = (given, None) if isinstance(given, str) else given
        try:
            return conversion(unit, known[symbol], fluid=fluid, where=f"{name}: {symbol}")(made)
        except UnitError as error:
            raise DataError(str(error)) from None

    u = np.column_stack([values(q.symbol) for q in model.inputs]) if model.inputs else np.zeros((len(df), 0))
    return u, np.column_stack([values(q.symbol) for q in model.outputs])
