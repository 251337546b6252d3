"""The plant is what its filters think it is: innovations are white when healthy, and a fault shows where it is."""

import numpy as np
import pytest

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.plant.district import POINTS, TRUTH, models
from fdd.plant.faults import DAY, PlantFault
from fdd.plant.scenario import Scenario, simulate

LEARN = 21 * 288


def data(frame, name, model, rows):
    part = frame.iloc[rows]
    roles = POINTS[name]
    u, y = (part[[roles[s] for s in model.symbols[t]]].to_numpy() for t in ("inputs", "outputs"))
    return Data(np.arange(len(part)) * 300.0, u, y, name=name)


def innovations(frame, fitted, name, rows):
    model = models()[name]
    values = np.array([fitted[name][s] for s in model.symbols["parameters"]])
    return Likelihood(model, data(frame, name, model, rows)).paths(values)[0].standardised[1:]


@pytest.fixture(scope="module")
def fitted():
    """Parameters from three healthy weeks, started where drawings would."""
    frame = simulate(Scenario(days=21, seed=11))
    found = {}
    for name, model in models().items():
        start = {s: float(f"{v:.0e}") for s, v in TRUTH[name].items() if s in model.symbols["parameters"]}
        found[name] = fit(model, data(frame, name, model, slice(0, LEARN)), start=start, errors="fisher")
    return found


def test_true_parameters_lie_within_their_intervals(fitted):
    z = [
        (r.params[s] - TRUTH[name][s]) / r.bse[s]
        for name, r in fitted.items()
        for s in r.params
        if s in TRUTH[name] and not s.startswith("sigma") and np.isfinite(r.bse[s]) and r.bse[s] > 0
    ]
    assert len(z) >= 15
    assert np.abs(z).max() < 4.0
    assert np.mean(np.square(z)) < 3.0


def test_healthy_innovations_of_later_weeks_are_white_and_standard(fitted):
    frame = simulate(Scenario(days=49, seed=11))
    parameters = {n: r.params for n, r in fitted.items()}
    for name in fitted:
        z = innovations(frame, parameters, name, slice(LEARN, None))
        n = len(z)
        # Six standard errors: parameters are estimated, so that a small part of the input shows in the innovations.
        assert np.abs(z.mean(axis=0)).max() < 0.08, name
        assert np.abs(z.std(axis=0) - 1).max() < 6 / np.sqrt(2 * n), name
        for lag in (1, 2, 12, 288):
            r = (z[lag:] * z[:-lag]).mean(axis=0)
            assert np.abs(r).max() < 6 / np.sqrt(n), (name, lag)


def test_growing_fouling_shows_on_the_heat_exchanger_only(fitted):
    fault = PlantFault("fouling", "hx", 28 * DAY, 0.25, "ramp", 14 * DAY)
    frame = simulate(Scenario(days=49, seed=11, faults=(fault,)))
    parameters = {n: r.params for n, r in fitted.items()}
    for name in fitted:
        z = innovations(frame, parameters, name, slice(35 * 288, None))
        mean = np.abs(z.mean(axis=0)).max()
        if name == "hx":
            assert mean > 5.0
        else:
            assert mean < 0.1, name
