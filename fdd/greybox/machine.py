"""Machine code from kernel text: a small typed part of Python, written as LLVM's language and compiled as a whole.

What it takes: functions of floats, integers and arrays with annotated arguments, assignments, ``for`` over ``range``,
``while``, ``if``, conditional expressions, arithmetic and the functions of :data:`INTRINSICS`. A loop over ``k`` with
fixed ends whose arrays are indexed by ``... + k`` becomes vector instructions directly. With ``lanes`` every float is a
vector of that many components instead, and the same text steps them all at once: an ``if`` on a lane's value becomes a
mask, under which names and arrays change in the lanes it holds for. What a lane computes never depends on its
neighbours.

One text gives one object file, whoever compiles it and whatever was loaded before, so that results do not depend on
which process compiled.
"""

from __future__ import annotations

import ast
import math
import re
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field

INTRINSICS = {"exp", "log", "sqrt", "sin", "cos", "tanh", "fabs", "abs", "floor"}
_FAST = "nsz"  # the sign of a zero is free; nothing is reordered, and only tangents are fused
_MATHEMATICS = {"exp", "log", "pow", "tanh"}  # in lanes: see lanes.py
LANE_FUNCTIONS = {f"lanes_{name}" for name in _MATHEMATICS} | {"exp_of_sum"}
_BITS = {"power_of_two", "exponent_of", "fraction_of", "product_error"}  # what lanes.py is written with
_BINARY = {ast.Add: ("fadd", "add"), ast.Sub: ("fsub", "sub"), ast.Mult: ("fmul", "mul")}
_COMPARE = {ast.Lt: ("olt", "slt"), ast.LtE: ("ole", "sle"), ast.Gt: ("ogt", "sgt"), ast.GtE: ("oge", "sge"),
            ast.Eq: ("oeq", "eq"), ast.NotEq: ("une", "ne")}  # fmt: skip
WIDTHS = (16, 8, 4, 2, 1)


class UnsupportedTextError(ValueError):
    """Kernel text outside the part of Python that is understood; a fault of the generator, never of a user."""


@dataclass(frozen=True)
class Array:
    """An argument that is an array: what it holds, and the lengths of its inner dimensions.

    ``each``: one row a component whatever the lanes are; other arrays of floats hold a vector of lanes in every place.
    """

    item: str
    inner: tuple[int, ...] = ()
    each: bool = False


@dataclass
class Signature:
    """Argument types by name in order, and the type returned: "float", "int", "bool", "none" or an array."""

    arguments: dict[str, str | Array]
    returns: str


@dataclass(frozen=True)
class Value:
    """An operand: its type ("float", "int", "bool", an array), its name, and its length if it is a vector over k."""

    type: str | Array
    name: str
    wide: int = 0


@dataclass
class Module:
    """Constants and functions of a text."""

    constants: dict[str, float | int] = field(default_factory=dict)
    functions: dict[str, ast.FunctionDef] = field(default_factory=dict)
    signatures: dict[str, Signature] = field(default_factory=dict)


def read(text: str) -> Module:
    """The constants, functions and signatures of a kernel text."""
    module = Module()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            module.constants[node.targets[0].id] = _constant(node.value, module.constants)
        elif isinstance(node, ast.FunctionDef):
            module.functions[node.name] = node
            arguments = {a.arg: _annotation(a.annotation, module.constants) for a in node.args.args}
            returns = node.returns.id if isinstance(node.returns, ast.Name) else "none"
            module.signatures[node.name] = Signature(arguments, returns)
    return module


def _constant(node: ast.expr, known: dict[str, float | int]) -> float | int:
    value = fold(node, known)
    if value is None:
        raise UnsupportedTextError(f"not a constant: {ast.unparse(node)}")
    return value


def fold(node: ast.expr, known: dict[str, float | int]) -> float | int | None:
    """The value of an expression of constants, else None."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return node.value
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        value = fold(node.operand, known)
        return None if value is None else -value
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        a, b = fold(node.left, known), fold(node.right, known)
        if a is None or b is None:
            return None
        return a + b if isinstance(node.op, ast.Add) else a - b if isinstance(node.op, ast.Sub) else a * b
    return None


def _annotation(node: ast.expr | None, known: dict[str, float | int]) -> str | Array:
    if isinstance(node, ast.Name):
        return {
            "array": Array("float"),
            "integers": Array("int"),
            "flags": Array("flag"),
            "each": Array("float", each=True),
        }.get(node.id, node.id)
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
        sizes = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if node.value.id in ("rows", "each", "indices"):
            item = "int" if node.value.id == "indices" else "float"
            return Array(item, tuple(int(_constant(s, known)) for s in sizes), node.value.id == "each")
    raise UnsupportedTextError("every argument needs a type")


def number(value: float) -> str:
    """A float as LLVM writes it, to the bit."""
    return "0x" + struct.pack(">d", float(value)).hex().upper()


class _Chunk(ast.stmt):
    """One pass of a loop over k at run time."""

    def __init__(self, name: str, at: int, width: int, body: list[ast.stmt]) -> None:
        super().__init__()
        self.name, self.at, self.width, self.body = name, at, width, body


class Writer:
    """Writes one function as LLVM's language."""

    def __init__(
        self, module: Module, name: str, prefix: str, *, external: bool, lanes: int = 1, masked: bool = False,
        fma: bool = True, widest: int = WIDTHS[0],
    ) -> None:  # fmt: skip
        self.module, self.node, self.prefix = module, module.functions[name], prefix
        self.lanes, self.fma, self.widest = lanes, fma, widest
        self.mask, self.masks = ("%mask", 1) if masked else ("", 0)  # lanes that are on; how many conditions deep
        self.born: dict[str, int] = {}  # how many conditions deep a name was first set
        self.called: set[tuple[str, bool]] = set()
        self.signature = module.signatures[name]
        self.external = external
        self.entry: list[str] = []
        self.lines: list[str] = []
        self.names: dict[str, tuple[str | Array, str]] = {}
        self.chunk: tuple[str, int] | None = None  # offset and width of the vector of a loop over k
        self.count, self.ended = 0, False

    # Text
    def new(self) -> str:
        """A fresh name."""
        self.count += 1
        return f"%t{self.count}"

    def emit(self, line: str) -> None:
        """Write an instruction."""
        self.lines.append("  " + line)

    def value(self, line: str) -> str:
        """Write an instruction and name its result."""
        name = self.new()
        self.lines.append(f"  {name} = {line}")
        return name

    def label(self, hint: str) -> str:
        """A fresh label."""
        self.count += 1
        return f"{hint}{self.count}"

    def begin(self, label: str) -> None:
        """Start a block, going on from the one before."""
        if not self.ended:
            self.emit(f"br label %{label}")
        self.lines.append(f"{label}:")
        self.ended = False

    def type(self, t: str | Array, wide: int = 0) -> str:
        """LLVM's type, of a vector ``wide`` long or of a number."""
        if isinstance(t, Array):
            return "ptr"
        if wide:
            return f"<{wide} x double>" if t == "float" else f"<{wide} x i1>"
        if t == "float":
            return f"<{self.lanes} x double>" if self.lanes > 1 else "double"
        if t == "bool":
            return f"<{self.lanes} x i1>" if self.lanes > 1 else "i1"
        return {"number": "double", "int": "i64", "condition": "i1", "none": "void"}[t]

    # The function
    def function(self) -> str:
        """The whole function."""
        arguments = []
        for name, t in self.signature.arguments.items():
            arguments.append(f"ptr noalias %{name}" if isinstance(t, Array) else f"{self.type(t)} %{name}")
            if isinstance(t, Array):
                self.names[name] = (t, f"%{name}")
            else:
                self._store_name(name, Value(t, f"%{name}"))
        if self.mask:
            arguments.append(f"{self.type('bool')} %mask")
        self.block(self.node.body)
        if not self.ended:
            t = self.type(self.signature.returns)
            self.emit("ret void" if t == "void" else f"ret {t} {self._zero(self.signature.returns)}")
        linkage = "" if self.external else "internal "
        name = f"{self.prefix}{self.node.name}{'.masked' if self.masks else ''}"
        head = f"define {linkage}{self.type(self.signature.returns)} @{name}"
        body = "\n".join(["entry:", *self.entry, *self.lines])
        always = " alwaysinline" if self.node.name in LANE_FUNCTIONS else ""
        return f"{head}({', '.join(arguments)}) nounwind{always} {{\n{body}\n}}"

    def _zero(self, t: str) -> str:
        if self.lanes > 1 and t in ("float", "bool"):
            return "zeroinitializer"
        return number(0.0) if t == "float" else "0"

    def block(self, body: Iterable[ast.stmt]) -> None:
        """Statements in order."""
        for s in body:
            if self.ended:
                raise UnsupportedTextError(f"nothing is reached after a return: {ast.unparse(s)}")
            self.statement(s)

    def statement(self, s: ast.stmt) -> None:
        """One statement."""
        if isinstance(s, ast.Assign):
            self.assign(s.targets[0], self.expression(s.value))
        elif isinstance(s, ast.AugAssign):
            now = ast.BinOp(_as_load(s.target), s.op, s.value)
            self.assign(s.target, self.expression(now))
        elif isinstance(s, ast.If):
            self.branch(s)
        elif isinstance(s, ast.For):
            self.loop(s)
        elif isinstance(s, ast.While):
            self.repeat(s)
        elif isinstance(s, ast.Return):
            self.leave(s)
        elif isinstance(s, _Chunk):
            pass_ = self.value(f"load i64, ptr %{s.name}.at")
            row = self.value(f"mul nsw i64 {pass_}, {max(1, s.width)}")
            self.chunk = (self.value(f"add nsw i64 {row}, {s.at}"), s.width)
            self.block(s.body)
            self.chunk = None
        elif isinstance(s, ast.Expr):
            if isinstance(s.value, ast.Call):
                self.expression(s.value)
        elif not isinstance(s, ast.Pass):
            raise UnsupportedTextError(ast.unparse(s))

    def assign(self, target: ast.expr, value: Value) -> None:
        """Store a value in a name or an array."""
        if isinstance(target, ast.Name):
            self._store_name(target.id, value)
            return
        assert isinstance(target, ast.Subscript)
        item, pointer, wide, apart = self.address(target)
        if item == "flag":
            raise UnsupportedTextError("flags are read only")
        if item == "int" and value.type == "float":
            t = f"<{self.lanes} x i64>" if self.lanes > 1 else "i64"
            whole = self.value(f"fptosi {self.type('float')} {value.name} to {t}")
            self.emit(f"store {t} {whole}, ptr {pointer}, align 8")
        elif apart:
            self.scatter(self.cast(value, "float"), pointer, apart)
        elif self.mask and item == "float":
            v = self.cast(value, "float")
            old = self.value(f"load {self.type('float')}, ptr {pointer}, align 8")
            self.emit(f"store {self.type('float')} {self.choose(v.name, old)}, ptr {pointer}, align 8")
        elif wide:
            v = self.widen(self.cast(value, "float"), wide)
            self.emit(f"store {self.type('float', wide)} {v.name}, ptr {pointer}, align 8")
        else:
            v = self.cast(value, item)
            self.emit(f"store {self.type(item)} {v.name}, ptr {pointer}, align 8")

    def choose(self, new: str, old: str, t: str = "float") -> str:
        """The new value in the lanes that are on, the old one in the others."""
        of = self.type(t)
        return self.value(f"select {self.type('bool')} {self.mask}, {of} {new}, {of} {old}")

    def scatter(self, v: Value, pointer: str, apart: int) -> None:
        """Store lanes ``apart`` floats from each other."""
        if self.mask:
            raise UnsupportedTextError(f"rows of components cannot be written under a condition: {self.node.name}")
        if apart == 1:
            self.emit(f"store {self.type('float')} {v.name}, ptr {pointer}, align 8")
            return
        for lane in range(self.lanes):
            at = self.value(f"getelementptr inbounds double, ptr {pointer}, i64 {lane * apart}")
            x = self.value(f"extractelement {self.type('float')} {v.name}, i64 {lane}")
            self.emit(f"store double {x}, ptr {at}, align 8")

    def gather(self, pointer: str, apart: int) -> Value:
        """Lanes ``apart`` floats from each other as a vector."""
        t = self.type("float")
        if apart == 1:
            return Value("float", self.value(f"load {t}, ptr {pointer}, align 8"))
        out = "poison"
        for lane in range(self.lanes):
            at = self.value(f"getelementptr inbounds double, ptr {pointer}, i64 {lane * apart}")
            x = self.value(f"load double, ptr {at}, align 8")
            out = self.value(f"insertelement {t} {out}, double {x}, i64 {lane}")
        return Value("float", out)

    def _store_name(self, name: str, value: Value) -> None:
        if isinstance(value.type, Array):
            self.names[name] = (value.type, value.name)
            return
        if value.wide:
            name = f"{name}.{value.wide}"
        if value.type == "number" and (value.name.startswith("0x") or self.names.get(name, ("",))[0] == "float"):
            value = self.cast(value, "float")
        if value.type == "condition" and self.lanes > 1:
            value = self.cast(value, "bool")
        if name not in self.names:
            self.born[name] = self.masks
            place = f"%{name}.at"
            self.entry.append(f"  {place} = alloca {self.type(value.type, value.wide)}, align 8")
            self.names[name] = (value.type, place)
        if value.wide:
            self.emit(f"store {self.type('float', value.wide)} {value.name}, ptr {self.names[name][1]}, align 8")
            return
        t, place = self.names[name]
        assert isinstance(t, str)
        v = self.cast(value, t)
        stored = v.name
        if self.born.get(name, 0) < self.masks:
            if t not in ("float", "bool"):
                raise UnsupportedTextError(f"{name} is one for all lanes and cannot be set under a condition")
            stored = self.choose(v.name, self.value(f"load {self.type(t)}, ptr {place}, align 8"), t)
        self.emit(f"store {self.type(t)} {stored}, ptr {place}, align 8")

    def branch(self, s: ast.If) -> None:
        """An ``if``; one whose condition is a constant leaves nothing of itself."""
        known = self.truth(s.test)
        if known.name in ("true", "false"):
            self.block(s.body if known.name == "true" else s.orelse)
            return
        if known.type == "bool" and self.lanes > 1:
            self._branch_lanes(s, known.name)
            return
        yes, no, after = self.label("yes"), self.label("no"), self.label("after")
        self.emit(f"br i1 {known.name}, label %{yes}, label %{no if s.orelse else after}")
        self.ended = True
        ends = []
        for label, body in ((yes, s.body), (no, s.orelse)):
            if body:
                self.begin(label)
                self.block(body)
                ends.append(self.ended)
                if not self.ended:
                    self.emit(f"br label %{after}")
                    self.ended = True
        if len(ends) == 2 and all(ends):
            return
        self.lines.append(f"{after}:")
        self.ended = False

    def _branch_lanes(self, s: ast.If, test: str) -> None:
        """Both sides one after the other, each for its lanes, and skipped where no lane wants it."""
        t, outer = self.type("bool"), self.mask
        for body, flip in ((s.body, False), (s.orelse, True)):
            if not body:
                continue
            which = self.value(f"xor {t} {test}, splat (i1 true)") if flip else test
            self.mask = self.value(f"and {t} {outer}, {which}") if outer else which
            self.masks += 1
            some = self.value(f"call i1 @llvm.vector.reduce.or.v{self.lanes}i1({t} {self.mask})")
            yes, after = self.label("yes"), self.label("after")
            self.emit(f"br i1 {some}, label %{yes}, label %{after}")
            self.ended = True
            self.begin(yes)
            self.block(body)
            self.begin(after)
            self.mask, self.masks = outer, self.masks - 1

    def loop(self, s: ast.For) -> None:
        """A ``for`` over a range."""
        assert isinstance(s.target, ast.Name)
        assert isinstance(s.iter, ast.Call)
        first, last = s.iter.args if len(s.iter.args) == 2 else [ast.Constant(0), s.iter.args[0]]
        known = fold(first, self.module.constants), fold(last, self.module.constants)
        if known[0] is not None and known[1] is not None and known[1] <= known[0]:
            return
        if s.target.id == "k" and known[0] == 0 and known[1] is not None:
            self._loop_over_k(s.body, int(known[1]))
            return
        self._count(s.target.id, self.expression(first), self._index(last), s.body)

    def _count(self, name: str, first: Value, end: str, content: list[ast.stmt]) -> None:
        self.born[name] = self.masks  # a counter belongs to its loop, which lanes go through together
        self._store_name(name, first)
        place = self.names[name][1]
        test, body, after = self.label("test"), self.label("body"), self.label("done")
        self.begin(test)
        at = self.value(f"load i64, ptr {place}")
        self.emit(f"br i1 {self.value(f'icmp slt i64 {at}, {end}')}, label %{body}, label %{after}")
        self.ended = True
        self.lines.append(f"{body}:")
        self.ended = False
        self.block(content)
        at = self.value(f"load i64, ptr {place}")
        self.emit(f"store i64 {self.value(f'add nsw i64 {at}, 1')}, ptr {place}")
        self.emit(f"br label %{test}")
        self.ended = True
        self.begin(after)

    def _loop_over_k(self, body: list[ast.stmt], size: int) -> None:
        """Vectors as wide as they come; one by one where the lanes are the vectors already."""
        simple = all(isinstance(s, ast.Assign | ast.AugAssign) for s in body)
        at = 0
        if self.lanes > 1:
            if size > 8 and not any(_asks_k(s) for s in body):
                self._k_at_run_time(body, 0, 0, size)
                return
            for i in range(size):
                self.chunk = (str(i), 0)
                self.block(body)
                self.chunk = None
            return
        for width in (w for w in WIDTHS if w <= self.widest):
            passes = (size - at) // width
            if passes > (1 if not simple else 8):
                self._k_at_run_time(body, at, width, passes)
            else:
                for i in range(passes):
                    self.chunk = (str(at + i * width), width)
                    self.block(body)
                    self.chunk = None
            at += passes * width

    def _k_at_run_time(self, body: list[ast.stmt], at: int, width: int, passes: int) -> None:
        name = self.label("k")
        self.names[name] = ("int", f"%{name}.at")
        self.entry.append(f"  %{name}.at = alloca i64, align 8")
        inner = _Chunk(name, at, width, body)
        self._count(name, Value("int", "0"), str(passes), [inner])

    def repeat(self, s: ast.While) -> None:
        """A ``while``."""
        test, body, after = self.label("test"), self.label("body"), self.label("done")
        self.begin(test)
        self.emit(f"br i1 {self.truth(s.test).name}, label %{body}, label %{after}")
        self.ended = True
        self.begin(body)
        self.block(s.body)
        if not self.ended:
            self.emit(f"br label %{test}")
            self.ended = True
        self.begin(after)

    def leave(self, s: ast.Return) -> None:
        """A ``return``."""
        t = self.signature.returns
        if self.mask and self.masks > ("%mask" in self.mask):
            raise UnsupportedTextError(f"lanes leave a function together: {ast.unparse(s)}")
        if s.value is None:
            self.emit("ret void")
        else:
            self.emit(f"ret {self.type(t)} {self.cast(self.expression(s.value), t).name}")
        self.ended = True

    # Expressions
    def expression(self, e: ast.expr) -> Value:
        """The value of an expression."""
        known = fold(e, self._constants())
        if known is not None:
            if isinstance(known, bool):
                return Value("condition", "true" if known else "false")
            return Value("int", str(known)) if isinstance(known, int) else self.splat(number(known))
        handler = getattr(self, f"_{type(e).__name__.lower()}", None)
        if handler is None:
            raise UnsupportedTextError(ast.unparse(e))
        out: Value = handler(e)
        return out

    def _constants(self) -> dict[str, float | int]:
        if self.chunk is not None and self.chunk[0].isdigit():
            return {**self.module.constants, "k": int(self.chunk[0])}
        return self.module.constants

    def splat(self, scalar: str) -> Value:
        """A number, the same in all lanes."""
        return Value("number" if self.lanes > 1 else "float", scalar)

    def _name(self, e: ast.Name) -> Value:
        if e.id in ("inf", "nan"):
            return self.splat(number(float(e.id)) if e.id == "inf" else "0x7FF8000000000000")
        if e.id == "k" and self.chunk is not None:
            return Value("int", self.chunk[0])
        wide = f"{e.id}.{self.chunk[1]}" if self.chunk is not None else ""
        if wide in self.names:
            name = self.value(f"load {self.type('float', self.chunk[1])}, ptr {self.names[wide][1]}, align 8")  # type: ignore[index]
            return Value("float", name, self.chunk[1])  # type: ignore[index]
        if e.id not in self.names:
            raise UnsupportedTextError(f"{e.id} is used before it is set in {self.node.name}")
        t, place = self.names[e.id]
        if isinstance(t, Array):
            return Value(t, place)
        return Value(t, self.value(f"load {self.type(t)}, ptr {place}, align 8"))

    def _subscript(self, e: ast.Subscript) -> Value:
        if isinstance(e.slice, ast.Slice):
            base, at = self.expression(e.value), self._index(e.slice.lower)
            return Value(base.type, self.value(f"getelementptr {self.type('float')}, ptr {base.name}, i64 {at}"))
        item, pointer, wide, apart = self.address(e)
        if isinstance(item, Array):
            return Value(item, pointer)
        if apart:
            return self.gather(pointer, apart)
        if item == "flag":
            t = f"<{self.lanes} x i8>" if self.lanes > 1 else "i8"
            byte = self.value(f"load {t}, ptr {pointer}, align 1")
            zero = "zeroinitializer" if self.lanes > 1 else "0"
            return Value("bool" if self.lanes > 1 else "condition", self.value(f"icmp ne {t} {byte}, {zero}"))
        name = self.value(f"load {self.type(item, wide)}, ptr {pointer}, align 8")
        return Value(item, name, wide)

    def _index(self, e: ast.expr | None) -> str:
        assert e is not None
        return self.cast(self.expression(e), "int").name

    def address(self, e: ast.Subscript) -> tuple[str | Array, str, int, int]:
        """Item type, pointer, the width where the index runs with k, and how far lanes are apart if not neighbours."""
        base = self.expression(e.value)
        assert isinstance(base.type, Array)
        indices = e.slice.elts if isinstance(e.slice, ast.Tuple) else [e.slice]
        inner, wide = base.type.inner, 0
        if self.chunk is not None and any(_mentions(i, "k") for i in indices):
            wide = self.chunk[1]  # of neighbours in memory: k stands alone in a sum
        at = self._index(indices[0])
        for size, index in zip(inner, indices[1:], strict=False):
            row = self.value(f"mul nsw i64 {at}, {size}")
            at = self.value(f"add nsw i64 {row}, {self._index(index)}")
        left = inner[len(indices) - 1 :]
        for size in left:
            at = self.value(f"mul nsw i64 {at}, {size}")
        rows = base.type.each and self.lanes > 1
        if rows and left:
            raise UnsupportedTextError(f"rows of components are read element by element: {ast.unparse(e)}")
        of = {"float": "double" if rows else self.type("float"), "int": "i64", "flag": "i8"}[base.type.item]
        pointer = self.value(f"getelementptr inbounds {of}, ptr {base.name}, i64 {at}")
        item = Array(base.type.item, left[1:], base.type.each) if left else base.type.item
        return item, pointer, wide, math.prod(inner) if rows else 0

    def _binop(self, e: ast.BinOp) -> Value:
        if (fused := self._fused(e)) is not None:
            return fused
        a, b = self.expression(e.left), self.expression(e.right)
        if isinstance(e.op, ast.Pow):
            return self.call("pow", [self.cast(a, "float"), self.cast(b, "float")])
        if isinstance(e.op, ast.Div):
            a, b = self.match(self.cast(a, "float"), self.cast(b, "float"))
            return Value("float", self.value(f"fdiv {_FAST} {self.type('float', a.wide)} {a.name}, {b.name}"), a.wide)
        if isinstance(e.op, ast.FloorDiv):
            return Value("int", self.value(f"sdiv i64 {a.name}, {b.name}"))  # of numbers that are not negative
        real, whole = _BINARY[type(e.op)]
        if a.type == b.type == "int":
            return Value("int", self.value(f"{whole} nsw i64 {a.name}, {b.name}"))
        a, b = self.match(self.cast(a, "float"), self.cast(b, "float"))
        return Value("float", self.value(f"{real} {_FAST} {self.type('float', a.wide)} {a.name}, {b.name}"), a.wide)

    def _fused(self, e: ast.BinOp) -> Value | None:
        """A vector over k plus or minus a product: one instruction where the processor has it."""
        minus = isinstance(e.op, ast.Sub)
        if minus or isinstance(e.op, ast.Add):
            for product, other in ((e.right, e.left), (e.left, e.right)):
                if isinstance(product, ast.BinOp) and isinstance(product.op, ast.Mult) and self._runs(product):
                    parts = [self.expression(part) for part in (product.left, product.right, other)]
                    wide = max(v.wide for v in parts)
                    a, b, c = (self.widen(self.cast(v, "float"), wide).name for v in parts)
                    t = self.type("float", wide)
                    if minus:
                        sign = self.value(f"fneg {t} {a if product is e.right else c}")
                        a, c = (sign, c) if product is e.right else (a, sign)
                    kind = self.kind(wide)
                    made = self.value(f"call {t} @llvm.fmuladd.{kind}({t} {a}, {t} {b}, {t} {c})")
                    return Value("float", made, wide)
        return None

    def _runs(self, e: ast.expr) -> bool:
        """Whether an expression is a vector over k."""
        if self.lanes > 1 and (self.chunk is not None or self.node.name in LANE_FUNCTIONS):
            return self._real(e)
        if self.chunk is None or not self.chunk[1]:
            return False
        names = {n.id for n in ast.walk(e) if isinstance(n, ast.Name)}
        return bool(names & {"k", "wide"}) or any(f"{n}.{self.chunk[1]}" in self.names for n in names)

    def _real(self, e: ast.expr) -> bool:
        """Whether an expression is a float and no index."""
        if isinstance(e, ast.Name):
            return self.names.get(e.id, ("",))[0] in ("float", "number")
        if isinstance(e, ast.BinOp):
            return self._real(e.left) or self._real(e.right)
        if isinstance(e, ast.UnaryOp):
            return self._real(e.operand)
        return not isinstance(e, ast.Constant) or isinstance(e.value, float)

    def kind(self, wide: int = 0) -> str:
        """How the names of LLVM's own functions end."""
        size = wide or (self.lanes if self.lanes > 1 else 0)
        return f"v{size}f64" if size else "f64"

    def _unaryop(self, e: ast.UnaryOp) -> Value:
        if isinstance(e.op, ast.Not):
            a = self.truth(e.operand)
            ones = "splat (i1 true)" if self.lanes > 1 and a.type == "bool" else "true"
            return Value(a.type, self.value(f"xor {self.type(a.type)} {a.name}, {ones}"))
        a = self.expression(e.operand)
        if a.type == "int":
            return Value("int", self.value(f"sub nsw i64 0, {a.name}"))
        a = self.cast(a, "float")
        return Value("float", self.value(f"fneg {_FAST} {self.type('float', a.wide)} {a.name}"), a.wide)

    def _compare(self, e: ast.Compare) -> Value:
        a, b = self.expression(e.left), self.expression(e.comparators[0])
        real, whole = _COMPARE[type(e.ops[0])]
        if a.type == b.type == "int":
            return Value("condition", self.value(f"icmp {whole} i64 {a.name}, {b.name}"))
        if a.type == b.type == "number":
            return Value("condition", self.value(f"fcmp {real} double {a.name}, {b.name}"))
        a, b = self.match(self.cast(a, "float"), self.cast(b, "float"))
        return Value("bool", self.value(f"fcmp {real} {self.type('float', a.wide)} {a.name}, {b.name}"), a.wide)

    def truth(self, e: ast.expr) -> Value:
        """A condition; numbers count as true where they are not zero."""
        v = self.expression(e)
        if v.type != "int":
            return v
        if v.name.lstrip("-").isdigit():
            return Value("condition", "true" if int(v.name) else "false")
        return self.cast(v, "condition")

    def _boolop(self, e: ast.BoolOp) -> Value:
        word = "and" if isinstance(e.op, ast.And) else "or"
        values = [self.truth(v) for v in e.values]
        t = "bool" if any(v.type == "bool" for v in values) else "condition"
        out = self.cast(values[0], t)
        for v in values[1:]:
            out = Value(t, self.value(f"{word} {self.type(t)} {out.name}, {self.cast(v, t).name}"))
        return out

    def _element(self, e: ast.IfExp) -> Value | None:
        """``a if k == 3 else b``: one element of a vector."""
        test = e.test
        if self.chunk is None or not isinstance(test, ast.Compare) or not _is_k(test.left):
            return None
        b, (at, wide) = self.expression(e.orelse), self.chunk
        element = int(_constant(test.comparators[0], self.module.constants)) - int(at)
        if not 0 <= element < max(1, wide):
            return b
        a = self.cast(self.expression(e.body), "float")
        if not wide:
            return a
        b = self.widen(self.cast(b, "float"), wide)
        t = self.type("float", wide)
        return Value("float", self.value(f"insertelement {t} {b.name}, double {a.name}, i64 {element}"), wide)

    def _ifexp(self, e: ast.IfExp) -> Value:
        element = self._element(e)
        if element is not None:
            return element
        test = self.expression(e.test)
        if test.name in ("true", "false"):
            return self.expression(e.body if test.name == "true" else e.orelse)
        a, b = self.expression(e.body), self.expression(e.orelse)
        if isinstance(a.type, Array) or a.type == b.type == "int":
            t = self.type(a.type)
            return Value(a.type, self.value(f"select i1 {test.name}, {t} {a.name}, {t} {b.name}"))
        a, b = self.match(self.cast(a, "float"), self.cast(b, "float"))
        t = self.type("float", a.wide)
        which = "i1" if test.type == "condition" else self.type("bool", test.wide)
        return Value("float", self.value(f"select {_FAST} {which} {test.name}, {t} {a.name}, {t} {b.name}"), a.wide)

    def _call(self, e: ast.Call) -> Value:
        assert isinstance(e.func, ast.Name)
        name = e.func.id
        arguments = [self.expression(a) for a in e.args]
        if name in _BITS:
            return getattr(self, f"_{name}")(*(self.cast(a, "float").name for a in arguments))  # type: ignore[no-any-return]
        if name == "int":
            return Value("int", self.value(f"fptosi double {arguments[0].name} to i64"))
        if name == "highest":
            return self._highest(arguments[0])
        if name == "wide":
            a = self.cast(arguments[0], "float")
            return self.widen(a, self.chunk[1]) if self.chunk is not None and self.chunk[1] else a
        if name in INTRINSICS:
            return self.call({"abs": "fabs"}.get(name, name), [self.cast(arguments[0], "float")])
        signature = self.module.signatures[name]
        given = []
        for v, t in zip(arguments, signature.arguments.values(), strict=True):
            given.append(f"ptr {v.name}" if isinstance(t, Array) else f"{self.type(t)} {self.cast(v, t).name}")
        if self.mask:
            given.append(f"{self.type('bool')} {self.mask}")
        self.called.add((name, bool(self.mask)))
        label = f"{self.prefix}{name}{'.masked' if self.mask else ''}"
        call = f"call {self.type(signature.returns)} @{label}({', '.join(given)})"
        if signature.returns == "none":
            self.emit(call)
            return Value("none", "")
        return Value(signature.returns, self.value(call))

    def _highest(self, a: Value) -> Value:
        """The largest element of a vector over k, or of the lanes that are on."""
        size = a.wide or self.lanes
        if size == 1:
            return a
        t, name = f"<{size} x double>", self.cast(a, "float").name
        if self.mask:
            name = self.choose(name, f"splat (double {number(-math.inf)})")
        reduced = self.value(f"call double @llvm.vector.reduce.fmax.v{size}f64({t} {name})")
        return Value("number" if self.lanes > 1 else "float", reduced)

    def call(self, name: str, arguments: list[Value]) -> Value:
        """A mathematical function, for each element."""
        arguments = list(self.match(*arguments)) if len(arguments) == 2 else arguments
        wide = arguments[0].wide
        t = self.type("float", wide)
        given = ", ".join(f"{t} {a.name}" for a in arguments)
        if self.lanes > 1 and name in _MATHEMATICS:
            self.called.add((f"lanes_{name}", False))
            return Value("float", self.value(f"call {t} @{self.prefix}lanes_{name}({given})"))
        if name == "tanh" and not wide:
            return Value("float", self.value(f"call double @tanh({given})"))
        return Value("float", self.value(f"call {_FAST} {t} @llvm.{name}.{self.kind(wide)}({given})"), wide)

    # The bits of numbers, for the functions of lanes
    def _bits(self, x: str) -> tuple[str, str, str]:
        t, of = self.type("float"), f"<{self.lanes} x i64>"
        return t, of, self.value(f"bitcast {t} {x} to {of}")

    def _number(self, bits: str) -> Value:
        return Value("float", self.value(f"bitcast <{self.lanes} x i64> {bits} to {self.type('float')}"))

    def _power_of_two(self, k: str) -> Value:
        """2**k of whole k from -1022 to 1023: k + 1023 stands in the last bits of a sum with 1.5 * 2**52."""
        shifted = self.value(f"fadd {self.type('float')} {k}, splat (double {number(1.5 * 2**52 + 1023)})")
        _, of, bits = self._bits(shifted)
        return self._number(self.value(f"shl {of} {bits}, splat (i64 52)"))

    def _above_half(self, x: str) -> tuple[str, str, str]:
        """The bits of x less those of sqrt(1/2): their upper twelve count the powers of two between."""
        _, of, bits = self._bits(x)
        return of, bits, self.value(f"sub {of} {bits}, splat (i64 {_ROOT_HALF})")

    def _exponent_of(self, x: str) -> Value:
        """k of x = m 2**k with m from sqrt(1/2) to sqrt(2), for normal positive x."""
        of, _, above = self._above_half(x)
        k = self.value(f"ashr {of} {above}, splat (i64 52)")
        magic = 1.5 * 2.0**52
        shifted = self._number(self.value(f"add {of} {k}, splat (i64 {_integer(magic)})"))
        t = self.type("float")
        return Value("float", self.value(f"fsub {t} {shifted.name}, splat (double {number(magic)})"))

    def _fraction_of(self, x: str) -> Value:
        """m of x = m 2**k with m from sqrt(1/2) to sqrt(2), for normal positive x."""
        of, bits, above = self._above_half(x)
        k = self.value(f"and {of} {above}, splat (i64 {-(1 << 52)})")
        return self._number(self.value(f"sub {of} {bits}, {k}"))

    def _product_error(self, a: str, b: str, p: str) -> Value:
        """a b - p for p near a b, exactly: fused where the processor can, else by halves (Dekker, 1971)."""
        t = self.type("float")
        if self.fma:
            minus = self.value(f"fneg {t} {p}")
            return Value("float", self.value(f"call {t} @llvm.fma.{self.kind()}({t} {a}, {t} {b}, {t} {minus})"))

        def op(name: str, x: str, y: str) -> str:
            return self.value(f"{name} {t} {x}, {y}")

        def halves(x: str) -> tuple[str, str]:
            big = op("fmul", x, f"splat (double {number(134217729.0)})")
            high = op("fsub", big, op("fsub", big, x))
            return high, op("fsub", x, high)

        (a1, a2), (b1, b2) = halves(a), halves(b)
        e = op("fsub", op("fmul", a1, b1), p)
        e = op("fadd", op("fadd", e, op("fmul", a1, b2)), op("fmul", a2, b1))
        return Value("float", op("fadd", e, op("fmul", a2, b2)))

    # Conversions
    def cast(self, v: Value, to: str | Array) -> Value:
        """The value as another type."""
        if v.type == to or isinstance(to, Array):
            return v
        if to == "float" and v.type == "number":
            return Value("float", self._broadcast(v.name, self.lanes))
        if to == "float" and v.type == "int":
            if v.name.lstrip("-").isdigit():
                return self.cast(self.splat(number(float(v.name))), to)
            return self.cast(self.splat(self.value(f"sitofp i64 {v.name} to double")), to)
        if to == "condition" and v.type == "int":
            return Value(to, self.value(f"icmp ne i64 {v.name}, 0"))
        if self.lanes > 1 and (to, v.type) == ("bool", "condition"):
            if v.name in ("true", "false"):
                return Value(to, f"splat (i1 {v.name})")
            t = self.type("bool")
            first = self.value(f"insertelement {t} poison, i1 {v.name}, i64 0")
            same = f"shufflevector {t} {first}, {t} poison, <{self.lanes} x i32> zeroinitializer"
            return Value(to, self.value(same))
        if to in ("bool", "condition") and v.type in ("bool", "condition") and self.lanes == 1:
            return Value(to, v.name, v.wide)
        raise UnsupportedTextError(f"{v.type} as {to} in {self.node.name}")

    def _broadcast(self, scalar: str, size: int) -> str:
        if scalar.startswith("0x"):
            return f"splat (double {scalar})"
        first = self.value(f"insertelement <{size} x double> poison, double {scalar}, i64 0")
        return self.value(
            f"shufflevector <{size} x double> {first}, <{size} x double> poison, <{size} x i32> zeroinitializer"
        )

    def widen(self, v: Value, wide: int) -> Value:
        """The value for every element of a vector over k."""
        if v.wide == wide:
            return v
        return Value("float", self._broadcast(v.name, wide), wide)

    def match(self, a: Value, b: Value) -> tuple[Value, Value]:
        """Both as vectors where one is."""
        wide = max(a.wide, b.wide)
        return (self.widen(a, wide), self.widen(b, wide)) if wide else (a, b)


def _is_k(e: ast.expr) -> bool:
    return isinstance(e, ast.Name) and e.id == "k"


def _asks_k(s: ast.stmt) -> bool:
    """Whether a statement compares k, so that it must be known."""
    return any(isinstance(n, ast.Compare) and _is_k(n.left) for n in ast.walk(s))


def _integer(value: float) -> int:
    return int(struct.unpack("<q", struct.pack("<d", value))[0])


_ROOT_HALF = _integer(math.sqrt(0.5))


def _mentions(e: ast.expr, name: str) -> bool:
    return any(isinstance(n, ast.Name) and n.id == name for n in ast.walk(e))


def _as_load(target: ast.expr) -> ast.expr:
    if isinstance(target, ast.Subscript):
        return ast.Subscript(target.value, target.slice, ast.Load())
    assert isinstance(target, ast.Name)
    return ast.Name(target.id, ast.Load())


def assemble(
    text: str, prefix: str, entries: Iterable[str], *, lanes: int = 1, fma: bool = True, widest: int = WIDTHS[0]
) -> str:
    """LLVM's language for the entry functions of a text and what they call; names get the prefix.

    ``lanes``: components that a float stands for; ``fma``: whether the processor fuses a product and a sum; ``widest``:
    the longest vectors over k, which its registers should hold by the dozen.
    """
    module = read(text)
    external, wanted = set(entries), [(name, False) for name in entries]
    parts = []
    for name, masked in wanted:  # grows while it is walked
        writer = Writer(
            module, name, prefix, external=name in external, lanes=lanes, masked=masked, fma=fma, widest=widest
        )
        parts.append(writer.function())
        wanted += sorted(writer.called - set(wanted))
    body = "\n\n".join(parts)
    declared = sorted(set(_INTRINSIC.findall(body)))
    return "\n".join([*(_declaration(name) for name in declared), body])


_INTRINSIC = re.compile(r"@(llvm\.[\w.]+|tanh)\(")


def _declaration(name: str) -> str:
    if name == "tanh":
        return "declare double @tanh(double) nounwind"
    kind = name.rsplit(".", 1)[1]
    t = "double" if kind == "f64" else f"<{kind[1:-3]} x double>"
    if ".reduce.or." in name:
        return f"declare i1 @{name}(<{kind[1:-2]} x i1>)"
    if ".reduce." in name:
        return f"declare double @{name}({t})"
    many = 3 if ".fmuladd." in name or ".fma." in name else 2 if ".pow." in name else 1
    return f"declare {t} @{name}({', '.join([t] * many)})"
