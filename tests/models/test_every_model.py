"""What must hold for every declared model and every variant its options name: limits, signs, balances, recovery."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.component_balances import BALANCES, closure
from benchmarks.component_cases import CASES, recover
from fdd.models.declare import ComponentModel, ModelError
from fdd.models.registry import MODELS, get_model
from tests.models.numeric import drift, typical


def variants() -> list[tuple[str, dict[str, Any]]]:
    """Every model as it is by default, and with every named or yes-or-no option changed."""
    found: list[tuple[str, dict[str, Any]]] = []
    for name, factory in MODELS.items():
        found.append((name, {}))
        hints = get_type_hints(factory)
        for option, parameter in inspect.signature(factory).parameters.items():
            for value in _values(hints[option]):
                if value != parameter.default and _makes(name, option, value):
                    found.append((name, {option: value}))
    return found


def _values(hint: Any) -> list[Any]:
    if get_origin(hint) is Literal:
        return list(get_args(hint))
    if hint is bool:
        return [True, False]
    return [v for part in get_args(hint) for v in _values(part)]


def _makes(name: str, option: str, value: Any) -> bool:
    try:
        get_model(name, **{option: value})
    except ModelError:  # options that exclude each other
        return False
    return True


VARIANTS = variants()
EVERY = pytest.mark.parametrize(("name", "options"), VARIANTS, ids=[f"{n} {o}" if o else n for n, o in VARIANTS])


def test_variants_are_found():
    assert len(VARIANTS) >= 30
    assert ("thermostatic_valve", {"friction": "bliman-sorine"}) in VARIANTS
    assert ("pipe_thermal", {"wall": True}) in VARIANTS


def levels(model: ComponentModel, rng: np.random.Generator) -> dict[str, float]:
    """Inputs anywhere in their range, or at its ends, or at nothing."""
    u = {}
    for q in model.inputs:
        low, high = model.valid.get(q.symbol, (-20.0, 90.0) if q.unit == "degC" else (0.0, 1.0))
        tries = [low, high, min(max(0.0, low), high), rng.uniform(low, high)]
        u[q.symbol] = float(tries[rng.integers(len(tries))])
    return u


def states(model: ComponentModel, rng: np.random.Generator) -> np.ndarray:
    """Any state: the cold side warmer than the hot one, rooms warmer than radiators, flows backwards."""
    return np.array([rng.uniform(-10, 90) if s.unit == "degC" else s.initial_sd * rng.normal() for s in model.states])


@EVERY
def test_rates_and_their_slopes_are_finite_at_every_limit(name, options):
    model = get_model(name, **options)
    p, rng = typical(model), np.random.default_rng(0)
    for _ in range(40):
        u, x = levels(model, rng), states(model, rng)
        if rng.random() < 0.3:  # all equally warm, where a power of the difference has its kink
            x = np.where([s.unit == "degC" for s in model.states], 20.0, x)
            u |= {q.symbol: 20.0 for q in model.inputs if q.unit == "degC"}
        rates = drift(model, x, u, p)
        assert np.isfinite(rates).all(), (u, x)
        for j in range(len(x)):
            step = 1e-6 * max(1.0, abs(x[j]))
            beside = drift(model, x + step * np.eye(len(x))[j], u, p)
            assert np.isfinite(beside).all()
            assert np.abs(beside - rates).max() <= 1e6 * step * max(1.0, np.abs(rates).max()), (u, x, j)


NO_HEAT = {"T_cold": 20.0, "T_hot": 20.0, "f_fan": 0.0, "b_off": 0.0}
"""Of the air handler: its waters, its fan and its surroundings, which are parameters"""
THERMAL = [(n, o) for n, o in VARIANTS if any(s.unit == "degC" for s in get_model(n, **o).states)]
EVERY_THERMAL = pytest.mark.parametrize(("name", "options"), THERMAL, ids=[f"{n} {o}" if o else n for n, o in THERMAL])


@EVERY_THERMAL
def test_nothing_warms_or_cools_where_all_is_equally_warm(name, options):
    model = get_model(name, **options)
    p = typical(model, **{s: v for s, v in NO_HEAT.items() if s in model.symbols["parameters"]})
    rng = np.random.default_rng(1)
    warm = np.array([s.unit == "degC" for s in model.states])
    for _ in range(10):
        u = levels(model, rng)
        u |= {q.symbol: 20.0 if q.unit == "degC" else 0.0 for q in model.inputs if q.unit in ("degC", "W", "W/m^2")}
        rates = drift(model, np.where(warm, 20.0, 0.1), u, p)
        assert np.abs(rates[warm]).max() < 1e-12, u


@EVERY_THERMAL
def test_heat_flows_the_other_way_when_all_differences_are_reversed(name, options):
    """T below the surroundings: what lost heat gains it, and as fast, for any power of the difference."""
    model = get_model(name, **options)
    if options.get("transfer") == "flow-temperature":
        pytest.skip("its transfer coefficient depends on the temperature itself")
    given = {s: v for s, v in NO_HEAT.items() if s in model.symbols["parameters"]}
    p, rng = typical(model, **given), np.random.default_rng(2)
    warm = np.array([s.unit == "degC" for s in model.states])
    for _ in range(10):
        u = levels(model, rng) | {q.symbol: 0.0 for q in model.inputs if q.unit in ("W", "W/m^2")}
        x = np.where(warm, states(model, rng), 0.1)
        mirrored = {q.symbol: 40.0 - u[q.symbol] if q.unit == "degC" else u[q.symbol] for q in model.inputs}
        rates, back = drift(model, x, u, p), drift(model, np.where(warm, 40.0 - x, x), mirrored, p)
        assert back[warm] == pytest.approx(-rates[warm], rel=1e-9, abs=1e-12), u


FLOWING = [
    (n, o) for n, o in THERMAL if any(q.unit == "kg/s" for q in get_model(n, **o).inputs) and o.get("form") != "printed"
]


@pytest.mark.parametrize(("name", "options"), FLOWING, ids=[f"{n} {o}" if o else n for n, o in FLOWING])
def test_a_reversed_flow_carries_no_heat(name, options):
    """What flows back has a temperature that nobody measures, and meters at rest read a little below zero."""
    model = get_model(name, **options)
    p, rng = typical(model), np.random.default_rng(4)
    flows, carried = [q.symbol for q in model.inputs if q.unit == "kg/s"], []
    for _ in range(10):
        x = np.where([s.unit == "degC" for s in model.states], states(model, rng), 0.1)
        u = levels(model, rng)
        still = drift(model, x, u | dict.fromkeys(flows, 0.0), p)
        for back in (-1e-9, -0.05, -1.0):
            np.testing.assert_array_equal(drift(model, x, u | dict.fromkeys(flows, back), p), still)
        carried.append(np.abs(drift(model, x, u | dict.fromkeys(flows, 0.05), p) - still).max())
    assert max(carried) > 0


ODD = ["pipe_hydraulic", "control_valve"]


@pytest.mark.parametrize("name", ODD)
def test_reversed_pressure_reverses_the_flow(name):
    model = get_model(name)
    p, rng = typical(model), np.random.default_rng(3)
    for _ in range(20):
        u, m = levels(model, rng), rng.normal() * 0.05
        rate = drift(model, np.array([m]), u, p)[0]
        back = drift(model, np.array([-m]), u | {"dp": -u["dp"]}, p)[0]
        assert back == pytest.approx(-rate, rel=1e-9, abs=1e-12)


def test_a_relief_valve_does_not_open_for_reversed_pressure():
    model = get_model("relief_valve")
    p = typical(model)
    forward, back = (drift(model, np.zeros(1), {"dp": dp}, p)[0] for dp in (4e4, -4e4))
    assert back < 0
    assert abs(back) < 2 * p.leak * forward


def test_every_thermal_model_has_a_balance():
    with_heat = {n for n, _ in THERMAL}
    assert {b.model.name for b in BALANCES.values()} == with_heat


@pytest.mark.parametrize("name", sorted(BALANCES))
def test_energy_balance_closes(name):
    assert closure(BALANCES[name]) < 1e-9


def test_a_balance_notices_a_thousandth_of_lost_heat():
    good = BALANCES["cooling coil"]
    leaking = good.model.drift

    def drifts(x: Any, u: Any, p: Any) -> Any:
        rates = dict(leaking(x, u, p))
        return rates | {"T_s": rates["T_s"] + 1e-3 * (p.T_cold - x.T_s) / p.tau_s}

    assert closure(replace(good, model=replace(good.model, drift=drifts))) > 1e-5


def test_every_model_has_a_case_to_be_recovered_from():
    assert set(CASES) == set(MODELS)
    assert all(case.model == name for name, case in CASES.items())


def recovered(name: str, seeds: range) -> None:
    """True parameters lie in their 95 % intervals, and innovations pass for white at 1 %, as often as chance allows."""
    found = [recover(name, seed) for seed in seeds]
    inside, of, white, outputs = (sum(r[k] for r in found) for k in ("inside", "of", "white", "outputs"))
    assert of > 0
    # Estimates of one record depend on each other: as if there were half as many of them.
    assert inside >= 2 * binom.ppf(1e-3, of // 2, 0.95), found
    assert white >= binom.ppf(1e-3, outputs, 0.99), found


@pytest.mark.parametrize("name", sorted(CASES))
def test_true_parameters_are_found_again_and_innovations_are_white(name):
    recovered(name, range(2))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CASES))
def test_intervals_cover_the_truth_over_many_records(name):
    recovered(name, range(100, 120))
