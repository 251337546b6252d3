"""Fit one chiller: points in, parameters with honest intervals out, every estimator beside the default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fdd.chiller_eiv.estimators import (
    ESTIMATORS,
    Estimator,
    choose_k,
    combine_with_prior,
    fit_orthogonal,
    hold,
    lambda_min,
    map_terms,
    positive_definite,
    solve,
)
from fdd.chiller_eiv.forms import DIVISION_FREE, Form
from fdd.chiller_eiv.intervals import groups_of, half_width, jackknife, sandwich, standard_errors
from fdd.chiller_eiv.model import ChillerError, GordonNg
from fdd.chiller_eiv.moments import Method, Terms, regression_terms, sum_moments
from fdd.records import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Prior:
    """Knowledge of a parameter from outside the data: a Gaussian and bounds, in the parameter's unit.

    ``sd`` infinite means bounds only.
    """

    mean: float = 0.0
    sd: float = np.inf
    lower: float = -np.inf
    upper: float = np.inf

    def __post_init__(self) -> None:
        """Refuse empty bounds and a standard deviation that is not positive."""
        if not self.sd > 0:
            raise ChillerError(f"a prior's standard deviation must be positive; got {self.sd!r}")
        if not self.lower < self.upper:
            raise ChillerError(f"a prior's lower bound {self.lower!r} is not below its upper bound {self.upper!r}")


@dataclass(frozen=True)
class ChillerFit:
    """Parameters of one chiller by one estimator.

    Attributes
    ----------
    form : regression form
    estimator : which of :data:`estimators.ESTIMATORS`, or ``orthogonal``
    parameters : the p' free parameters, in order
    held : parameters held and their values
    estimate : shape (p',), SI units of the form
    covariance : shape (p', p')
    freedom : degrees of freedom of the intervals, one number or one for each parameter
    k : share of the error moments taken off
    lambda_min : (true / assumed error variance), where the model is exact
    positive_definite : False where plain CLS broke down and the estimate means nothing
    residual_sd : standard deviation of the power residual, relative to power [1]
    n, groups : points and jackknife groups
    """

    form: Form
    estimator: str
    parameters: tuple[str, ...]
    held: Mapping[str, float]
    estimate: FloatArray
    covariance: FloatArray
    freedom: float | FloatArray
    k: float
    lambda_min: float
    positive_definite: bool
    residual_sd: float
    n: int
    groups: int
    interval_method: str = "jackknife"

    @property
    def se(self) -> FloatArray:
        """Standard errors, shape (p',)."""
        return standard_errors(self.covariance)

    def interval(self, level: float = 0.95) -> FloatArray:
        """Two-sided intervals, shape (p', 2)."""
        w = half_width(self.se, self.freedom, level)
        return np.stack([self.estimate - w, self.estimate + w], axis=-1)

    def values(self) -> dict[str, float]:
        """Every parameter by name, held ones included."""
        return {**self.held, **{p: float(v) for p, v in zip(self.parameters, self.estimate, strict=True)}}

    def chiller(self) -> GordonNg:
        """The fitted machine."""
        return GordonNg(**{k: self.values()[k] for k in self.form.parameters})

    def predicted_power(self, x: FloatArray) -> FloatArray:
        """Power the fitted machine would take at measurements x (n, m) of the form [W]."""
        return predict_power(self.form, self.chiller(), x)


def predict_power(form: Form, machine: GordonNg, x: FloatArray) -> FloatArray:
    """Power of a machine at measurements x (n, m) in the form's order [W]."""
    names = form.measured
    flow = x[:, names.index("V")] if "V" in names else 1.0
    speed: FloatArray | float = 0.0
    if "w" in names:
        speed = x[:, names.index("w")]
    elif "dS_speed" in form.parameters:
        speed = x[:, 2] * form.coefficients[form.position("dS_speed") + 1, 0]
    return machine.power(x[:, 2], x[:, 0], x[:, 1], flow, speed)


@dataclass(frozen=True)
class FitOptions:
    """How to fit.

    Attributes
    ----------
    form : regression form
    estimator : default ``capped``
    method : where the error moments come from
    held : parameters to hold, in SI units
    priors : Gaussian knowledge or bounds by parameter
    error_scale : factor on every assumed error variance, from self-calibration
    """

    form: Form = DIVISION_FREE
    estimator: Estimator = "capped"
    method: Method = "exact"
    held: Mapping[str, float] = field(default_factory=dict)
    priors: Mapping[str, Prior] = field(default_factory=dict)
    error_scale: float = 1.0


def fit_gordon_ng(
    x: FloatArray, cov: FloatArray, group: IntArray | None = None, options: FitOptions | None = None
) -> ChillerFit:
    """Fit the Gordon-Ng model to steady points with errors in every variable.

    Parameters
    ----------
    x : shape (n, m), measurements in the form's order [K, K, W, W, ...]
    cov : shape (n, m, m) or (m, m), covariance of their random errors
    group : shape (n,), day of each point; without it, 25 runs of consecutive points
    options : how to fit

    Raises
    ------
    ChillerError : not more points than parameters, or values that are not finite

    References
    ----------
    Andersen and Reddy (2000), Eq. 11, with the corrections of ``docs/chiller.md``; W.A. Fuller, *Measurement Error
    Models*, 1987, Sec. 2.5
    """
    o = options or FitOptions()
    if len(x) <= len(o.form.parameters) - len(o.held) + 1:
        raise ChillerError(
            f"{len(x)} steady points are too few for {len(o.form.parameters) - len(o.held)} parameters; "
            "give more data or loosen the steady-state limits"
        )
    terms = _scaled(regression_terms(o.form, x, cov, o.method), o.error_scale)
    free: tuple[str, ...] = o.form.parameters
    if o.held:
        T, free = hold(o.form, o.held)
        terms = map_terms(terms, T)
    g = groups_of(len(x), min(25, len(x))) if group is None else np.unique(group, return_inverse=True)[1]
    return _fit_terms(terms, np.asarray(g, dtype=np.int64), free, o, x, RUNS if group is not None else (1,))


RUNS = (1, 2, 4, 8)
"""Days that are left out together: a model error of days makes neighbouring days one. The widest interval counts."""


def _scaled(terms: Terms, factor: float) -> Terms:
    return terms if factor == 1.0 else Terms(terms.z, terms.C * factor)


def _fit_terms(
    terms: Terms, group: IntArray, free: tuple[str, ...], o: FitOptions, x: FloatArray, runs: tuple[int, ...]
) -> ChillerFit:
    grouped = sum_moments(terms, group)
    total = grouped.total()
    k = float(choose_k(total, o.estimator))
    beta = solve(total, k)
    used = int((grouped.n > 0).sum())
    if o.estimator in ("ols", "cls") and used == len(x):
        cov, freedom, how = sandwich(terms, beta, k), np.full(len(free), float(len(x) - len(free))), "sandwich"
    elif used >= 2:
        cov, freedom, how = *_widest(terms, group, o.estimator, runs), "jackknife"
    else:
        cov, freedom, how = np.full((len(free), len(free)), np.nan), np.ones(len(free)), "none: one day only"
    if any(p in free for p in o.priors):
        beta, cov = _with_priors(beta, cov, free, o.priors)
    return ChillerFit(
        form=o.form,
        estimator=o.estimator,
        parameters=free,
        held=dict(o.held),
        estimate=beta,
        covariance=cov,
        freedom=freedom,
        k=k,
        lambda_min=float(lambda_min(total)),
        positive_definite=bool(positive_definite(total, k)),
        residual_sd=_residual_sd(o.form, {**o.held, **dict(zip(free, beta, strict=True))}, x),
        n=len(x),
        groups=used,
        interval_method=how,
    )


def _widest(
    terms: Terms, group: IntArray, estimator: Estimator, runs: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Jackknife covariance (p, p) and degrees of freedom (p,): for each parameter of the widest interval's run."""
    found = []
    for run in runs:
        groups = np.unique(group // run, return_inverse=True)[1].astype(np.int64)
        count = int(groups.max()) + 1
        if run > 1 and count < LEAST_RUNS:
            break
        cov = jackknife(sum_moments(terms, groups), estimator)
        found.append((cov, float(count - 1), half_width(standard_errors(cov), float(count - 1))))
    best = np.argmax(np.array([f[2] for f in found]), axis=0)
    se = np.array([standard_errors(found[b][0])[i] for i, b in enumerate(best)])
    first = standard_errors(found[0][0])
    factor = se / np.where(first > 0, first, 1.0)
    return found[0][0] * np.outer(factor, factor), np.array([found[b][1] for b in best])


LEAST_RUNS = 4
"""Runs of days without which their spread says nothing."""


def _with_priors(
    beta: FloatArray, cov: FloatArray, free: tuple[str, ...], priors: Mapping[str, Prior]
) -> tuple[FloatArray, FloatArray]:
    table = [priors.get(p, Prior()) for p in free]
    return combine_with_prior(
        beta,
        cov,
        mean=np.array([p.mean for p in table]),
        precision=np.diag([0.0 if np.isinf(p.sd) else p.sd**-2 for p in table]),
        lower=np.array([p.lower for p in table]),
        upper=np.array([p.upper for p in table]),
    )


def _residual_sd(form: Form, values: Mapping[str, float], x: FloatArray) -> float:
    """Spread of measured over predicted power; NaN where the parameters cannot be a machine."""
    try:
        predicted = predict_power(form, GordonNg(**dict(values)), x)
    except ChillerError:
        return float("nan")
    electric = x[:, form.measured.index("E")]
    return float(np.std(electric / predicted - 1)) if np.all(predicted > 0) else float("nan")


def fit_by_every_estimator(
    x: FloatArray, cov: FloatArray, group: IntArray | None = None, options: FitOptions | None = None
) -> dict[str, ChillerFit]:
    """Every estimator's fit side by side, orthogonal distance regression last; the default is ``capped``."""
    o = options or FitOptions()
    fits: dict[str, ChillerFit] = {e: fit_gordon_ng(x, cov, group, replace(o, estimator=e)) for e in ESTIMATORS}
    methods: tuple[Method, ...] = ("propagation", "calculus", "simulation")
    for method in methods:
        name = f"cls, {method}"
        fits[name] = fit_gordon_ng(x, cov, group, replace(o, estimator="cls", method=method))
    orthogonal = _fit_orthogonal(x, cov, o, fits["capped"])
    return fits if orthogonal is None else {**fits, "orthogonal": orthogonal}


def _fit_orthogonal(x: FloatArray, cov: FloatArray, o: FitOptions, start: ChillerFit) -> ChillerFit | None:
    terms = _scaled(regression_terms(o.form, x, cov, "propagation"), o.error_scale)
    if o.held:
        terms = map_terms(terms, hold(o.form, o.held)[0])
    if not np.all(terms.C[:, 0, 0] > 0):
        return None
    beta, minimum = fit_orthogonal(terms, start.estimate)
    freedom = float(len(x) - len(beta))
    k = minimum / freedom
    return replace(
        start,
        estimator="orthogonal",
        estimate=beta,
        covariance=sandwich(terms, beta, k),
        freedom=freedom,
        k=k,
        residual_sd=_residual_sd(o.form, {**o.held, **dict(zip(start.parameters, beta, strict=True))}, x),
        interval_method="sandwich",
    )
