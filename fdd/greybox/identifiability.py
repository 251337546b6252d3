"""What the data can tell: information inverted where it can be, and parameters named where it cannot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
STRONG = 0.95


def strongly_correlated(correlation: FloatArray, names: Sequence[str]) -> str:
    """Pairs of estimates whose correlation (n_p, n_p) is beyond ``STRONG``, strongest first, in words."""
    pairs = [
        (abs(r), f"{names[i]} and {names[j]} {r:+.3f}")
        for i in range(len(names))
        for j in range(i)
        if abs(r := float(correlation[i, j])) > STRONG
    ]
    return ", ".join(words for _, words in sorted(pairs, reverse=True))


def positive_definite(H: FloatArray) -> bool:
    """Whether second derivatives are those of a minimum, on the scale where each parameter's own is one."""
    if not np.isfinite(H).all():
        return False
    d = np.sqrt(np.abs(np.diag(H)))
    d[d == 0] = 1.0
    return bool(np.linalg.eigvalsh(H / np.outer(d, d)).min() > 1e-9) if len(H) else True


def invert(
    information: FloatArray, at_bound: NDArray[np.bool_], names: Sequence[str]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Covariance of what can be identified, and the names of what cannot.

    A direction of (almost) no information, seen on the scale where every parameter's own information is one, names the
    parameters that take part in it; they are left out one after the other until the rest can be inverted.
    """
    k = len(information)
    inside = [i for i in range(k) if not at_bound[i]]
    lost: list[int] = []
    # Less than 1e-3 on a log scale of e: the likelihood does not change when the parameter changes tenfold.
    for i in list(inside):
        if not information[i, i] > 1e-3:
            inside.remove(i)
            lost.append(i)
    while inside:
        part = information[np.ix_(inside, inside)]
        d = np.sqrt(np.diag(part))
        values, vectors = np.linalg.eigh(part / np.outer(d, d))
        if values[0] > 1e-8:
            break
        worst = [i for i, v in zip(inside, np.abs(vectors[:, 0]), strict=True) if v > 0.3 * np.abs(vectors[:, 0]).max()]
        lost += worst
        inside = [i for i in inside if i not in worst]
    out = np.zeros((k, k))
    if inside:
        out[np.ix_(inside, inside)] = np.linalg.inv(information[np.ix_(inside, inside)])
    return out, tuple(names[i] for i in sorted(lost))


def reservations(lost: Sequence[str], bound: Sequence[str], converged: bool, reason: str) -> list[str]:
    """What to say about parameters that were not found, and what to do about it."""
    out = []
    if lost:
        out.append(
            f"not identifiable from these data: {', '.join(lost)}; "
            "fix them, give a prior, or excite what they act through"
        )
    if bound:
        out.append(f"at a bound: {', '.join(bound)}; widen the bound or simplify the model")
    if not converged:
        out.append(f"the search did not converge ({reason}); try more starts")
    return out
