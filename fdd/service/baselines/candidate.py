"""One component's candidate for a new baseline: fitted to a window, and put through the gates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fdd.diagnosis import gates as g
from fdd.diagnosis.gates import Estimate, Gate, Outcome, Policy
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.scale import to_scale
from fdd.models.declare import Parameter
from fdd.records import Baseline, FloatArray, JsonObject
from fdd.service.baselines.history import History, runs
from fdd.service.baselines.identify import IdentifyError, identify
from fdd.service.baselines.plausible import objections
from fdd.service.baselines.window import DAY, LENGTHS, Window, choose, days_of, record
from fdd.service.monitoring.baseline_uncertainty import spread_of
from fdd.service.site.plan import Component, Plan

# Every fifth day is held out of a fit that is only made to be tested on them.
HELD_OUT = 5
SPLITS = (0.25, 0.5, 0.75)
BREAK = 20  # values left out between runs, so that no lag reaches over


@dataclass(frozen=True, slots=True)
class Candidate:
    """What a re-identification found; ``baseline`` is None where nothing could be fitted."""

    component: str
    outcome: Outcome
    reason: str
    window: Window | None = None
    gates: tuple[Gate, ...] = ()
    baseline: Baseline | None = None
    seconds: float = field(default=0.0, compare=False)


def consider(
    plan: Plan,
    component: Component,
    history: History,
    chain: Sequence[Baseline],
    policy: Policy,
    *,
    suspected: bool = False,
    lengths: Sequence[int] = LENGTHS,
) -> Candidate:
    """Fit a candidate to the most informative recent window of a history and judge it.

    Parameters
    ----------
    history : healthy as far as is known: nothing under alarms
    chain : baselines from the last that a person vouched for to the one in force, which comes last
    suspected : a fault was suspected before and nobody has answered yet
    """
    current = chain[-1]
    component = component.following(current)
    if not len(history):
        return Candidate(component.name, Outcome.REFUSED, "no data outside alarms in the span that was asked for")
    window = choose(plan, component, history, current, lengths)
    part = history.between(window.start, window.end)
    try:
        baseline, result = identify(plan, component, part, start=current.parameters)
        if against := objections(component, result):
            return Candidate(component.name, Outcome.REFUSED, "; ".join(against), window)
        trained, gain = _held_out(plan, component, part, current)
    except IdentifyError as error:
        return Candidate(component.name, Outcome.REFUSED, str(error), window)
    model = component.model
    told = _told(component, baseline, current)
    symbols = [p.symbol for p in model.parameters if p.kind == "physical"]
    new = _estimate(component, baseline, "now", told)
    earlier = [_estimate(component, b, f"version {b.version}", told, vouched=i == 0) for i, b in enumerate(chain)]
    values = np.array(list(baseline.parameters.values()))
    records = [record(r) for r in runs(plan, component, part)]
    judged = (
        g.converged(result.converged, result.reason),
        g.identifiable(symbols, replace(new, error=_errors(component, baseline)), _known(component, current), policy),
        g.inside(
            [p.symbol for p in model.parameters],
            values,
            np.array([p.lower for p in model.parameters]),
            np.array([p.upper for p in model.parameters]),
        ),
        g.white(
            [q.symbol for q in model.outputs],
            _innovations(component, records, values),
            _innovations(component, records, _values(component, current)),
            policy,
        ),
        g.better(gain, policy),
        g.steady(symbols, _parts(plan, component, part, baseline, told), policy),
        g.no_fault(symbols, new, earlier, policy, suspected=suspected),
    )
    outcome = g.decide(judged)
    reason = "; ".join(f"{v.name}: {v.remark}" for v in judged if not v.passed) or trained
    about: JsonObject = {
        **baseline.diagnostics,
        "follows": current.version,
        "automatic": True,
        "gates": [[v.name, v.passed, float(v.statistic), float(v.limit), v.remark] for v in judged],
        "window": window.reason,
    }
    baseline = replace(baseline, diagnostics=about, reason=f"re-identified: {reason}")
    return Candidate(component.name, outcome, reason, window, judged, baseline)


def _held_out(plan: Plan, component: Component, part: History, current: Baseline) -> tuple[str, FloatArray]:
    """Log-likelihood that parameters fitted to the other days gain over the present ones on each day held out."""
    days = days_of(part)
    held = days[HELD_OUT // 2 :: HELD_OUT]
    day = part.time // DAY
    rest = ~np.isin(day, held)
    training = [record(r) for r in runs(plan, component, History(part.columns, part.time[rest], part.values[rest]))]
    if not training:
        raise IdentifyError(f"{component.name}: no data are left when every fifth day is held out; give a longer span")
    fitted = fit(component.model, training, start=current.parameters, errors="fisher").values
    old, gain = _values(component, current), []
    for d in held:
        records = [record(r) for r in runs(plan, component, part.between(d * DAY, (d + 1) * DAY))]
        if records:
            likelihood = Likelihood(component.model, records)
            gain.append(likelihood.value(old) - likelihood.value(fitted))
    total = np.array(gain)
    return f"log-likelihood gains {total.sum():.1f} on {len(total)} held-out days", total


def _parts(
    plan: Plan, component: Component, part: History, baseline: Baseline, told: FloatArray
) -> list[tuple[Estimate, Estimate]]:
    """Estimates before and after several points of the window, one Newton step from its own estimate."""
    pairs = []
    for share in SPLITS:
        at = int(part.time[int(share * (len(part) - 1))])
        found = [
            _newton(plan, component, piece, baseline, told)
            for piece in (part.between(None, at), part.between(at, None))
        ]
        if found[0] is not None and found[1] is not None:
            pairs.append((found[0], found[1]))
    return pairs


def _newton(plan: Plan, component: Component, piece: History, baseline: Baseline, told: FloatArray) -> Estimate | None:
    found = runs(plan, component, piece)
    if not found:
        return None
    e = Likelihood(component.model, [record(r) for r in found]).evaluate(_values(component, baseline))
    closed = {*baseline.diagnostics["unidentifiable"], *baseline.diagnostics["at_bound"]}
    free = [i for i, p in enumerate(component.model.parameters) if p.symbol not in closed and p.lower < p.upper]
    inverse = np.linalg.pinv(e.information[np.ix_(free, free)], hermitian=True)
    theta, error = _theta(component, baseline), np.full(len(e.gradient), np.nan)
    theta[free] -= inverse @ e.gradient[free]
    error[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    at, unit = _physical(component), _unit(component)
    return Estimate(
        "part",
        (theta / unit)[at],
        (error / unit)[at] * _spread(component, baseline) * told,
        int(piece.time[len(piece) // 2]),
    )


def _estimate(component: Component, b: Baseline, name: str, told: FloatArray, *, vouched: bool = False) -> Estimate:
    """A baseline's physical parameters; errors are widened as its charts are, and NaN where nothing can be told."""
    theta = (_theta(component, b) / _unit(component))[_physical(component)]
    error = np.nan_to_num(_errors(component, b)) * _spread(component, b) * told
    return Estimate(name, theta, error, (b.start + b.end) // 2, vouched)


def _known(component: Component, b: Baseline) -> Estimate:
    error = _errors(component, b) if b.covariance else np.full(len(_physical(component)), np.nan)
    return Estimate(f"version {b.version}", np.zeros_like(error), error, 0)


def _errors(component: Component, b: Baseline) -> FloatArray:
    """Standard errors of the physical parameters on the estimation scale; NaN for those left open."""
    at = _physical(component)
    if not b.covariance:
        return np.zeros(len(at))
    closed = {*b.diagnostics.get("unidentifiable", ()), *b.diagnostics.get("at_bound", ())}
    error = np.sqrt(np.maximum(np.diag(np.array(b.covariance)), 0.0)) / _unit(component)
    open_ = np.array([p.symbol in closed for p in component.model.parameters])
    return np.asarray(np.where(open_, np.nan, error)[at])


def _told(component: Component, new: Baseline, old: Baseline) -> FloatArray:
    """1 for each physical parameter that both baselines know, NaN for the others."""
    told = np.isfinite(_errors(component, new)) & np.isfinite(_errors(component, old))
    return np.where(told, 1.0, np.nan)


def _spread(component: Component, b: Baseline) -> FloatArray:
    return spread_of(b, [component.model.parameters[i].symbol for i in _physical(component)])


def _physical(component: Component) -> list[int]:
    return [i for i, p in enumerate(component.model.parameters) if p.kind == "physical"]


def _unit(component: Component) -> FloatArray:
    """What a change of 1 is counted in: a share for logarithms, the parameter's own size where it may change sign."""

    def one(p: Parameter) -> float:
        return max(abs(p.typical), (p.upper - p.lower) / 10) if p.transform == "identity" else 1.0

    return np.array([one(p) for p in component.model.parameters])


def _values(component: Component, b: Baseline) -> FloatArray:
    return np.array([b.parameters[p.symbol] for p in component.model.parameters])


def _theta(component: Component, b: Baseline) -> FloatArray:
    return np.array([to_scale(p, b.parameters[p.symbol]) for p in component.model.parameters])


def _innovations(component: Component, records: Sequence[Data], values: FloatArray) -> FloatArray:
    """Standardised innovations of all runs (m, n_y), NaN between them."""
    gap = np.full((BREAK, len(component.model.outputs)), np.nan)
    paths = Likelihood(component.model, list(records)).paths(values)
    return np.vstack([np.vstack([path.standardised[1:], gap]) for path in paths])
