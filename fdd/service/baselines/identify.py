"""Baselines by maximum likelihood: from a history to the parameters a component's filter runs on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data
from fdd.greybox.record_faults import DataError
from fdd.greybox.results import FitResult
from fdd.records import NANOSECONDS, Baseline, FloatArray, JsonObject
from fdd.residual_monitors.effective_charts import effective_share
from fdd.residual_monitors.information import inverse
from fdd.residual_monitors.score import CHANCE
from fdd.residual_monitors.whiten import Whitener
from fdd.service.baselines.history import History, Run, runs
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.flatline_charts import flatline_statistics
from fdd.service.monitoring.health_charts import window_of, window_statistics
from fdd.service.monitoring.power import sensitivities
from fdd.service.monitoring.score_charts import SCORE_BLOCK
from fdd.service.site.plan import Component, Plan


class IdentifyError(ValueError):
    """A history from which a component cannot be identified; the text says why and what to do."""


# Fewer samples than this for each parameter leave more to chance than to the plant.
SAMPLES_PER_PARAMETER = 10
# Second order is enough for what a nearly right model leaves: a relaxation and an overshoot.
COLOUR_ORDER = 2
# Frames in a window over which the spread is taken to be steady: an hour at five minutes.
WINDOW = 12
# Windows above this quantile are the bad hours.
QUANTILE = 0.95
# Interquartile range of a standard normal, and the standard error of one from n values times sqrt(n), relative.
IQR, QUARTILES_ERROR = 1.349, 1.166
# A spread from fewer blocks would say more of chance than of the model.
FEWEST_BLOCKS = 8


def identify(
    plan: Plan,
    component: Component,
    history: History,
    *,
    version: int = 1,
    start: Mapping[str, float] | None = None,
    starts: int = 1,
) -> tuple[Baseline, FitResult]:
    """Fit one component to a healthy history; ``starts`` searches, the first from ``start``, the best one counts.

    Raises
    ------
    IdentifyError
        There is too little usable data.
    """
    found = runs(plan, component, history)
    n, needed = sum(len(r.time) for r in found), SAMPLES_PER_PARAMETER * len(component.model.parameters)
    if n < needed:
        raise IdentifyError(
            f"{component.name}: {n} usable frames in {len(history)}, at least {needed} are needed for "
            f"{len(component.model.parameters)} parameters; give a longer span, or check that "
            f"{', '.join((*component.inputs, *component.outputs))} have data there"
            + (f" and that the gate {component.when!r} is open" if component.when else "")
        )
    records = [data_of(r) for r in found]
    try:
        result = fit(component.model, records, start=start, starts=starts, priors=component.priors)
    except DataError as error:
        raise IdentifyError(f"{component.name}: {error}") from None
    baseline = Baseline(
        component=component.name,
        version=version,
        model=component.model.name,
        model_version=component.model.version,
        options=dict(component.model.options),
        parameters={k: float(v) for k, v in result.params.items()},
        standard_errors={k: float(v) if np.isfinite(v) else float("nan") for k, v in result.bse.items()},
        covariance=np.asarray(result.cov_scale).tolist(),
        start=int(found[0].time[0]),
        end=int(found[-1].time[-1]),
        samples=n,
        log_likelihood=float(result.llf),
        innovation={},
        diagnostics={
            "converged": result.converged,
            "unidentifiable": list(result.unidentifiable),
            "at_bound": list(result.at_bound),
            "flat": [f.words for f in result.flat],
            "known": [str(k) for k in result.known],
        },
    )
    steps = healthy_steps(plan, component, baseline, history)
    diagnostics = {**baseline.diagnostics, **score_diagnostics(plan, component, steps)}
    diagnostics["flatline"] = flatline_statistics(component, steps)
    diagnostics["conditions"] = conditions_of(component, found)
    baseline = replace(baseline, innovation=innovation_statistics(component, steps, plan.step), diagnostics=diagnostics)
    diagnostics["sensitivity"] = sensitivities(component.model, [data_of(r) for r in found], baseline)
    return baseline, result


def conditions_of(component: Component, found: Sequence[Run]) -> dict[str, list[float]]:
    """Mean and standard deviation of every input over the runs of a fit: what later days are compared with."""
    u = np.concatenate([r.u for r in found])
    return {
        q.symbol: [float(column.mean()), float(column.std())]
        for q, column in zip(component.model.inputs, u.T, strict=True)
    }


def data_of(run: Run) -> Data:
    """A run as a record to fit or to validate on; time from its first sample."""
    return Data(t=(run.time - run.time[0]) / NANOSECONDS, u=run.u, y=run.y)


def healthy_steps(plan: Plan, component: Component, baseline: Baseline, history: History) -> list[GroupStep]:
    """What the engine would have seen of a component over a history, frame by frame."""
    group = FilterGroup([component], {component.name: baseline}, plan.columns, hold=plan.hold, max_gap=plan.max_gap)
    return [group.step(t, row) for t, row in zip(history.time.tolist(), history.values, strict=True)]


def innovation_statistics(component: Component, steps: Sequence[GroupStep], step: int) -> dict[str, JsonObject]:
    """What is left of each output's standardised innovations on the baseline: mean, colour and spread.

    Where they are coloured beyond chance, an autoregression (``ar``) takes the colour out before they are charted.
    ``windows`` is what tests of whiteness say of what is left; ``step`` the length of a frame [ns].
    """
    z = np.array([s.standardised[0] for s in steps])
    found: dict[str, JsonObject] = {}
    for quantity, column in zip(component.model.outputs, z.T, strict=True):
        seen = column[np.isfinite(column)]
        both = np.isfinite(column[1:]) & np.isfinite(column[:-1])
        lag1 = float(np.corrcoef(column[1:][both], column[:-1][both])[0, 1])
        order = COLOUR_ORDER if abs(lag1) > chance(len(seen)) else 0
        whitener = Whitener.fit(column[:, None], order, centre=True)
        whitener.scale[:] = 1.0
        white = np.array([whitener.update(row)[0] for row in column[:, None]])
        white = white[np.isfinite(white)]
        sd = honest_spread(white)
        found[quantity.symbol] = {
            "mean": float(whitener.mean[0]),
            "ar": whitener.coefficients[0].tolist(),
            "sd": sd,
            "lag1": lag1,
            "samples": len(seen),
            "windows": window_statistics(white / sd, *window_of(step)),
        }
    return found


def honest_spread(values: FloatArray) -> float:
    """Standard deviation that understates neither shoulders, nor tails, nor the worst hours.

    A model errs more while the sun shines than at night. A chart that is fed with one scale keeps its promise only if
    the scale is that of the bad hours: the 95 % quantile of the spread of short windows, over what white noise has.
    Shoulders (interquartile range) and bad hours count where they are beyond chance, for the largest of three estimates
    of the same number is too large: by 0.7 % from four weeks at five minutes, which is a tenth of a CUSUM's false
    alarms, and by 1.3 % from one.
    """
    n = len(values)
    sd = float(values.std())
    low, high = np.percentile(values, [25, 75])
    found = [(float(high - low) / IQR, QUARTILES_ERROR / float(np.sqrt(n)))]
    if m := n // WINDOW:
        windows = np.mean(np.square(values[: m * WINDOW].reshape(m, WINDOW)), axis=1)
        bad = chi2.ppf(QUANTILE, WINDOW)
        # Standard error of a quantile (Cramer 1946, 28.5), relative, of the square root.
        error = np.sqrt(QUANTILE * (1 - QUANTILE) / m) / (2 * bad * chi2.pdf(bad, WINDOW))
        found.append((float(np.sqrt(np.quantile(windows, QUANTILE) * WINDOW / bad)), float(error)))
    return max([sd, *(value for value, error in found if value > sd * (1 + CHANCE * error))])


def chance(samples: int) -> float:
    """Lag-one autocorrelation that white innovations hardly ever show in so many samples."""
    return max(0.03, 4.0 / float(np.sqrt(samples)))


def score_diagnostics(plan: Plan, component: Component, steps: Sequence[GroupStep]) -> JsonObject:
    """Standard deviation of each parameter's block scores on the baseline (``score_spread``), from ``score_blocks``.

    1 where the model is true, else more. ``effective_share`` is how far their charts ring apart
    (:func:`fdd.residual_monitors.effective_charts.effective_share`).

    Where the model misses something, innovations are coloured and scores of hours vary more than their information
    says; the charts divide by this.
    """
    charted = [s for s in steps if s.charted[0] and np.isfinite(s.score).all() and np.isfinite(s.information).all()]
    block = max(1, SCORE_BLOCK // plan.step)
    n = len(charted) // block
    if n < FEWEST_BLOCKS:
        return {"score_spread": {}, "score_blocks": n}
    p = len(component.model.parameters)
    score = np.array([s.score[0] for s in charted[: n * block]]).reshape(n, block, p).sum(axis=1)
    full = np.array([s.information[0] for s in charted[: n * block]]).reshape(n, block, p, p).sum(axis=1)
    # What given parameters are off by on the whole is not spread; of fitted ones it is next to nothing.
    offset = inverse(full.sum(axis=0))[0] @ score.sum(axis=0)
    score = score - full @ offset
    information = np.diagonal(full, axis1=1, axis2=2)
    z = np.where(information > 0, score / np.sqrt(np.where(information > 0, information, 1.0)), 0.0)
    spread = np.maximum(1.0, np.sqrt(np.mean(np.square(z), axis=0)))
    table = {q.symbol: float(v) for q, v in zip(component.model.parameters, spread, strict=True)}
    return {"score_spread": table, "score_blocks": n, "effective_share": _apart(component, full)}


def _apart(component: Component, information: FloatArray) -> float:
    """Alarms of the physical parameters' charts over their sum, at the mean correlation of blocks (n, n_p, n_p)."""
    at = np.flatnonzero([q.kind == "physical" for q in component.model.parameters])
    own = information[:, at[:, None], at]
    diagonal = np.diagonal(own, axis1=1, axis2=2)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    correlation = np.mean(own * scale[:, :, None] * scale[:, None, :], axis=0)
    np.fill_diagonal(correlation, 1.0)
    return effective_share(correlation)
