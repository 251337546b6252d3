from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from fdd.greybox.experiment import (
    DesignError,
    Signal,
    candidates,
    cross_correlation,
    d_optimal,
    prbs,
    prms,
    sequence,
)
from tests.greybox import problems


@pytest.mark.parametrize("stages", range(3, 14))
def test_registers_are_maximal(stages: int) -> None:
    """With the last two stages fed back, as the thesis has it, 9, 11 and 13 stages repeat early; here no stage does."""
    s = prbs(stages)
    n = 2**stages - 1
    assert len(s) == n
    assert s.sum() == (n + 1) // 2
    a = 2.0 * s - 1
    rho = np.fft.irfft(np.abs(np.fft.rfft(a)) ** 2, n) / n
    np.testing.assert_allclose(rho[1:], -1 / n, atol=1e-9)  # Eq. 2.6: the property that defines an m-sequence


@pytest.mark.parametrize("levels", [2, 4, 8])
def test_levels_come_equally_often(levels: int) -> None:
    s = prms(9, levels)
    counts = np.bincount(s, minlength=levels)
    assert counts.max() - counts.min() <= 1
    assert np.abs(np.corrcoef(s[:-1], s[1:])[0, 1]) < 0.2


def test_signal_keeps_levels_dwell_and_step() -> None:
    t = np.arange(0, 7200.0, 10)
    signal = Signal("u", (0.3, 0.37, 0.5, 0.71), dwell=60.0, largest_step=0.25)
    v = sequence(signal, t, 3)
    assert set(v) <= set(signal.levels)
    assert np.abs(np.diff(v)).max() <= 0.25
    changes = np.flatnonzero(np.diff(v)) + 1
    assert (t[changes] % 60 == 0).all()


def test_inputs_of_a_design_are_uncorrelated_and_the_best_comes_first(tmp_path: Path) -> None:
    m = problems.heat_exchanger()
    t = np.arange(0, 1800.0, 2.0)
    base = np.tile([0.4, 0.4, 70.0, 30.0], (len(t), 1))
    signals = [Signal("Thin", (65.0, 75.0), 10.0), Signal("mh", (0.31, 0.37, 0.5, 0.71), 10.0)]
    designs = candidates(m, signals, base, t, count=4, limit=0.3)
    assert all(d.correlation() <= 0.3 for d in designs)
    scored = d_optimal(m, designs, outputs={"Tho": 50.0, "Tco": 45.0})
    assert [d.score for d in scored] == sorted((d.score for d in scored), reverse=True)
    still = d_optimal(m, [type(designs[0])(t, base, m.symbols["inputs"], ("mh",))], outputs={"Tho": 50.0, "Tco": 45.0})[
        0
    ]
    assert scored[0].score > still.score
    assert scored[0].errors["Mh"] < still.errors["Mh"]
    scored[0].write_csv(tmp_path / "design.csv")
    rows = list(csv.reader((tmp_path / "design.csv").open()))
    assert rows[0] == ["t_s", "Thin", "mh"]
    assert len(rows) > 10


def test_cross_correlation_is_the_definition() -> None:
    random = np.random.default_rng(0)
    u, v = random.normal(size=50), random.normal(size=50)
    a, b = u - u.mean(), v - v.mean()
    direct = [float((np.roll(a, -k) * b).sum() / np.sqrt((a**2).sum() * (b**2).sum())) for k in range(50)]
    np.testing.assert_allclose(cross_correlation(u, v), direct, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Signal("u", (1.0, 2.0, 3.0), 10.0), "3 levels; give 2, 4, 8"),
        (lambda: Signal("u", (1.0, 9.0), 10.0, 2.0), "neighbouring levels are 8 apart"),
        (lambda: Signal("u", (1.0, 2.0), 0.0), "dwell time 0"),
        (lambda: prms(3, 5), "power of two"),
        (lambda: prbs(1), "register of 1"),
        (
            lambda: candidates(problems.ou1d(), [Signal("q", (0, 1), 1)], np.zeros((9, 1)), np.arange(9.0)),
            "no input 'q'; known: u",
        ),
    ],
)
def test_impossible_designs_are_refused(make: object, message: str) -> None:
    with pytest.raises(DesignError, match=message):
        make()  # type: ignore[operator]


def test_what_an_experiment_cannot_show_is_left_out_of_its_score() -> None:
    """Window area without sun: no design shows it; the others are compared on what they show."""
    m = problems.flexhouse("TiTe")
    t = np.arange(0, 48.0, 5 / 60)
    base = np.tile([5.0, 0.0, 0.0], (len(t), 1))
    scored = d_optimal(m, candidates(m, [Signal("Ph", (0.0, 5.0), 0.5)], base, t, count=3), outputs={"yTi": 20.0})
    assert all(d.errors["Aw"] == np.inf for d in scored)
    assert all(np.isfinite(d.score) and d.errors["Ci"] < 0.2 for d in scored)
    assert scored[0].plot().axes[0].get_ylabel() == "Ph [1]"
