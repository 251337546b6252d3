"""The expression graph a model's equations leave behind when they are run once on symbols.

Nodes are hash-consed (equal expressions are one node), trivial operations are simplified away, and derivatives are
again nodes of the same graph, so that everything common is computed once in the generated kernel.
"""

from __future__ import annotations

import difflib
import linecache
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

from fdd.models.declare import ModelError

Number = int | float
COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">="}


class Level(IntEnum):
    """What an expression's value changes with; the generated code computes each level only as often as it must."""

    CONSTANT = 0
    PARAMETER = 1
    INPUT = 2
    STATE = 3


def _caller() -> str:
    """The line of the model that is being traced, for error messages."""
    frame = sys._getframe(1)
    here = {__file__, str(Path(__file__).with_name("equations.py"))}
    while frame is not None and (frame.f_code.co_filename in here or "models/functions" in frame.f_code.co_filename):
        if frame.f_back is None:
            break
        frame = frame.f_back
    line = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    where = f"{frame.f_code.co_name} ({Path(frame.f_code.co_filename).name}:{frame.f_lineno})"
    return f"{where}: `{line}`" if line else where


class Expr:
    """One node: an operation on other nodes, a symbol or a constant."""

    __slots__ = ("args", "graph", "index", "level", "op", "positive", "symbols", "value")

    def __init__(self, graph: Graph, op: str, args: tuple[Expr, ...], value: Any, index: int) -> None:
        self.graph, self.op, self.args, self.value, self.index = graph, op, args, value, index
        self.symbols: frozenset[int] = frozenset().union(*(a.symbols for a in args)) if args else frozenset()
        self.level: Level = max((a.level for a in args), default=Level.CONSTANT)
        self.positive = False

    def __repr__(self) -> str:
        return text(self)

    # Arithmetic
    def __add__(self, other: Any) -> Expr:
        return self.graph.add(self, self.graph.wrap(other))

    def __radd__(self, other: Any) -> Expr:
        return self.graph.add(self.graph.wrap(other), self)

    def __sub__(self, other: Any) -> Expr:
        return self.graph.sub(self, self.graph.wrap(other))

    def __rsub__(self, other: Any) -> Expr:
        return self.graph.sub(self.graph.wrap(other), self)

    def __mul__(self, other: Any) -> Expr:
        return self.graph.mul(self, self.graph.wrap(other))

    def __rmul__(self, other: Any) -> Expr:
        return self.graph.mul(self.graph.wrap(other), self)

    def __truediv__(self, other: Any) -> Expr:
        return self.graph.div(self, self.graph.wrap(other))

    def __rtruediv__(self, other: Any) -> Expr:
        return self.graph.div(self.graph.wrap(other), self)

    def __pow__(self, other: Any) -> Expr:
        return self.graph.pow(self, self.graph.wrap(other))

    def __rpow__(self, other: Any) -> Expr:
        return self.graph.pow(self.graph.wrap(other), self)

    def __neg__(self) -> Expr:
        return self.graph.neg(self)

    def __pos__(self) -> Expr:
        return self

    def __abs__(self) -> Expr:
        return self.graph.call("abs", (self,))

    # Conditions, for ``where`` only
    def __lt__(self, other: Any) -> Expr:
        return self.graph.make("lt", (self, self.graph.wrap(other)))

    def __le__(self, other: Any) -> Expr:
        return self.graph.make("le", (self, self.graph.wrap(other)))

    def __gt__(self, other: Any) -> Expr:
        return self.graph.make("gt", (self, self.graph.wrap(other)))

    def __ge__(self, other: Any) -> Expr:
        return self.graph.make("ge", (self, self.graph.wrap(other)))

    def __bool__(self) -> bool:
        raise ModelError(
            f"{_caller()} branches on `{text(self)}`. Equations are traced once, so that both branches must stand "
            "in the result: write where(condition, a, b), maximum or minimum of fdd.models.functions instead of "
            "if, and, max, min"
        )

    def __float__(self) -> float:
        raise ModelError(
            f"{_caller()} turns `{text(self)}` into a number, as the functions of math do. "
            "Use exp, log, sqrt, tanh, ... of fdd.models.functions"
        )

    def __int__(self) -> int:
        return int(float(self))

    def __index__(self) -> int:
        return int(float(self))

    def __array_ufunc__(self, ufunc: Any, *_: Any, **__: Any) -> Any:
        raise ModelError(f"{_caller()} uses numpy.{ufunc.__name__} on an equation. Use fdd.models.functions")

    def traced_call(self, name: str, arguments: Sequence[Any]) -> Expr:
        """The functions of :mod:`fdd.models.functions` arrive here."""
        return self.graph.call(name, tuple(self.graph.wrap(a) for a in arguments))


class Graph:
    """All nodes of one model."""

    def __init__(self) -> None:
        self.nodes: list[Expr] = []
        self._known: dict[tuple[Any, ...], Expr] = {}
        self._derivatives: dict[tuple[int, int], Expr] = {}
        self.zero, self.one = self.constant(0.0), self.constant(1.0)

    def make(self, op: str, args: tuple[Expr, ...] = (), value: Any = None) -> Expr:
        """The node for an operation, made once."""
        key = (op, *(a.index for a in args), value)
        node = self._known.get(key)
        if node is None:
            node = Expr(self, op, args, value, len(self.nodes))
            self.nodes.append(node)
            self._known[key] = node
            node.positive = _positive(node)
        return node

    def symbol(self, name: str, level: Level, positive: bool = False) -> Expr:
        """A named leaf."""
        node = self.make("symbol", (), name)
        node.symbols, node.level, node.positive = frozenset((node.index,)), level, positive
        return node

    def constant(self, value: Number) -> Expr:
        """A number."""
        node = self.make("constant", (), float(value))
        node.positive = float(value) > 0
        return node

    def wrap(self, value: Any) -> Expr:
        """A number or a node as a node."""
        if isinstance(value, Expr):
            return value
        try:
            return self.constant(float(value))
        except (TypeError, ValueError):
            raise ModelError(
                f"{_caller()}: {value!r} of type {type(value).__name__} cannot stand in an equation"
            ) from None

    def add(self, a: Expr, b: Expr) -> Expr:
        """a + b."""
        if a is self.zero:
            return b
        if b is self.zero:
            return a
        if a.op == b.op == "constant":
            return self.constant(a.value + b.value)
        if b.op == "neg":
            return self.sub(a, b.args[0])
        if a.op == "neg":
            return self.sub(b, a.args[0])
        return self.make("add", (a, b) if a.index <= b.index else (b, a))

    def sub(self, a: Expr, b: Expr) -> Expr:
        """a - b."""
        if b is self.zero:
            return a
        if a is self.zero:
            return self.neg(b)
        if a is b:
            return self.zero
        if a.op == b.op == "constant":
            return self.constant(a.value - b.value)
        if b.op == "neg":
            return self.add(a, b.args[0])
        if a.op == "neg":
            return self.neg(self.add(a.args[0], b))
        # One order only, so that a difference and its opposite are computed once; the sign moves outwards.
        return self.make("sub", (a, b)) if a.index < b.index else self.neg(self.make("sub", (b, a)))

    def mul(self, a: Expr, b: Expr) -> Expr:
        """a * b."""
        if a is self.zero or b is self.zero:
            return self.zero
        if a is self.one:
            return b
        if b is self.one:
            return a
        if a.op == b.op == "constant":
            return self.constant(a.value * b.value)
        if a.op == "neg":
            return self.neg(self.mul(a.args[0], b))
        if b.op == "neg":
            return self.neg(self.mul(a, b.args[0]))
        for one, other in ((a, b), (b, a)):
            if one.op == "constant" and one.value < 0.0:
                return self.neg(self.mul(self.constant(-one.value), other))
        return self.make("mul", (a, b) if a.index <= b.index else (b, a))

    def div(self, a: Expr, b: Expr) -> Expr:
        """a / b; by what changes less often, as a product with the reciprocal."""
        if a is self.zero:
            return self.zero
        if b is self.one:
            return a
        if a is b:
            return self.one
        if b.op == "constant":
            if b.value == 0.0:
                raise ModelError(f"{_caller()} divides by zero")
            return self.mul(a, self.constant(1.0 / b.value))
        if a.op == "neg":
            return self.neg(self.div(a.args[0], b))
        if a.level > b.level:  # the reciprocal is computed less often than the quotient would be
            return self.mul(a, self.make("div", (self.one, b)))
        return self.make("div", (a, b))

    def neg(self, a: Expr) -> Expr:
        """-a."""
        if a.op == "constant":
            return self.constant(-a.value)
        if a.op == "neg":
            return a.args[0]
        return self.make("neg", (a,))

    def pow(self, a: Expr, b: Expr) -> Expr:
        """a ** b; small integer powers by multiplication."""
        if b.op == "constant":
            if a.op == "constant":
                return self.constant(a.value**b.value)
            if b.value == 0.5:
                return self.call("sqrt", (a,))
            if b.value == int(b.value) and abs(b.value) <= 8:
                return self._integer_power(a, int(b.value))
        return self.make("pow", (a, b))

    def _integer_power(self, a: Expr, n: int) -> Expr:
        if n < 0:
            return self.div(self.one, self._integer_power(a, -n))
        if n == 0:
            return self.one
        half = self._integer_power(a, n // 2)
        square = self.mul(half, half)
        return self.mul(square, a) if n % 2 else square

    def call(self, name: str, args: tuple[Expr, ...]) -> Expr:
        """A named function of nodes."""
        if name == "where":
            condition, a, b = args
            if condition.op not in COMPARISONS:
                raise ModelError(f"{_caller()}: where() needs a comparison (<, <=, >, >=), not `{text(condition)}`")
            return a if a is b else self.make("where", args)
        if all(a.op == "constant" for a in args):
            return self.constant(_FOLD[name](*(a.value for a in args)))
        return self.make(name, args)

    def total(self, terms: Iterable[Expr]) -> Expr:
        """Sum of nodes."""
        out = self.zero
        for term in terms:
            out = self.add(out, term)
        return out

    def diff(self, a: Expr, by: Expr) -> Expr:
        """Derivative of ``a`` with respect to the symbol ``by``."""
        if by.index not in a.symbols:
            return self.zero
        if a is by:
            return self.one
        key = (a.index, by.index)
        known = self._derivatives.get(key)
        if known is None:
            known = self._derivatives[key] = self._diff(a, by)
        return known

    def _diff(self, a: Expr, by: Expr) -> Expr:
        if a.op in COMPARISONS:
            return self.zero
        d = [self.diff(x, by) for x in a.args]
        if a.op == "add":
            return d[0] + d[1]
        if a.op == "sub":
            return d[0] - d[1]
        if a.op == "neg":
            return -d[0]
        if a.op == "mul":
            return d[0] * a.args[1] + a.args[0] * d[1]
        if a.op == "div":
            return (d[0] - a * d[1]) / a.args[1]
        if a.op == "pow":
            return self._diff_pow(a, d[0], d[1])
        if a.op in ("where", "min", "max"):
            return self._diff_choice(a, d)
        return d[0] * _SLOPE[a.op](self, a, a.args[0])

    def _diff_pow(self, a: Expr, db: Expr, de: Expr) -> Expr:
        base, exponent = a.args
        out = self.zero
        if db is not self.zero:
            # Sharing the power costs a division instead of a second power; that needs a base that is never zero.
            lower = a / base if base.positive else self.pow(base, exponent - self.one)
            out = exponent * lower * db
        if de is not self.zero:
            out = out + a * self.call("log", (base,)) * de
        return out

    def _diff_choice(self, a: Expr, d: list[Expr]) -> Expr:
        if a.op == "where":
            return self.call("where", (a.args[0], d[1], d[2]))
        condition = a.args[0] < a.args[1] if a.op == "min" else a.args[0] > a.args[1]
        return self.call("where", (condition, d[0], d[1]))


_FOLD: dict[str, Callable[..., float]] = {
    "exp": math.exp, "log": math.log, "sqrt": math.sqrt, "tanh": math.tanh, "sin": math.sin, "cos": math.cos,
    "abs": abs, "min": min, "max": max,
}  # fmt: skip
_SLOPE: dict[str, Callable[[Graph, Expr, Expr], Expr]] = {
    "exp": lambda g, a, x: a,
    "log": lambda g, a, x: g.one / x,
    "sqrt": lambda g, a, x: g.constant(0.5) / a,
    "tanh": lambda g, a, x: g.one - a * a,
    "sin": lambda g, a, x: g.call("cos", (x,)),
    "cos": lambda g, a, x: -g.call("sin", (x,)),
    "abs": lambda g, a, x: g.call("where", (x < 0.0, g.constant(-1.0), g.one)),
}


def _square(a: Expr) -> bool:
    return a.op == "mul" and a.args[0] is a.args[1]


def _positive(a: Expr) -> bool:
    """Whether the value is above zero whatever the symbols are (conservative)."""
    if a.op in ("add", "mul", "div", "pow", "sqrt"):
        if a.op == "add" and any(x.positive for x in a.args) and all(x.positive or _square(x) for x in a.args):
            return True
        return a.args[0].positive if a.op == "pow" else all(x.positive for x in a.args)
    if a.op == "max":
        return any(x.positive for x in a.args)
    return a.op == "exp"


class Namespace:
    """Symbols by attribute; an unknown one is an error that names the equation."""

    def __init__(self, kind: str, model: str, symbols: dict[str, Expr]) -> None:
        self.__dict__.update(symbols)
        self.__dict__["_about"] = (kind, model, tuple(symbols))

    def __getattr__(self, name: str) -> Expr:
        if name.startswith("__"):
            raise AttributeError(name)
        kind, model, symbols = self.__dict__["_about"]
        near = difflib.get_close_matches(name, symbols, 1)
        hint = f"did you mean {near[0]}?" if near else f"declare it; known: {', '.join(symbols) or 'none'}"
        raise ModelError(f"{model}: {_caller()}: no {kind} {name!r}; {hint}")

    def __setattr__(self, name: str, value: Any) -> None:
        raise ModelError(f"{_caller()} assigns {name!r}; equations return a mapping and change nothing")


_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**", **COMPARISONS}


def text(a: Expr, depth: int = 6) -> str:
    """Readable form, for messages."""
    if a.op in ("symbol", "constant"):
        return str(a.value) if a.op == "symbol" else f"{a.value:g}"
    if depth == 0:
        return "..."
    parts = [text(x, depth - 1) for x in a.args]
    if a.op in _INFIX:
        return f"({parts[0]} {_INFIX[a.op]} {parts[1]})"
    return f"-{parts[0]}" if a.op == "neg" else f"{a.op}({', '.join(parts)})"
