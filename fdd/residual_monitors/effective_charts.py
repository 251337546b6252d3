"""Charts of one component that ring together: how many alarms a component gives to those of its charts alone.

Scores of parameters that act alike are nearly the same numbers, so that their charts pass their limits in the same
hour, and what an operator sees is one alarm. A budget that is shared as if each chart rang by itself is then not used.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.residual_monitors.run_length import limit_for

APART = 600.0
"""Mean updates between the alarms of one chart in the simulation; what they have in common hardly depends on it. Two
charts with correlations of 0.5, 0.8, 0.95 and 0.98 have a share of 0.93, 0.81, 0.67 and 0.62, and 0.97, 0.85, 0.69 and
0.61 at 8 000."""
ROUND = 20
"""Shares are rounded to a twentieth, so that components that are alike have the same limits."""
UPDATES = 400_000
SEED = 7


def effective_share(correlation: ArrayLike, k: float = 0.5) -> float:
    """Alarms of two-sided CUSUMs that are cleared together, over the sum of what each gives alone; 1/p to 1.

    Parameters
    ----------
    correlation : shape (p, p), of the standardised values that the charts are fed with
    k : reference value

    Notes
    -----
    By simulation, always with the same random numbers; the standard error is below 3 %.
    """
    r = np.array(correlation, dtype=np.float64, ndmin=2)
    p = len(r)
    if p < 2:
        return 1.0
    values, vectors = np.linalg.eigh(0.5 * (r + r.T))
    root = np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    limit = float(limit_for("cusum", APART, k=k))
    share = _alarms(root, limit, k, UPDATES, np.random.default_rng(SEED)) * APART / (p * UPDATES)
    return min(1.0, max(1.0 / p, round(ROUND * share) / ROUND))


@numba.njit(cache=True)
def _alarms(root: NDArray[np.float64], limit: float, k: float, updates: int, rng: np.random.Generator) -> int:
    p, q = root.shape
    upper, lower, e = np.zeros(p), np.zeros(p), np.empty(q)
    count = 0
    for _ in range(updates):
        for i in range(q):
            e[i] = rng.standard_normal()
        rang = False
        for j in range(p):
            z = 0.0
            for i in range(q):
                z += root[j, i] * e[i]
            upper[j] = max(0.0, upper[j] + z - k)
            lower[j] = max(0.0, lower[j] - z - k)
            rang = rang or upper[j] > limit or lower[j] > limit
        if rang:
            count += 1
            upper[:] = 0.0
            lower[:] = 0.0
    return count
