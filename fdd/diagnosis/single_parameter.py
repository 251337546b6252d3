"""Which parameter alone explains a stretch of data best: each refitted by itself, the others as on the baseline.

Sums of scores tell small changes apart. The estimate from them is linear, and after a change of some tens of standard
errors the tangents at the baseline are no longer those at the plant's parameters: what fits best in a straight line
need not fit best. Here every parameter is followed to its own optimum, with tangents taken anew at each step.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from fdd.greybox.likelihood import Evaluation, FilterPath, Likelihood
from fdd.greybox.scale import from_scale, to_scale
from fdd.models.declare import ComponentModel
from fdd.records import FloatArray

STEPS = 12
"""Newton steps at most."""
SETTLED = 0.05
"""A step of less than so many standard errors ends the search."""
LONGEST = 0.5
"""Longest step on the scale of estimation, where that is a logarithm or a logit."""


@dataclass(frozen=True, slots=True)
class Alone:
    """A parameter moved by itself.

    Attributes
    ----------
    symbol : of the parameter
    change, error : to its optimum, and its standard error there, on the estimation scale; 0 and inf where the data do
        not speak of it
    gain : twice the log-likelihood gained over the baseline; the largest names the parameter
    """

    symbol: str
    change: float
    error: float
    gain: float


def alone(model: ComponentModel, likelihood: Likelihood, values: FloatArray, left: Collection[str] = ()) -> list[Alone]:
    """Every physical parameter's own optimum, the one that explains most first; empty where the filter fails.

    Parameters
    ----------
    likelihood : of the data since the onset
    values : parameters of the baseline, natural scale, (n_p,)
    left : symbols of parameters to leave out
    """
    base = likelihood.evaluate(values)
    if not np.isfinite(base.value):
        return []
    physical = [i for i, p in enumerate(model.parameters) if p.kind == "physical" and p.symbol not in left]
    return sorted((_follow(model, likelihood, values, base, i) for i in physical), key=lambda a: -a.gain)


def moved(model: ComponentModel, values: FloatArray, by: Alone) -> FloatArray:
    """The parameters with this one moved, natural scale, (n_p,)."""
    found = values.copy()
    i = [p.symbol for p in model.parameters].index(by.symbol)
    found[i] = from_scale(model.parameters[i], to_scale(model.parameters[i], float(values[i])) + by.change)
    return found


def frames_before(likelihood: Likelihood, values: FloatArray, changed: FloatArray) -> int:
    """How many of the first frames the baseline explains better than parameters ``changed`` do: they were healthy yet.

    An onset is an estimate. The maximum of the likelihood over all onsets (Basseville and Nikiforov 1993, 2.4.3).
    """
    losses = [np.concatenate([_losses(path) for path in likelihood.paths(at)]) for at in (changed, values)]
    return int(np.argmin(np.cumsum([0.0, *(losses[1] - losses[0])[:-1]])))


def _losses(path: FilterPath) -> FloatArray:
    """Of each frame, twice the negative log-likelihood but for a constant."""
    return np.asarray(np.nansum(path.standardised**2 + np.log(path.innovation_variance), axis=1))


def _follow(model: ComponentModel, likelihood: Likelihood, values: FloatArray, base: Evaluation, index: int) -> Alone:
    """Fisher scoring with halved steps from the baseline's value."""
    q = model.parameters[index]
    low, high = (-np.inf, np.inf) if q.transform == "logit" else (to_scale(q, q.lower), to_scale(q, q.upper))
    here, at, start = values.copy(), base, to_scale(q, float(values[index]))
    theta = start
    for _ in range(STEPS):
        information = float(at.information[index, index])
        if not information > 0:
            break
        step = float(-at.gradient[index] / information)
        if q.transform != "identity":
            step = float(np.clip(step, -LONGEST, LONGEST))
        step = float(np.clip(theta + step, low, high)) - theta
        while abs(step) * np.sqrt(information) > SETTLED:
            here[index] = from_scale(q, theta + step)
            there = likelihood.evaluate(here)
            if there.value < at.value:
                break
            step /= 2
        else:
            break
        theta, at = theta + step, there
    information = float(at.information[index, index])
    error = 1.0 / np.sqrt(information) if information > 0 else np.inf
    return Alone(q.symbol, theta - start, float(error), 2.0 * (base.value - at.value))
