"""What a baseline says of its innovations' spread."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.service.identify import honest_spread

WEEK = 2016


def test_spread_of_white_innovations_is_not_widened_by_chance() -> None:
    """The largest of three unbiased estimates is 1.3 % too large from a week: a fifth of a CUSUM's false alarms."""
    rng = np.random.default_rng(1)
    found = [honest_spread(rng.standard_normal(WEEK)) for _ in range(300)]
    # Three standard errors of the mean, whose standard deviation from a week is 1.6 to 1.9 %.
    assert np.mean(found) == pytest.approx(1.0, abs=3 * 0.019 / np.sqrt(len(found)))


def test_spread_is_that_of_the_bad_hours_and_of_the_shoulders() -> None:
    rng = np.random.default_rng(2)
    bad = np.repeat(np.where(rng.random(80) < 0.3, 1.5, 1.0), 100)
    values = bad * rng.standard_normal(bad.size)
    assert values.std() < 1.25
    assert 1.3 < honest_spread(values) < 1.6
    uniform = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), 4 * WEEK)
    assert honest_spread(uniform) == pytest.approx(np.sqrt(3.0) / 1.349, rel=0.03)
