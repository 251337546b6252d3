"""Run a model's equations on plain floats: what a declaration says, without kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fdd.models.declare import ComponentModel

Array = NDArray[np.float64]


def typical(model: ComponentModel, **changed: float) -> SimpleNamespace:
    """Parameters at their typical values, some changed."""
    return SimpleNamespace(**{p.symbol: p.typical for p in model.parameters} | changed)


def drift(model: ComponentModel, x: Array, u: Mapping[str, float], p: SimpleNamespace) -> Array:
    """dx/dt in the order of the states."""
    state = SimpleNamespace(**dict(zip((s.symbol for s in model.states), map(float, x), strict=True)))
    rates = model.drift(state, SimpleNamespace(**u), p)
    return np.array([rates[s.symbol] for s in model.states])


def simulate(
    model: ComponentModel,
    x0: Array,
    u: Mapping[str, float],
    p: SimpleNamespace,
    end: float,
    extra: Callable[[Array], Array] | None = None,
) -> tuple[Array, Array]:
    """State at ``end`` [s] and the integrals of ``extra(x)``, to 1e-12."""
    n = len(x0)

    def rates(t: float, z: Array) -> Array:
        more = extra(z[:n]) if extra else np.zeros(0)
        return np.concatenate([drift(model, z[:n], u, p), more])

    size = len(extra(x0)) if extra else 0
    done = solve_ivp(rates, (0.0, end), np.concatenate([x0, np.zeros(size)]), method="DOP853", rtol=1e-12, atol=1e-12)
    assert done.success, done.message
    return done.y[:n, -1], done.y[n:, -1]


def steady(model: ComponentModel, x0: Array, u: Mapping[str, float], p: SimpleNamespace, end: float) -> Array:
    """Where the state settles after ``end`` seconds, integrated implicitly."""
    done = solve_ivp(lambda t, x: drift(model, x, u, p), (0.0, end), x0, method="LSODA", rtol=1e-10, atol=1e-10)
    assert done.success, done.message
    return done.y[:, -1]


def jacobian(model: ComponentModel, x: Array, u: Mapping[str, float], p: SimpleNamespace) -> Array:
    """Central differences of the drift, (n, n)."""
    step = 1e-4
    eye = np.eye(len(x)) * step
    return np.array([(drift(model, x + e, u, p) - drift(model, x - e, u, p)) / (2 * step) for e in eye]).T
