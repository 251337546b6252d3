"""The error that is granted to a baseline's physical parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.models.declare import Parameter
from fdd.records import Baseline, FloatArray
from fdd.service.filtering.filters import FilterGroup, GroupStep

# Relative standard error granted to a physical parameter that was given and not fitted: a figure that is right to one
# per cent is a good one. What of it is true is learned from the first weeks' scores.
MODEL_ERROR = 0.01


def baseline_covariance(group: FilterGroup, baseline: Baseline) -> FloatArray:
    """Covariance of the physical parameters on the estimation scale: the fit's own, and what is granted to given ones.

    That scores vary more than their information says is in the scale that they are charted in, and not paid for here.
    """
    at = group.physical
    parameters = [group.model.parameters[i] for i in at]
    own = np.zeros((len(at), len(at)))
    if baseline.covariance:
        order = [list(baseline.parameters).index(p.symbol) for p in parameters]
        own = np.nan_to_num(np.array(baseline.covariance))[np.ix_(order, order)]
    slopes = _relative_slopes(group, baseline)
    given = np.diagonal(own) <= 0
    return np.asarray(own + np.diag(np.where(given, np.square(MODEL_ERROR * slopes), 0.0)))


def spread_of(baseline: Baseline, symbols: Sequence[str]) -> FloatArray:
    """Standard deviations of parameters' scores on the baseline's own data: at least 1, and 1 where none is kept."""
    table = baseline.diagnostics.get("score_spread", {})
    return np.array([max(1.0, float(table.get(s, 1.0))) for s in symbols])


def shift_variance(group: FilterGroup, step: GroupStep, covariance: FloatArray) -> FloatArray:
    """Variance that errors of the parameters give to the means of a group's innovations in this step, one an output.

    ``covariance`` is that of the physical parameters, (n, p, p). Of a component with several outputs that of all
    together: which of them an error moves is not known here.
    """
    at = group.physical
    information = np.nan_to_num(step.information[:, at[:, None], at])
    variance = np.einsum("njk,njk->n", information, covariance)
    return np.repeat(np.maximum(variance, 0.0), step.standardised.shape[1])


def relative_slopes(group: FilterGroup) -> FloatArray:
    """What small relative changes of the physical parameters are on the estimation scale, a row a component."""
    return np.stack([_relative_slopes(group, b) for b in group.baselines])


def _relative_slopes(group: FilterGroup, baseline: Baseline) -> FloatArray:
    parameters = [group.model.parameters[i] for i in group.physical]
    return np.array([_relative_slope(p, baseline.parameters[p.symbol]) for p in parameters])


def _relative_slope(parameter: Parameter, value: float) -> float:
    """What a small relative change of a parameter is on its estimation scale."""
    match parameter.transform:
        case "log":
            return 1.0
        case "logit":
            lower, upper = parameter.lower, parameter.upper
            inside = max((value - lower) * (upper - value), 1e-6 * (upper - lower) ** 2)
            return abs(value) * (upper - lower) / inside
        case _:
            return abs(value)
