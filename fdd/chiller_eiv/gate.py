"""The identifiability gate: what the data of one chiller allow to be said, and why not more.

Three answers: all three parameters (``FULL``); internal loss and resistance with the leak held (``HELD``); or neither,
and only the power residual at given load and temperatures is watched (``RESIDUAL``). The gate refuses where the load
hardly moves, where the equations are ill-conditioned, where an interval is wide, where two halves of the data disagree,
where few points are independent, and where a parameter comes out with an impossible sign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from fdd.chiller_eiv.estimators import hold, lambda_min
from fdd.chiller_eiv.fit import ChillerFit, FitOptions, fit_gordon_ng, predict_power
from fdd.chiller_eiv.forms import Form
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.moments import Moments, regression_terms, sum_moments
from fdd.records import FloatArray, IntArray


class Level(StrEnum):
    """What may be reported and charted."""

    FULL = "all parameters"
    HELD = "internal loss and resistance, leak held"
    RESIDUAL = "power residual only"


@dataclass(frozen=True)
class GateLimits:
    """When to decline.

    Attributes
    ----------
    load_spread : least ratio of the 95th to the 5th percentile of load [1]
    signal : least root of |M_xx - lambda S_xx|: (signal + noise) / noise variance in the weakest direction
    condition : largest condition number of the scaled normal equations
    half_width : largest half-width of a 95 % interval, as a share of the parameter
    split_factor : largest ratio between the values of two halves of the data
    split_errors, split_share : halves also disagree where they differ by so many standard errors *and* by this share
    independent_points : least effective sample size
    days : least days of data
    """

    load_spread: float = 1.2
    signal: float = 3.0
    condition: float = 1e5
    half_width: Mapping[str, float] = field(default_factory=lambda: {"dS": 0.35, "Q_leak": 0.75, "R": 0.35})
    split_factor: float = 1.5
    split_errors: float = 3.0
    split_share: float = 0.15
    independent_points: float = 20.0
    days: int = 5


@dataclass(frozen=True)
class GateDecision:
    """The gate's answer.

    Attributes
    ----------
    level : what may be reported and charted
    reasons : why not more, in words; empty at ``FULL``
    measures : the figures the decision rests on
    fit : the fit at that level, its intervals with all that is not known; at ``RESIDUAL`` the free fit
    """

    level: Level
    reasons: tuple[str, ...]
    measures: Mapping[str, float]
    fit: ChillerFit

    def se(self) -> FloatArray:
        """Standard errors of the fit's parameters: an interval is the estimate and 1.96 of them either way, (p,)."""
        interval = self.fit.interval()
        return np.asarray((interval[:, 1] - interval[:, 0]) / (2 * 1.96))

    def sentence(self) -> str:
        """One sentence for a report."""
        if self.level is Level.FULL:
            return "identifiable: entropy production, leak and resistance are all estimated"
        if self.level is Level.HELD:
            return f"leak held at {self.fit.held['Q_leak']:.4g} W, because {self._because()}"
        return f"not identifiable, because {self._because()}"

    def _because(self) -> str:
        more = len(self.reasons) - 1
        return self.reasons[0] + (f" (and {more} more reason{'s' if more > 1 else ''})" if more else "")


def effective_size(residual: FloatArray) -> float:
    """Number of independent points the residuals of n consecutive points are worth.

    n / (1 + 2 sum rho_j), the autocorrelations summed over Geyer's initial positive pairs (Geyer 1992).
    """
    n = len(residual)
    e = residual - residual.mean()
    variance = float(e @ e) / n
    if n < 4 or variance == 0:
        return float(n)
    total = 0.0
    for j in range(1, n - 2, 2):
        pair = float(e[:-j] @ e[j:] + e[: -j - 1] @ e[j + 1 :]) / (n * variance)
        if pair <= 0:
            break
        total += pair
    return n / (1 + 2 * total)


def gate(
    x: FloatArray,
    cov: FloatArray,
    day: IntArray,
    *,
    options: FitOptions | None = None,
    limits: GateLimits | None = None,
    leak: float | None = None,
    scale: Mapping[str, float] | None = None,
) -> GateDecision:
    """Decide what the points of one chiller allow.

    Parameters
    ----------
    x, cov : measurements (n, m) and error covariance
    day : shape (n,), increasing; halves are split between days
    options : form, estimator, priors
    limits : when to decline
    leak : value to hold the leak at [W], where it is known; otherwise the free estimate, or zero where that is negative
    scale : declared scale errors of ``Q`` and ``E`` [1]; they join the intervals and decide nothing

    Raises
    ------
    ChillerError : too few points for any fit
    """
    o, g = options or FitOptions(), limits or GateLimits()
    free = fit_gordon_ng(x, cov, day, o)
    measures = _measures(x, cov, o, free)
    common = _common_reasons(measures, day, g)
    first = [*common, *_reasons(x, cov, day, free, o, g, measures, "")]
    if not first:
        return GateDecision(Level.FULL, (), measures, with_scale(free, x, cov, day, o, scale or {}))
    if "Q_leak" in o.held:
        return GateDecision(Level.RESIDUAL, tuple(first), measures, free)
    value = leak if leak is not None else max(free.values()["Q_leak"], 0.0)
    fixed = replace(o, held={**o.held, "Q_leak": value})
    held = fit_gordon_ng(x, cov, day, fixed)
    second = [*common, *_reasons(x, cov, day, held, fixed, g, measures, "held: ")]
    if not second:
        if leak is None:
            held = _marginal(held, free)
        return GateDecision(Level.HELD, tuple(first), measures, with_scale(held, x, cov, day, fixed, scale or {}))
    more = [f"with the leak held, {r}" for r in second if r not in first]
    return GateDecision(Level.RESIDUAL, (*first, *more), measures, free)


def _marginal(held: ChillerFit, free: ChillerFit) -> ChillerFit:
    """A fit with the leak held, its intervals as wide as the unknown leak makes them."""
    at = [free.parameters.index(p) for p in held.parameters]
    own = free.interval()[at]
    moved = held.estimate - free.estimate[at]
    sd = np.hypot((own[:, 1] - own[:, 0]) / (2 * 1.96), moved)
    known = held.interval()
    sd = np.where(np.isfinite(sd), np.maximum(sd, (known[:, 1] - known[:, 0]) / (2 * 1.96)), np.nan)
    return _widened(held, sd)


def with_scale(
    fit: ChillerFit, x: FloatArray, cov: FloatArray, day: IntArray, o: FitOptions, scale: Mapping[str, float]
) -> ChillerFit:
    """A fit whose intervals hold declared scale errors too: what each does to the estimate, in quadrature."""
    interval = fit.interval()
    variance = ((interval[:, 1] - interval[:, 0]) / (2 * 1.96)) ** 2
    for name, share in scale.items():
        if share > 0 and name in fit.form.measured:
            i, moved = fit.form.measured.index(name), x.copy()
            moved[:, i] *= 1 + share
            variance = variance + (fit_gordon_ng(moved, cov, day, o).estimate - fit.estimate) ** 2
    return _widened(fit, np.sqrt(variance))


def _widened(fit: ChillerFit, sd: FloatArray) -> ChillerFit:
    """The same estimate with standard deviations (p,) that an interval takes 1.96 of."""
    d = np.sqrt(np.diagonal(fit.covariance))
    correlation = fit.covariance / np.outer(d, d)
    return replace(fit, covariance=correlation * np.outer(sd, sd), freedom=np.full(len(sd), 1e9))


def _measures(x: FloatArray, cov: FloatArray, o: FitOptions, fit: ChillerFit) -> dict[str, float]:
    q = x[:, 2]
    out = {"load spread": float(np.percentile(q, 95) / max(np.percentile(q, 5), 1e-9)), "points": float(len(x))}
    electric = x[:, o.form.measured.index("E")]
    try:
        residual = electric / predict_power(o.form, fit.chiller(), x) - 1
    except ChillerError:
        residual = electric / electric.mean() - 1
    out["independent points"] = effective_size(residual)
    out["residual autocorrelation"] = _lag_one(residual)
    out["residual sd"] = float(residual.std())
    out["lambda_min"] = fit.lambda_min
    return out


def _lag_one(residual: FloatArray) -> float:
    e = residual - residual.mean()
    square = float(e @ e)
    return float(e[1:] @ e[:-1]) / square if square > 0 else 0.0


def _common_reasons(m: Mapping[str, float], day: IntArray, g: GateLimits) -> list[str]:
    reasons = []
    days = len(np.unique(day))
    if days < g.days:
        have = "day has" if days == 1 else "days have"
        reasons.append(f"only {days} {have} steady points ({g.days} are needed)")
    if m["load spread"] < g.load_spread:
        reasons.append(f"the load hardly moves (95th to 5th percentile {m['load spread']:.2f}, {g.load_spread} needed)")
    if m["independent points"] < g.independent_points:
        reasons.append(
            f"the {m['points']:.0f} points are worth {m['independent points']:.0f} independent ones "
            f"(lag-1 autocorrelation {m['residual autocorrelation']:.2f}; {g.independent_points:.0f} needed)"
        )
    return reasons


def _reasons(
    x: FloatArray,
    cov: FloatArray,
    day: IntArray,
    fit: ChillerFit,
    o: FitOptions,
    g: GateLimits,
    measures: dict[str, float],
    prefix: str,
) -> list[str]:
    """Why this fit may not be believed; adds what it measured."""
    reasons = []
    signal, condition = conditioning(o.form, x, cov, o.held)
    measures[prefix + "signal"], measures[prefix + "condition"] = signal, condition
    if signal < g.signal:
        reasons.append(f"sensor noise drowns the variation (lambda_x {signal:.2g}, {g.signal:g} needed)")
    if condition > g.condition:
        reasons.append(f"the equations are ill-conditioned ({condition:.2g}, at most {g.condition:.0g})")
    widths = _relative_half_width(fit)
    for p, w in widths.items():
        measures[f"{prefix}half-width {p}"] = w
        most = g.half_width.get(p)
        if most is None or w <= most:
            continue
        if np.isfinite(w):
            reasons.append(f"the interval of {p} is too wide (+-{100 * w:.0f} %, at most {100 * most:.0f} %)")
        else:
            reasons.append(f"one day does not tell how well {p} is known")
    for p, v in zip(fit.parameters, fit.estimate, strict=True):
        if p in ("dS", "R") and v <= 0 and "dS_speed" not in fit.parameters:
            reasons.append(f"{p} comes out {'negative' if v < 0 else 'zero'}, which no machine has")
        if p == "Q_leak" and v < 0:
            reasons.append("Q_leak comes out negative: it stands for model error, not for a leak")
    return reasons + _halves(x, cov, day, o, g, measures, prefix)


def conditioning(form: Form, x: FloatArray, cov: FloatArray, held: Mapping[str, float]) -> tuple[float, float]:
    """Least root of |M_xx - lambda S_xx|, and the condition number of M_xx scaled to unit diagonal."""
    moments = sum_moments(regression_terms(form, x, cov))
    if held:
        moments = moments.map(hold(form, held)[0])
    inner = Moments(moments.M[1:, 1:], moments.S[1:, 1:], moments.n)
    d = np.sqrt(np.diagonal(inner.M))
    return float(lambda_min(inner)), float(np.linalg.cond(inner.M / np.outer(d, d)))


def _relative_half_width(fit: ChillerFit) -> dict[str, float]:
    interval = fit.interval()
    with np.errstate(divide="ignore", invalid="ignore"):
        width = (interval[:, 1] - interval[:, 0]) / 2 / np.abs(fit.estimate)
    return {p: float(w) for p, w in zip(fit.parameters, width, strict=True)}


def _halves(
    x: FloatArray,
    cov: FloatArray,
    day: IntArray,
    o: FitOptions,
    g: GateLimits,
    measures: dict[str, float],
    prefix: str,
) -> list[str]:
    """Fit the first and second half of the days, and even and odd days; parameters must agree."""
    index = np.unique(day, return_inverse=True)[1]
    splits = {"the first and second half": index < (index.max() + 1) / 2, "even and odd days": index % 2 == 0}
    reasons = []
    for name, first in splits.items():
        try:
            a = fit_gordon_ng(x[first], cov[first], day[first], o)
            b = fit_gordon_ng(x[~first], cov[~first], day[~first], o)
        except ChillerError:
            reasons.append(f"{name} of the data cannot be fitted apart: too few points")
            continue
        for i, p in enumerate(a.parameters):
            u, v = float(a.estimate[i]), float(b.estimate[i])
            factor = max(abs(u), abs(v)) / max(min(abs(u), abs(v)), 1e-300) if u * v > 0 else np.inf
            measures[f"{prefix}{name} {p}"] = factor
            if p not in g.half_width:
                continue
            error = float(np.hypot(a.se[i], b.se[i]))
            apart = abs(u - v) > g.split_errors * error and abs(u - v) > g.split_share * abs(u + v) / 2
            if factor > g.split_factor or apart:
                how = f"by a factor of {factor:.1f}" if np.isfinite(factor) else "in sign"
                reasons.append(f"{name} of the data disagree on {p} {how} ({u:.3g} and {v:.3g} {_unit(a, p)})")
    return reasons


def _unit(fit: ChillerFit, parameter: str) -> str:
    return fit.form.units[fit.form.position(parameter)]
