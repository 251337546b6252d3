from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fdd.greybox.alternatives import Kind, estimated, filtered
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.simulate import realise
from tests.greybox import problems
from tests.greybox.records import kernel_record, ou1d

VALUES = np.array([0.5, 2.9, 0.4, -1.0, -1.0, -2.0, -1.0])


def squared() -> tuple[object, Data]:
    m = dataclasses.replace(
        problems.ou2d(), name="squared", observe=lambda x, u, p: {"y1": x.x1 * x.x1 / 6, "y2": x.x1 * x.x2 / 3}
    )
    t = np.arange(40) * 0.1
    return m, realise(m, VALUES, Data(t, np.sin(t)[:, None], np.zeros((40, 2))), seed=2)


@pytest.mark.parametrize("kind", ["extended", "iterated", "unscented"])
def test_all_filters_are_one_for_a_linear_model(kind: Kind) -> None:
    d = ou1d("_missing")
    short = Data(d.t[:80], d.u[:80], d.y[:80])
    values = np.array([5.29, 2.98, 0.22, -2.48])
    expected = Likelihood(problems.ou1d(), short).value(values)
    assert filtered(problems.ou1d(), short, values, kind).value == pytest.approx(expected, abs=2e-4)


def test_the_kernel_is_the_plain_extended_filter_for_nonlinear_drift() -> None:
    d, m = kernel_record("radiator"), problems.radiator()
    short = Data(d.t[:40], d.u[:40], d.y[:40])
    values = np.array([q.typical for q in m.parameters])
    plain = filtered(m, short, values, "extended", substeps=4).value
    assert Likelihood(m, short, substeps=4).value(values) == pytest.approx(plain, rel=1e-6)


def test_the_kernel_is_the_plain_extended_filter_for_nonlinear_outputs() -> None:
    m, d = squared()
    plain = filtered(m, d, VALUES, "extended", substeps=20)  # type: ignore[arg-type]
    assert Likelihood(m, d).value(VALUES) == pytest.approx(plain.value, rel=1e-6)  # type: ignore[arg-type]


def test_iterating_changes_only_nonlinear_updates() -> None:
    m, d = squared()
    plain, iterated = (filtered(m, d, VALUES, k) for k in ("extended", "iterated"))  # type: ignore[arg-type]
    assert np.abs(plain.state - iterated.state).max() > 1e-4
    assert np.isfinite(iterated.value)


def test_unscented_prediction_has_the_exact_mean_of_a_square() -> None:
    """E[x^2] = mean^2 + variance: the extended filter misses the variance."""
    m, d = squared()
    first = filtered(m, d, VALUES, "unscented")  # type: ignore[arg-type]
    assert d.y[0, 0] - first.innovation[0, 0] == pytest.approx((9.0 + 0.1) / 6, rel=1e-9)


def test_estimates_by_another_filter_are_the_same_for_a_linear_model() -> None:
    d = ou1d()
    short = Data(d.t[:30], d.u[:30], d.y[:30])
    extended = fit(problems.ou1d(), short, errors="fisher")
    other = estimated(problems.ou1d(), short, "unscented", start=extended)
    assert other.converged
    assert other.llf == pytest.approx(extended.llf, abs=2e-3)
    for name, error in extended.bse.items():
        assert other.params[name] == pytest.approx(extended.params[name], abs=0.02 * error)
        assert other.bse[name] == pytest.approx(error, rel=0.02)


def test_estimates_by_the_unscented_filter_are_the_most_likely_by_it() -> None:
    """Outputs that are squares of a state known badly: the extended filter's estimates are not the best there."""
    m, d = squared()
    start = fit(m, d, fixed={"lr1": -2.0, "lr2": -1.0, "ls1": -1.0, "ls2": -1.0}, errors="fisher")  # type: ignore[arg-type]
    other = estimated(m, d, "unscented", start=start, substeps=2)  # type: ignore[arg-type]
    assert set(other.bse) == {"lth", "mu", "lal"}
    at_start = filtered(m, d, start.values, "unscented", substeps=2).value  # type: ignore[arg-type]
    assert -other.llf <= at_start + 1e-9
    values = np.array(list(other.params.values()))
    for k in range(3):  # no neighbour is better
        for sign in (1, -1):
            moved = values + sign * 0.3 * other.bse[list(other.bse)[k]] * (np.arange(7) == k)
            assert filtered(m, d, moved, "unscented", substeps=2).value > -other.llf  # type: ignore[arg-type]
    for name, error in other.bse.items():
        assert (
            abs(other.params[name] - dict(zip(problems.ou2d().symbols["parameters"], VALUES, strict=True))[name])
            < 3 * error
        )
