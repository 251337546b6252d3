"""Beyond the point estimate: profile likelihoods, likelihood-ratio tests, forward selection of models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fdd.greybox.fit import Progress, fit
from fdd.greybox.likelihood import Data
from fdd.greybox.results import FitResult
from fdd.greybox.scale import from_scale, scale_bounds, to_scale
from fdd.models.declare import ComponentModel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Profile:
    """Profile likelihood of one parameter: ``values`` natural, ``drop`` twice the loss of log-likelihood.

    ``interval`` is where the drop stays below ``threshold``; infinite where it never reaches it within the bounds.
    """

    parameter: str
    unit: str
    values: FloatArray
    drop: FloatArray
    threshold: float
    interval: tuple[float, float]


def profile(
    result: FitResult, parameter: str, *, alpha: float = 0.05, points: int = 8, progress: Progress | None = None
) -> Profile:
    """Profile likelihood with its interval: all other free parameters are estimated anew at every point.

    Raises
    ------
    ValueError : a parameter that was not estimated
    """
    if parameter not in result.free:
        raise ValueError(f"{result.model_name}: {parameter!r} was not estimated; estimated: {', '.join(result.free)}")
    model = result._model()
    q = next(p for p in model.parameters if p.symbol == parameter)
    low, high = scale_bounds(q)
    centre = float(np.clip(to_scale(q, result.params[parameter]), low, high))
    k = model.symbols["parameters"].index(parameter)
    sd = math.sqrt(max(result.cov_scale[k, k], 0.0)) or 0.3
    threshold = float(stats.chi2.isf(alpha, 1))
    best = -result.llf + result.penalty
    found: dict[float, float] = {centre: 0.0}
    for side, bound in ((-1, low), (1, high)):
        warm: Mapping[str, float] = result.params
        for step in range(1, points + 1):
            theta = float(np.clip(centre + side * sd * 0.5 * step, low, high))
            drop, warm = _profile_point(result, parameter, from_scale(q, theta), warm, best)
            found[theta] = drop
            if progress is not None:
                progress(len(found) - 1, 2 * points, best)
            if drop > 1.5 * threshold or theta == bound:
                break
    thetas = np.array(sorted(found))
    drops = np.array([found[t] for t in thetas])
    edges = [_crossing(thetas, drops, centre, side, threshold) for side in (-1, 1)]
    values = np.array([from_scale(q, t) for t in thetas])
    interval = (
        from_scale(q, edges[0]) if math.isfinite(edges[0]) else -math.inf,
        from_scale(q, edges[1]) if math.isfinite(edges[1]) else math.inf,
    )
    return Profile(parameter, q.unit, values, drops, threshold, interval)


def _profile_point(
    result: FitResult, parameter: str, value: float, warm: Mapping[str, float], best: float
) -> tuple[float, Mapping[str, float]]:
    model, likelihood = result._model(), result._likelihood()
    fixed = {s: result.params[s] for s in model.symbols["parameters"] if s not in result.free} | {parameter: value}
    other = fit(
        model, likelihood.records, start={s: v for s, v in warm.items() if s not in fixed}, fixed=fixed,
        errors="fisher", huber=likelihood.huber, method=likelihood.method, priors=result.priors,
    )  # fmt: skip
    return max(0.0, 2 * (-other.llf + other.penalty - best)), other.params


def _crossing(thetas: FloatArray, drops: FloatArray, centre: float, side: int, threshold: float) -> float:
    """Where the signed root of the drop, nearly a straight line, crosses that of the threshold."""
    use = (thetas - centre) * side >= 0
    t, r = thetas[use][::side], np.sqrt(drops[use][::side])
    level = math.sqrt(threshold)
    for i in range(1, len(t)):
        if r[i] >= level:
            return float(t[i - 1] + (t[i] - t[i - 1]) * (level - r[i - 1]) / (r[i] - r[i - 1]))
    return side * math.inf


@dataclass(frozen=True, slots=True)
class RatioTest:
    """Likelihood-ratio test of a smaller model within a larger one."""

    statistic: float
    degrees: int
    p: float


def likelihood_ratio(smaller: FitResult, larger: FitResult) -> RatioTest:
    """Test whether the larger of two nested models fitted to the same data is worth its parameters.

    Raises
    ------
    ValueError : other data, not more parameters, or a larger model that fits worse (it stopped in a local optimum)
    """
    if smaller.span != larger.span or smaller.nobs != larger.nobs:
        raise ValueError(f"the fits are of different data: {smaller.nobs} and {larger.nobs} values")
    degrees = len(larger.free) - len(smaller.free)
    if degrees <= 0:
        raise ValueError(f"the second model has {len(larger.free)} free parameters, the first {len(smaller.free)}")
    statistic = 2 * (larger.llf - smaller.llf)
    if statistic < -1e-3:
        raise ValueError(
            f"the larger model fits worse by {-statistic / 2:.3f}: it stopped in a local optimum (try more starts) "
            "or the models are not nested"
        )
    return RatioTest(max(0.0, statistic), degrees, float(stats.chi2.sf(max(0.0, statistic), degrees)))


@dataclass(frozen=True, slots=True)
class Selection:
    """The path of a forward selection: one row a step, (name, result, test against the step before)."""

    path: tuple[tuple[str, FitResult, RatioTest | None], ...]
    tried: tuple[tuple[str, str, float, float], ...]
    """Every candidate: (from, candidate, log-likelihood, p)."""

    @property
    def chosen(self) -> tuple[str, FitResult]:
        """Name and fit of the selected model."""
        return self.path[-1][0], self.path[-1][1]

    def table(self) -> str:
        """The path as text."""
        head = f"{'model':<16}{'parameters':>11}{'log-lik.':>13}{'AIC':>13}{'BIC':>13}{'LR':>11}{'p':>10}"
        rows = [
            f"{name:<16}{len(r.free):>11}{r.llf:>13.3f}{r.aic:>13.2f}{r.bic:>13.2f}"
            + (f"{t.statistic:>11.2f}{t.p:>10.2g}" if t else "")
            for name, r, t in self.path
        ]
        return "\n".join([head, *rows])


def forward_selection(
    models: Mapping[str, ComponentModel],
    extends: Mapping[str, Sequence[str]],
    data: Data | Sequence[Data],
    *,
    first: str,
    alpha: float = 0.05,
    **options: Any,
) -> Selection:
    """Grow a model step by step (Bacher and Madsen 2011): of all extensions take the most likely, if it is worth it.

    Parameters
    ----------
    models : candidates by name
    extends : name to the names of the models one step larger that contain it
    first : where to begin
    alpha : level of the likelihood-ratio test an extension must pass
    options : handed to :func:`fdd.greybox.fit.fit`, for example ``starts``
    """
    name, result = first, fit(models[first], data, **options)
    path: list[tuple[str, FitResult, RatioTest | None]] = [(name, result, None)]
    tried: list[tuple[str, str, float, float]] = []
    while True:
        candidates = []
        for larger in extends.get(name, ()):
            other = fit(models[larger], data, **options)
            if other.llf > result.llf and len(other.free) > len(result.free):
                test = likelihood_ratio(result, other)
                candidates.append((other.llf, larger, other, test))
                tried.append((name, larger, other.llf, test.p))
            else:
                tried.append((name, larger, other.llf, 1.0))
        best = max(candidates, key=lambda c: c[0], default=None)
        if best is None or best[3].p > alpha:
            return Selection(tuple(path), tuple(tried))
        name, result = best[1], best[2]
        path.append((name, result, best[3]))
