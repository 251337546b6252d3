"""The error that is granted to a baseline's physical parameters."""

from __future__ import annotations

import numpy as np

from fdd.models.declare import Parameter
from fdd.records import Baseline, FloatArray, IntArray
from fdd.service.filters import FilterGroup

# Relative standard error granted to a physical parameter that was given and not fitted: a figure that is right to one
# per cent is a good one. What of it is true is learned from the first weeks' scores.
MODEL_ERROR = 0.01


def physical(group: FilterGroup) -> IntArray:
    """Positions of the physical parameters in the group's model."""
    return np.flatnonzero([p.kind == "physical" for p in group.model.parameters])


def granted(group: FilterGroup, baseline: Baseline) -> FloatArray:
    """Covariance of the physical parameters on the estimation scale: the fit's own, and what is granted to given ones.

    Where scores of the fit's own data vary more than their information says, the fit's errors are larger in proportion.
    """
    at = physical(group)
    parameters = [group.model.parameters[i] for i in at]
    own = np.zeros((len(at), len(at)))
    if baseline.covariance:
        order = [list(baseline.parameters).index(p.symbol) for p in parameters]
        own = np.nan_to_num(np.array(baseline.covariance))[np.ix_(order, order)]
        table = baseline.diagnostics.get("score_spread", {})
        spread = np.array([max(1.0, table.get(p.symbol, 1.0)) for p in parameters])
        own = own * spread[:, None] * spread
    slopes = relative_slopes(group, baseline)
    given = np.diagonal(own) <= 0
    return np.asarray(own + np.diag(np.where(given, np.square(MODEL_ERROR * slopes), 0.0)))


def relative_slopes(group: FilterGroup, baseline: Baseline) -> FloatArray:
    """What small relative changes of the physical parameters are on the estimation scale."""
    parameters = [group.model.parameters[i] for i in physical(group)]
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
