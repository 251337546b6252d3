"""The benchmark's own sets: models that can be drawn and fitted, and truths that are those of the draw."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.identification import exchanger_set, radiator_set, unknown_heater, zone_set
from fdd.greybox.fit import fit


@pytest.mark.parametrize("made", [radiator_set, zone_set, exchanger_set])
def test_estimates_lie_within_their_errors_of_the_truth(made: object) -> None:
    m, truth, data = made(7)  # type: ignore[operator]
    found = fit(m, data, start=truth)
    z = [
        (found.params[q.symbol] - truth[q.symbol]) / found.bse[q.symbol]
        for q in m.parameters
        if q.kind == "physical" and np.isfinite(found.bse[q.symbol])
    ]
    assert z
    assert np.abs(z).max() < 4


def test_nothing_on_the_flat_direction_has_an_error() -> None:
    m, data, moving = unknown_heater(3)
    found = fit(m, data)
    assert set(found.unidentifiable) == set(moving)
