"""Symbols that models had in the version before: baselines and site files that have them work for one version more."""

from __future__ import annotations

from collections.abc import Mapping

SYMBOLS: Mapping[str, Mapping[str, str]] = {
    "zone": {"T_in": "T_room"},
    "heat_exchanger": {"U": "UA"},
}
"""Model to former symbol to present symbol."""


def present(model: str, symbol: str) -> str:
    """The symbol that a model has now for one that it had."""
    return SYMBOLS.get(model, {}).get(symbol, symbol)
