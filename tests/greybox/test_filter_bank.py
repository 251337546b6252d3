from __future__ import annotations

import json

import numpy as np
import pytest

from fdd.greybox.filter_bank import STATUS, FilterBank
from fdd.greybox.likelihood import Likelihood
from tests.greybox import problems
from tests.greybox.records import kernel_record


def run(bank: FilterBank, d: object, steps: range, y: np.ndarray | None = None) -> list:
    n = len(bank)
    out = []
    for k in steps:
        dt = np.full(n, d.dt[k - 1] if k else 0.0)  # type: ignore[attr-defined]
        rows = np.tile(d.y[k], (n, 1)) if y is None else y[k]  # type: ignore[attr-defined]
        out.append(bank.step(dt, np.tile(d.u[k], (n, 1)), rows, np.ones(n, bool)))  # type: ignore[attr-defined]
    return out


def typical(m: object, n: int = 1) -> np.ndarray:
    return np.tile([q.typical for q in m.parameters], (n, 1))  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", list(problems.KERNEL_PROBLEMS))
def test_bank_gives_what_the_likelihood_saw(name: str) -> None:
    m, d = problems.KERNEL_PROBLEMS[name](), kernel_record(name)
    path = Likelihood(m, d).paths(typical(m)[0])[0]
    steps = run(FilterBank(m, typical(m, 3)), d, range(60))
    assert STATUS[steps[0].status[1]] == "started"
    for k, s in enumerate(steps[1:], 1):
        assert (s.status == 0).all()
        np.testing.assert_allclose(s.predicted[2], path.predicted[k], rtol=1e-10)
        np.testing.assert_allclose(s.variance[2], path.variance[k], rtol=1e-8)
        np.testing.assert_allclose(s.standardised[2], path.standardised[k], rtol=1e-6, atol=1e-8)


def test_scores_add_up_to_the_gradient_for_a_parameter_of_the_drift() -> None:
    """The innovation variance of the OU process does not depend on mu: its whole gradient is the score."""
    m = problems.ou1d()
    t, values = np.arange(50) * 0.1, np.array([5.0, 3.0, 0.2, -1.5])
    random = np.random.default_rng(0)
    from fdd.greybox.likelihood import Data

    d = Data(t, random.normal(size=(50, 1)), 3 + random.normal(size=(50, 1)))
    whole = Likelihood(m, d).evaluate(values)
    total = sum(s.score[0] for s in run(FilterBank(m, values[None]), d, range(50)))
    info = sum(s.information[0] for s in run(FilterBank(m, values[None]), d, range(50)))
    assert -total[1] == pytest.approx(whole.gradient[1], rel=1e-9)
    assert info[1, 1] == pytest.approx(whole.information[1, 1], rel=1e-9)


def test_score_is_minus_the_gradient_at_the_first_sample_too_late_to_matter() -> None:
    m = problems.building()
    bank = FilterBank(m, typical(m, 2))
    s = run(bank, kernel_record("building"), range(3))[-1]
    assert s.score.shape == (2, 15)
    assert s.information.shape == (2, 15, 15)
    np.testing.assert_allclose(s.information[0], s.information[0].T)
    assert np.linalg.eigvalsh(s.information[0]).min() > -1e-9 * s.information[0].max()


def test_a_bad_row_never_spreads() -> None:
    m, d = problems.radiator(), kernel_record("radiator")
    parameters = typical(m, 5)
    y = np.tile(d.y[:, None], (1, 5, 1))
    y[7, 1] = np.nan  # missing
    y[8, 2] = np.inf  # nonsense
    y[9, 3] = 1e300
    clean = run(FilterBank(m, parameters), d, range(20))
    steps = run(FilterBank(m, parameters), d, range(20), y)
    for k in range(20):
        for row in (0, 4):
            np.testing.assert_array_equal(steps[k].innovation[row], clean[k].innovation[row])
    assert np.isnan(steps[7].innovation[1]).all()
    assert np.isfinite(steps[8].innovation[1]).all()
    assert np.isnan(steps[8].innovation[2]).all()
    words = {STATUS[s.status[3]] for s in steps[9:]}
    assert any(w.startswith("restarting") for w in words)
    assert "started" in words
    assert steps[-1].status[3] == 0
    assert np.isfinite(steps[-1].innovation[3]).all()


def test_inactive_rows_are_left_as_they_were() -> None:
    m, d = problems.building(), kernel_record("building")
    bank = FilterBank(m, typical(m, 2))
    run(bank, d, range(5))
    before = bank.export_state()["state"][1].copy()
    s = bank.step(np.full(2, d.dt[5]), np.tile(d.u[5], (2, 1)), np.tile(d.y[5], (2, 1)), np.array([True, False]))
    np.testing.assert_array_equal(bank.export_state()["state"][1], before)
    assert STATUS[s.status[1]] == "not active"
    assert np.isnan(s.innovation[1]).all()


def test_restored_state_goes_on_to_the_bit() -> None:
    m, d = problems.building(), kernel_record("building")
    bank = FilterBank(m, typical(m, 2))
    run(bank, d, range(10))
    state = bank.export_state()
    state = {
        k: np.array(json.loads(json.dumps(v.tolist()))) if isinstance(v, np.ndarray) else v for k, v in state.items()
    }
    other = FilterBank(m, typical(m, 2) * 1.1)
    other.restore_state(state)
    for a, b in zip(run(bank, d, range(10, 20)), run(other, d, range(10, 20)), strict=True):
        np.testing.assert_array_equal(a.innovation, b.innovation)
        np.testing.assert_array_equal(a.score, b.score)


def test_restore_refuses_another_model() -> None:
    m = problems.building()
    state = FilterBank(m, typical(m, 2)).export_state()
    with pytest.raises(ValueError, match="model_version"):
        FilterBank(m, typical(m, 2)).restore_state({**state, "model_version": "0"})
    with pytest.raises(ValueError, match="shape"):
        FilterBank(m, typical(m, 3)).restore_state(state)


def test_new_parameters_take_hold_of_running_filters() -> None:
    m, d = problems.building(), kernel_record("building")
    new = typical(m, 2)
    new[1, 0] *= 1.5
    bank = FilterBank(m, typical(m, 2))
    run(bank, d, range(10))
    x, _ = bank.states()
    bank.set_parameters([1], new[1:])
    np.testing.assert_array_equal(bank.states()[0], x)
    s = run(bank, d, range(10, 40))[-1]
    assert s.predicted[0, 0] != s.predicted[1, 0]
    started = FilterBank(m, new)
    run(started, d, range(10))
    late = run(started, d, range(10, 40))[-1]
    np.testing.assert_allclose(s.predicted[1], late.predicted[1], atol=0.05)


def test_moved_parameters_take_their_states_with_them_by_the_tangents() -> None:
    """Central differences of whole runs with other parameters are the outside number."""
    m, d = problems.building(), kernel_record("building")
    at, by = 0, 1e-3
    rows = typical(m, 3)
    rows[1, at] *= np.exp(by)
    rows[2, at] *= np.exp(-by)
    bank = FilterBank(m, rows)
    run(bank, d, range(60))
    x, _ = bank.states()
    derivative = (x[1] - x[2]) / (2 * by)
    shift = np.zeros((1, rows.shape[1]))
    shift[0, at] = 0.01
    bank.move(np.array([0]), shift)
    moved = bank.states()[0]
    assert np.abs(derivative).max() > 1e-3  # the state does hang on this parameter
    np.testing.assert_allclose(moved[0] - x[0], 0.01 * derivative, rtol=0.05, atol=2e-4 * np.abs(derivative).max())
    np.testing.assert_array_equal(moved[1:], x[1:])
    assert bank.parameters[0, at] == pytest.approx(rows[0, at] * np.exp(0.01))


def test_time_that_does_not_increase_and_missing_inputs_have_words() -> None:
    m, d = problems.building(), kernel_record("building")
    bank = FilterBank(m, typical(m, 2))
    run(bank, d, range(3))
    u = np.tile(d.u[3], (2, 1))
    u[1, 0] = np.nan
    s = bank.step(np.array([0.0, d.dt[2]]), u, np.tile(d.y[3], (2, 1)))
    assert STATUS[s.status[0]] == "time did not increase"
    assert STATUS[s.status[1]] == "input missing, last value held"
    assert np.isfinite(s.innovation[1]).all()


def test_an_input_that_moved_unseen_leaves_the_state_halfway_and_less_certain() -> None:
    """The scalar Ornstein-Uhlenbeck filter by hand: both predictions, their moments, then the measurement."""
    theta, mu, sigma, noise, h, old, new, y = 0.8, 3.0, 0.5, 0.2, 0.7, 0.0, 2.0, 4.2
    values = np.array([[theta, mu, np.log(sigma), np.log(noise)]] * 9)
    bank, told = FilterBank(problems.ou1d(), values), np.arange(9) == 7
    for measured in (3.0, 3.3):
        bank.step(np.full(9, h), np.full((9, 1), old), np.full((9, 1), measured))
    (x,), (P,) = (a[7].ravel() for a in bank.states())
    done = bank.step(np.full(9, h), np.full((9, 1), new), np.full((9, 1), y), unseen=told)
    a = np.exp(-theta * h)
    stayed, moved = (a * x + (1 - a) * (mu + u) for u in (old, new))
    middle = (stayed + moved) / 2
    spread = a * a * P + sigma**2 * (1 - a * a) / (2 * theta) + (moved - middle) ** 2
    gain = spread / (spread + noise**2)
    found, covariance = bank.states()
    assert (done.status == 0).all()
    assert found[7, 0] == pytest.approx(middle + gain * (y - middle), rel=1e-5)
    assert covariance[7, 0, 0] == pytest.approx((1 - gain) * spread, rel=1e-5)
    assert found[6, 0] != found[7, 0]
    assert found[6, 0] == found[8, 0]
    # The next step starts from the new input.
    late = bank.step(np.full(9, h), np.full((9, 1), new), np.full((9, 1), y))
    assert late.predicted[7, 0] == pytest.approx(a * found[7, 0] + (1 - a) * (mu + new), rel=1e-5)


def test_an_absurd_input_that_moved_unseen_breaks_its_own_row_only() -> None:
    m, d = problems.radiator(), kernel_record("radiator")
    bank, plain = FilterBank(m, typical(m, 3)), FilterBank(m, typical(m, 3))
    run(bank, d, range(5))
    run(plain, d, range(5))
    u, y, dt = np.tile(d.u[5], (3, 1)), np.tile(d.y[5], (3, 1)), np.full(3, d.dt[4])
    u[1] = 1e300
    s = bank.step(dt, u, y, unseen=[False, True, False])
    np.testing.assert_array_equal(s.predicted, plain.step(dt, u, y).predicted)
    s = bank.step(dt, u, y)
    assert STATUS[s.status[1]].startswith("restarting")
    assert (s.status[[0, 2]] == 0).all()


def test_wrong_shape_or_parameter_is_refused_by_name() -> None:
    m = problems.building()
    bad = typical(m, 2)
    bad[1, 2] = np.nan
    with pytest.raises(ValueError, match="parameter Bn of component 1 is nan"):
        FilterBank(m, bad)
    with pytest.raises(ValueError, match="shape"):
        FilterBank(m, typical(m)[:, :3])
