"""Whether a fitted model may be trusted: every test of Andersen (2001), section 2.5, in one call, and its skill.

One-step residuals of a model that holds are white and normal, unrelated to every input, no larger than the measurement
uncertainty allows; parameters are plausible; other data are predicted as well as those it was fitted to. Long records
make every departure significant: those of no size (``SMALL``) pass. Some hours ahead a model predicts better than "as
now" and "as yesterday", and its intervals hold what they promise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fdd.greybox.likelihood import Data, FilterPath
from fdd.greybox.results import FitResult

FloatArray = NDArray[np.float64]
SMALL = 0.1  # correlation below which a relation explains less than a hundredth of the residuals
HOURS = (1.0, 6.0, 24.0)
ORIGINS = 200  # rows from which forecasts are judged
INTERVALS = (0.8, 0.95)
COVERAGE = 0.05  # by which a share may miss its probability
INTEGRATES = 1e4  # spans of the record beyond which a time constant is that of an integrator
WORSE = 1.05  # times the error of the better of "as now" and "as yesterday" that counts as no skill
GROUPS = 10
"""Groups of equal size whose means are compared where a curve is looked for in the residuals."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One test: what, of what, its statistic and limit, the p value where there is one, and a sentence."""

    test: str
    about: str
    statistic: float
    limit: float
    p: float
    passed: bool
    remark: str
    effect: float = math.nan
    """Size of what is wrong over the residuals' (or the reference's) standard deviation, where it has one."""


@dataclass(frozen=True)
class Validation:
    """All verdicts, and what the page of plots draws."""

    result: FitResult
    data: Data
    path: FilterPath
    verdicts: tuple[Verdict, ...]
    curves: dict[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every test was passed."""
        return all(v.passed for v in self.verdicts)

    def table(self) -> str:
        """The verdicts as text."""
        head = f"{'test':<22}{'of':<22}{'statistic':>11}{'limit':>11}{'p':>8}  verdict"
        rows = [
            f"{v.test:<22}{v.about:<22}{_cell(v.statistic, '.4g'):>11}{_cell(v.limit, '.4g'):>11}"
            f"{_cell(v.p, '.3f'):>8}  {'pass' if v.passed else 'FAIL'}: {v.remark}"
            for v in self.verdicts
        ]
        return "\n".join([head, *rows])

    def causes(self) -> list[str]:
        """What failed in words, the largest effect first."""
        failed = [v for v in self.verdicts if not v.passed]
        ranked = sorted(failed, key=lambda v: -(v.effect if math.isfinite(v.effect) else 0.0))
        return [f"{v.test} of {v.about}: {v.remark}" for v in ranked]

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the verdicts."""
        names = ("test", "about", "statistic", "limit", "p", "passed", "remark", "effect")
        rows = [{name: getattr(v, name) for name in names} for v in self.verdicts]
        for row in rows:
            row.update({k: None for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)})
        return {"passed": self.passed, "verdicts": rows}


def _cell(value: float, form: str) -> str:
    return "" if math.isnan(value) else format(value, form)


def validate(
    result: FitResult,
    data: Data | None = None,
    *,
    other: Data | None = None,
    uncertainty: Mapping[str, float] | None = None,
    alpha: float = 0.01,
    lags: int | None = None,
    hour: float = 3600.0,
) -> Validation:
    """All tests of a fitted model on one record.

    Parameters
    ----------
    result : the fit
    data : record to test on; by default the (first) one of the fit
    other : a second record for cross-validation, one step ahead and simulated
    uncertainty : known standard uncertainty of measured inputs and outputs by symbol, their units (Eq. 2.29)
    alpha : level of each test
    lags : of the autocorrelation; by default 10 log10 N, at most N / 5
    hour : an hour in the data's unit of time; 1 where that is the hour
    """
    record = data if data is not None else result.records[0]
    path = result.paths(record)[0]
    model = result._model()
    lags = lags or int(min(10 * math.log10(len(record)), len(record) // 5))
    verdicts: list[Verdict] = []
    curves: dict[str, Any] = {}
    for j, symbol in enumerate(model.symbols["outputs"]):
        z = path.standardised[1:, j]  # the start value is made from the first sample
        made = _whiteness(symbol, z, lags, alpha)
        verdicts += made[0]
        curves[symbol] = made[1]
        verdicts += _against_signals(result, record, path, j, alpha)
        verdicts += [_normality(symbol, z, alpha), _scale(symbol, z, alpha)]
        if other is not None:
            verdicts += _cross(result, record, other, j)
    verdicts += _uncertainty(result, record, path, uncertainty)
    verdicts += _ahead(result, record, hour)
    verdicts += plausibility(result, record, hour)
    return Validation(result, record, path, tuple(verdicts), curves)


def autocorrelation(z: FloatArray, lags: int) -> FloatArray:
    """Sample autocorrelation at lags 0..``lags``; missing values are left out of every product (Eq. 2.33)."""
    d = z - np.nanmean(z)
    variance = np.nanmean(d * d)
    return np.array([1.0] + [float(np.nanmean(d[k:] * d[:-k]) / variance) for k in range(1, lags + 1)])


def cumulated_periodogram(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies i / N, i = 1..N/2, and cumulated periodogram.

    Eq. 2.34 without its i = 0, because the mean is no test of whiteness. Missing values count as zero, which is what
    is expected of them.
    """
    d = np.nan_to_num(z - np.nanmean(z))
    power = np.abs(np.fft.rfft(d)[1:]) ** 2
    return np.arange(1, len(power) + 1) / len(z), np.cumsum(power) / power.sum()


def kolmogorov_band(n: int, alpha: float) -> float:
    """Half width of the band of a cumulated periodogram of n values (Bartlett 1955)."""
    return float(stats.kstwobign.isf(alpha) / math.sqrt(max(1, (n - 1) // 2)))


def lag_dependence(z: FloatArray, lags: int, bins: int = 12) -> FloatArray:
    """Lag dependent function at lags 1..``lags`` (Nielsen and Madsen 2001): signed root of the R squared of a smooth.

    The smooth is the mean within ``bins`` groups of equal size of the lagged value; its R squared is corrected for the
    degrees of freedom it uses. It sees dependence that the autocorrelation, being linear, does not.
    """
    out = []
    for k in range(1, lags + 1):
        now, before = z[k:], z[:-k]
        ok = np.isfinite(now) & np.isfinite(before)
        out.append(_smooth_r2(before[ok], now[ok], bins))
    r2 = np.array(out)
    return np.asarray(np.sign(r2) * np.sqrt(np.abs(r2)))


def _smooth_r2(x: FloatArray, y: FloatArray, bins: int) -> float:
    order = np.argsort(x, kind="stable")
    groups = [g for g in np.array_split(y[order], bins) if len(g)]
    residual = sum(float(((g - g.mean()) ** 2).sum()) for g in groups)
    total = float(((y - y.mean()) ** 2).sum())
    n = len(y)
    if total == 0 or n <= bins:
        return 0.0
    return 1.0 - (residual / (n - bins)) / (total / (n - 1))


def _whiteness(symbol: str, z: FloatArray, lags: int, alpha: float) -> tuple[list[Verdict], dict[str, Any]]:
    from statsmodels.stats.diagnostic import acorr_ljungbox

    n = int(np.isfinite(z).sum())
    rho = autocorrelation(z, lags)
    band = float(stats.norm.isf(alpha / 2 / lags)) / math.sqrt(n)
    worst = int(np.abs(rho[1:]).argmax()) + 1
    limit, slight = max(band, SMALL), bool(np.abs(rho[1:]).max() < SMALL)
    box = acorr_ljungbox(np.nan_to_num(z - np.nanmean(z)), lags=[lags])
    q, p = float(box["lb_stat"].iloc[0]), float(box["lb_pvalue"].iloc[0])
    frequency, c = cumulated_periodogram(z)
    distance = float(np.abs(c - frequency / frequency[-1]).max())
    ks = kolmogorov_band(len(z), alpha)
    squares = np.arange(1, min(lags, 20) + 1)
    dependence = lag_dependence(z, len(squares))
    ldf_limit = _ldf_limit(n, len(squares), alpha)
    at = int(dependence.argmax()) + 1
    verdicts = [
        Verdict("autocorrelation", symbol, float(rho[worst]), limit, math.nan, abs(rho[worst]) < limit,
                f"largest at lag {worst}; limit for {lags} lags together, or what is small", abs(float(rho[worst]))),
        Verdict("Ljung-Box", symbol, q, float(stats.chi2.isf(alpha, lags)), p, p > alpha or slight, f"{lags} lags"),
        Verdict("cumulated periodogram", symbol, distance, ks, math.nan, distance < max(ks, SMALL / 2),
                "distance from the diagonal; Kolmogorov-Smirnov band, or what is small", distance),
        Verdict("lag dependence", symbol, float(dependence[at - 1]), ldf_limit, math.nan,
                bool(dependence.max() < ldf_limit),
                f"non-linear dependence, largest at lag {at}"),
    ]  # fmt: skip
    curves = {"acf": rho, "band": float(stats.norm.isf(alpha / 2)) / math.sqrt(n), "frequency": frequency}
    curves |= {"cumulated": c, "ks": ks, "ldf": dependence, "ldf_limit": ldf_limit}
    return verdicts, curves


def _ldf_limit(n: int, lags: int, alpha: float, bins: int = 12) -> float:
    """Limit of the largest of several lag dependent functions of white noise, by the F distribution of group means."""
    f = float(stats.f.isf(alpha / lags, bins - 1, max(n - bins, 1)))
    r2 = 1.0 - (n - 1) / (n - bins) * 1.0 / (1.0 + f * (bins - 1) / (n - bins))
    return math.sqrt(max(r2, 0.0))


def signals(result: FitResult, d: Data, path: FilterPath) -> list[tuple[str, str, FloatArray]]:
    """What residuals are held against, name, unit and values: inputs since the sample before, and predicted outputs."""
    model = result._model()
    inputs = [(q.symbol, q.unit, d.u[:-1, i]) for i, q in enumerate(model.inputs)]
    outputs = [(f"{q.symbol} predicted", q.unit, path.predicted[1:, i]) for i, q in enumerate(model.outputs)]
    return inputs + outputs


def _against_signals(result: FitResult, d: Data, path: FilterPath, j: int, alpha: float) -> list[Verdict]:
    """Residuals against every input and predicted output: correlation, and any curve (F test of group means)."""
    model, out = result._model(), []
    symbol, unit = model.outputs[j].symbol, model.outputs[j].unit
    z = path.standardised[1:, j]
    held_against = signals(result, d, path)
    for name, _, signal in held_against:
        ok = np.isfinite(z) & np.isfinite(signal)
        if np.ptp(signal[ok]) == 0:
            continue
        r = float(np.corrcoef(signal[ok], z[ok])[0, 1])
        p_line = float(2 * stats.norm.sf(abs(r) * math.sqrt(int(ok.sum()))))
        groups = [g for g in np.array_split(z[ok][np.argsort(signal[ok], kind="stable")], GROUPS) if len(g) > 1]
        p_curve = float(stats.f_oneway(*groups).pvalue) if len(groups) > 1 else 1.0
        p = min(1.0, 2 * min(p_line, p_curve))
        limit = alpha / len(held_against)
        remark = (
            "no relation" if p > limit else ("a line" if p_line <= p_curve else "a curve") + " is left in the residuals"
        )
        between = float(np.var([g.mean() for g in groups])) / float(np.var(z[ok])) if len(groups) > 1 else 0.0
        size = max(abs(r), math.sqrt(between))
        sd = float(np.nanstd(d.y[1:, j] - path.predicted[1:, j]))
        remark += f", {size * sd:.2g} {unit} of {sd:.2g}; p of line and curve against {limit:.2g}"
        out.append(
            Verdict("residual against", f"{symbol} / {name}", r, SMALL, p, p > limit or size < SMALL, remark, size)
        )
    return out


def _normality(symbol: str, z: FloatArray, alpha: float) -> Verdict:
    v = z[np.isfinite(z)]
    statistic, p = (float(a) for a in stats.jarque_bera(v))
    skew, tail = float(stats.skew(v)), float(stats.kurtosis(v))
    remark = f"skewness {skew:.2f}, excess kurtosis {tail:.2f}"
    return Verdict("normality", symbol, statistic, float(stats.chi2.isf(alpha, 2)), p, p > alpha, remark)


def _scale(symbol: str, z: FloatArray, alpha: float) -> Verdict:
    v = z[np.isfinite(z)]
    ratio = float(np.mean(v**2))
    limit = 1 + float(stats.norm.isf(alpha / 2)) * math.sqrt(2 / len(v))
    p = float(2 * stats.norm.sf(abs(ratio - 1) / math.sqrt(2 / len(v))))
    return Verdict(
        "variance", symbol, ratio, limit, p, p > alpha, "mean square of the standardised residuals, 1 expected"
    )


def propagated_sd(result: FitResult, d: Data, uncertainty: Mapping[str, float]) -> FloatArray:
    """Standard deviation (n_y,) that known measurement errors alone give the one-step residuals (Eq. 2.29).

    The error propagation formula with every sample of every measured signal as a variable of its own. Its sum of
    squared derivatives is taken by perturbing all of them at once with independent errors: cross terms average out.
    """
    model, random = result._model(), np.random.default_rng(0)
    known = {**dict.fromkeys((*model.symbols["inputs"], *model.symbols["outputs"]), 0.0), **uncertainty}
    sd_u = np.array([known[s] for s in model.symbols["inputs"]])
    sd_y = np.array([known[s] for s in model.symbols["outputs"]])
    plain = result.paths(d)[0]
    moved = replace(d, u=d.u + sd_u * random.normal(size=d.u.shape), y=d.y + sd_y * random.normal(size=d.y.shape))
    change = (moved.y - result.paths(moved)[0].predicted) - (d.y - plain.predicted)
    return np.asarray(np.sqrt(np.nanmean(change[1:] ** 2, axis=0)))


def _uncertainty(result: FitResult, d: Data, path: FilterPath, known: Mapping[str, float] | None) -> list[Verdict]:
    """Residual sd against what measurement errors explain: more is left to the model's own errors."""
    if not known:
        return []
    out = []
    for j, (symbol, limit) in enumerate(
        zip(result._model().symbols["outputs"], propagated_sd(result, d, known), strict=True)
    ):
        sd = float(np.nanstd(d.y[1:, j] - path.predicted[1:, j]))
        remark = f"residual sd against the {limit:.3g} that measurement errors explain, 10 % allowed"
        out.append(Verdict("Eq. 2.29", symbol, sd, 1.1 * limit, math.nan, sd <= 1.1 * limit, remark))
    return out


def _cross(result: FitResult, own: Data, other: Data, j: int) -> list[Verdict]:
    """Other data, one step ahead and simulated without its outputs: root mean square against that of the own data."""
    symbol, out = result._model().symbols["outputs"][j], []
    for kind in ("one step", "simulation"):
        rms = []
        for d in (own, other):
            guess = result.paths(d)[0].predicted if kind == "one step" else result.simulate(d)
            rms.append(math.sqrt(float(np.nanmean((d.y[1:, j] - guess[1:, j]) ** 2))))
        limit = 1.5 * rms[0]
        out.append(
            Verdict("cross-validation", f"{symbol} {kind}", rms[1], limit, math.nan, rms[1] <= limit,
                    f"rms on other data; {rms[0]:.3g} on its own, limit 1.5 times that")
        )  # fmt: skip
    return out


def _horizons(d: Data, hour: float) -> dict[str, int]:
    """Samples ahead by name: the next one, and the hours that the record holds several of."""
    step = float(np.median(d.dt))
    found = {"1 sample": 1}
    for hours in HOURS:
        k = round(hours * hour / step)
        if 1 < k < len(d) // 3:
            found[f"{hours:g} h"] = k
    return found


def _ahead(result: FitResult, d: Data, hour: float) -> list[Verdict]:
    """Skill and coverage of forecasts at several horizons."""
    out = []
    day = round(24 * hour / float(np.median(d.dt)))
    for name, k in _horizons(d, hour).items():
        first = min(day, len(d) - k - 2) if day + k < len(d) else len(d) // 10
        rows = np.unique(np.linspace(first, len(d) - k - 1, ORIGINS).astype(np.int64))
        ahead = result.forecast(rows.tolist(), k, d)
        for j, q in enumerate(result._model().outputs):
            out += _skill(d.y[:, j], rows, k, ahead.y[:, -1, j], day, f"{q.symbol} {name}", q.unit)
            z = (d.y[rows + k, j] - ahead.y[:, -1, j]) / np.sqrt(ahead.variance[:, -1, j])
            out += _coverage(z[np.isfinite(z)], len(d) // k, f"{q.symbol} {name}")
    return out


def _skill(
    y: FloatArray, rows: NDArray[np.int64], k: int, forecast: FloatArray, day: int, about: str, unit: str
) -> list[Verdict]:
    """Error of forecasts over that of the better of "as now" and "as yesterday"."""

    def rms(error: FloatArray) -> float:
        return math.sqrt(float(np.nanmean(error**2))) if np.isfinite(error).any() else math.nan

    truth, guesses = y[rows + k], {"as now": rms(y[rows + k] - y[rows])}
    if day >= k and (rows + k >= day).all() and 1 < day < len(y):
        guesses["as yesterday"] = rms(truth - y[rows + k - day])
    own, (best, reference) = rms(truth - forecast), min(guesses.items(), key=lambda g: g[1])
    if not (math.isfinite(own) and reference > 0):
        return []
    told = ", ".join(f"{name} {error:.3g}" for name, error in guesses.items())
    better = own <= WORSE * reference
    remark = f"rms {own:.3g} {unit}; {told}" + ("" if better else f": worse than {best!r}, the model has no skill here")
    return [Verdict("skill", about, own / reference, WORSE, math.nan, better, remark, own / reference - 1.0)]


def _coverage(z: FloatArray, independent: int, about: str) -> list[Verdict]:
    """Shares of forecasts within their intervals, against the probabilities that these have."""
    out = []
    for probability in INTERVALS if len(z) > 1 else ():
        share = float(np.mean(np.abs(z) < stats.norm.isf((1 - probability) / 2)))
        error = math.sqrt(probability * (1 - probability) / max(1, min(len(z), independent)))
        allowed = max(COVERAGE, 3 * error)
        remark = f"share of {len(z)} forecasts within their {probability:.0%} interval, {allowed:.2f} allowed"
        passed = abs(share - probability) <= allowed
        miss = abs(share - probability)
        name = f"{about} {probability:.0%}"
        out.append(Verdict("coverage", name, share, probability, math.nan, passed, remark, miss))
    return out


def plausibility(result: FitResult, d: Data, hour: float = 3600.0) -> list[Verdict]:
    """Bounds, significance and time constants: estimates that physics or the sampling cannot mean."""
    model, out = result._model(), []
    for name in result.at_bound:
        out.append(Verdict("plausible", name, result.params[name], math.nan, math.nan, False, "ended at its bound"))
    for name in result.unidentifiable:
        ways = "; ".join(f.words for f in result.flat if name in f.powers) or "the data say nothing about it"
        out.append(Verdict("identifiable", name, math.nan, math.nan, math.nan, False, ways))
    taus = time_constants(result, d)
    step, span = float(np.median(d.dt)), float(d.t[-1] - d.t[0])
    unit = {3600.0: "s", 60.0: "min", 1.0: "h"}.get(hour, "of the data's time")
    for i, tau in enumerate(taus):
        ok = step / 10 <= tau <= 5 * span
        remark = f"{unit}; sampled every {step:g}, over {span:g}"
        if abs(tau) > INTEGRATES * span:
            ok, remark = (
                True,
                "integrates: this state keeps what inputs and noise have added up",
            )
        elif tau < 0:
            remark = "unstable: it moves away from where it is; " + remark
        out.append(Verdict("time constant", f"{model.name} {i + 1}", tau, 5 * span, math.nan, ok, remark))
    return out


def time_constants(result: FitResult, d: Data) -> list[float]:
    """-1 / real part of the Jacobian's eigenvalues at mean state and input, slowest last [the data's unit of time]."""
    from types import SimpleNamespace as Space

    model = result._model()
    x = np.nanmean(result.paths(d)[0].xf, axis=0)
    u, p = Space(**dict(zip(model.symbols["inputs"], d.u.mean(axis=0), strict=True))), Space(**result.params)
    names = model.symbols["states"]

    def f(x: FloatArray) -> FloatArray:
        slopes = model.drift(Space(**dict(zip(names, x, strict=True))), u, p)
        return np.array([float(slopes[s]) for s in names])

    h = 1e-5 * np.maximum(1.0, np.abs(x))
    A = np.column_stack([(f(x + h[i] * e) - f(x - h[i] * e)) / (2 * h[i]) for i, e in enumerate(np.eye(len(x)))])
    real = np.linalg.eigvals(A).real
    return sorted((float(-1 / r) if r != 0 else math.inf) for r in real)
