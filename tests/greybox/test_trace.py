from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace as Space
from typing import Any

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.greybox.equations import trace
from fdd.greybox.trace import Graph, Level
from fdd.models import functions as fn
from fdd.models.declare import ModelError
from tests.greybox import problems

CASES = {
    "gpow": lambda x, p: fn.gpow(x - p, 1.3),
    "exp": lambda x, p: fn.exp(-x * p) + x**3,
    "log": lambda x, p: fn.log(1 + x * x) * p,
    "sqrt": lambda x, p: fn.sqrt(x * x + p * p + 1),
    "tanh": lambda x, p: fn.tanh(x / (p + 20)) ** 2,
    "where": lambda x, p: fn.where(x > p, x * x, 3 * x),
    "min": lambda x, p: fn.minimum(x, p) * fn.maximum(x, 0.0),
    "trig": lambda x, p: fn.sin(x) * fn.cos(p * x),
    "power": lambda x, p: (x * x + 1) ** p / (2 + x * x),
    "abs": lambda x, p: fn.absolute(x) * p - fn.softplus(x) + fn.logistic(p),
    "smooth": lambda x, p: fn.smooth_maximum(x, p, 0.1) * fn.smooth_sign(x, 0.5),
}


def value(e: Any, x: float, p: float) -> float:
    """Evaluate a node by walking the graph."""
    names = {"x": x, "p": p}
    if e.op == "symbol":
        return names[e.value]
    if e.op == "constant":
        return float(e.value)
    a = [value(b, x, p) for b in e.args]
    plain = {
        "add": lambda: a[0] + a[1], "sub": lambda: a[0] - a[1], "mul": lambda: a[0] * a[1], "div": lambda: a[0] / a[1],
        "neg": lambda: -a[0], "pow": lambda: a[0] ** a[1], "lt": lambda: a[0] < a[1], "gt": lambda: a[0] > a[1],
        "le": lambda: a[0] <= a[1], "ge": lambda: a[0] >= a[1],
    }  # fmt: skip
    return plain[e.op]() if e.op in plain else fn._FLOAT[e.op](*a)


@pytest.mark.parametrize("name", list(CASES))
@settings(max_examples=30, deadline=None)
@given(x=st.floats(-3, 3), p=st.floats(0.2, 2.5))
def test_values_and_derivatives_are_those_of_the_function(name: str, x: float, p: float) -> None:
    f = CASES[name]
    if min(abs(x), abs(x - p)) < 1e-3:
        return  # kinks
    g = Graph()
    sx, sp = g.symbol("x", Level.STATE), g.symbol("p", Level.PARAMETER, positive=True)
    e = f(sx, sp)
    assert value(e, x, p) == pytest.approx(f(x, p), rel=1e-12, abs=1e-12)
    for by, h in ((sx, (1e-5, 0)), (sp, (0, 1e-5))):
        difference = (f(x + h[0], p + h[1]) - f(x - h[0], p - h[1])) / 2e-5
        assert value(g.diff(e, by), x, p) == pytest.approx(difference, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("name", ["gpow", "exp", "log", "sqrt", "tanh", "power", "trig", "where"])
def test_the_same_function_runs_on_sympy(name: str) -> None:
    x, p = sympy.symbols("x p", real=True)
    e = CASES[name](x, p)
    assert float(e.subs({x: 0.7, p: 1.3})) == pytest.approx(CASES[name](0.7, 1.3), rel=1e-12)


def test_equal_expressions_are_one_node() -> None:
    g = Graph()
    a, b = g.symbol("a", Level.STATE), g.symbol("b", Level.STATE)
    assert (a + b) * a is a * (b + a)
    assert a - a is g.zero
    assert a * 1.0 is a
    assert (-a) * (-b) is a * b


def changed(**equations: Any) -> Any:
    return dataclasses.replace(problems.ou1d(), **equations)


def branching(x: Any, u: Any, p: Any) -> Any:
    if x.x > 2.5:
        return {"x": -p.th * x.x}
    return {"x": p.th * (p.mu - x.x)}


@pytest.mark.parametrize(
    ("equations", "message"),
    [
        ({"drift": branching}, r"branching .*if x.x > 2.5.*branches on `\(x > 2.5\)`.*where\(condition"),
        ({"drift": lambda x, u, p: {"x": max(x.x, 0.0)}}, "branches on.*maximum"),
        ({"drift": lambda x, u, p: {"x": math.exp(x.x)}}, "into a number.*fdd.models.functions"),
        ({"drift": lambda x, u, p: {"x": p.thh * x.x}}, r"no parameter 'thh'; did you mean th\?"),
        ({"drift": lambda x, u, p: {"x": p.th * x.z}}, "no state 'z'"),
        ({"drift": lambda x, u, p: {"z": p.th * x.x}}, "drift has an equation for unknown symbol 'z'"),
        ({"drift": lambda x, u, p: {}}, "drift has no equation for 'x'"),
        ({"drift": lambda x, u, p: p.th}, "return a mapping"),
        ({"diffusion": lambda x, u, p: {"x": x.x}}, "diffusion of x depends on state x.*Lamperti"),
        ({"noise": lambda x, u, p: {"y": 0.0}}, "noise of output y is zero"),
        ({"observe": lambda x, u, p: {"y": "x"}}, "'x' of type str cannot stand"),
    ],
)
def test_what_cannot_be_traced_is_refused_with_cause_and_remedy(equations: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        trace(changed(**equations))


def test_linear_models_are_known_as_linear() -> None:
    assert trace(problems.building()).linear
    assert trace(problems.heat_exchanger()).linear
    assert trace(problems.heat_exchanger()).varying == (0, 1)
    assert not trace(problems.radiator()).linear
    switched = changed(drift=lambda x, u, p: {"x": fn.where(x.x > 0, 1.0, 0.0) - p.th * x.x})
    assert not trace(switched).linear


def test_models_run_on_floats_too() -> None:
    out = problems.radiator().drift(
        Space(T1=45.0, T2=40.0, Tl=26.0, A=0.5),
        Space(Tf=55.0, Ta=20.0, q=20.0),
        Space(**{q.symbol: q.typical for q in problems.radiator().parameters}),
    )
    assert out["A"] == pytest.approx(0.075 * 20 - 6 * 0.5)
