"""The power residual: what a machine draws beyond what it drew at the same load and temperatures when it was healthy.

This is what can always be watched, also where the parameters cannot be identified: prediction does not need them one by
one. The model is fitted robustly, because real machines run hours in another mode (hot-gas bypass, surge control) that
must not become the baseline. The chart works on daily medians for the same reason, with each value's weight limited.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fdd.chiller_eiv.fit import predict_power
from fdd.chiller_eiv.forms import DIVISION_FREE, Form
from fdd.chiller_eiv.model import ChillerError, GordonNg
from fdd.records import FloatArray, IntArray, JsonObject
from fdd.residual_monitors.budget import spread
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum

DAY = 86_400 * 10**9
"""[ns]"""

LARGEST_Z = 3.0
"""A day counts at most this many standard deviations, so that one odd day alone does not raise an alarm."""


@dataclass(frozen=True)
class PowerModel:
    """Expected power of a healthy machine.

    Attributes
    ----------
    form : regression form
    machine : its parameters; good for prediction, not to be read one by one
    spread : robust standard deviation of the relative residual of one point [1]
    points : points it was fitted on
    """

    form: Form
    machine: GordonNg
    spread: float
    points: int

    def residual(self, x: FloatArray) -> FloatArray:
        """Relative power residual E / predicted - 1 at measurements x (n, m) of the form, shape (n,)."""
        return np.asarray(x[:, self.form.measured.index("E")] / self.predict(x) - 1)

    def predict(self, x: FloatArray) -> FloatArray:
        """Expected power [W], shape (n,)."""
        return predict_power(self.form, self.machine, x)


def fit_power_model(x: FloatArray, form: Form = DIVISION_FREE, *, cutoff: float = 2.0, rounds: int = 60) -> PowerModel:
    """Fit expected power by least squares on the relative power error, weights falling off beyond ``cutoff`` sigmas.

    Parameters
    ----------
    x : shape (n, m), measurements in the form's order
    cutoff : of the Cauchy-like weights 1 / max(1, |r| / cutoff sigma)^2
    rounds : of reweighting

    Raises
    ------
    ChillerError : not more points than parameters, or a machine that cannot be
    """
    if len(x) < 2 * len(form.parameters):
        raise ChillerError(f"{len(x)} points are too few to predict power with {len(form.parameters)} parameters")
    z = form.evaluate(x)[0] / (x[:, 1] * x[:, 3])[:, None]  # the equation error in shares of power
    scale = np.sqrt((z**2).mean(0))
    weight = np.ones(len(x))
    beta = np.zeros(z.shape[1] - 1)
    sigma = np.inf
    for _ in range(rounds):
        A = z[:, 1:] / scale[1:]
        beta = np.linalg.lstsq(A * weight[:, None], z[:, 0] * weight, rcond=None)[0]
        r = z[:, 0] - A @ beta
        sigma = max(1.4826 * float(np.median(np.abs(r))), 1e-9)
        weight = 1.0 / np.maximum(1.0, np.abs(r) / (cutoff * sigma))
    values = dict(zip(form.parameters, beta / scale[1:], strict=True))
    model = PowerModel(form, GordonNg(**values), sigma, len(x))
    r = model.residual(x)
    return PowerModel(form, model.machine, 1.4826 * float(np.median(np.abs(r - np.median(r)))), len(x))


def choose_power_model(x_by_form: list[tuple[Form, FloatArray]], day: IntArray) -> PowerModel:
    """The form whose left-out days are predicted best (median absolute residual), fitted on all points.

    Parameters
    ----------
    x_by_form : candidate forms with their measurements of the same points
    day : shape (n,), day of each point
    """
    folds = np.unique(day, return_inverse=True)[1] % 5
    best: tuple[float, PowerModel] | None = None
    for form, x in x_by_form:
        try:
            errors = [np.abs(fit_power_model(x[folds != f], form).residual(x[folds == f])) for f in np.unique(folds)]
            candidate = (float(np.median(np.concatenate(errors))), fit_power_model(x, form))
        except ChillerError:
            continue
        if best is None or candidate[0] < best[0]:
            best = candidate
    if best is None:
        raise ChillerError("no form predicts this machine's power; give more steady points")
    return best[1]


@dataclass(frozen=True)
class Reference:
    """How daily values of a series scatter while the machine is healthy.

    Attributes
    ----------
    mean, sd : of the daily medians, robust; sd widened for their autocorrelation from day to day
    days : days it was learned from
    """

    mean: float
    sd: float
    days: int


def daily_medians(time: IntArray, value: FloatArray, least: int = 2) -> tuple[IntArray, FloatArray]:
    """Median of each day with at least ``least`` finite values: end of the day [ns] and value, shape (d,)."""
    keep = np.isfinite(value)
    day = time[keep] // DAY
    found, start, count = np.unique(day, return_index=True, return_counts=True)
    split = np.split(value[keep], start[1:])
    good = count >= least
    medians = np.array([np.median(v) for v, g in zip(split, good, strict=True) if g])
    return (found[good] + 1) * DAY, medians


def learn_reference(medians: FloatArray, floor: float = 0.0, least_days: int = 7) -> Reference:
    """Reference from a healthy period's daily medians.

    Parameters
    ----------
    medians : shape (d,), in order
    floor : least standard deviation believed, in the series' unit
    least_days : fewer are refused
    """
    if len(medians) < least_days:
        raise ChillerError(f"{len(medians)} days with points are too few for a reference; {least_days} are needed")
    centre = float(np.median(medians))
    e = np.clip(
        medians - centre, *np.array([-3.0, 3.0]) * max(1.4826 * float(np.median(np.abs(medians - centre))), floor)
    )
    square = float(e @ e)
    rho = float(np.clip(e[1:] @ e[:-1] / square, 0.0, 0.6)) if square > 0 else 0.0
    sd = np.sqrt(square / (len(e) - 1)) * np.sqrt((1 + rho) / (1 - rho))
    return Reference(centre, float(max(sd, floor)), len(medians))


@dataclass(frozen=True)
class DailyVerdict:
    """What a daily chart says.

    Attributes
    ----------
    time : end of the day [ns]
    value : the day's median
    z : standardised
    phase : :class:`fdd.residual_monitors.chart.Phase`
    statistic, limit : of the CUSUM
    onset : begin of the change [ns], None where not in alarm
    """

    time: int
    value: float
    z: float
    phase: int
    statistic: float
    limit: float
    onset: int | None

    @property
    def alarm(self) -> bool:
        """Whether the chart is in alarm."""
        return self.phase == Phase.ALARM


@dataclass
class DailyMonitor:
    """Two-sided CUSUM of one daily series against its reference; updated on days with points only.

    Attributes
    ----------
    reference : from :func:`learn_reference`
    false_alarms : wanted, a year [1/a]
    availability : share of days with points (0, 1]; fewer updates a year allow a lower limit
    """

    reference: Reference
    false_alarms: float = 0.25
    availability: float = 1.0
    times: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Design the chart, widened for the reference's own error."""
        updates = float(spread(self.false_alarms, [1.0], DAY / 1e9, self.availability)[0])
        limit = min(float(Cusum.design(updates).limit[0]) * (1 + 2.0 / self.reference.days), 40.0)
        self.chart = Cusum(np.array([limit]))

    def update(self, time: int, value: float) -> DailyVerdict:
        """Take one day's median; NaN is a day without points and leaves the chart as it is."""
        z = (value - self.reference.mean) / self.reference.sd
        z = float(np.clip(z, -LARGEST_Z, LARGEST_Z)) if np.isfinite(z) else np.nan
        v = self.chart.update(np.array([z]))
        if np.isfinite(z):
            self.times = [*self.times, time][-60:]
        age = int(v.onset_age[0])
        onset = None
        if v.phase[0] == Phase.ALARM and self.times:
            onset = self.times[-min(max(age, 1), len(self.times))] - DAY
        return DailyVerdict(time, value, z, int(v.phase[0]), float(v.statistic[0]), float(v.limit[0]), onset)

    def reset(self) -> None:
        """Clear the alarm."""
        self.chart.reset()

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {"schema": 1, "chart": self.chart.export_state(), "times": list(self.times)}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where ``export_state`` was called."""
        self.chart.restore_state(state["chart"])
        self.times = [int(t) for t in state["times"]]
