"""Derived points and gates: arithmetic over point names, unit-checked once, then evaluated on SI columns.

    q(4186, "J/(kg*K)") * m_flow * (T_supply - T_return)       a heat flow; 4186 [J/(kg*K)] says the same
    pump.speed > 20 [%] and not `boiler-1.fault`               a gate

Point names may hold dots; a name with a dash stands in backticks. Operators: ``+ - * / **``, comparisons,
``and or not``. Functions: ``abs exp log sqrt min max mean where(condition, a, b) q(number, unit)``. The text is parsed
to a syntax tree and only these nodes are built: nothing of it is ever run as Python.

The difference of two temperatures is a temperature difference [K]; a temperature plus a difference is a temperature;
the sum or product of temperatures is refused. A missing value (NaN) makes a result missing unless the rest decides it
(``false and missing`` is false), and a gate that cannot be decided is closed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import reduce

import numpy as np
import pint
from numpy.typing import NDArray
from pint.facets.plain import PlainUnit

from fdd.limits import EXPRESSION_CHARACTERS, EXPRESSION_DEPTH, EXPRESSION_TERMS, UNIT_POWER
from fdd.records import FloatArray
from fdd.units import NAMES, REGISTRY, UnitError, conversion, normalise, si_symbol

Columns = Mapping[str, FloatArray]
Evaluate = Callable[[Columns], FloatArray]


class ExpressionError(ValueError):
    """An expression that cannot be used: the text, the part that is wrong, the remedy."""

    def __init__(self, text: str, problem: str, remedy: str = "") -> None:
        self.text, self.problem, self.remedy = text, problem, remedy
        shown = text if len(text) <= 200 else f"{text[:200]}..."
        super().__init__(f"expression {shown!r}: {problem}" + (f". {remedy}" if remedy else ""))


@dataclass(frozen=True, slots=True)
class Expression:
    """A checked expression.

    Attributes
    ----------
    text : as written
    unit : SI unit of the result, ``1`` for a number or a truth value
    points : names it needs, in order of appearance
    logical : whether the result is a truth value
    """

    text: str
    unit: str
    points: tuple[str, ...]
    logical: bool
    _evaluate: Evaluate

    def __call__(self, columns: Columns) -> FloatArray:
        """SI values, the columns' shape; NaN where an input is missing or the result is not finite.

        A truth value is 1.0 or 0.0.
        """
        with np.errstate(all="ignore"):
            value = np.asarray(self._evaluate(columns), dtype=np.float64)
        if value.ndim == 0 and columns:
            value = np.broadcast_to(value, np.shape(next(iter(columns.values()))))
        return np.where(np.isfinite(value), value, np.nan)

    def gate(self, columns: Columns) -> NDArray[np.bool_]:
        """Where the condition is known to hold."""
        value = self(columns)
        return np.asarray(np.isfinite(value) & (value != 0.0))


@dataclass(frozen=True, slots=True)
class _Part:
    """A node of the tree: what it measures, and how its value is found."""

    evaluate: Evaluate
    unit: pint.Unit
    temperature: bool = False
    logical: bool = False
    constant: float | None = None  # SI value where it is known from the text

    @property
    def name(self) -> str:
        if self.logical:
            return "truth value"
        symbol = "degC" if self.temperature else si_symbol(self.unit)
        return f"{NAMES.get(symbol, 'quantity')} [{symbol}]"


_PLAIN = REGISTRY.Unit("dimensionless")
_KELVIN = REGISTRY.Unit("kelvin")
_NUMBER_WITH_UNIT = re.compile(
    r"((?<![\w.])\d+\.?\d*(?:[eE][-+]?\d+)?|(?<![\w.])\.\d+(?:[eE][-+]?\d+)?)\s*\[([^\]\[]+)\]"
)
_SHORTER = "Name parts of it as derived points of their own, and combine those."
_QUOTED = re.compile(r"`([^`]+)`")
_HOLDER = "quoted_point_"


def compile_expression(text: str, units: Mapping[str, str]) -> Expression:
    """Parse an expression over points and check its units.

    Parameters
    ----------
    text : the expression
    units : SI unit of every point that may be named (``degC`` marks a temperature)

    Raises
    ------
    ExpressionError : syntax, an unknown name or function, units that do not fit; with the remedy.
    """
    return _Compiler(text, units).compile()


class _Compiler:
    def __init__(self, text: str, units: Mapping[str, str]) -> None:
        self.text, self.units = text, units
        self.quoted: list[str] = []
        self.points: dict[str, None] = {}

    def compile(self) -> Expression:
        try:
            part = self.build(self.parse())
            symbol = "1" if part.logical else "degC" if part.temperature else si_symbol(part.unit)
        except (ArithmeticError, RecursionError, pint.PintError) as error:
            raise self.error(f"its unit cannot be worked out ({type(error).__name__})", _SHORTER) from None
        return Expression(self.text, symbol, tuple(self.points), part.logical, part.evaluate)

    def parse(self) -> ast.expr:
        def hold(match: re.Match[str]) -> str:
            self.quoted.append(match[1])
            return f" {_HOLDER}{len(self.quoted) - 1} "

        if len(self.text) > EXPRESSION_CHARACTERS:
            raise self.error(f"{len(self.text)} characters; at most {EXPRESSION_CHARACTERS} are read", _SHORTER)
        source = _NUMBER_WITH_UNIT.sub(r'q(\1, "\2")', _QUOTED.sub(hold, self.text))
        try:
            tree = ast.parse(" ".join(source.split()), mode="eval").body
        except (SyntaxError, ValueError) as error:
            raise self.error(f"not understood ({error})", "Put names with dashes or spaces in `backticks`.") from None
        except (RecursionError, MemoryError):  # the parser's own words for nested too deeply
            raise self.error("nested too deeply", _SHORTER) from None
        self._bounded(tree)
        return tree

    def _bounded(self, tree: ast.expr) -> None:
        """Refuse what is too deep or too long to be built, without recursion."""
        level, depth, terms = [tree], 0, 0
        while level:
            depth, terms = depth + 1, terms + len(level)
            if depth > EXPRESSION_DEPTH or terms > EXPRESSION_TERMS:
                bound = f"{EXPRESSION_DEPTH} levels and {EXPRESSION_TERMS} terms"
                raise self.error(f"nested too deeply or too long; at most {bound} are read", _SHORTER)
            level = [n for node in level for n in ast.iter_child_nodes(node) if isinstance(n, ast.expr)]

    def error(self, problem: str, remedy: str = "") -> ExpressionError:
        return ExpressionError(self.text, problem, remedy)

    def build(self, node: ast.expr) -> _Part:
        for kind, builder in _BUILDERS.items():
            if isinstance(node, kind):
                return builder(self, node)
        raise self.error(
            f"{ast.unparse(node)!r} is not allowed", "Use + - * / **, comparisons, and, or, not, functions."
        )

    # Leaves

    def constant(self, node: ast.Constant) -> _Part:
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            raise self.error(f"{node.value!r} is no number", "A constant with a unit is written 4186 [J/(kg*K)].")
        try:
            value = float(node.value)
        except OverflowError:
            raise self.error("a constant beyond 1e308") from None
        return _Part(lambda _: np.float64(value), _PLAIN, constant=value)  # type: ignore[arg-type, return-value]

    def point(self, node: ast.Name | ast.Attribute) -> _Part:
        name = self._dotted(node)
        if name not in self.units:
            raise self.error(f"no point is named {name!r}", self._name_advice(name))
        self.points[name] = None
        symbol = self.units[name]
        if symbol == "degC":
            return _Part(lambda columns: columns[name], _KELVIN, temperature=True)
        return _Part(lambda columns: columns[name], _unit(symbol))

    def _dotted(self, node: ast.expr) -> str:
        if isinstance(node, ast.Attribute):
            return f"{self._dotted(node.value)}.{node.attr}"
        if not isinstance(node, ast.Name):
            raise self.error(f"{ast.unparse(node)!r} is no point name")
        number = node.id.removeprefix(_HOLDER)
        if number != node.id and number.isdecimal() and int(number) < len(self.quoted):
            return self.quoted[int(number)]
        return node.id

    def _name_advice(self, name: str) -> str:
        dashed = [p for p in self.units if "-" in p and name in re.split(r"[-.]", p) + p.split("-")]
        if dashed:
            return f"A name with a dash stands in backticks: `{dashed[0]}`."
        close = get_close_matches(name, self.units, n=1)
        return f"Did you mean {close[0]!r}?" if close else f"Points are {', '.join(sorted(self.units)) or 'none'}."

    # Arithmetic

    def unary(self, node: ast.UnaryOp) -> _Part:
        part = self.build(node.operand)
        if isinstance(node.op, ast.Not):
            self._truth(part)
            return _logic(_known(np.equal, part.evaluate, lambda _: np.float64(0.0)))  # type: ignore[arg-type, return-value]
        if isinstance(node.op, ast.USub | ast.UAdd):
            self._number(part)
            if isinstance(node.op, ast.UAdd):
                return part
            self._no_temperature(part, "have its sign changed")
            negative = None if part.constant is None else -part.constant
            return _Part(lambda columns: -part.evaluate(columns), part.unit, constant=negative)
        raise self.error(f"{ast.unparse(node)!r} is not allowed")

    def binary(self, node: ast.BinOp) -> _Part:
        left, right = self.build(node.left), self.build(node.right)
        self._number(left)
        self._number(right)
        a, b = left.evaluate, right.evaluate
        if isinstance(node.op, ast.Add | ast.Sub):
            return self._sum(left, right, isinstance(node.op, ast.Sub))
        if isinstance(node.op, ast.Pow):
            return self._power(left, right)
        for part in (left, right):
            self._no_temperature(part, "be multiplied or divided")
        if isinstance(node.op, ast.Mult):
            return _Part(lambda c: a(c) * b(c), _base(left.unit * right.unit))
        if isinstance(node.op, ast.Div):
            return _Part(lambda c: a(c) / b(c), _base(left.unit / right.unit))
        raise self.error(f"{ast.unparse(node)!r} is not allowed", "Use + - * / **.")

    def _sum(self, left: _Part, right: _Part, minus: bool) -> _Part:
        a, b = left.evaluate, right.evaluate
        word = "subtract" if minus else "add"
        if left.unit.dimensionality != right.unit.dimensionality:
            raise self.error(f"cannot {word} a {left.name} and a {right.name}", "Give constants their unit: 5 [K].")
        if right.temperature and (minus != left.temperature):
            problem = "two temperatures" if left.temperature else f"a temperature from a {left.name}"
            raise self.error(f"cannot {word} {problem}", "Only a difference of temperatures, or mean(), is meaningful.")
        temperature = left.temperature != right.temperature
        if minus:
            return _Part(lambda c: a(c) - b(c), left.unit, temperature)
        return _Part(lambda c: a(c) + b(c), left.unit, temperature)

    def _power(self, left: _Part, right: _Part) -> _Part:
        self._no_temperature(left, "be raised to a power")
        self._no_dimension(right, "an exponent")
        a, b = left.evaluate, right.evaluate
        if left.unit.dimensionless:
            return _Part(lambda c: np.power(a(c), b(c)), _PLAIN)
        if right.constant is None:
            raise self.error(f"a {left.name} can only be raised to a constant power")
        if not abs(right.constant) <= UNIT_POWER:
            raise self.error(f"a {left.name} can only be raised to a power up to {UNIT_POWER}")
        return _Part(lambda c: np.power(a(c), b(c)), _base(left.unit**right.constant))

    # Truth

    def compare(self, node: ast.Compare) -> _Part:
        parts = [self.build(n) for n in (node.left, *node.comparators)]
        pairs = []
        for op, left, right in zip(node.ops, parts[:-1], parts[1:], strict=True):
            if type(op) not in _COMPARE:
                raise self.error(f"{ast.unparse(node)!r} is not allowed", "Compare with < <= > >= == !=.")
            self._same((left, right), "compare")
            pairs.append(_known(_COMPARE[type(op)], left.evaluate, right.evaluate))
        return _logic(lambda c: reduce(_and, [p(c) for p in pairs]))

    def boolean(self, node: ast.BoolOp) -> _Part:
        parts = [self.build(n) for n in node.values]
        for part in parts:
            self._truth(part)
        join = _and if isinstance(node.op, ast.And) else _or
        return _logic(lambda c: reduce(join, [p.evaluate(c) for p in parts]))

    # Functions

    def call(self, node: ast.Call) -> _Part:
        name = node.func.id if isinstance(node.func, ast.Name) else ast.unparse(node.func)
        if name == "q":
            return self._quantity(node)
        if node.keywords or name not in _FUNCTIONS:
            raise self.error(f"function {name!r} is not known", f"Functions are {', '.join(sorted(_FUNCTIONS))} and q.")
        parts = [self.build(n) for n in node.args]
        low, high = _ARGUMENTS.get(name, (1, 1))
        if not low <= len(parts) <= high:
            raise self.error(f"{name} takes {low if low == high else f'at least {low}'} arguments, not {len(parts)}")
        return _FUNCTIONS[name](self, parts)

    def _quantity(self, node: ast.Call) -> _Part:
        try:
            number, unit = (ast.literal_eval(n) for n in node.args)
            known = conversion(unit)
            value = float(known(float(number)))
        except UnitError as error:
            raise self.error(error.statement, error.remedy) from None
        except (ValueError, TypeError, OverflowError, AttributeError):
            raise self.error(f"{ast.unparse(node)!r} is not understood", 'Write q(4186, "J/(kg*K)").') from None
        constant = np.float64(value)
        temperature = known.si == "degC"
        unit_inside = _KELVIN if temperature else _unit(known.si)
        return _Part(lambda _: constant, unit_inside, temperature, constant=value)  # type: ignore[arg-type, return-value]

    def smooth(self, function: Callable[[FloatArray], FloatArray], parts: list[_Part]) -> _Part:
        """``exp`` and ``log``: numbers only."""
        (part,) = parts
        self._no_dimension(part, "the argument of exp or log")
        return _Part(lambda c: function(part.evaluate(c)), _PLAIN)

    def root(self, parts: list[_Part]) -> _Part:
        (part,) = parts
        self._number(part)
        self._no_temperature(part, "have a square root")
        return _Part(lambda c: np.sqrt(part.evaluate(c)), _base(part.unit**0.5))

    def absolute(self, parts: list[_Part]) -> _Part:
        (part,) = parts
        self._number(part)
        self._no_temperature(part, "have an absolute value")
        return _Part(lambda c: np.abs(part.evaluate(c)), part.unit)

    def alike(self, combine: Callable[[list[FloatArray]], FloatArray], parts: list[_Part]) -> _Part:
        """``min``, ``max`` and ``mean``: arguments of one quantity, result the same."""
        first = self._same(tuple(parts), "combine")
        return _Part(lambda c: combine([p.evaluate(c) for p in parts]), first.unit, first.temperature)

    def where(self, parts: list[_Part]) -> _Part:
        condition, yes, no = parts
        self._truth(condition)
        first = self._same((yes, no), "choose between")

        def choose(columns: Columns) -> FloatArray:
            held = condition.evaluate(columns)
            chosen = np.where(held > 0, yes.evaluate(columns), no.evaluate(columns))
            return np.where(np.isnan(held), np.nan, chosen)

        return _Part(choose, first.unit, first.temperature)

    # Checks

    def _number(self, part: _Part) -> None:
        if part.logical:
            raise self.error("a comparison cannot be used as a number", "Use where(condition, 1, 0).")

    def _truth(self, part: _Part) -> None:
        # A status point (0 or 1) is the commonest gate of all.
        if not part.logical and not (part.unit.dimensionless and part.constant is None):
            raise self.error(
                f"and, or, not and where need a condition, not a {part.name}", "Compare it: power > 1 [kW]."
            )

    def _no_temperature(self, part: _Part, what: str) -> None:
        if part.temperature:
            raise self.error(f"a temperature [degC] cannot {what}", "Take its difference to another: T - 20 [degC].")

    def _no_dimension(self, part: _Part, what: str) -> None:
        self._number(part)
        if part.temperature or not part.unit.dimensionless:
            raise self.error(f"{what} must be a number, not a {part.name}", "Divide by a constant with that unit.")

    def _same(self, parts: tuple[_Part, ...], what: str) -> _Part:
        for part in parts:
            self._number(part)
        # Nought is nought in every unit that has no offset.
        real = [p for p in parts if p.constant != 0.0 or not p.unit.dimensionless] or list(parts)
        first = real[0]
        for other in real[1:]:
            if (first.unit.dimensionality, first.temperature) != (other.unit.dimensionality, other.temperature):
                raise self.error(
                    f"cannot {what} a {first.name} and a {other.name}", "Give constants their unit: 15 [degC]."
                )
        if first.temperature and len(real) < len(parts):
            raise self.error(f"cannot {what} a temperature and a plain 0", "Give constants their unit: 0 [degC].")
        return first


def _unit(symbol: str) -> pint.Unit:
    return _base(REGISTRY.Unit(normalise(symbol)))


def _base(unit: PlainUnit) -> pint.Unit:
    return REGISTRY.Unit(REGISTRY.Quantity(1.0, unit).to_base_units().units)


def _logic(evaluate: Evaluate) -> _Part:
    return _Part(evaluate, _PLAIN, logical=True)


def _known(compare: Callable[[FloatArray, FloatArray], NDArray[np.bool_]], a: Evaluate, b: Evaluate) -> Evaluate:
    def evaluate(columns: Columns) -> FloatArray:
        left, right = a(columns), b(columns)
        return np.where(np.isnan(left) | np.isnan(right), np.nan, compare(left, right))

    return evaluate


def _and(a: FloatArray, b: FloatArray) -> FloatArray:
    """Kleene's and: false decides, otherwise missing stays missing."""
    return np.where((a == 0) | (b == 0), 0.0, np.where(np.isnan(a) | np.isnan(b), np.nan, 1.0))


def _or(a: FloatArray, b: FloatArray) -> FloatArray:
    """Kleene's or: true decides, otherwise missing stays missing."""
    true = ((a != 0) & ~np.isnan(a)) | ((b != 0) & ~np.isnan(b))
    return np.where(true, 1.0, np.where(np.isnan(a) | np.isnan(b), np.nan, 0.0))


_COMPARE: Mapping[type[ast.cmpop], Callable[[FloatArray, FloatArray], NDArray[np.bool_]]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}

_FUNCTIONS: Mapping[str, Callable[[_Compiler, list[_Part]], _Part]] = {
    "exp": lambda c, parts: c.smooth(np.exp, parts),
    "log": lambda c, parts: c.smooth(np.log, parts),
    "sqrt": lambda c, parts: c.root(parts),
    "abs": lambda c, parts: c.absolute(parts),
    "min": lambda c, parts: c.alike(lambda values: reduce(np.minimum, values), parts),
    "max": lambda c, parts: c.alike(lambda values: reduce(np.maximum, values), parts),
    "mean": lambda c, parts: c.alike(lambda values: reduce(np.add, values) / len(values), parts),
    "where": lambda c, parts: c.where(parts),
}
_ARGUMENTS: Mapping[str, tuple[int, int]] = {"min": (2, 100), "max": (2, 100), "mean": (1, 100), "where": (3, 3)}

_BUILDERS: Mapping[type[ast.expr], Callable[[_Compiler, ast.expr], _Part]] = {
    ast.Constant: lambda c, n: c.constant(n),  # type: ignore[arg-type]
    ast.Name: lambda c, n: c.point(n),  # type: ignore[arg-type]
    ast.Attribute: lambda c, n: c.point(n),  # type: ignore[arg-type]
    ast.UnaryOp: lambda c, n: c.unary(n),  # type: ignore[arg-type]
    ast.BinOp: lambda c, n: c.binary(n),  # type: ignore[arg-type]
    ast.Compare: lambda c, n: c.compare(n),  # type: ignore[arg-type]
    ast.BoolOp: lambda c, n: c.boolean(n),  # type: ignore[arg-type]
    ast.Call: lambda c, n: c.call(n),  # type: ignore[arg-type]
}
