"""The theory that detection delays are held against, against the run-length solver."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.detection import BLOCK, DAY, RATE, STEP
from benchmarks.detection_tables import BLOCK_DAYS, K, shifted, theoretical
from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.run_length import Rule, limit_for, run_length_quantile


@pytest.mark.parametrize("shift", [1.0, 1.5, 3.0])
def test_theory_of_a_constant_shift_is_the_solvers_median(shift: float) -> None:
    """Information of one a block and a change of ``shift``: a constant mean; 8 000 runs, medians whole blocks."""
    charts = 2
    h = float(limit_for("cusum", YEAR / STEP / RATE * charts / BLOCK, k=K))
    exact = run_length_quantile(Rule("cusum", k=K), h, 0.5, shift, "steady")
    found = theoretical(-shift, [np.ones(200)] * 20, charts) / BLOCK_DAYS
    assert found == pytest.approx(exact, abs=1.01)


def test_theory_of_no_change_finds_nothing() -> None:
    assert theoretical(0.0, [np.ones(84)] * 4, 2) == np.inf


def test_theory_of_a_lasting_shift_of_innovations_is_the_solvers_median() -> None:
    charts = 2
    h = float(limit_for("cusum", YEAR / STEP / RATE * charts, k=K))
    exact = run_length_quantile(Rule("cusum", k=K), h, 0.5, 2.0, "steady")
    assert shifted([np.full(300, 2.0)] * 10, charts) * DAY / STEP == pytest.approx(exact, abs=1.01)
