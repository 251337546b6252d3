"""Run lengths of charts, and the limits for a wanted one: how long between false alarms, how soon a shift is found.

A run length counts updates up to and with the one that alarms. Its mean (ARL) comes from the integral equations of
:mod:`fdd.residual_monitors.transition`, its distribution from their powers. Inputs are standard normal and independent,
moved by ``shift`` standard deviations from the first update on; what an estimated baseline does to that is
:func:`baseline_effect`.

Starts: ``"zero"``, a share of the limit (head start, 0 to 1), or ``"steady"``: the shift comes when the chart has long
been running without alarm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri
from scipy.stats import chi2

from fdd.records import FloatArray
from fdd.residual_monitors import transition
from fdd.residual_monitors.transition import Transition

Kind = Literal["cusum", "ewma", "mewma", "shewhart"]
Start = float | Literal["zero", "steady"]

ARL_MOST = 1e15
"""Longest mean run length of a limit: a chart of 1 000 samples a second would ring once in 30 000 years."""
_SHIFT_NODES = 15
_SCALE_NODES = 9
_LONGEST_OPENING = 20_000
"""Updates followed one by one at most until a run's hazard is constant."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A chart's constants.

    Attributes
    ----------
    kind : ``"cusum"``, ``"ewma"``, ``"mewma"`` or ``"shewhart"`` (a single two-sided limit)
    k : reference value of a CUSUM
    lam : weight of the newest value in an EWMA or MEWMA, (0, 1]
    sided : 1 or 2, sides of a CUSUM
    dimension : length of a MEWMA's vectors
    exact : whether an EWMA's limit follows its exact variance while it settles
    """

    kind: Kind
    k: float = 0.5
    lam: float = 0.1
    sided: int = 2
    dimension: int = 2
    exact: bool = False

    def __post_init__(self) -> None:
        """Refuse constants outside their range."""
        if self.kind not in ("cusum", "ewma", "mewma", "shewhart"):
            raise ValueError(f"no run lengths for {self.kind!r}; there are cusum, ewma, mewma and shewhart")
        if self.k < 0:
            raise ValueError(f"reference value k is {self.k}; give zero or more standard deviations")
        if not 0.005 <= self.lam <= 1:
            raise ValueError(f"weight lam is {self.lam}; give a number from 0.005 to 1")
        if self.sided not in (1, 2):
            raise ValueError(f"sided is {self.sided}; give 1 or 2")
        if self.dimension < 1:
            raise ValueError(f"dimension is {self.dimension}; give 1 or more")


@lru_cache(maxsize=4096)
def arl(rule: Rule, limit: float, shift: float = 0.0, start: Start = "zero") -> float:
    """Mean number of updates to an alarm.

    Parameters
    ----------
    rule, limit : the chart; ``limit`` is h of a CUSUM, L of an EWMA or Shewhart chart, the squared distance of a MEWMA
    shift : standard deviations (Mahalanobis distance for a MEWMA)
    start : see the module

    Notes
    -----
    Two sides of a CUSUM are joined by Lucas and Crosier (1982), equation A.3; from a steady start with the two sides'
    own distributions, which neglects that both have not alarmed.
    """
    if not limit > 0:
        raise ValueError(f"limit is {limit}; give a positive number")
    if rule.kind == "shewhart":
        return 1.0 / _shewhart_rate(limit, shift)
    if rule.kind == "ewma" and rule.exact:
        if start != "zero":
            raise ValueError("an EWMA with exact limits starts at zero; use exact=False for another start")
        early, weights = transition.ewma_opening(limit, rule.lam, shift)
        return early + float(weights @ _means(rule, limit, shift))
    if rule.kind == "cusum" and rule.sided == 2:
        zero = [_start_mean(rule, limit, s, "zero") for s in (shift, -shift)]
        begun = zero if start == "zero" else [_start_mean(rule, limit, s, start) for s in (shift, -shift)]
        return (begun[0] * zero[1] + begun[1] * zero[0] - zero[0] * zero[1]) / (zero[0] + zero[1])
    return _start_mean(rule, limit, shift, start)


def _shewhart_rate(limit: float, shift: float) -> float:
    return float(ndtr(-limit - shift) + ndtr(-limit + shift))


@lru_cache(maxsize=64)
def _chain(rule: Rule, limit: float, shift: float, plane: bool = False) -> Transition:
    """One side's steps; ``plane`` keeps the nodes of a shifted MEWMA while all is well."""
    if rule.kind == "cusum":
        return transition.cusum(limit, rule.k, shift)
    if rule.kind == "ewma" or rule.dimension == 1:
        return transition.ewma(limit if rule.kind == "ewma" else float(np.sqrt(limit)), rule.lam, shift)
    if shift == 0 and not plane:
        return transition.mewma(limit, rule.lam, rule.dimension)
    return transition.mewma_shifted(limit, rule.lam, rule.dimension, shift)


@lru_cache(maxsize=256)
def _means(rule: Rule, limit: float, shift: float, plane: bool = False) -> FloatArray:
    return _chain(rule, limit, shift, plane).mean()


def _start_mean(rule: Rule, limit: float, shift: float, start: Start) -> float:
    """Mean run length of one side from a start."""
    if start == "steady":
        plane = rule.kind == "mewma" and shift != 0
        before = _chain(rule, limit, 0.0, plane).quasi_stationary()
        return float(before @ _means(rule, limit, shift, plane))
    return 1.0 + float(_chain(rule, limit, shift).row(_share(start)) @ _means(rule, limit, shift))


def _share(start: Start) -> float:
    if start == "zero":
        return 0.0
    if isinstance(start, str) or not 0 <= start < 1:
        raise ValueError(f"start is {start!r}; give 'zero', 'steady' or a share of the limit in [0, 1)")
    return float(start)


@dataclass(frozen=True)
class _Survival:
    """Probability of no alarm within n updates, for one side.

    ``first`` holds it for 1, 2, ... updates until it falls by the same factor each time; ``log_factor`` is that
    factor's logarithm, the largest eigenvalue of the matrix.
    """

    first: FloatArray
    log_factor: float

    def log_at(self, updates: int) -> float:
        """Its logarithm; minus infinity where it has vanished."""
        beyond = updates - len(self.first)
        value = self.first[min(updates, len(self.first)) - 1]
        if value <= 0:
            return -np.inf
        return float(np.log(value) + (beyond * self.log_factor if beyond > 0 else 0.0))


@lru_cache(maxsize=1024)
def _survival(rule: Rule, limit: float, shift: float, start: Start) -> _Survival:
    plane = rule.kind == "mewma" and start == "steady" and shift != 0
    chain = _chain(rule, limit, shift, plane)
    if start == "steady":
        weights = _chain(rule, limit, 0.0, plane).quasi_stationary() @ chain.matrix
    else:
        weights = chain.row(_share(start))
    mean = float(weights @ _means(rule, limit, shift, plane))
    if mean > transition.PLAIN_MOST:
        # The opening is nothing against it, and its hazard is below what a product of survivals resolves.
        return _Survival(np.ones(1), -1.0 / mean)
    first, factor = [float(weights.sum())], 0.0
    for _ in range(_LONGEST_OPENING):
        weights = weights @ chain.matrix
        first.append(float(weights.sum()))
        if first[-1] < 1e-12:
            return _Survival(np.array(first), -np.inf)
        last, factor = factor, first[-1] / first[-2]
        # The hazard, 1 - factor, is nothing in the first updates, and must have settled for its own size.
        if 1 - factor > 1e-12 and abs(factor - last) < 1e-7 * (1 - factor):
            break
    return _Survival(np.array(first), float(np.log(factor)))


def _sides(rule: Rule, limit: float, shift: float, start: Start) -> list[_Survival]:
    """Each side that can alarm."""
    shifts = (shift, -shift) if rule.kind == "cusum" and rule.sided == 2 else (shift,)
    return [_survival(rule, limit, s, start) for s in shifts]


def alarm_probability(rule: Rule, limit: float, updates: int, shift: float = 0.0, start: Start = "zero") -> float:
    """Probability of an alarm within this many updates.

    The two sides of a CUSUM are taken as independent, which is not exact but good to a part in a thousand for k of a
    half and limits above 3, and to two in a hundred for k of a tenth; an EWMA with exact limits is taken as one with
    settled limits.
    """
    if updates < 1:
        return 0.0
    if rule.kind == "shewhart":
        return float(-np.expm1(updates * np.log1p(-_shewhart_rate(limit, shift))))
    return float(-np.expm1(sum(side.log_at(updates) for side in _sides(rule, limit, shift, start))))


def run_length_quantile(rule: Rule, limit: float, p: float, shift: float = 0.0, start: Start = "zero") -> int:
    """Least number of updates within which an alarm comes with probability ``p``.

    Raises
    ------
    ValueError
        Where ``p`` is not inside (0, 1).
    """
    if not 0 < p < 1:
        raise ValueError(f"p is {p}; give a probability inside (0, 1)")

    def late(updates: int) -> bool:
        return alarm_probability(rule, limit, updates, shift, start) < p

    return _first(late)


def _first(late: Callable[[int], bool]) -> int:
    """Least number of updates that is not too few."""
    low, high = 0, 1
    while late(high):
        low, high = high, 2 * high
        if high > 2**60:
            raise ValueError("the run length exceeds 2^60 updates; lower the limit")
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if late(middle) else (low, middle)
    return high


def _guess(rule: Rule, wanted: float) -> float:
    """A limit near the one sought: Siegmund (1985) for a CUSUM, the quantile of one value for the others."""
    if rule.kind == "cusum":
        one = wanted * rule.sided
        k = max(rule.k, 0.01)

        def gap(h: float) -> float:
            b = h + 1.166
            return float(np.log(np.expm1(2 * k * b) - 2 * k * b) - np.log(2 * k * k * one))

        return float(brentq(gap, 1e-3, 300.0 / k)) if gap(1e-3) < 0 else 0.3
    if rule.kind == "mewma":
        return float(chi2.isf(min(0.5, 1 / wanted), rule.dimension))
    return float(-ndtri(min(0.25, 0.5 / wanted)))


def _solve(log_arl: Callable[[float], float], wanted: float, guess: float) -> float:
    """The limit at which the mean run length is the wanted one; it grows with the limit."""
    target = np.log(wanted)
    low, high = 0.8 * guess, 1.1 * guess
    while log_arl(low) > target:
        high, low = low, 0.6 * low
        if low < 1e-4:
            raise ValueError(f"no positive limit gives a mean run length of {wanted:g}; ask for a longer one")
    while log_arl(high) < target:
        low, high = high, 1.3 * high
    return float(brentq(lambda x: log_arl(x) - target, low, high, xtol=1e-7, rtol=1e-10))


@lru_cache(maxsize=1024)
def _limit(rule: Rule, wanted: float, head_start: float, shift_sd: float) -> float:
    if not 1 < wanted <= ARL_MOST:
        raise ValueError(
            f"wanted mean run length is {wanted:g} updates; it must lie above 1 and not above {ARL_MOST:g}: "
            "raise the false-alarm budget, lengthen the sampling interval, or use fewer charts"
        )
    if shift_sd > 0:
        return _solve(lambda x: -np.log(false_alarm_rate(rule, x, shift_sd, head_start)), wanted, _guess(rule, wanted))
    if rule.kind == "shewhart":
        return float(-ndtri(0.5 / wanted))
    start: Start = head_start if head_start > 0 else "zero"
    settled = Rule(rule.kind, rule.k, rule.lam, rule.sided, rule.dimension)
    limit = _solve(lambda x: float(np.log(arl(settled, x, 0.0, start))), wanted, _guess(rule, wanted))
    if rule.exact:
        return _solve(lambda x: float(np.log(arl(rule, x))), wanted, limit)
    return limit


def limit_for(
    kind: Kind,
    in_control_arl: ArrayLike,
    *,
    k: float = 0.5,
    lam: float = 0.1,
    sided: int = 2,
    dimension: int = 2,
    exact: bool = False,
    head_start: float = 0.0,
    shift_sd: float = 0.0,
) -> FloatArray:
    """Limits for wanted mean numbers of updates between false alarms; the shape of ``in_control_arl``.

    Parameters
    ----------
    kind, k, lam, sided, dimension, exact : see :class:`Rule`
    in_control_arl : scalar or array, updates, above 1 and up to 1e15
    head_start : share of the limit a CUSUM starts from
    shift_sd : standard deviation of the constant error that an estimated baseline leaves in the values [standard
        deviations of a value]: ``1 / sqrt(m)`` for a mean of m values. The limit is widened so that the false-alarm
        rate, averaged over that error, is the wanted one.

    Raises
    ------
    ValueError
        Where no limit gives the wanted run length.
    """
    rule = Rule(kind, k=k, lam=lam, sided=sided, dimension=dimension, exact=exact)
    wanted = np.asarray(in_control_arl, dtype=np.float64)
    unique, back = np.unique(wanted, return_inverse=True)
    limits = np.array([_limit(rule, float(u), float(head_start), float(shift_sd)) for u in unique])
    # The last bits depend on how many threads the linear algebra had; verdicts may not.
    return np.asarray(np.round(limits, 6)[back].reshape(wanted.shape))


def false_alarm_rate(rule: Rule, limit: float, shift_sd: float, head_start: float = 0.0) -> float:
    """False alarms an update, averaged over a normal baseline error of this standard deviation."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(_SHIFT_NODES)
    start: Start = head_start if head_start > 0 else "zero"
    one_sided = rule.kind == "cusum" and rule.sided == 1
    errors = nodes if one_sided else np.abs(nodes)  # every other chart is symmetric, and its ARL is kept
    rates = [1.0 / arl(rule, limit, float(round(e * shift_sd, 12)), start) for e in errors]
    return float(np.dot(weights, rates) / weights.sum())


@dataclass(frozen=True, slots=True)
class BaselineEffect:
    """What estimating mean and standard deviation from ``samples`` values does to a chart.

    ``probability`` is that of a false alarm within ``updates``, ``known`` the same with a known baseline, ``median``
    the median run length, ``rate`` the mean false alarms an update.
    """

    samples: int
    updates: int
    probability: float
    known: float
    median: int
    rate: float


def baseline_effect(rule: Rule, limit: float, samples: int, updates: int) -> BaselineEffect:
    """Average a chart's behaviour over the error of a baseline of ``samples`` independent values.

    The mean's error is normal, the variance's chi-square with ``samples - 1`` degrees of freedom (Jensen et al. 2006,
    Journal of Quality Technology 38, review the literature).

    Raises
    ------
    ValueError
        For fewer than 5 samples, and for a MEWMA, whose covariance has an error of its own.
    """
    if samples < 5:
        raise ValueError(f"a baseline of {samples} values is too short to speak of; give at least 5")
    if rule.kind == "mewma":
        raise ValueError("baseline_effect knows cusum, ewma and shewhart; use it per output")
    errors, error_w = np.polynomial.hermite_e.hermegauss(_SHIFT_NODES)
    error_w = error_w / error_w.sum()
    levels, level_w = transition.gauss(0.0, 1.0, _SCALE_NODES)
    ratios = np.sqrt((samples - 1) / chi2.ppf(levels, samples - 1))  # true over estimated standard deviation
    # The error counts in units of the true standard deviation; its sign does not matter to a two-sided chart.
    cases = [
        (_rescaled(rule, r), limit / r, float(e / np.sqrt(samples)), float(we * wr))
        for e, we in zip(errors, error_w, strict=True)
        for r, wr in zip(ratios, level_w, strict=True)
    ]

    def within(n: int) -> float:
        return float(sum(w * alarm_probability(q, x, n, d) for q, x, d, w in cases))

    rate = float(sum(w / arl(q, x, d) for q, x, d, w in cases))
    median = _first(lambda n: within(n) < 0.5)
    return BaselineEffect(samples, updates, within(updates), alarm_probability(rule, limit, updates), median, rate)


def _rescaled(rule: Rule, ratio: float) -> Rule:
    """The rule on values whose standard deviation is ``ratio``, brought back to 1 (limits are divided by it)."""
    return Rule(rule.kind, rule.k / ratio, rule.lam, rule.sided, rule.dimension, rule.exact)
