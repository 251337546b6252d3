"""The error that is granted to a baseline's physical parameters."""

from __future__ import annotations

import numpy as np

from fdd.models.declare import Parameter
from fdd.records import Baseline, FloatArray, IntArray
from fdd.service.filters import FilterGroup

# No model is right to better than a per cent: every physical parameter is granted this relative standard error for
# good, of which charts forgive ALLOWANCE times as much. This is the floor on the changes that are found.
MODEL_ERROR = 0.005


def physical(group: FilterGroup) -> IntArray:
    """Positions of the physical parameters in the group's model."""
    return np.flatnonzero([p.kind == "physical" for p in group.model.parameters])


def granted(group: FilterGroup, baseline: Baseline) -> FloatArray:
    """Covariance granted to the physical parameters, on the estimation scale: the baseline's own, and the model's.

    A baseline that is known, not fitted, has none of its own.
    """
    at = physical(group)
    own = np.zeros((len(at), len(at)))
    parameters = [group.model.parameters[i] for i in at]
    if baseline.covariance:
        order = [list(baseline.parameters).index(p.symbol) for p in parameters]
        own = np.nan_to_num(np.array(baseline.covariance))[np.ix_(order, order)]
    slopes = [_relative_slope(p, baseline.parameters[p.symbol]) for p in parameters]
    return np.asarray(own + np.diag(np.square(MODEL_ERROR * np.array(slopes))))


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
