"""Run length of Shewhart run rules, exactly, as a Markov chain on what the rules remember (Champ and Woodall 1987)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import spsolve
from scipy.special import ndtr, ndtri

from fdd.records import FloatArray

LONGEST = 8
"""Values the longest rule looks at."""
NEEDED, WITHIN = (1, 2, 4, LONGEST), (1, 3, 5, LONGEST)
"""Rule r alarms on NEEDED[r] of WITHIN[r] consecutive values beyond its limit on one side."""

_Side = tuple[tuple[bool, ...], ...]


def _next(memory: _Side, beyond: Sequence[bool]) -> _Side | None:
    """A side's memory after a value; None when a rule alarms."""
    out = []
    for r, past in enumerate(memory):
        now = (beyond[r], *past)
        if sum(now) >= NEEDED[r]:
            return None
        out.append(now[: WITHIN[r] - 1])
    return tuple(_forget(past, r) for r, past in enumerate(out))


def _forget(past: tuple[bool, ...], r: int) -> tuple[bool, ...]:
    """Drop what cannot matter any more, so that states that act alike are one."""
    if NEEDED[r] == WITHIN[r]:  # a run: what lies before a break is forgotten
        kept = next((m for m, hit in enumerate(past) if not hit), len(past))
        return past[:kept] + (False,) * (len(past) - kept)
    return past


@lru_cache(maxsize=8)
def _graph(order: tuple[int, ...]) -> tuple[NDArray[np.int32], int]:
    """Next state by (state, zone), -1 for an alarm; ``order``: rules in use, by falling limit."""
    depth = len(order)
    blank: _Side = tuple((False,) * (within - 1) for within in WITHIN)
    start = (blank, blank)
    index, queue, table = {start: 0}, [start], []
    while queue:
        upper, lower = queue.pop(0)
        row = []
        for zone in range(-depth, depth + 1):
            beyond = [False] * 4
            for r in order[depth - abs(zone) :]:
                beyond[r] = True
            inside = [False] * 4
            up = _next(upper, beyond if zone > 0 else inside)
            down = _next(lower, beyond if zone < 0 else inside)
            if up is None or down is None:
                row.append(-1)
                continue
            state = (up, down)
            if state not in index:
                index[state] = len(index)
                queue.append(state)
            row.append(index[state])
        table.append(row)
    return np.array(table, dtype=np.int32), depth


def rules_arl(limits: Sequence[float] | FloatArray, shift: float = 0.0) -> float:
    """Mean run length of the rules with these limits [standard deviations], infinity for a rule that is off."""
    used = [r for r in range(4) if np.isfinite(limits[r])]
    if not used:
        return np.inf
    order = tuple(sorted(used, key=lambda r: -limits[r]))
    table, depth = _graph(order)
    edges = np.array([limits[r] for r in reversed(order)])
    cuts = np.concatenate([[-np.inf], -edges[::-1], edges, [np.inf]])
    probability = np.diff(ndtr(cuts - shift))
    # Beyond zero the tails keep their digits only when taken from their own side.
    probability[depth + 1 :] = -np.diff(ndtr(-(np.append(edges, np.inf)) + shift))
    states = len(table)
    rows = np.repeat(np.arange(states), 2 * depth + 1)
    columns, weights = table.ravel(), np.tile(probability, states)
    go = columns >= 0
    matrix = coo_matrix((weights[go], (rows[go], columns[go])), shape=(states, states))
    means: FloatArray = spsolve((identity(states) - matrix).tocsc(), np.ones(states))
    return float(np.atleast_1d(means)[0])


@lru_cache(maxsize=512)
def rule_limits(arl: float, rules: tuple[bool, bool, bool, bool] = (True,) * 4) -> tuple[float, ...]:
    """Limits of the four rules that together give this mean run length, each alone about the same share of alarms.

    Raises
    ------
    ValueError
        Where the run length lies outside [100, 1e8], or the first rule is off.
    """
    if not 100 <= arl <= 1e8 or not rules[0]:
        raise ValueError(f"run rules need the single-value rule and a mean run length from 100 to 1e8, got {arl:g}")
    share = arl * sum(rules)
    limits = np.full(4, np.inf)
    for r in range(4):
        if rules[r]:
            limits[r] = _single(r, share)

    def gap(factor: float) -> float:
        return float(np.log(rules_arl(limits * factor) / arl))

    factor = float(brentq(gap, 0.5, 1.3, xtol=1e-8))
    return tuple(float(x) for x in limits * factor)


def _single(r: int, arl: float) -> float:
    """Limit of one rule alone."""
    if r == 0:
        return float(-ndtri(0.5 / arl))

    def gap(limit: float) -> float:
        alone = [np.inf] * 4
        alone[r] = limit
        return float(np.log(rules_arl(alone) / arl))

    return float(brentq(gap, 0.01, 6.0, xtol=1e-6))
