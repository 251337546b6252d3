"""Run lengths against the R package spc 0.6.7 (tests/oracle) and against plain simulation."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng

from fdd.residual_monitors.run_length import (
    Rule,
    alarm_probability,
    arl,
    baseline_effect,
    false_alarm_rate,
    limit_for,
    run_length_quantile,
)

TOLERANCE = {"cusum": 0.005, "cusum370": 0.005, "ewma": 0.005, "mewma": 0.01}
STARTS: dict[str, Any] = {"FIR h/2": 0.5, "steady": "steady"}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def rule_of(row: dict[str, str]) -> Rule:
    kind, constant = row["kind"].split()[0], float(row["k_or_lambda"])
    if kind.startswith("cusum"):
        return Rule("cusum", k=constant, sided=2 if row["sided"] == "two" else 1)
    if kind == "ewma":
        return Rule("ewma", lam=constant, exact="vacl" in row["start"])
    return Rule("mewma", lam=constant, dimension=int(row["kind"].split("p=")[1][0]))


@pytest.mark.parametrize("kind", sorted(TOLERANCE))
def test_arl_agrees_with_spc(oracle: Path, kind: str) -> None:
    of_kind = [r for r in rows(oracle / "arl_oracle.csv") if r["kind"].split()[0] == kind]
    assert len(of_kind) >= 18
    for row in of_kind:
        start = STARTS.get(row["start"], "zero")
        own = arl(rule_of(row), float(row["h_or_L"]), float(row["shift"]), start)
        assert own == pytest.approx(float(row["ARL"]), rel=TOLERANCE[kind]), row


def test_limit_for_agrees_with_spc(oracle: Path) -> None:
    for row in rows(oracle / "cusum_design_h.csv"):
        k = float(row["k"])
        h = float(limit_for("cusum", float(row["ARL0"]), k=k))
        assert h == pytest.approx(float(row["h_two_sided"]), abs=1e-3)
        for shift, name in ((0.5, "ARL(0.5s)"), (1.0, "ARL(1s)"), (2.0, "ARL(2s)")):
            assert arl(Rule("cusum", k=k), h, shift) == pytest.approx(float(row[name]), rel=0.005)


@pytest.mark.parametrize(
    "options",
    [
        {"kind": "cusum", "k": 0.5},
        {"kind": "cusum", "k": 0.25, "sided": 1},
        {"kind": "cusum", "k": 0.5, "head_start": 0.5},
        {"kind": "ewma", "lam": 0.05},
        {"kind": "ewma", "lam": 0.2, "exact": True},
        {"kind": "mewma", "lam": 0.1, "dimension": 4},
        {"kind": "shewhart"},
    ],
    ids=str,
)
@pytest.mark.parametrize("wanted", [50.0, 1e4, 1e7])
def test_limit_for_is_the_inverse_of_arl(options: dict[str, Any], wanted: float) -> None:
    limit = float(limit_for(in_control_arl=wanted, **options))
    given = dict(options)
    start = given.pop("head_start", "zero")
    assert arl(Rule(**given), limit, 0.0, start) == pytest.approx(wanted, rel=1e-4)


def test_limit_for_keeps_the_shape_and_solves_equal_targets_once() -> None:
    limits = limit_for("cusum", np.full((3, 4), 12345.0))
    assert limits.shape == (3, 4)
    assert np.unique(limits).size == 1


@pytest.mark.parametrize("kind", ["cusum", "ewma", "mewma"])
def test_a_limit_is_solved_in_tens_of_milliseconds(kind: Any) -> None:
    limit_for(kind, 3333.0)
    begun = time.perf_counter()
    limit_for(kind, 105_120.7)
    assert time.perf_counter() - begun < 0.25  # 2 to 10 ms alone; the margin is for a loaded machine


def simulate_cusum(h: float, k: float, shift: float, runs: int, head_start: float = 0.0) -> np.ndarray:
    """Run lengths of a two-sided CUSUM, written apart from the chart."""
    rng = default_rng(20)
    up, low = np.full(runs, h * head_start), np.full(runs, h * head_start)
    length, alive, t = np.zeros(runs, dtype=int), np.ones(runs, dtype=bool), 0
    while alive.any():
        t += 1
        z = rng.standard_normal(runs) + shift
        up, low = np.maximum(0, up + z - k), np.maximum(0, low - z - k)
        hit = alive & ((up > h) | (low > h))
        length[hit] = t
        alive &= ~hit
    return length


@pytest.mark.parametrize(("shift", "head_start"), [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (2.5, 0.0)])
def test_distribution_of_the_cusum_run_length_agrees_with_simulation(shift: float, head_start: float) -> None:
    rule, runs = Rule("cusum"), 20_000
    length = simulate_cusum(4.0, 0.5, shift, runs, head_start)
    start: Any = head_start or "zero"
    for n in (5, 20, 100):
        p = alarm_probability(rule, 4.0, n, shift, start)
        assert np.mean(length <= n) == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / runs) + 1e-3)
    for p in (0.1, 0.5, 0.9):
        n = run_length_quantile(rule, 4.0, p, shift, start)
        assert np.mean(length <= n) >= p - 0.012
        assert np.mean(length < n) <= p + 0.012


def test_quantile_and_probability_are_inverse() -> None:
    for rule, limit in ((Rule("cusum"), 10.4), (Rule("ewma", lam=0.1), 3.5), (Rule("shewhart"), 3.0)):
        n = run_length_quantile(rule, limit, 0.3)
        assert alarm_probability(rule, limit, n) >= 0.3 > alarm_probability(rule, limit, n - 1)


def test_mewma_under_a_shift_agrees_with_simulation() -> None:
    rng, lam, h, runs = default_rng(5), 0.1, 8.634, 20_000
    z, length, alive, t = np.zeros((runs, 2)), np.zeros(runs), np.ones(runs, dtype=bool), 0
    while alive.any():
        t += 1
        z = (1 - lam) * z + lam * (rng.standard_normal((runs, 2)) + np.array([0.5, 0.0]))
        hit = alive & ((2 - lam) / lam * (z**2).sum(axis=1) > h)
        length[hit] = t
        alive &= ~hit
    own = arl(Rule("mewma", lam=lam, dimension=2), h, 0.5)
    assert own == pytest.approx(length.mean(), abs=4 * length.std() / np.sqrt(runs))


def test_baseline_effect_agrees_with_published_simulation() -> None:
    """Simulated elsewhere: h = 5, k = 0.5, false alarm within 100 updates, to two digits."""
    for samples, probability in ((20, 0.45), (30, 0.39), (100, 0.26), (300, 0.22)):
        effect = baseline_effect(Rule("cusum"), 5.0, samples, 100)
        assert effect.probability == pytest.approx(probability, abs=0.012)
        assert effect.probability > effect.known
    assert baseline_effect(Rule("cusum"), 5.0, 30, 100).median == pytest.approx(152, rel=0.03)


def test_widening_for_the_baseline_restores_the_mean_rate() -> None:
    rule = Rule("cusum")
    narrow, wide = (float(limit_for("cusum", 5000.0, shift_sd=s)) for s in (0.0, 0.1))
    assert wide > narrow
    draws = default_rng(3).normal(0, 0.1, 400)
    rates = np.array([1 / arl(rule, wide, float(abs(d))) for d in draws])
    assert rates.mean() == pytest.approx(1 / 5000, abs=4 * rates.std() / 20)
    assert false_alarm_rate(rule, narrow, 0.1) > 1.5 / 5000


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: limit_for("cusum", 0.5), "above 1"),
        (lambda: limit_for("cusum", 1e16), "1e\\+15"),
        (lambda: limit_for("median", 100.0), "no run lengths"),  # type: ignore[arg-type]
        (lambda: arl(Rule("cusum"), -1.0), "positive"),
        (lambda: arl(Rule("ewma", exact=True), 3.0, 0.0, "steady"), "exact=False"),
        (lambda: arl(Rule("cusum"), 4.0, 0.0, 1.5), "share of the limit"),
        (lambda: Rule("ewma", lam=2.0), "lam is 2.0"),
        (lambda: Rule("cusum", k=-1.0), "k is -1.0"),
        (lambda: baseline_effect(Rule("cusum"), 5.0, 2, 100), "at least 5"),
        (lambda: run_length_quantile(Rule("cusum"), 5.0, 1.0), "inside"),
    ],
)
def test_bad_requests_say_what_to_do(call: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        call()


@pytest.mark.parametrize(
    ("rule", "limit"),
    [(Rule("cusum", k=0.1), 25.0), (Rule("cusum"), 10.4), (Rule("ewma", lam=0.02), 3.0), (Rule("mewma"), 20.0)],
    ids=str,
)
def test_distribution_and_mean_of_the_run_length_agree(rule: Rule, limit: float) -> None:
    """The mean is the sum of the survival over all updates: both ways of solving must say the same."""
    mean = arl(rule, limit)
    edges = np.unique(np.geomspace(1, 40 * mean, 4000).astype(int))
    survival = np.array([1 - alarm_probability(rule, limit, int(n)) for n in edges])
    total = 1 + np.sum((survival[1:] + survival[:-1]) / 2 * np.diff(edges))
    assert total == pytest.approx(mean, rel=0.02 if rule.kind == "cusum" and rule.k < 0.25 else 3e-3)
