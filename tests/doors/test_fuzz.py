"""Mutants of valid payloads against every decoder, reader and parser; a million of them in the slow suite."""

from __future__ import annotations

import warnings

import pytest

from benchmarks.doors.__main__ import SHARES
from benchmarks.doors.fuzz import Target, run, targets

QUICK, SLOW = 150, 1_000_000


@pytest.mark.parametrize("target", targets(), ids=lambda t: t.name)
def test_mutants_are_read_or_refused_in_the_doors_own_words(target: Target) -> None:
    _held(target, QUICK, 1)


@pytest.mark.slow
@pytest.mark.parametrize("target", targets(), ids=lambda t: t.name)
def test_a_million_mutants_are_read_or_refused_in_the_doors_own_words(target: Target) -> None:
    others = (1.0 - sum(SHARES.values())) / (len(targets()) - len(SHARES))
    _held(target, round(SLOW * SHARES.get(target.name, others)), 2)


def _held(target: Target, cases: int, seed: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcome = run(target, cases, seed)
    assert outcome.held, (outcome.crashed, outcome.hangs, outcome.crashes)
    assert outcome.grown_bytes < 300_000_000
