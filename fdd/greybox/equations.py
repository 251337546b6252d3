"""A component model as traced equations: drift, Jacobians, noise, and what kind of model it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fdd.greybox.trace import Expr, Graph, Level, Namespace, text
from fdd.models.declare import ComponentModel, ModelError


@dataclass
class System:
    """The traced equations of a model with n states, m inputs, q outputs and k parameters.

    Attributes
    ----------
    f, A : drift (n,) and its Jacobian (n, n)
    c : drift less A x (n,), free of x for models linear in x
    q : diffusion variances per second (n,)
    h, H, r : expected outputs (q,), their Jacobian (q, n), error variances (q,)
    x0 : start values (n,), functions of first outputs, inputs and parameters
    linear : the drift is linear in x given u
    varying : indices of the inputs A or q depend on
    """

    model: ComponentModel
    graph: Graph
    x: list[Expr]
    u: list[Expr]
    p: list[Expr]
    y: list[Expr]
    f: list[Expr] = field(default_factory=list)
    q: list[Expr] = field(default_factory=list)
    h: list[Expr] = field(default_factory=list)
    r: list[Expr] = field(default_factory=list)
    x0: list[Expr] = field(default_factory=list)
    A: list[list[Expr]] = field(default_factory=list)
    H: list[list[Expr]] = field(default_factory=list)
    c: list[Expr] = field(default_factory=list)
    linear: bool = False
    varying: tuple[int, ...] = ()


_traced: dict[int, System] = {}


def trace(model: ComponentModel) -> System:
    """Run a model's equations once on symbols.

    Raises
    ------
    ModelError : an unknown symbol, a branch on a state, a missing equation, noise that depends on a state
    """
    known = _traced.get(id(model))
    if known is not None and known.model is model:
        return known
    if len(_traced) > 64:
        _traced.clear()
    system = _traced[id(model)] = _trace(model)
    return system


def _trace(model: ComponentModel) -> System:
    g = Graph()
    p = [g.symbol(q.symbol, Level.PARAMETER, positive=q.lower > 0) for q in model.parameters]
    u = [g.symbol(q.symbol, Level.INPUT) for q in model.inputs]
    x = [g.symbol(q.symbol, Level.STATE) for q in model.states]
    y = [g.symbol(f"measured {q.symbol}", Level.STATE) for q in model.outputs]
    s = System(model, g, x, u, p, y)
    space = {
        "state": Namespace("state", model.name, dict(zip((q.symbol for q in model.states), x, strict=True))),
        "input": Namespace("input", model.name, dict(zip((q.symbol for q in model.inputs), u, strict=True))),
        "parameter": Namespace(
            "parameter", model.name, dict(zip((q.symbol for q in model.parameters), p, strict=True))
        ),
        "output": Namespace("output", model.name, dict(zip((q.symbol for q in model.outputs), y, strict=True))),
    }
    states, outputs = [q.symbol for q in model.states], [q.symbol for q in model.outputs]
    args = (space["state"], space["input"], space["parameter"])
    s.f = _rows(s, "drift", model.drift(*args), states)
    s.q = [a * a for a in _rows(s, "diffusion", model.diffusion(*args), states)]
    s.h = _rows(s, "observe", model.observe(*args), outputs)
    s.r = [a * a for a in _rows(s, "noise", model.noise(*args), outputs)]
    s.x0 = _rows(s, "start", model.start(space["output"], space["input"], space["parameter"]), states)
    _differentiate(s)
    _check(s)
    return s


def _rows(s: System, equation: str, result: Any, symbols: Sequence[str]) -> list[Expr]:
    name = s.model.name
    if not isinstance(result, Mapping):
        raise ModelError(
            f"{name}: {equation} returned {type(result).__name__}; return a mapping from symbol to expression for "
            f"{', '.join(symbols)}"
        )
    for symbol in result:
        if symbol not in symbols:
            raise ModelError(
                f"{name}: {equation} has an equation for unknown symbol {symbol!r}; known: {', '.join(symbols)}"
            )
    for symbol in symbols:
        if symbol not in result:
            raise ModelError(f"{name}: {equation} has no equation for {symbol!r}; add one")
    return [s.graph.wrap(result[symbol]) for symbol in symbols]


def _differentiate(s: System) -> None:
    g = s.graph
    s.A = [[g.diff(f, x) for x in s.x] for f in s.f]
    s.H = [[g.diff(h, x) for x in s.x] for h in s.h]
    s.linear = all(a.level < Level.STATE for row in s.A for a in row) and not any(_switches(f) for f in s.f)
    # For linear drift c = f at x = 0; substituting is cleaner than subtracting A x, which leaves x in the graph.
    s.c = [substitute(f, {x.index: g.zero for x in s.x}) for f in s.f] if s.linear else list(s.f)
    inputs = {u.index: i for i, u in enumerate(s.u)}
    used = [i for a in (*(a for row in s.A for a in row), *s.q) for i in a.symbols]
    s.varying = tuple(sorted({inputs[i] for i in used if i in inputs}))


def _switches(a: Expr) -> bool:
    """Whether a condition on a state stands in the expression (its slope may be the same on both sides)."""
    if a.level < Level.STATE:
        return False
    return a.op in ("lt", "le", "gt", "ge", "min", "max") or any(_switches(x) for x in a.args)


def substitute(a: Expr, values: Mapping[int, Expr]) -> Expr:
    """The expression with symbols (by index) replaced."""
    memo: dict[int, Expr] = {}

    def walk(e: Expr) -> Expr:
        if e.index in values:
            return values[e.index]
        if not e.args or not (e.symbols & values.keys()):
            return e
        if e.index not in memo:
            memo[e.index] = _rebuild(e, tuple(walk(x) for x in e.args))
        return memo[e.index]

    return walk(a)


def _rebuild(e: Expr, args: tuple[Expr, ...]) -> Expr:
    g = e.graph
    binary = {"add": g.add, "sub": g.sub, "mul": g.mul, "div": g.div, "pow": g.pow}
    if e.op in binary:
        return binary[e.op](args[0], args[1])
    if e.op == "neg":
        return g.neg(args[0])
    return g.make(e.op, args) if e.op in ("lt", "le", "gt", "ge") else g.call(e.op, args)


def _check(s: System) -> None:
    states = {x.index: x.value for x in s.x}
    for equation, rows, names in (
        ("diffusion", s.q, [q.symbol for q in s.model.states]),
        ("noise", s.r, [q.symbol for q in s.model.outputs]),
    ):
        for row, symbol in zip(rows, names, strict=True):
            seen = sorted(states[i] for i in row.symbols if i in states)
            if seen:
                raise ModelError(
                    f"{s.model.name}: {equation} of {symbol} depends on state {', '.join(seen)} (`{text(row)}`). "
                    "The filter takes noise that depends on inputs and parameters only: "
                    "transform the state (Lamperti) so that it does"
                )
    for row, symbol in zip(s.r, (q.symbol for q in s.model.outputs), strict=True):
        if row is s.graph.zero:
            raise ModelError(
                f"{s.model.name}: noise of output {symbol} is zero; give its measurement error a standard deviation"
            )
