"""Gates that a re-identified baseline must pass before it may replace the one in force.

Re-identification follows what is slow and harmless (seasons, ageing) and must never learn a fault. Every gate is a pure
function of estimates; together they say accepted, refused, or *suspected fault*.

=============  =======================================================================================================
gate           passed when
=============  =======================================================================================================
converged      the search ended at an optimum
identifiable   no physical parameter is left open, or is much vaguer, than in the baseline in force
bounds         every parameter is inside its physical bounds
white          innovations are as white as those of the baseline in force on the same data (Ljung and Box 1978)
better         the log-likelihood of days that were held out is higher, in sum and on most of them
steady         the estimates of the parts of the window agree: nothing stepped or ran away inside it
no fault       no physical parameter has left the baselines before it by more than its error *and* the rate of ageing
=============  =======================================================================================================

``steady`` and ``no fault`` are what a fault fails; the others speak of the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

from fdd.records import NANOSECONDS, FloatArray

MONTH = 365.25 / 12 * 86400 * NANOSECONDS
FAULT_GATES = ("steady", "no fault")


class Outcome(StrEnum):
    """What became of a candidate."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    SUSPECTED = "suspected fault"


@dataclass(frozen=True, slots=True)
class Policy:
    """Limits of the gates.

    Attributes
    ----------
    errors : combined standard errors beyond which a change is no chance
    rate : change a month that ageing and seasons may make (0.05 is 5 %)
    negligible : change that is never a fault, however well it is seen
    most : change from the last baseline that a person vouched for, beyond which a person is asked again
    evidence : log-likelihood that held-out days must gain in sum (3 nats are odds of 20)
    vaguer : how much a standard error may grow
    clear : standard error (of the logarithm, so a share) that is always good enough
    level : of the whiteness test
    """

    errors: float = 3.0
    rate: float = 0.05
    negligible: float = 0.03
    most: float = 0.20
    evidence: float = 3.0
    vaguer: float = 2.0
    clear: float = 0.03
    level: float = 0.01


@dataclass(frozen=True, slots=True)
class Gate:
    """One gate's verdict: the statistic that was compared with its limit, and why in words."""

    name: str
    passed: bool
    statistic: float
    limit: float
    remark: str


@dataclass(frozen=True, slots=True)
class Estimate:
    """Physical parameters on the estimation scale with their errors.

    Attributes
    ----------
    name : what the estimate is, for remarks
    theta, error : shape (p,); ``error`` is NaN where the data leave a parameter open
    middle : event time in the middle of its data [ns]
    vouched : a person stands for it
    """

    name: str
    theta: FloatArray
    error: FloatArray
    middle: int
    vouched: bool = False


def decide(gates: Sequence[Gate]) -> Outcome:
    """A fault is suspected where the fit can be believed and only the plant looks wrong."""
    failed = [g.name for g in gates if not g.passed]
    if not failed:
        return Outcome.ACCEPTED
    believable = not {"converged", "identifiable", "bounds"} & set(failed)
    return Outcome.SUSPECTED if believable and set(FAULT_GATES) & set(failed) else Outcome.REFUSED


def converged(found: bool, reason: str) -> Gate:
    """The search ended at an optimum."""
    return Gate("converged", found, float(found), 1.0, reason)


def identifiable(symbols: Sequence[str], new: Estimate, old: Estimate, policy: Policy) -> Gate:
    """No parameter that was known has become open, and no error has grown much."""
    known = np.isfinite(old.error)
    lost = [s for s, k, e in zip(symbols, known, new.error, strict=True) if k and not np.isfinite(e)]
    if lost:
        return Gate("identifiable", False, np.inf, policy.vaguer, f"the data say nothing about {', '.join(lost)}")
    limit = np.maximum(policy.vaguer * old.error, policy.clear)
    with np.errstate(invalid="ignore"):
        ratio = np.where(known & np.isfinite(new.error), new.error / limit, 0.0)
    if not ratio.size:
        return Gate("identifiable", True, 0.0, policy.vaguer, "there are no physical parameters")
    worst = int(ratio.argmax())
    remark = f"standard error of {symbols[worst]} {new.error[worst]:.3g}, was {old.error[worst]:.3g}"
    return Gate("identifiable", bool(ratio[worst] <= 1), float(ratio[worst]), 1.0, remark)


def inside(symbols: Sequence[str], values: FloatArray, lower: FloatArray, upper: FloatArray) -> Gate:
    """Every parameter is strictly inside its bounds, natural scale (p,); those that cannot move are left out."""
    free = lower < upper
    out = free & ~((values > lower) & (values < upper))
    names = [f"{s} = {v:.4g}" for s, v, o in zip(symbols, values, out, strict=True) if o]
    remark = f"at or outside a bound: {', '.join(names)}" if names else "all inside"
    return Gate("bounds", not names, float(out.sum()), 0.0, remark)


def ljung_box(z: FloatArray, lags: int) -> tuple[float, int]:
    """Ljung and Box's statistic of a series with gaps (NaN), and how many values it has.

    Source: Ljung, G. M., Box, G. E. P. (1978), Biometrika 65, 297-303, with the pairs that are there at each lag.
    """
    d = z - np.nanmean(z)
    n = int(np.isfinite(d).sum())
    variance = np.nanmean(d * d)
    total = 0.0
    for k in range(1, lags + 1):
        pairs = d[k:] * d[:-k]
        seen = int(np.isfinite(pairs).sum())
        if seen:
            total += (float(np.nansum(pairs)) / n / variance) ** 2 / seen
    return float(n * (n + 2) * total), n


def white(symbols: Sequence[str], new: FloatArray, old: FloatArray, policy: Policy, lags: int = 20) -> Gate:
    """Standardised innovations (m, q) are white, or at most a fifth more coloured than under the old parameters."""
    limit = float(stats.chi2.isf(policy.level, lags))
    found = [(ljung_box(a, lags)[0], ljung_box(b, lags)[0], s) for a, b, s in zip(new.T, old.T, symbols, strict=True)]
    q_new, q_old, symbol = max(found, key=lambda f: f[0] / max(limit, 1.2 * f[1]))
    most = max(limit, 1.2 * q_old)
    return Gate("white", q_new <= most, q_new, most, f"Ljung-Box of {symbol} over {lags} lags, was {q_old:.4g}")


def better(gain: FloatArray, policy: Policy) -> Gate:
    """Log-likelihood gained on each held-out day (d,): enough in sum, and on more than half of the days."""
    if not len(gain):
        return Gate("better", False, 0.0, policy.evidence, "no day could be held out")
    days = int((gain > 0).sum())
    passed = bool(gain.sum() >= policy.evidence and 2 * days > len(gain))
    remark = f"log-likelihood gained on held-out days; higher on {days} of {len(gain)}"
    return Gate("better", passed, float(gain.sum()), policy.evidence, remark)


def _verdict(name: str, symbols: Sequence[str], cases: Sequence[tuple[str, FloatArray, FloatArray, float]]) -> Gate:
    """The worst of several changes (p,): each is failed beyond its bound in errors (p,) and beyond its allowance."""
    worst = Gate(name, True, 0.0, 1.0, "no change that its error and ageing do not explain")
    for what, change, bound, allowed in cases:
        with np.errstate(invalid="ignore"):
            ratio = np.minimum(np.abs(change) / bound, np.abs(change) / allowed)
        ratio = np.where(np.isfinite(ratio), ratio, 0.0)
        if not ratio.size or ratio.max() <= worst.statistic:
            continue
        k = int(ratio.argmax())
        remark = f"{symbols[k]} {change[k]:+.1%} {what}; error bound {bound[k]:.1%}, allowed {allowed:.1%}"
        worst = Gate(name, bool(ratio[k] <= 1), float(ratio[k]), 1.0, remark)
    return worst


def steady(symbols: Sequence[str], parts: Sequence[tuple[Estimate, Estimate]], policy: Policy) -> Gate:
    """Estimates before and after several split points of the window agree.

    ``parts`` are pairs whose middles say how far apart they are in time.
    """
    cases = []
    for before, after in parts:
        bound = policy.errors * np.hypot(before.error, after.error)
        allowed = max(policy.negligible, policy.rate * (after.middle - before.middle) / MONTH)
        cases.append(("within the window", after.theta - before.theta, bound, allowed))
    return _verdict("steady", symbols, cases)


def no_fault(
    symbols: Sequence[str], new: Estimate, earlier: Sequence[Estimate], policy: Policy, *, suspected: bool = False
) -> Gate:
    """No parameter has left any earlier baseline by more than chance and ageing explain.

    Parameters
    ----------
    earlier : baselines from the last that a person vouched for to the one in force. All of them: daily steps of a third
        of a per cent, each within its error, are 10 % a month seen from the month before.
    suspected : a fault was suspected before and nobody has answered; then time excuses nothing, or a step that was
        refused would count as ageing some months later
    """
    cases = []
    for e in earlier:
        change, bound = new.theta - e.theta, policy.errors * np.hypot(new.error, np.nan_to_num(e.error))
        months = max(0.0, (new.middle - e.middle) / MONTH)
        allowed = policy.negligible if suspected else max(policy.negligible, policy.rate * months)
        cases.append((f"from {e.name}, {months:.1f} months before", change, bound, allowed))
        if e.vouched:
            cases.append((f"from {e.name}, which a person vouched for", change, bound, policy.most))
    return _verdict("no fault", symbols, cases)
