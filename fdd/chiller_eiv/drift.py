"""Weekly parameter charts: internal loss and heat-exchanger resistance against their baseline, and which of them moved.

dS and Q_leak cannot be told apart in a week (their estimates correlate by -0.98). With Q_leak held at its baseline,
dS and R are seen weekly to a few per cent; what dS then shows is called *internal loss* (entropy or leak).

The chart is a two-sided CUSUM of z = (estimate - baseline) / sd, where sd is widened to the spread that z really had on
the baseline: a model that is 1 % wrong and autocorrelated would otherwise ring. Its limit follows from the wanted false
alarms a year and from how long the baseline was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from fdd.chiller_eiv.calibration import judge
from fdd.chiller_eiv.estimators import Estimator, choose_k, hold, lambda_min, map_terms, solve
from fdd.chiller_eiv.forms import DIVISION_FREE, Form
from fdd.chiller_eiv.intervals import jackknife, sandwich, standard_errors
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.moments import Moments, Terms, regression_terms, sum_moments
from fdd.records import FloatArray, IntArray, JsonObject
from fdd.residual_monitors.budget import spread
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum

WEEK = 7 * 86_400 * 10**9
"""[ns]"""

CLEAR_SIGNAL = 4.0
"""Least root of |M_xx - lambda S_xx| at which a week's regressors stand clear of their errors."""

CLASSES = {"dS": "internal loss (entropy or leak)", "R": "heat-exchanger resistance"}
"""What a parameter's drift is called."""


@dataclass(frozen=True, slots=True)
class DriftOptions:
    """How parameters are charted.

    Attributes
    ----------
    false_alarms : a year, for this chiller's parameter charts together [1/a]
    reference_value : k of the CUSUM [standard deviations]
    least_points : steady points a week needs to be charted
    least_weeks : weeks a baseline needs
    estimator : of the weekly estimates; ``ols`` is there for comparison only
    rescale : widen sd to the spread z had on the baseline
    """

    false_alarms: float = 0.15
    reference_value: float = 0.5
    least_points: int = 20
    least_weeks: int = 8
    estimator: Estimator = "capped"
    rescale: bool = True


@dataclass(frozen=True)
class DriftBaseline:
    """What weekly estimates are compared with; plain data.

    Attributes
    ----------
    parameters : the charted parameters, in order
    held : parameters held and their values
    estimate : shape (p,), baseline values
    covariance : shape (p, p), of the baseline values
    spread : shape (p,), factor on a week's standard error
    error_scale : factor on declared error variances, from self-calibration
    weeks : weeks the baseline was made of
    points : steady points in it
    note : what self-calibration said
    """

    parameters: tuple[str, ...]
    held: Mapping[str, float]
    estimate: FloatArray
    covariance: FloatArray
    spread: FloatArray
    error_scale: float
    weeks: int
    points: int
    note: str = ""

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {**asdict(self), "held": dict(self.held), "parameters": list(self.parameters)}

    @classmethod
    def of_state(cls, state: JsonObject) -> DriftBaseline:
        """From what ``export_state`` gave."""
        arrays = {k: np.asarray(state[k], dtype=float) for k in ("estimate", "covariance", "spread")}
        return cls(**{**state, **arrays, "parameters": tuple(state["parameters"])})


@dataclass(frozen=True, slots=True)
class WeekEstimate:
    """One week's parameters.

    Attributes
    ----------
    estimate, se : shape (p,); NaN with too few points
    points : steady points in the week
    """

    estimate: FloatArray
    se: FloatArray
    points: int


def chart_terms(form: Form, x: FloatArray, cov: FloatArray, held: Mapping[str, float], scale: float = 1.0) -> Terms:
    """Regression terms with the held parameters moved to the left-hand side and the errors rescaled."""
    terms = regression_terms(form, x, cov)
    if held:
        terms = map_terms(terms, hold(form, held)[0])
    return Terms(terms.z, terms.C * scale)


def estimate_week(terms: Terms, options: DriftOptions) -> WeekEstimate:
    """A week's estimate with its sandwich standard error.

    The error scale is known from the baseline, so that a week takes off all of S (k = 1) as long as its own scatter
    leaves M_xx - S_xx clearly positive definite; the cap, which guesses the scale anew and costs a bias of the order of
    1/n, is for weeks whose load hardly moves.
    """
    p = terms.z.shape[1] - 1
    if len(terms) < max(options.least_points, p + 2):
        return WeekEstimate(np.full(p, np.nan), np.full(p, np.nan), len(terms))
    moments = sum_moments(terms)
    k = _week_share(moments, options.estimator)
    beta = solve(moments, k)
    return WeekEstimate(beta, standard_errors(sandwich(terms, beta, k)), len(terms))


def _week_share(moments: Moments, estimator: Estimator) -> float:
    if estimator != "capped":
        return float(choose_k(moments, estimator))
    inner = Moments(moments.M[1:, 1:], moments.S[1:, 1:], moments.n)
    return 1.0 if lambda_min(inner) > CLEAR_SIGNAL else float(choose_k(moments, "capped"))


def fit_baseline(
    x: FloatArray,
    cov: FloatArray,
    week: IntArray,
    held: Mapping[str, float],
    *,
    form: Form = DIVISION_FREE,
    options: DriftOptions | None = None,
) -> DriftBaseline:
    """Baseline of the weekly charts from a healthy period.

    Parameters
    ----------
    x, cov : measurements (n, m) and error covariance (n, m, m)
    week : shape (n,), week of each point, any integers
    held : parameters to hold, usually ``{"Q_leak": its baseline value}``

    Raises
    ------
    ChillerError : fewer weeks with enough points than ``options.least_weeks``
    """
    o = options or DriftOptions()
    calibration = judge(sum_moments(chart_terms(form, x, cov, held)))
    terms = chart_terms(form, x, cov, held, calibration.scale)
    index = np.unique(week, return_inverse=True)[1]
    weeks = [estimate_week(Terms(terms.z[index == w], terms.C[index == w]), o) for w in range(index.max() + 1)]
    good = [w for w in weeks if np.isfinite(w.estimate).all()]
    if len(good) < o.least_weeks:
        raise ChillerError(
            f"the baseline has {len(good)} weeks with at least {o.least_points} steady points; "
            f"{o.least_weeks} are needed: give a longer healthy period"
        )
    grouped = sum_moments(terms, index.astype(np.int64))
    total = grouped.total()
    k = choose_k(total, o.estimator)
    beta = solve(total, k)
    z = np.array([(w.estimate - beta) / w.se for w in good])
    # Only ever wider: a spread below one is luck of a short baseline, not a better instrument.
    wide = np.maximum(1.0, np.sqrt((z**2).sum(0) / (len(good) - 1))) if o.rescale else np.ones(len(beta))
    return DriftBaseline(
        parameters=tuple(p for p in form.parameters if p not in held),
        held=dict(held),
        estimate=beta,
        covariance=jackknife(grouped, o.estimator),
        spread=wide,
        error_scale=calibration.scale,
        weeks=len(good),
        points=len(x),
        note=calibration.note,
    )


@dataclass(frozen=True)
class Isolation:
    """Which single parameter's change explains the weeks since the onset best.

    Attributes
    ----------
    parameter, name : the parameter and what its drift is called
    probability : of this explanation among the single ones
    change : its relative change if it alone moved [1]
    low, high : 95 % interval of that
    separate : joint change of every parameter [1], by name
    weeks : weeks the estimate is made of
    """

    parameter: str
    name: str
    probability: float
    change: float
    low: float
    high: float
    separate: Mapping[str, float]
    weeks: int


@dataclass(frozen=True)
class DriftVerdict:
    """What the charts say after a week.

    Attributes
    ----------
    time : end of the week [ns]
    parameters : the charted parameters, in the order of every array here
    week : its estimate
    z : shape (p,), standardised change; NaN where the week had too few points
    phase : shape (p,), :class:`fdd.residual_monitors.chart.Phase`
    statistic, limit : shape (p,), of the CUSUM
    onset : estimated begin of the change [ns], None where no chart is in alarm
    isolation : which parameter moved, None where no chart is in alarm
    """

    time: int
    parameters: tuple[str, ...]
    week: WeekEstimate
    z: FloatArray
    phase: IntArray
    statistic: FloatArray
    limit: FloatArray
    onset: int | None
    isolation: Isolation | None

    @property
    def alarm(self) -> bool:
        """Whether any parameter's chart is in alarm."""
        return bool(np.any(self.phase == Phase.ALARM))


def limit_of(options: DriftOptions, charts: int, weeks: int) -> float:
    """CUSUM limit for the wanted false alarms a year, widened for the baseline's own error."""
    updates = spread(options.false_alarms, np.ones(charts), WEEK / 1e9)[0]
    k = options.reference_value
    return float(Cusum.design(updates, k=k, shift_sd=1 / np.sqrt(weeks)).limit[0])


@dataclass
class DriftMonitor:
    """Weekly charts of one chiller: feed it each week's points, read the verdict.

    A standing alarm stands until :meth:`reset`; weeks with too few points leave the charts as they are. ``keep_weeks``
    is how many of the newest weeks the isolation looks at.
    """

    baseline: DriftBaseline
    form: Form = DIVISION_FREE
    options: DriftOptions = field(default_factory=DriftOptions)
    keep_weeks: int = 4

    def __post_init__(self) -> None:
        """Design the charts."""
        p = len(self.baseline.parameters)
        h = limit_of(self.options, p, self.baseline.weeks)
        self.chart = Cusum(np.full(p, h), k=self.options.reference_value)
        self._recent: list[tuple[int, Moments]] = []

    def update(self, time: int, x: FloatArray, cov: FloatArray) -> DriftVerdict:
        """Take a week's steady points; ``time`` is the end of the week [ns]."""
        b = self.baseline
        terms = chart_terms(self.form, x, cov, b.held, b.error_scale)
        week = estimate_week(terms, self.options)
        z = (week.estimate - b.estimate) / (week.se * b.spread)
        verdicts = self.chart.update(z)
        self._recent = [*self._recent, (time, sum_moments(terms))][-self.keep_weeks :]
        onset, isolation = None, None
        alarmed = verdicts.phase == Phase.ALARM
        if alarmed.any():
            age = int(verdicts.onset_age[alarmed].max())
            onset = time - max(age, 1) * WEEK
            isolation = self._isolate(onset)
        phase = verdicts.phase.astype(np.int64)
        return DriftVerdict(
            time, b.parameters, week, z, phase, verdicts.statistic.copy(), np.asarray(verdicts.limit), onset, isolation
        )

    def reset(self, baseline: DriftBaseline | None = None) -> None:
        """Clear alarms; with a new baseline after a repair."""
        if baseline is not None:
            self.baseline = baseline
            self.__post_init__()
        self.chart.reset()

    def _isolate(self, onset: int) -> Isolation | None:
        """Compare the single explanations on the newest weeks since the onset.

        Few weeks: a fault that grows, seen over months of changing weather, is no single change any more.
        """
        b = self.baseline
        weeks = [m for t, m in self._recent if t > onset and m.n > 0]
        grouped = Moments(
            np.array([m.M for m in weeks]), np.array([m.S for m in weeks]), np.array([m.n for m in weeks])
        )
        total = grouped.total()
        if int(total.n) <= len(b.parameters) + 2:
            return None
        k = choose_k(total, self.options.estimator)
        change = solve(total, k) - b.estimate
        cov = self._model_covariance(total, b.estimate + change, float(k)) * np.outer(b.spread, b.spread) + b.covariance
        return isolate(b, change, cov, len(weeks))

    def _model_covariance(self, total: Moments, beta: FloatArray, k: float) -> FloatArray:
        """Covariance of a pooled estimate from its equation error: s^2 A^-1 M_xx A^-1."""
        D = total.M - k * total.S
        a = np.concatenate([[1.0], -beta])
        s2 = float(a @ total.M @ a) / max(float(total.n) - len(beta), 1.0)
        inverse = np.linalg.inv(D[1:, 1:])
        return np.asarray(s2 * inverse @ total.M[1:, 1:] @ inverse)

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {
            "schema": 1,
            "baseline": self.baseline.export_state(),
            "chart": self.chart.export_state(),
            "recent": [{"time": t, "M": m.M, "S": m.S, "n": int(m.n)} for t, m in self._recent],
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where ``export_state`` was called."""
        self.baseline = DriftBaseline.of_state(state["baseline"])
        self.__post_init__()
        self.chart.restore_state(state["chart"])
        self._recent = [
            (int(r["time"]), Moments(np.asarray(r["M"], float), np.asarray(r["S"], float), np.asarray(r["n"])))
            for r in state["recent"]
        ]


def isolate(baseline: DriftBaseline, change: FloatArray, covariance: FloatArray, weeks: int) -> Isolation:
    """Compare the explanations "only this parameter changed" by their chi-square.

    Parameters
    ----------
    change, covariance : joint change of the parameters since the onset (p,) and its covariance (p, p)
    """
    d = np.sqrt(np.diagonal(covariance))
    weight = np.linalg.inv(covariance / np.outer(d, d))
    r = change / d
    alone = (weight @ r) / np.diagonal(weight)  # size of each change if it alone is there, in d
    chi2 = np.array([r @ weight @ r - alone[j] ** 2 * weight[j, j] for j in range(len(r))])
    probability = np.exp(-0.5 * (chi2 - chi2.min()))
    probability /= probability.sum()
    best = int(np.argmin(chi2))
    size = np.abs(baseline.estimate[best])
    half = 1.96 * d[best] / np.sqrt(weight[best, best])
    p = baseline.parameters[best]
    value = alone[best] * d[best]
    return Isolation(
        parameter=p,
        name=CLASSES.get(p, p),
        probability=float(probability[best]),
        change=float(value / size),
        low=float((value - half) / size),
        high=float((value + half) / size),
        separate={q: float(c / abs(e)) for q, c, e in zip(baseline.parameters, change, baseline.estimate, strict=True)},
        weeks=weeks,
    )
