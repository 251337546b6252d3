"""What an alarm carries, as types: which charts there are, and what their names say.

A chart is named ``component/symbol:kind``; the tests of rows ``component/ROW +`` (or ``-``, the side), the bank of
alternatives on settled readings ``component/steady readings``.
"""

from __future__ import annotations

from enum import StrEnum

STEADY = "steady readings"
"""What the bank of alternatives watches."""


class ChartKind(StrEnum):
    """Every kind of chart that may raise an alarm; its title stands in the report's catalogues."""

    CUSUM = "cusum"
    DAY = "day"
    SCORE = "score"
    FLATLINE = "flatline"
    AUTOCORRELATION = "autocorrelation"
    PERIODOGRAM = "periodogram"
    DISPERSION = "dispersion"
    CLUSTER = "cluster"
    WEEKLY = "weekly"
    ROW = "row"
    STEADY = "steady"


def parts_of(chart: str) -> tuple[str, ChartKind]:
    """What a chart watches (a symbol, or a row's name) and its kind, from its name.

    Raises
    ------
    ValueError : there is no such kind; name it in :class:`ChartKind` and give it a title in every catalogue
    """
    own = chart.rpartition("/")[2]
    if own == STEADY:
        return STEADY, ChartKind.STEADY
    symbol, colon, kind = own.rpartition(":")
    if colon:
        return symbol, ChartKind(kind)
    if own[-2:] in (" +", " -"):
        return own[:-2], ChartKind.ROW
    raise ValueError(f"chart {chart!r} has no kind; name it component/symbol:kind")


def has_kind(chart: str) -> bool:
    """Whether this version still has the kind of chart that a name in the store speaks of."""
    try:
        parts_of(chart)
    except ValueError:
        return False
    return True
