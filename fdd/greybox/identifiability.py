"""What the data can tell: the directions in which the likelihood is flat, in words, and the errors of all else.

A parameter that takes part in a flat direction has no error of its own, however sharp the likelihood is along the
parameter alone. Products and quotients of such parameters may be known well: time constants, gains, transfers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from fdd.greybox.scale import scale_unit
from fdd.models.declare import Parameter

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
STRONG = 0.95
# Information of a direction below which it counts as flat, per squared unit (a factor e): a change by a factor of ten
# moves the log-likelihood by a quarter, so that a 95 % interval spans more than a factor of 400 to either side.
LEAST = 0.1
# Standard deviation, in units, that flat directions may add to a parameter before it counts as taking part.
SHARE = 1.0
EXACT = 1e-6  # information of a direction along which nothing changes but by rounding
ROUNDING = 1e-11  # of the largest information
SMALL = 0.03  # powers below this, of the largest, are not told


@dataclass(frozen=True, slots=True)
class Flat:
    """A direction in which the likelihood does not change: ``powers`` by symbol, largest 1, and the same in words."""

    powers: Mapping[str, float]
    words: str


@dataclass(frozen=True, slots=True)
class Known:
    """A product of powers that the data tell although its factors are not told; ``error`` is relative."""

    words: str
    value: float
    error: float

    def __str__(self) -> str:
        return f"{self.words} = {self.value:.4g} +- {self.error:.2g} of it"


@dataclass(frozen=True, slots=True)
class Identified:
    """Covariance (k, k) on the transform scale, zero for what is not told, and what is not told and why.

    ``untold`` names the parameters that take part in a flat direction, ``flat`` the directions, ``known`` products of
    untold parameters that are told. ``observed`` says whether the observed information could be used.
    """

    covariance: FloatArray
    untold: tuple[str, ...]
    flat: tuple[Flat, ...]
    known: tuple[Known, ...]
    observed: bool


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


def identified(
    fisher: FloatArray,
    observed: FloatArray | None,
    at_bound: BoolArray,
    rows: Sequence[Parameter],
    values: FloatArray,
) -> Identified:
    """What information (k, k) on the transform scale tells of the parameters ``rows`` at natural ``values`` (k,).

    Flat directions are those of the Fisher information, which is exact, and those that the observed information adds.
    Parameters at a bound are held there for the errors of the others, but not where a flat direction leads through
    them: whoever moves along with one at its bound is not told either.
    """
    unit = np.array([scale_unit(q) for q in rows])
    size = np.outer(unit, unit)
    F, own = fisher * size, np.flatnonzero(~at_bound)
    lam, axes = _axes(F, np.arange(len(rows)))
    part, flat, sure = _part(lam, axes), [axes[:, lam < LEAST]], lam >= LEAST
    spread = (axes[:, sure] / lam[sure]) @ axes[:, sure].T
    lam, axes = _axes(F, own)
    curved = _curvature(observed * size, axes[:, lam >= LEAST]) if observed is not None else None
    if curved is not None:
        lam, axes = np.concatenate([lam[lam < LEAST], curved[0]]), np.column_stack([axes[:, lam < LEAST], curved[1]])
        flat.append(curved[1][:, curved[0] < LEAST])
    moves = np.maximum(part, _part(lam, axes)) > SHARE
    good = lam > _floor(lam)
    covariance = (axes[:, good] / lam[good]) @ axes[:, good].T
    shut = moves | at_bound
    covariance[shut] = 0.0
    covariance[:, shut] = 0.0
    basis = _sparse(np.column_stack(flat))
    return Identified(
        covariance=np.asarray(covariance * size),
        untold=tuple(q.symbol for q, lost in zip(rows, moves & ~at_bound, strict=True) if lost),
        flat=tuple(_in_words(v, F, rows) for v in basis.T if (np.abs(v) > SMALL)[~at_bound].any()),
        known=_known(basis, spread, np.flatnonzero(moves), rows, values),
        observed=curved is not None,
    )


def _axes(F: FloatArray, at: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Principal axes of the information of the parameters ``at``: informations (m,), and axes (k, m) among all."""
    lam, V = np.linalg.eigh(F[np.ix_(at, at)])
    axes = np.zeros((len(F), len(at)))
    axes[at] = V
    return lam, axes


def _curvature(H: FloatArray, within: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Principal axes of the observed information within a space (k, m); None where it is not that of a minimum."""
    inner = within.T @ H @ within
    if not positive_definite(inner):
        return None
    lam, U = np.linalg.eigh(inner)
    return lam, within @ U


def _floor(lam: FloatArray) -> float:
    """Information up to which a direction differs from one without any by rounding only."""
    return max(EXACT, ROUNDING * float(lam.max(initial=0.0)))


def _part(lam: FloatArray, axes: FloatArray) -> FloatArray:
    """Standard deviation (k,) that the flat directions alone give each parameter."""
    flat = lam < LEAST
    held = np.where(lam[flat] > _floor(lam), lam[flat], EXACT)
    return np.asarray(np.sqrt((axes[:, flat] ** 2 / held).sum(axis=1)))


def _sparse(flat: FloatArray) -> FloatArray:
    """A basis (k, r) of the space that the columns span in which every direction moves as few parameters as may be."""
    if not flat.shape[1]:
        return flat
    left, singular, _ = np.linalg.svd(flat, full_matrices=False)
    span = left[:, singular > 1e-6]
    pivots = qr(span.T, pivoting=True, mode="r")[1][: span.shape[1]]
    basis = span @ np.linalg.inv(span[pivots])
    basis = basis / np.abs(basis).max(axis=0)
    return np.asarray(np.where(np.abs(basis) > SMALL, basis, 0.0))


def _in_words(v: FloatArray, F: FloatArray, rows: Sequence[Parameter]) -> Flat:
    powers = {q.symbol: _tidy(float(a)) for q, a in zip(rows, v, strict=True) if a}
    kinds = {q.symbol: q.transform for q in rows}
    if len(powers) == 1:
        return Flat(powers, f"{next(iter(powers))} alone: hardly any change from any value of it")
    if sum(np.sign(a) for a in powers.values()) < 0:
        powers = {s: -a for s, a in powers.items()}
    groups: dict[str, list[str]] = {}
    for symbol, a in powers.items():
        groups.setdefault(_move(kinds[symbol], a, rows, symbol), []).append(symbol)
    every = [q.symbol for q in rows if q.kind == "physical"]
    told = ", ".join(f"{_group(symbols, every)} {move}" for move, symbols in groups.items())
    exact = float(v @ F @ v) <= _floor(np.asarray(np.linalg.eigvalsh(F), dtype=np.float64)) * float(v @ v)
    return Flat(powers, f"{told}: {'no' if exact else 'hardly any'} change")


def _tidy(a: float) -> float:
    nice = min((1.0, 0.5, 2.0, 1 / 3, 0.25), key=lambda b: abs(abs(a) - b))
    return math.copysign(nice, a) if abs(abs(a) - nice) < 0.02 * nice else round(a, 2)


def _move(transform: str, power: float, rows: Sequence[Parameter], symbol: str) -> str:
    if transform == "identity":
        q = next(q for q in rows if q.symbol == symbol)
        return f"{'plus' if power > 0 else 'minus'} {abs(power) * scale_unit(q):.3g} {q.unit} times ln c"
    exponent = "" if abs(power) == 1 else f"^{abs(power):.3g}"
    return f"{'times' if power > 0 else 'over'} c{exponent}"


def _group(symbols: Sequence[str], every: Sequence[str]) -> str:
    """Symbols in words; "all R" where a letter's whole family moves together."""
    family = [s for s in every if s.split("_")[0] == symbols[0].split("_")[0]]
    if len(symbols) > 2 and list(symbols) == family:
        return f"all {symbols[0].split('_')[0]}"
    return ", ".join(symbols)


def _known(
    flat: FloatArray, spread: FloatArray, moves: NDArray[np.int64], rows: Sequence[Parameter], values: FloatArray
) -> tuple[Known, ...]:
    """Pairs of moving parameters whose product of powers no flat direction changes, the best known first."""
    usable = [int(i) for i in moves if rows[i].transform == "log" and rows[i].kind == "physical"]
    found = []
    for place, i in enumerate(usable):
        for j in usable[place + 1 :]:
            left, singular, _ = np.linalg.svd(flat[[i, j]])
            if len(singular) > 1 and singular[1] > 0.02 * singular[0]:
                continue
            v = np.zeros(len(rows))
            v[[i, j]] = left[:, 1] / left[np.abs(left[:, 1]).argmax(), 1]
            if np.abs(v[[i, j]]).min() > SMALL:
                found.append((math.sqrt(max(float(v @ spread @ v), 0.0)), v))
    out: list[Known] = []
    span = np.zeros((len(rows), 0))
    for error, v in sorted(found, key=lambda pair: pair[0]):
        wider = np.column_stack([span, v])
        if error < SHARE and np.linalg.matrix_rank(wider, 1e-6) > span.shape[1]:
            span = wider
            powers = {q.symbol: _tidy(float(a)) for q, a in zip(rows, v, strict=True) if a}
            value = math.exp(sum(a * math.log(values[i]) for i, a in enumerate(v) if a))
            out.append(Known(_product(powers), value, error))
    return tuple(out)


def _product(powers: Mapping[str, float]) -> str:
    """Factors over divisors, such as ``C_i R_ie`` or ``C_w / C_i``."""

    def factor(symbol: str, power: float) -> str:
        return symbol if abs(power) == 1 else f"{symbol}^{abs(power):.3g}"

    above = " ".join(factor(s, a) for s, a in powers.items() if a > 0)
    below = " ".join(factor(s, a) for s, a in powers.items() if a < 0)
    return f"{above} / {below}" if below else above


def reservations(
    found: Identified, bound: Sequence[str], converged: bool, reason: str, wanted: str, kind: str
) -> list[str]:
    """What to say about parameters that were not found, and what to do about it."""
    out = []
    if found.untold:
        ways = "; ".join(flat.words for flat in found.flat)
        out.append(
            f"not identifiable from these data: {', '.join(found.untold)} ({ways}); "
            "fix one of them, give a prior, or excite what they act through"
        )
    if found.known:
        out.append("known all the same: " + "; ".join(map(str, found.known)))
    if bound:
        out.append(
            f"at a bound: {', '.join(bound)}; its error is not known, and those of the others hold if the bound is the "
            "truth; widen the bound or simplify the model"
        )
    if wanted != "fisher" and kind == "fisher":
        out.append(
            "errors are those of the Fisher information, because the observed one is not that of a minimum; they hold "
            "only as far as the model does: try more starts or a simpler model"
        )
    if not converged:
        out.append(f"the search did not converge ({reason}); try more starts")
    return out
