"""Charts that ring together share alarms: the simulated share against charts themselves."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.effective_charts import APART, ROUND, effective_share


def test_independent_charts_share_nothing_and_equal_ones_all() -> None:
    assert effective_share([[1.0]]) == 1.0
    assert effective_share(np.eye(2)) == 1.0
    assert effective_share(np.ones((4, 4))) == 0.25
    assert effective_share([[1.0, -1.0], [-1.0, 1.0]]) == 0.5


@pytest.mark.parametrize("rho", [0.8, -0.98])
def test_share_is_what_charts_cleared_together_give(rho: float) -> None:
    pairs, steps, rng = 2000, 1500, np.random.default_rng(3)
    chart = Cusum.design(np.full(2 * pairs, APART))
    alarms = 0
    for _ in range(steps):
        first, second = rng.standard_normal((2, pairs))
        z = np.column_stack([first, rho * first + np.sqrt(1 - rho * rho) * second])
        rang = (chart.update(z.ravel()).phase == Phase.ALARM).reshape(pairs, 2).any(axis=1)
        alarms += int(rang.sum())
        chart.reset(np.repeat(rang, 2))
    share = alarms * APART / (2 * pairs * steps)
    error = share / np.sqrt(alarms)
    # Three errors of this simulation, as many of the other (as long as 267 of these pairs), and the rounding.
    assert effective_share([[1.0, rho], [rho, 1.0]]) == pytest.approx(share, abs=3 * error + 0.03 + 0.5 / ROUND)
