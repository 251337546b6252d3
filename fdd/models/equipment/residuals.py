"""Residuals that many rows have: a difference of two readings, or a share, while a condition holds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fdd.models.expectation import BoolArray, Day, Residual

Condition = Callable[[Day], BoolArray]
HELD = 900.0
"""How long a condition must have held before it is judged [s]."""


def at_least(role: str, level: float) -> Condition:
    """A reading is so high or higher."""
    return lambda v: v[role] >= level


def at_most(role: str, level: float) -> Condition:
    """A reading is so low or lower."""
    return lambda v: v[role] <= level


def both(*conditions: Condition) -> Condition:
    """All of them."""
    return lambda v: np.all([c(v) for c in conditions], axis=0)


def difference(
    a: str, b: str, when: Condition, less: float = 0.0, terms: tuple[str, ...] = (), held: float = HELD
) -> Callable[[Day], Residual]:
    """a - b - less, while the condition has held; terms enter with a factor of one."""

    def residual(v: Day) -> Residual:
        value = np.where(v.held(when(v), held), v[a] - v[b] - less, np.nan)
        return value, {a: 1.0, b: -1.0, **dict.fromkeys(terms, 1.0)}

    return residual


def short_of(a: str, wanted: str, when: Condition, term: str, held: float = HELD) -> Callable[[Day], Residual]:
    """How far a reading is below what is wanted, as a share of that."""

    def residual(v: Day) -> Residual:
        share = 1.0 - v[a] / np.where(v[wanted] > 0, v[wanted], np.nan)
        return np.where(v.held(when(v), held), share, np.nan), {term: 1.0}

    return residual


def of_largest(role: str, when: Condition, term: str, held: float = HELD) -> Callable[[Day], Residual]:
    """A reading as a share of the day's largest, which must have been seen outside the condition."""

    def residual(v: Day) -> Residual:
        now = when(v)
        largest = np.nanmax(np.where(now, np.nan, v[role]), initial=-np.inf)
        if not largest > 0:
            return np.full(len(v.time), np.nan), {term: 1.0}
        return np.where(v.held(now, held), v[role] / largest, np.nan), {term: 1.0}

    return residual


def rises(
    role: str, when: Condition, around: tuple[str, ...], term: str, held: float = HELD
) -> Callable[[Day], Residual]:
    """How far a reading gets above its value when the condition began and above all around it since then.

    The maximum principle: without a source of heat no temperature rises above its start and its surroundings.
    """

    def residual(v: Day) -> Residual:
        now = when(v)
        bound = v.since(now, v[role], "first")
        for other in around:
            if other in v:
                bound = np.fmax(bound, v.since(now, v[other], "highest"))
        return np.where(v.held(now, held), v[role] - bound, np.nan), {role: 1.0, term: 1.0}

    return residual
