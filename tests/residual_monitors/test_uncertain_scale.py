"""Limits for values whose scale is uncertain: the promised rate on average over the scale."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.residual_monitors.predictive import widened
from fdd.residual_monitors.run_length import Rule, arl, limit_for


def mean_rate(limit: float, error: float, k: float = 0.5) -> float:
    """False alarms an update, averaged over variances of the values that are normal about 1 with sd ``error``."""
    z = np.linspace(-4, 4, 33)
    weights = np.exp(-0.5 * z * z) / np.exp(-0.5 * z * z).sum()
    scale = np.sqrt(1 + error * z)
    # A CUSUM on values times s with (k, h) is one on the values with (k / s, h / s).
    rates = [1 / arl(Rule("cusum", k=k / s, sided=2), limit / s, 0.0) for s in scale]
    return float(np.dot(weights, rates))


@pytest.mark.parametrize("error", [0.03, 0.06, 0.1])
@pytest.mark.parametrize("wanted", [1e4, 1e5, 1e6])
def test_widened_limits_keep_the_rate_that_an_uncertain_scale_would_raise(wanted: float, error: float) -> None:
    limit = float(limit_for("cusum", wanted, k=0.5))
    before, after = (wanted * mean_rate(h, error) for h in (limit, float(widened(limit, 0.5, error**2))))
    assert before > 1 + 10 * error**2
    assert 1 - 25 * error**2 < after < 1.02  # of the first order: what it takes too much is a quarter at most


def test_a_known_scale_leaves_limits_alone() -> None:
    assert widened([4.0, 9.0], 0.5, 0.0).tolist() == [4.0, 9.0]
