from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import poisson

from fdd.residual_monitors.budget import YEAR, BudgetError, poisson_interval, realised, spread


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.floats(0.1, 10), min_size=1, max_size=30),
    st.floats(0.1, 50),
    st.floats(60, 3600),
    st.floats(0.05, 1),
)
def test_spread_adds_up_to_the_budget(
    weights: list[float], budget: float, interval: float, availability: float
) -> None:
    arl = spread(budget, weights, interval, availability)
    rates = availability * YEAR / interval / arl
    assert rates.sum() == pytest.approx(budget)
    np.testing.assert_allclose(rates / rates[0], np.array(weights) / weights[0])


def test_one_chart_once_a_year_at_five_minutes() -> None:
    assert spread(1.0, [1.0], 300.0)[0] == pytest.approx(105_192)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((0.0, [1.0], 300.0), "positive number"),
        ((1.0, [1.0, 0.0], 300.0), "leave a chart out"),
        ((1.0, [1.0], 0.0), "positive seconds"),
        ((1.0, [1.0], 300.0, 1.5), "availability"),
        ((400.0, [1.0], 86400.0), "alarm at once"),
    ],
)
def test_an_impossible_budget_says_why(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(BudgetError, match=text):
        spread(*arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [0, 1, 7, 60])
def test_poisson_interval_has_exact_tails(count: int) -> None:
    low, high = poisson_interval(count, 0.9)
    assert poisson.cdf(count, high) == pytest.approx(0.05)
    if count:
        assert poisson.sf(count - 1, low) == pytest.approx(0.05)
    else:
        assert low == 0


def test_realised_rate_is_compared_with_the_promise() -> None:
    kept = realised(9, 10 * YEAR, 1.0)
    assert kept.rate == pytest.approx(0.9)
    assert kept.consistent
    assert not realised(40, 10 * YEAR, 1.0).consistent
    assert not realised(0, 10 * YEAR, 1.0).consistent
