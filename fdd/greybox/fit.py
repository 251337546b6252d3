"""Maximum likelihood and maximum a posteriori estimation of a model's parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fdd.greybox import codegen
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.record_faults import DataError
from fdd.greybox.results import FitResult, Trial
from fdd.greybox.scale import ParameterError, Prior, chain, from_scale, scale_bounds, scale_unit, to_scale
from fdd.greybox.trust import Optimum, minimise
from fdd.models.declare import ComponentModel

if TYPE_CHECKING:
    import pandas as pd

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, float], None]
Errors = Literal["observed", "fisher", "sandwich"]


class Objective:
    """Negative log posterior of the free parameters on the transform scale, remembering the last point."""

    def __init__(
        self, likelihood: Likelihood, values: FloatArray, free: NDArray[np.int64], priors: Mapping[str, Prior]
    ) -> None:
        self.likelihood, self.free = likelihood, free
        self.rows = [likelihood.model.parameters[k] for k in free]
        self.base = values.copy()
        self.priors = [(i, priors[q.symbol]) for i, q in enumerate(self.rows) if q.symbol in priors]
        self.reason = ""

    def natural(self, theta: FloatArray) -> FloatArray:
        """All parameters (n_p,), natural scale, from the free ones on the transform scale."""
        values = self.base.copy()
        values[self.free] = [from_scale(q, t) for q, t in zip(self.rows, theta, strict=True)]
        return values

    def theta(self, values: FloatArray) -> FloatArray:
        """The free parameters on the transform scale."""
        return np.array([to_scale(q, values[k]) for q, k in zip(self.rows, self.free, strict=True)])

    def __call__(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Value, gradient and information at the free parameters on the transform scale."""
        values = self.natural(theta)
        e = self.likelihood.evaluate(values)
        self.reason = e.reason
        gradient, information = e.gradient[self.free], e.information[np.ix_(self.free, self.free)]
        if not (np.isfinite(gradient).all() and np.isfinite(information).all()):
            return math.inf, np.zeros(len(theta)), np.eye(len(theta))
        penalty, slope, curve = self.penalty(values)
        return e.value + penalty, gradient + slope, information + np.diag(curve)

    def gradient(self, theta: FloatArray) -> FloatArray:
        """The gradient alone, which costs less; not finite where there is no likelihood."""
        values = self.natural(theta)
        e = self.likelihood.evaluate(values, information=False)
        slope = e.gradient[self.free] + self.penalty(values)[1]
        return slope if math.isfinite(e.value) else np.full(len(theta), np.nan)

    def penalty(self, values: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Negative log prior density with slope and (positive) curvature on the transform scale."""
        slope, curve, total = np.zeros(len(self.free)), np.zeros(len(self.free)), 0.0
        scale = chain(self.likelihood.model, values)[self.free]
        for i, prior in self.priors:
            loss, slope[i], curve[i] = prior.penalty(float(values[self.free[i]]), float(scale[i]))
            total += loss
        return total, slope, curve


def fit(
    model: ComponentModel,
    data: Data | Sequence[Data] | pd.DataFrame,
    *,
    start: Mapping[str, float] | FitResult | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, Prior] | None = None,
    starts: int = 1,
    seed: int = 0,
    spread: float = 0.7,
    errors: Errors = "observed",
    huber: float = math.inf,
    method: codegen.Method | None = None,
    substeps: int | None = None,
    progress: Progress | bool | None = None,
) -> FitResult:
    """Estimate a model's parameters by maximum likelihood, or maximum a posteriori where ``priors`` are given.

    Parameters
    ----------
    model : the component model; bounds and transforms are those of its parameter table
    data : one record, or several experiments whose likelihoods are added; or a table as :meth:`Data.from_frame` takes
    start : values to start from by symbol (others start at their typical value), or an earlier result (warm start)
    fixed : parameters held at a value
    priors : :class:`Prior` by symbol
    starts : how many searches; the first from ``start``, the others scattered around it on the transform scale
    seed, spread : of that scatter (standard deviation on the transform scale)
    errors : standard errors from the observed information (2 p more gradients), from Fisher's, or by the sandwich of
        observed information and scatter of the scores, which holds for a misspecified model, too (White 1982)
    huber : standardised innovation from which on a measurement counts as an outlier (2 to 3 where they are expected);
        errors are then those of the sandwich
    method, substeps : override the automatic choice of prediction; for experts and tests
    progress : True for a progress bar, or what is called with (search, searches, best negative log-likelihood so far)

    Raises
    ------
    DataError, ParameterError : what cannot be used, with the remedy
    """
    records = _records(data, model)
    likelihood = Likelihood(model, records, method=method, substeps=substeps, huber=huber)
    held = dict(fixed or {})
    values = _start_values(model, start, held, priors or {})
    free = np.array(
        [k for k, q in enumerate(model.parameters) if q.symbol not in held and q.lower < q.upper], dtype=np.int64
    )
    samples = sum(int(np.isfinite(d.y).sum()) for d in records)
    if samples <= len(free):
        raise DataError(
            f"{model.name}: {samples} measured values for {len(free)} free parameters; give more data or fix some"
        )
    objective = Objective(likelihood, values, free, priors or {})
    objective.base = values = _where_it_exists(objective, values)
    with _bar(model.name) if progress is True else nullcontext(progress or None) as told:
        best, trials = _search(objective, starts, seed, spread, told)
    return _result(objective, best, trials, errors, values)


def _records(data: Data | Sequence[Data] | pd.DataFrame, model: ComponentModel) -> list[Data]:
    if isinstance(data, Data):
        return [data]
    return list(data) if isinstance(data, Sequence) else [Data.from_frame(data, model)]


@contextmanager
def _bar(name: str) -> Iterator[Progress]:
    """A progress bar of searches on the terminal (standard error), with the best of them so far."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total, best: bar.update(
            task, completed=done, total=total, description=f"{name}, best {best:.4f}"
        )


def _start_values(
    model: ComponentModel,
    start: Mapping[str, float] | FitResult | None,
    fixed: dict[str, float],
    priors: Mapping[str, Prior],
) -> FloatArray:
    given = dict(start.params) if isinstance(start, FitResult) else dict(start or {})
    table = {q.symbol: q for q in model.parameters}
    for what, names in (("start", given), ("fixed", fixed), ("priors", priors)):
        for symbol in names:
            if symbol not in table:
                raise ParameterError(
                    f"{model.name}: {what} names {symbol!r}, which is no parameter; known: {', '.join(table)}"
                )
    for symbol, value in given.items():
        q = table[symbol]
        if symbol not in fixed and not q.lower <= value <= q.upper:
            raise ParameterError(
                f"{model.name}: start of {symbol} is {value:g} {q.unit}, outside its bounds "
                f"[{q.lower:g}, {q.upper:g}]; give a value inside or widen the bounds in the model's table"
            )
    for symbol, value in fixed.items():
        if not math.isfinite(value):
            raise ParameterError(f"{model.name}: {symbol} is fixed at {value}; give a finite number")
    # Whole numbers would make the array, and every trial point with it, one of integers.
    values = [{**{q.symbol: q.typical}, **given, **fixed}[q.symbol] for q in model.parameters]
    return np.array(values, dtype=np.float64)


def _where_it_exists(objective: Objective, values: FloatArray) -> FloatArray:
    """The start, moved towards the model's typical values as far as it takes for likelihood and gradient to exist."""
    model, likelihood = objective.likelihood.model, objective.likelihood
    given, typical = objective.theta(values), np.array([to_scale(q, q.typical) for q in objective.rows])
    reason = ""
    for share in (0.0, 0.25, 0.5, 0.75, 0.9, 1.0):
        moved = objective.natural(given + share * (typical - given)) if share else values
        likelihood.choose_substeps(moved)
        e = likelihood.evaluate(moved)
        reason = reason or e.reason or "its derivatives are not finite"
        if math.isfinite(e.value) and np.isfinite(e.gradient).all() and np.isfinite(e.information).all():
            if share:
                likelihood.warnings.append(
                    f"the likelihood does not exist at the start ({reason}); searched from a point {share:.0%} of the "
                    "way to the model's typical values instead"
                )
            return moved
    raise ParameterError(f"{model.name}: no likelihood at the start: {reason}; give a start nearer to the data")


def _search(
    objective: Objective, starts: int, seed: int, spread: float, progress: Progress | None
) -> tuple[Optimum, list[Trial]]:
    bounds = np.array([scale_bounds(q) for q in objective.rows]).reshape(-1, 2)
    unit = np.array([scale_unit(q) for q in objective.rows])
    first = np.clip(objective.theta(objective.base), bounds[:, 0], bounds[:, 1])
    random = np.random.default_rng(seed)
    best: Optimum | None = None
    trials: list[Trial] = []
    for i in range(max(1, starts)):
        theta = first if i == 0 else _scattered(objective, first, bounds, unit * spread, random)
        found = _polished(objective, theta, bounds, unit)
        trials.append(Trial(theta, found.theta, found.value, found.evaluations, found.converged, found.reason))
        if best is None or found.value < best.value:
            best = found
        if progress is not None:
            progress(i + 1, max(1, starts), best.value)
    assert best is not None
    return best, trials


def _scattered(
    objective: Objective, first: FloatArray, bounds: FloatArray, spread: FloatArray, random: np.random.Generator
) -> FloatArray:
    """A random start at which the likelihood exists."""
    for attempt in range(20):
        theta = np.clip(first + random.normal(size=len(first)) * spread * 0.9**attempt, bounds[:, 0], bounds[:, 1])
        if math.isfinite(objective.likelihood.value(objective.natural(theta))):
            return theta
    return first


def _polished(objective: Objective, theta: FloatArray, bounds: FloatArray, unit: FloatArray) -> Optimum:
    """Search with substeps as they suit the start, again where the optimum needs others, and past blind noise."""
    found = _minimised(objective, _with_enough_noise(objective, theta, bounds), bounds, unit, 1.0)
    for _ in range(3):
        if not math.isfinite(found.value) or not objective.likelihood.choose_substeps(objective.natural(found.theta)):
            break
        count = found.evaluations
        found = _minimised(objective, _with_enough_noise(objective, found.theta, bounds), bounds, unit, 0.1)
        found = replace(found, evaluations=found.evaluations + count)
    for _ in range(2):
        other = _past_blind_noise(objective, theta, found, bounds, unit)
        if other is None or not other.value < found.value - 1e-6:
            break
        found = other
    return found


def _with_enough_noise(objective: Objective, theta: FloatArray, bounds: FloatArray) -> FloatArray:
    """The start with all noise raised together for as long as that makes the data more likely; substeps to suit.

    Scaled together the noises leave a filter's gains as they are, so that this only makes the innovations' spread what
    the start foretells. Where that is far too little, the likelihood is steep and rough, or does not exist at all.
    """
    noise = np.array([q.kind == "noise" for q in objective.rows], dtype=np.bool_)
    best, chosen = math.inf, theta
    for factor in range(9 if noise.any() else 1):  # up to e^8
        raised = np.clip(theta + factor * noise, bounds[:, 0], bounds[:, 1])
        value = _value_with_substeps(objective, raised)
        if value < best:
            best, chosen = value, raised
        elif math.isfinite(value):
            break
    objective.likelihood.choose_substeps(objective.natural(chosen))
    return chosen


def _value_with_substeps(objective: Objective, theta: FloatArray) -> float:
    values = objective.natural(theta)
    objective.likelihood.choose_substeps(values)
    return objective.likelihood.value(values)


def _minimised(objective: Objective, theta: FloatArray, bounds: FloatArray, unit: FloatArray, radius: float) -> Optimum:
    """Fisher scoring; where that oscillates, as it does for models that do not fit, Newton's method ends it."""
    found = minimise(objective, theta, bounds[:, 0], bounds[:, 1], scale=unit, radius=radius, most=80)
    for _ in range(4):
        if found.converged or not math.isfinite(found.value):
            break
        curvature = observed_information(objective, found.theta)
        if not np.isfinite(curvature).all():
            break
        count = found.evaluations
        found = minimise(
            objective, found.theta, bounds[:, 0], bounds[:, 1], scale=unit, radius=0.5, most=30, curvature=curvature
        )
        found = replace(found, evaluations=found.evaluations + count + 2 * len(theta))
    return found


def _past_blind_noise(
    objective: Objective, start: FloatArray, found: Optimum, bounds: FloatArray, unit: FloatArray
) -> Optimum | None:
    """Search again where a noise ended so small that the likelihood no longer sees it.

    Its gradient has vanished there, so that the search cannot come back by itself: a local optimum in which one noise
    explains what another should. Raise what is blind to where the search began and lower the others.
    """
    noise = np.array([q.kind == "noise" for q in objective.rows], dtype=np.bool_)
    blind = np.diag(found.information) * unit**2 < 0.05
    if not (noise & blind).any() or not (noise & ~blind).any():
        return None
    on_bound = (found.theta <= bounds[:, 0]) | (found.theta >= bounds[:, 1])
    typical = np.array([to_scale(q, q.typical) for q in objective.rows])
    lost = (~noise & (blind | on_bound)).any()
    theta = np.where(noise, np.where(blind, typical, found.theta - 3.0 * unit), typical if lost else found.theta)
    theta = np.clip(theta, bounds[:, 0], bounds[:, 1])
    other = _minimised(objective, theta, bounds, unit, 1.0)
    return replace(other, evaluations=other.evaluations + found.evaluations)


def observed_information(objective: Objective, theta: FloatArray) -> FloatArray:
    """Second derivatives of the objective from central differences of exact gradients, not finite at its edge."""
    H = _differences(objective.gradient, theta)
    return np.asarray(0.5 * (H + H.T))


def score_scatter(objective: Objective, theta: FloatArray) -> FloatArray:
    """Sum of the outer products of the scores of single measurements, from central differences of their losses."""
    scores = _differences(lambda at: objective.likelihood.losses(objective.natural(at)), theta)
    return np.asarray(scores @ scores.T)


def _differences(f: Callable[[FloatArray], FloatArray], theta: FloatArray) -> FloatArray:
    """Central differences of a function with m values, (k, m); (0, 0) where no parameter is free."""
    rows = []
    for step in np.diag(1e-4 * np.maximum(1.0, np.abs(theta) * 1e-2)):
        rows.append((f(theta + step) - f(theta - step)) / (2 * step.sum()))
    return np.array(rows) if rows else np.empty((0, 0))


def _result(objective: Objective, best: Optimum, trials: list[Trial], errors: Errors, start: FloatArray) -> FitResult:
    likelihood = objective.likelihood
    values = objective.natural(best.theta)
    bounds = np.array([scale_bounds(q) for q in objective.rows]).reshape(-1, 2)
    width = 1e-6 * np.maximum(1.0, bounds[:, 1] - bounds[:, 0])
    at_bound = (best.theta - bounds[:, 0] < width) | (bounds[:, 1] - best.theta < width)
    penalty = objective.penalty(values)[0]
    robust = math.isfinite(likelihood.huber)
    observed = observed_information(objective, best.theta) if errors != "fisher" or robust else None
    scatter = score_scatter(objective, best.theta) if errors == "sandwich" or robust else None
    return FitResult.build(
        likelihood=likelihood,
        values=values,
        free=objective.free,
        llf=-(best.value - penalty),
        penalty=penalty,
        gradient=best.gradient,
        fisher=best.information,
        observed=observed,
        scatter=scatter,
        at_bound=at_bound,
        trials=trials,
        converged=best.converged,
        reason=best.reason,
        priors={objective.rows[i].symbol: p for i, p in objective.priors},
        wanted=errors,
        start={q.symbol: float(v) for q, v in zip(likelihood.model.parameters, start, strict=True)},
    )
