from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.typing import NDArray

from fdd.residual_monitors.chart import Phase, StateError
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.whiten import Whitener, robust_scale


def coloured(seed: int, steps: int, n: int, rho: float = 0.6) -> NDArray[Any]:
    rng = default_rng(seed)
    x = rng.standard_normal((steps, n))
    for t in range(1, steps):
        x[t] = rho * x[t - 1] + np.sqrt(1 - rho**2) * x[t]
    return x


def test_whitened_values_are_white_and_of_variance_one() -> None:
    white = Whitener.fit(coloured(1, 4000, 5), order=2)
    z = np.array([white.update(row) for row in coloured(2, 8000, 5)])[2:]
    assert np.nanstd(z, axis=0) == pytest.approx(1.0, abs=0.06)
    assert np.abs(np.mean(z[1:] * z[:-1], axis=0)).max() < 0.06
    np.testing.assert_allclose(white.coefficients[:, 0], 0.6, atol=0.06)


def test_colour_ruins_a_chart_and_whitening_mends_it() -> None:
    """For AR(1) with rho 0.5 a CUSUM designed for 465 gives 52; h = 5, k = 0.5."""
    n = 400
    history, values = coloured(3, 5000, n, 0.5), coloured(4, 1500, n, 0.5)
    white = Whitener.fit(history, order=1)
    spans = {}
    for name in ("raw", "white"):
        chart, first = Cusum(np.full(n, 5.0)), np.zeros(n)
        for t, row in enumerate(values):
            rang = (chart.update(white.update(row) if name == "white" else row).phase == Phase.ALARM) & (first == 0)
            first[rang] = t + 1
        spans[name] = np.where(first > 0, first, len(values)).sum() / np.count_nonzero(first)
    assert spans["raw"] == pytest.approx(52, rel=0.2)
    assert spans["white"] == pytest.approx(465, rel=0.25)


def test_outliers_do_not_move_the_fit() -> None:
    x = coloured(5, 4000, 1)
    x[::97] = 40.0
    white = Whitener.fit(x, order=1)
    assert white.coefficients[0, 0] == pytest.approx(0.6, abs=0.12)
    assert white.scale[0] == pytest.approx(0.8, abs=0.1)
    assert robust_scale(x[:, 0]) == pytest.approx(1.0, abs=0.08)


def test_gap_is_followed_by_order_values_of_waiting() -> None:
    white = Whitener([[0.5, 0.1]], 0.0, 1.0)
    out = [white.update([v])[0] for v in (1.0, 2.0, 3.0, np.nan, 1.0, 2.0, 3.0)]
    assert np.isnan(out).tolist() == [True, True, False, True, True, True, False]
    assert out[2] == pytest.approx(3.0 - 0.5 * 2.0 - 0.1 * 1.0)


def test_short_or_stuck_baselines_are_passed_on_as_they_are() -> None:
    x = np.full((500, 3), np.nan)
    x[:20, 0] = default_rng(6).standard_normal(20)
    x[:, 1] = 0.0
    x[:, 2] = default_rng(7).standard_normal(500)
    with np.errstate(all="raise"):
        white = Whitener.fit(x, order=2)
    np.testing.assert_array_equal(white.coefficients[:2], 0.0)
    np.testing.assert_array_equal(white.scale[:2], 1.0)


def test_an_estimate_on_the_unit_circle_is_held_inside() -> None:
    walk = np.cumsum(default_rng(8).standard_normal((3000, 4)), axis=0)
    white = Whitener.fit(walk, order=2)
    for phi in white.coefficients:
        assert np.abs(np.roots(np.concatenate([[1.0], -phi]))).max() <= 0.98 + 1e-9


def test_restart_changes_no_byte() -> None:
    x = coloured(9, 200, 3)
    x[default_rng(10).random(x.shape) < 0.1] = np.nan
    one, first, second = (Whitener([[0.5, 0.1]] * 3, 0.0, 1.0) for _ in range(3))
    whole = np.array([one.update(r) for r in x])
    half = [first.update(r) for r in x[:77]]
    second.restore_state(first.export_state())
    assert np.array(half + [second.update(r) for r in x[77:]]).tobytes() == whole.tobytes()
    with pytest.raises(StateError, match="start it anew"):
        second.restore_state({**first.export_state(), "schema": 9})
