"""Kernel text from traced equations: straight-line Python that LLVM compiles and plain Python runs as well.

One text holds, for one model: ``prepare`` (what depends on parameters only), ``start``, ``predict`` (covariance and, if
wanted, tangents of state and covariance with respect to every parameter), ``update`` (sequential scalar updates on the
packed symmetric covariance), ``run`` (the likelihood over a record) and ``bank`` (one step of many components).

Everything lives in one flat workspace ``w`` at constant offsets, because that is what the compiler can vectorise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from fdd.greybox import local, templates
from fdd.greybox.equations import System, substitute
from fdd.greybox.trace import Expr, Level

Method = Literal["exact", "rk4", "local"]
Hold = Literal["zero", "first"]
LINE = 8  # floats in a cache line
FORMAT = 4  # raise when the meaning of the generated text changes


@dataclass(frozen=True, slots=True)
class Variant:
    """Which filter to generate: how to predict, how inputs act between samples, with tangents or without.

    ``robust``: an innovation beyond w[HUBER] standard deviations is taken for one of just so many.
    ``lanes``: 0 for the likelihood of one record, else how many components of a bank are stepped at once.
    """

    method: Method
    hold: Hold = "zero"
    tangents: bool = False
    robust: bool = False
    lanes: int = 0


def packed(i: int, j: int, n: int) -> int:
    """Position of element (i, j) in the packed upper triangle of a symmetric (n, n) matrix."""
    i, j = min(i, j), max(i, j)
    return i * n - i * (i - 1) // 2 + j - i


@dataclass(frozen=True)
class Layout:
    """Offsets in the workspace; the first ``persistent`` entries are what a filter must remember between samples."""

    n: int
    inputs: int
    outputs: int
    parameters: int
    varying: int
    variant: Variant

    @property
    def K(self) -> int:
        """Tangent row length: parameters, padded to full vectors that do not straddle cache lines."""
        full = 1 if self.variant.lanes > 1 else 4 if self.parameters <= 4 else LINE
        return -(-self.parameters // full) * full if self.variant.tangents else 0

    @property
    def nz(self) -> int:
        """States and packed covariance."""
        return self.n + self.n * (self.n + 1) // 2

    @property
    def offsets(self) -> dict[str, int]:
        """Where each array starts."""
        n, K, nz, q = self.n, self.K, self.nz, self.outputs
        sizes = {"X": n, "P": nz - n, "T": nz * K, "STARTED": 1, "UPREV": self.inputs}
        if self.variant.method == "exact":
            sizes |= {"KEY": 1 + self.varying}
            for name in ("AD", "PH", "PH2", "QD"):
                sizes |= {name: n * n, "T" + name: n * n * K}
        sizes |= {"PERSISTENT": 0, "DE": q * K, "DS": q * K, "DG": q * n * K, "G": q * n, "TXP": n * K}
        sizes |= {"HUBER": 1} if self.variant.robust else {}
        sizes |= {"GRAD": K, "INFO": self.parameters * K, "HELD": 3 * q}
        if self.variant.method != "rk4":
            kept = ("AD", "PH", "PH2", "QD") if self.variant.method == "local" else ()
            for name in (*kept, "A", "Q", "X1", "X2", "Y1", "Y2"):
                sizes |= {name: n * n, "T" + name: n * n * K}
            sizes |= {"M": n * n, "TM": n * n * K}
        if self.variant.method == "exact":
            sizes |= {"LAST": (nz - n) * (1 + K)}
        elif self.variant.method == "local":
            sizes |= {"C0": n, "TC0": n * K, "C1": n, "TC1": n * K, "TN": n * K, "C2": n, "A0": n * n}
            sizes |= {"BEFORE": nz * (1 + K)}
        else:
            sizes |= {"TS": nz * K, "TACC": nz * K}
        if self.variant.lanes:
            sizes |= {"UNOW": self.inputs, "YNOW": q, "OUT": 4 * q, "GAIN": q, "WEIGHT": q}
        out, at = {}, 0
        for name, size in sizes.items():
            # The covariance is right behind the state, and tangents behind their matrix.
            if self.variant.lanes < 2 and name != "P" and name[1:] not in sizes:
                at = -(-at // LINE) * LINE
            out[name] = at
            at += size
        return out | {"SIZE": at}


class Constants:
    """Expressions of the parameters alone, each computed once a parameter vector and kept in ``c``."""

    def __init__(self, parameters: Sequence[Expr]) -> None:
        self.slots = {p.index: i for i, p in enumerate(parameters)}
        self.extra: list[Expr] = []

    def slot(self, e: Expr) -> int:
        """Its place in ``c``."""
        if e.index not in self.slots:
            self.slots[e.index] = len(self.slots)
            self.extra.append(e)
        return self.slots[e.index]


class Scope:
    """Lines of one nesting level of a generated function, and the names its expressions have."""

    def __init__(self, names: dict[int, str], prefix: str, constants: Constants, outer: Scope | None = None) -> None:
        self.names, self.prefix, self.constants, self.outer = dict(names), prefix, constants, outer
        self.level = Level.STATE
        self.lines: list[str] = []

    def __call__(self, e: Expr) -> str:
        """The name (or literal) of an expression's value, writing the lines it needs."""
        if e.op == "constant":
            return repr(e.value)
        if self.outer is not None and e.level <= self.outer.level:
            return self.outer(e)
        name = self.names.get(e.index)
        if name is None:
            if e.level <= Level.PARAMETER and self.outer is None and self.level > Level.CONSTANT:
                slot = self.constants.slot(e)
                name = f"c{slot}"
                self.lines.append(f"{name} = c[{slot}]")
            else:
                name = f"{self.prefix}{e.index}"
                e = self._turned(e)
                self.lines.append(f"{name} = {_operation(e, [self(a) for a in e.args])}")
            self.names[e.index] = name
        return name

    def _turned(self, e: Expr) -> Expr:
        """-(a - b) as b - a, where a - b itself is not at hand."""
        inside = e.args[0] if e.op == "neg" else e
        if inside.op != "sub" or inside is e or self.known(inside):
            return e
        a, b = inside.args
        return Expr(e.graph, "sub", (b, a), None, e.index)

    def known(self, e: Expr) -> bool:
        """Whether an expression's value has a name here or further out."""
        return e.index in self.names or (self.outer is not None and self.outer.known(e))

    def inner(self, names: dict[int, str], prefix: str) -> Scope:
        """A scope nested in this one, for expressions that change more often."""
        return Scope(names, prefix, self.constants, self)


_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}


def _operation(e: Expr, a: Sequence[str]) -> str:
    if e.op in _INFIX:
        return f"{a[0]} {_INFIX[e.op]} {a[1]}"
    if e.op == "neg":
        return f"-{a[0]}"
    if e.op == "where":
        return f"{a[1]} if {a[0]} else {a[2]}"
    if e.op in ("min", "max"):
        return f"{a[0]} if {a[0]} {'<' if e.op == 'min' else '>'} {a[1]} else {a[1]}"
    return f"{e.op}({a[0]})"


def indent(lines: Iterable[str], by: int = 1) -> list[str]:
    """Lines shifted right."""
    return ["    " * by + line for line in lines]


class Generator:
    """Writes the text of one variant of one model."""

    def __init__(self, system: System, variant: Variant) -> None:
        self.s, self.variant = system, variant
        self.n = len(system.x)
        self.layout = Layout(self.n, len(system.u), len(system.y), len(system.p), len(system.varying), variant)
        self.K, self.nz, self.at = self.layout.K, self.layout.nz, self.layout.offsets
        self.constants = Constants(system.p)
        g = system.graph
        self.P = [g.symbol(f"P{k}", Level.STATE) for k in range(self.nz - self.n)]

    def text(self) -> str:
        """The whole module."""
        functions = [self.start(), self.predict(), self.update(), self.steady()]
        head = [f"{name} = {value}" for name, value in self.at.items()]
        sizes = {
            "N": self.n, "NZ": self.nz, "K": self.K, "NP": self.layout.parameters, "NU": self.layout.inputs,
            "NY": self.layout.outputs, "NC": len(self.constants.slots), "FIRST": self.variant.hold == "first",
            "LANES": max(1, self.variant.lanes),
        }  # fmt: skip
        head += [f"{name} = {value}" for name, value in sizes.items()]
        parts = [templates.HEADER, "\n".join(head), self.prepare()]
        if self.variant.method != "rk4":
            parts.append(templates.discretise(tangents=self.K > 0))
        else:
            parts.append(templates.SUBSTEPS)
        if self.variant.lanes:
            parts += [*functions, templates.bank(tangents=self.K > 0, exact=self.variant.method == "exact")]
        else:
            parts += [*functions, templates.loops(self.K > 0, self.freezes, self.variant.robust)]
        return "\n\n".join(parts) + "\n"

    @property
    def freezes(self) -> bool:
        """Whether covariance and gains of regular sampling settle: nothing in them depends on inputs or states.

        Only the loop over a record makes use of it.
        """
        s = self.s
        fixed = all(e.level <= Level.PARAMETER for e in (*s.r, *(a for row in s.H for a in row)))
        v = self.variant
        return v.method == "exact" and not v.lanes and not v.robust and not s.varying and fixed

    # Names
    def pk(self, i: int, j: int) -> int:
        """Packed position of covariance element (i, j)."""
        return packed(i, j, self.n)

    def _states(self, prefix: str) -> dict[int, str]:
        names = {x.index: f"{prefix}{i}" for i, x in enumerate(self.s.x)}
        return names | {P.index: f"{prefix}{self.n + k}" for k, P in enumerate(self.P)}

    def _inputs(self, name: str) -> dict[int, str]:
        return {u.index: f"{name}[{i}]" for i, u in enumerate(self.s.u)}

    def scopes(self, inputs: str) -> tuple[Scope, Scope]:
        """Scope of parameters and, nested in it, scope of inputs."""
        top = Scope({}, "c", self.constants)
        top.level = Level.PARAMETER
        middle = top.inner(self._inputs(inputs), "u")
        middle.level = Level.INPUT
        return top, middle

    # Functions
    def prepare(self) -> str:
        """What depends on parameters only."""
        names = {p.index: f"c[{i}]" for i, p in enumerate(self.s.p)}
        scope = Scope(names, "q", self.constants)
        scope.level = Level.CONSTANT
        for e in self.constants.extra:
            scope.lines.append(f"c[{self.constants.slots[e.index]}] = {scope(e)}")
        return "\n".join([
            "def derive(c: array):", *indent(scope.lines or ["pass"]), "\n",
            "def prepare(p: array, c: array):", "    for i in range(NP):", "        c[i] = p[i]", "    derive(c)", "\n",
            "def prepare_bank(n: int, p: each[NP], c: rows[NC]):",
            "    for b in range(n // LANES):", "        r = b * LANES",
            "        for i in range(NP):", "            c[b, i] = p[r, i]", "        derive(c[b])",
        ])  # fmt: skip

    def start(self) -> str:
        """Start values, their variances and tangents."""
        top, middle = self.scopes("u")
        body = middle.inner({y.index: f"y[{j}]" for j, y in enumerate(self.s.y)}, "v")
        tail = [f"w[X + {i}] = {body(e)}" for i, e in enumerate(self.s.x0)]
        for i, state in enumerate(self.s.model.states):
            tail.append(f"w[P + {self.pk(i, i)}] = {float(state.initial_sd) ** 2!r}")
        if self.K:
            for i, e in enumerate(self.s.x0):
                for k, p in enumerate(self.s.p):
                    d = self.s.graph.diff(e, p)
                    if d is not self.s.graph.zero:
                        tail.append(f"w[T + {i * self.K + k}] = {body(d)}")
        lines = ["for i in range(STARTED):", "    w[i] = 0.0"]
        lines += [*top.lines, *middle.lines, *body.lines, *tail]
        return "\n".join(["def start(w: array, c: array, u: array, y: array):", *indent(lines)])

    def predict(self) -> str:
        """From one sample to the next."""
        head = "def predict(w: array, c: array, dt: float, u0: array, u1: array, n: float) -> float:"
        if self.variant.method == "rk4":
            return "\n".join([head, *indent(self._predict_rk4())])
        if self.variant.method == "local":
            return local.functions(self)
        return "\n".join([
            "def advance(w: array, c: array, dt: float, u0: array, u1: array):", *indent(self._advance()), "", "",
            head, *indent(self._predict_exact()),
        ])  # fmt: skip

    # Runge-Kutta of order four on state and covariance jointly
    def _moments(self) -> list[Expr]:
        """Right-hand sides of dx/dt = f and dP/dt = A P + P A' + Q, P packed (Andersen 2001, Eq. 2.24-2.25)."""
        s, out = self.s, list(self.s.f)
        for i in range(self.n):
            for j in range(i, self.n):
                terms = [s.A[i][k] * self.P[self.pk(k, j)] for k in range(self.n)]
                terms += [s.A[j][k] * self.P[self.pk(k, i)] for k in range(self.n)]
                out.append(s.graph.total([*terms, *([s.q[i]] if i == j else [])]))
        return out

    def _substeps(self, scope: Scope) -> list[str]:
        """Number of substeps from a bound on the Jacobian's eigenvalues: the smaller of its row and column norms."""
        rows = [[scope(a) for a in row if a is not self.s.graph.zero] for row in self.s.A]
        columns = [[scope(a) for a in col if a is not self.s.graph.zero] for col in zip(*self.s.A, strict=True)]
        lines, start = list(scope.lines), ["big = 0.0"]
        for sums in (rows, columns):
            for entries in sums:
                if entries:
                    start += [f"t = {' + '.join(f'fabs({e})' for e in entries)}", "big = t if t > big else big"]
            start += ["small = big", "big = 0.0"] if sums is rows else ["small = big if big < small else small"]
        return [*lines, *start, "n = substeps(small * dt)"]

    def _predict_rk4(self) -> list[str]:
        nz = self.nz
        first = self.variant.hold == "first"
        top, middle = self.scopes("u0")
        choose = (top if first else middle).inner(self._states("x") | (self._inputs("u0") if first else {}), "j")
        auto = ["if n == 0.0:", *indent(self._substeps(choose))]
        loop = self._stages_tangent(top, middle, first) if self.K else self._stages(top, middle, first)
        load = [f"x{i} = w[{i}]" for i in range(nz)]
        save = [f"w[{i}] = x{i}" for i in range(nz)]
        uses = [] if first else middle.lines
        return [
            *top.lines,
            *uses,
            *load,
            *auto,
            "h = dt / n",
            "for sub in range(int(highest(n))):",
            *indent(loop),
            *save,
            "return n",
        ]

    def _stage_inputs(self, fraction: str) -> list[str]:
        return [f"f = (sub + {fraction}) / n"] + [
            f"ui{i} = u0[{i}] + f * (u1[{i}] - u0[{i}])" for i in range(self.layout.inputs)
        ]

    def _stages(self, top: Scope, middle: Scope, first: bool) -> list[str]:
        lines: list[str] = []
        F = self._moments()
        inputs = {u.index: f"ui{i}" for i, u in enumerate(self.s.u)}
        names = "x"
        for stage, (fraction, step) in enumerate((("0.0", ""), ("0.5", "0.5 * h"), ("0.5", "0.5 * h"), ("1.0", "h"))):
            if step:
                previous = f"k{stage}_"
                names = f"s{stage}_"
                lines += [f"{names}{i} = x{i} + {step} * {previous}{i}" for i in range(self.nz)]
            if first:
                lines += self._stage_inputs(fraction)
            scope = (top if first else middle).inner(self._states(names) | (inputs if first else {}), f"v{stage}_")
            values = [scope(e) for e in F]
            lines += [*scope.lines, *(f"k{stage + 1}_{i} = {v}" for i, v in enumerate(values))]
        lines += ["g = h / 6.0", "if sub < n:"]
        lines += [f"    x{i} = x{i} + g * (k1_{i} + 2.0 * (k2_{i} + k3_{i}) + k4_{i})" for i in range(self.nz)]
        return lines

    def _stages_tangent(self, top: Scope, middle: Scope, first: bool) -> list[str]:
        nz, K, at = self.nz, self.K, self.at
        inputs = {u.index: f"ui{i}" for i, u in enumerate(self.s.u)}
        scope = (top if first else middle).inner(self._states("s") | (inputs if first else {}), "v")
        F = self._moments()
        values = [scope(e) for e in F]
        rows = [f"{at['TS'] + i * K} + k" for i in range(nz)]
        tangents = self.tangents(scope, self.s.f, self.s.x, [f"r{i}" for i in range(self.n)], "k_")
        tangents += self._covariance_tangents(scope)
        stage = [
            "b = h / 6.0 if stage == 0 or stage == 3 else h / 3.0",
            "a = 0.5 * h if stage < 2 else h",
        ]
        if first:
            stage += self._stage_inputs("(0.0 if stage == 0 else (1.0 if stage == 3 else 0.5))")
        stage += scope.lines
        stage += [f"k{i} = {v}" for i, v in enumerate(values)]
        body = [f"r{i} = w[{row}]" for i, row in enumerate(rows)] + tangents
        body += [f"w[{at['TACC'] + i * K} + k] += b * k_{i}" for i in range(nz)]
        body += [f"w[{row}] = w[{at['T'] + i * K} + k] + a * k_{i}" for i, row in enumerate(rows)]
        stage += [f"for k in range({K}):", *indent(body)]
        stage += [f"y{i} = y{i} + b * k{i}" for i in range(nz)] + [f"s{i} = x{i} + a * k{i}" for i in range(nz)]
        return [
            f"for i in range({nz}):",
            f"    for k in range({K}):",
            f"        w[{at['TS']} + i * {K} + k] = w[{at['T']} + i * {K} + k]",
            f"        w[{at['TACC']} + i * {K} + k] = w[{at['T']} + i * {K} + k]",
            *(f"s{i} = x{i}" for i in range(nz)),
            *(f"y{i} = x{i}" for i in range(nz)),
            "for stage in range(4):",
            *indent(stage),
            "if sub < n:",  # components of a bank may need more substeps than this one
            *(f"    x{i} = y{i}" for i in range(nz)),
            f"    for i in range({nz}):",
            f"        for k in range({K}):",
            f"            w[{at['T']} + i * {K} + k] = w[{at['TACC']} + i * {K} + k]",
        ]

    def _covariance_tangents(self, scope: Scope) -> list[str]:
        """Tangents of A P + P A' + Q by way of those of A: far fewer products than derivatives of each entry."""
        s, n, g = self.s, self.n, self.s.graph
        rows, lines, moving = [f"r{i}" for i in range(n)], [], set()
        for i in range(n):
            for m in range(n):
                if any(g.diff(s.A[i][m], v) is not g.zero for v in (*s.x, *s.p)):
                    lines += self.tangents(scope, [s.A[i][m]], s.x, rows, f"a{i}_{m}_")
                    moving.add((i, m))
        for i in range(n):
            for j in range(i, n):
                terms = []
                for a, b in ((i, j), (j, i))[: 1 if i == j else 2]:  # row a of A, column b of P
                    for m in range(n):
                        if i != j and m == a:
                            continue
                        if s.A[a][m] is not g.zero:
                            terms.append(f"{_wrap(scope(s.A[a][m]))} * r{n + self.pk(m, b)}")
                    terms += [f"a{a}_{m}_0 * s{n + self.pk(m, b)}" for m in range(n) if (a, m) in moving]
                name = f"k_{n + self.pk(i, j)}"
                if i == j:
                    lines.append(f"t = {' + '.join(terms) or 'wide(0.0)'}")
                    lines += self.tangents(scope, [s.q[i]], s.x, rows, "q")
                    lines.append(f"{name} = t + t + q0")
                else:
                    both = s.A[i][i] + s.A[j][j]
                    terms += [f"{_wrap(scope(both))} * r{n + self.pk(i, j)}"] if both is not g.zero else []
                    lines.append(f"{name} = {' + '.join(terms) or 'wide(0.0)'}")
        return lines

    def tangents(self, scope: Scope, values: Sequence[Expr], by: Sequence[Expr], rows: Sequence[str], to: str
                 ) -> list[str]:  # fmt: skip
        """Lines ``to``i = sum (d value / d by) row + d value / d p, for a loop over k; coefficients go to the scope."""
        g, lines = self.s.graph, []
        for i, e in enumerate(values):
            pairs = [(g.diff(e, b), row) for b, row in zip(by, rows, strict=True)]
            terms = [f"{_wrap(scope(d))} * {row}" if d is not g.one else row for d, row in pairs if d is not g.zero]
            lines.append(f"{to}{i} = {' + '.join([*terms, self._own(scope, e)])}")
        return lines

    def _own(self, scope: Scope, e: Expr) -> str:
        """d value / d p of parameter k; in lanes from a table, so that one loop over k serves all parameters."""
        g, out = self.s.graph, "wide(0.0)"
        if self.variant.lanes > 1 and any(g.diff(e, p) is not g.zero for p in self.s.p):
            row = self.at["SIZE"]
            self.at["SIZE"] += self.K
            for k, p in enumerate(self.s.p):
                if g.diff(e, p) is not g.zero:
                    scope.lines.append(f"w[{row + k}] = {scope(g.diff(e, p))}")
            return f"w[{row} + k]"
        for k, p in enumerate(self.s.p):
            d = g.diff(e, p)
            if d is not g.zero:
                out = f"({scope(d)} if k == {k} else {out})"
        return out

    def _direct(self, scope: Scope, e: Expr, o: int) -> list[str]:
        g = self.s.graph
        pairs = [(k, g.diff(e, p)) for k, p in enumerate(self.s.p)]
        return [f"w[{o + k}] += {scope(d)}" for k, d in pairs if d is not g.zero]

    # Exact discretisation of models linear in x given u
    def _predict_exact(self) -> list[str]:
        n, K, at, s = self.n, self.K, self.at, self.s
        key = ["w[KEY] != dt", *(f"w[KEY + {i + 1}] != u0[{v}]" for i, v in enumerate(s.varying))]
        fresh_top, fresh = self.scopes("u0")
        entries = [f"w[A + {i * n + j}] = {fresh(s.A[i][j])}" for i in range(n) for j in range(n)]
        entries += [f"w[Q + {i * n + i}] = {fresh(s.q[i])}" for i in range(n)]
        if K:
            entries += [f"for i in range({n * n * K}):", "    w[TA + i] = 0.0", "    w[TQ + i] = 0.0"]
            for i in range(n):
                for j in range(n):
                    entries += self._direct(fresh, s.A[i][j], at["TA"] + (i * n + j) * K)
                entries += self._direct(fresh, s.q[i], at["TQ"] + (i * n + i) * K)
        refresh = [*fresh_top.lines, *fresh.lines, *entries, "discretise(w, dt)", "w[KEY] = dt"]
        refresh += [f"w[KEY + {i + 1}] = u0[{v}]" for i, v in enumerate(s.varying)]
        lines = [f"if n >= 0.0 and ({' or '.join(key)}):", *indent(refresh), "advance(w, c, dt, u0, u1)"]
        if K:
            lines += ["propagate_covariance_tangents(w)"]
        return [*lines, *self.propagate_covariance(), "return 1.0"]

    def _advance(self) -> list[str]:
        """x+ = Ad x + Ph c (+ Ph2 dc/dt) with tangents; the covariance may have settled."""
        n, r, first = self.n, range(self.n), self.variant.hold == "first"
        top, middle = self.scopes("u0")
        drive = [f"c_{i} = {middle(c)}" for i, c in enumerate(self.s.c)]
        maps = [("a", "AD"), ("b", "PH"), *([("g", "PH2")] if first else [])]
        load = [f"{m}{i}_{j} = w[{name} + {i * n + j}]" for m, name in maps for i in r for j in r]
        load += [f"x{i} = w[{i}]" for i in r]
        slope: list[str] = []
        after_top, after = self.scopes("u1")
        if first:
            after.prefix = "a"
            slope = [f"d_{i} = ({_wrap(after(c))} - c_{i}) / dt" for i, c in enumerate(self.s.c)]
        tangent = self._state_tangents(middle, after) if self.K else []
        lines = [*top.lines, *middle.lines, *drive, *after_top.lines, *after.lines, *slope, *load, *tangent]
        for i in r:
            total = " + ".join(f"a{i}_{j} * x{j} + b{i}_{j} * c_{j}" for j in r)
            total += "".join(f" + g{i}_{j} * d_{j}" for j in r) if first else ""
            lines.append(f"w[X + {i}] = {total}")
        return lines

    def _state_tangents(self, middle: Scope, after: Scope) -> list[str]:
        """Tangents of x + Ph f (+ Ph2 df/dt), which is the same as Ad x + Ph c and has fewer products.

        With f = A x + c and Ad = 1 + Ph A they are Ad dx + dPh f + Ph (dA x + dc).
        """
        n, K, at, s, zero = self.n, self.K, self.at, self.s, self.s.graph.zero
        scope = middle.inner({x.index: f"x{i}" for i, x in enumerate(s.x)}, "f")
        lines = [f"f_{i} = {scope(f)}" for i, f in enumerate(s.f)]
        body = [f"r{i} = w[{at['T'] + i * K} + k]" for i in range(n)]
        body += [f"e{i} = {self._own(scope, f)}" for i, f in enumerate(s.f)]
        terms = [("PH", "f_", "b", "e", s.f)]
        if self.variant.hold == "first":
            body += [f"h{i} = ({self._own(after, c)} - {self._own(middle, c)}) / dt" for i, c in enumerate(s.c)]
            terms.append(("PH2", "d_", "g", "h", s.c))
        for i in range(n):
            total = []
            for name, value, matrix, own, of in terms:
                total += [f"w[{at['T' + name] + (i * n + j) * K} + k] * {value}{j}" for j in range(n)]
                moving = [any(s.graph.diff(e, p) is not zero for p in s.p) for e in of]
                total += [f"{matrix}{i}_{j} * {own}{j}" for j in range(n) if moving[j]]
            total += [f"a{i}_{j} * r{j}" for j in range(n)]  # what waits for the sample before comes last
            body.append(f"w[{at['T'] + i * K} + k] = {' + '.join(total)}")
        return [*scope.lines, *lines, f"for k in range({K}):", *indent(body)]

    def propagate_covariance(self) -> list[str]:
        """P+ = Ad P Ad' + Qd, unrolled."""
        n, r = self.n, range(self.n)
        lines = [f"a{i}_{j} = w[AD + {i * n + j}]" for i in r for j in r]
        lines += [f"p{k} = w[P + {k}]" for k in range(self.nz - n)]
        lines += [f"m{i}_{j} = " + " + ".join(f"a{i}_{k} * p{self.pk(k, j)}" for k in r) for i in r for j in r]
        for i in r:
            for j in range(i, n):
                total = " + ".join(f"m{i}_{k} * a{j}_{k}" for k in r)
                lines.append(f"w[P + {self.pk(i, j)}] = {total} + w[QD + {i * n + j}]")
        return lines

    # Measurement update
    def update(self) -> str:
        """Sequential scalar updates, joint linearisation at the prediction; missing outputs are skipped."""
        s, n, q = self.s, self.n, len(self.s.y)
        nonlinear = [any(a.level == Level.STATE for a in row) for row in s.H]
        keep = any(nonlinear[1:])
        head = [f"x{i} = w[{i}]" for i in range(self.nz)]
        if keep:
            head += [f"z{i} = x{i}" for i in range(n)]
            if self.K:
                head += [f"for m in range({n * self.K}):", "    w[TXP + m] = w[T + m]"]
        top, middle = self.scopes("u")
        marginal = middle.inner(self._states("x"), "m")
        shown: list[str] = []
        for j in range(q):
            shown += [f"o[{j}] = {marginal(s.h[j])}", f"o[{q + j}] = {marginal(self._variance(s.H[j], s.r[j]))}"]
        body = [*marginal.lines, *shown, "status = 0.0"]
        parts = [self._scalar_update(j, middle, keep and nonlinear[j] and j > 0) for j in range(q)]
        for j, part in enumerate(parts):
            body += [f"o[{2 * q + j}] = nan", f"o[{3 * q + j}] = nan", f"if y[{j}] == y[{j}]:", *indent(part)]
        save = [f"w[{i}] = x{i}" for i in range(self.nz)]
        lines = [*top.lines, *head, *middle.lines, *body, *save, "return status"]
        return "\n".join(["def update(w: array, c: array, u: array, y: array, o: array) -> float:", *indent(lines)])

    def steady(self) -> str:
        """The update of a settled filter: gains and variances (and their tangents) are those of the last full one."""
        s, n, q, K, at = self.s, self.n, len(self.s.y), self.K, self.at
        lines: list[str] = []
        for j in range(q if self.freezes else 0):
            top, middle = self.scopes("u")
            scope = middle.inner({x.index: f"w[{i}]" for i, x in enumerate(s.x)}, f"v{j}_")
            expected = scope(s.h[j])
            tangent = self._steady_tangents(j, scope) if K else []
            lines += [*top.lines, *middle.lines, *scope.lines, f"e = y[{j}] - {_wrap(expected)}"]
            lines += [f"o[{2 * q + j}] = e", f"i = 1.0 / o[{3 * q + j}]", "ei = e * i"]
            lines += [f"g{i} = w[{at['G'] + j * n + i}]" for i in range(n)]
            lines += [*tangent, *(f"w[{i}] += g{i} * ei" for i in range(n))]
        return "\n".join(["def steady(w: array, c: array, u: array, y: array, o: array):", *indent(lines or ["pass"])])

    def _steady_tangents(self, j: int, scope: Scope) -> list[str]:
        """Tangents of e and of x + g e / s from those of x, g and s."""
        n, K, at = self.n, self.K, self.at
        body = [f"r{a} = w[{at['T'] + a * K} + k]" for a in range(n)]
        body += self.tangents(scope, [-self.s.h[j]], self.s.x, [f"r{a}" for a in range(n)], "d")
        body += [f"w[{at['DE'] + j * K} + k] = d0", f"d = d0 - w[{at['DS'] + j * K} + k] * ei"]
        for a in range(n):
            gain = f"w[{at['DG'] + (j * n + a) * K} + k]"
            body.append(f"w[{at['T'] + a * K} + k] = r{a} + ei * {gain} + f{a} * d")
        return [*(f"f{a} = g{a} * i" for a in range(n)), f"for k in range({K}):", *indent(body)]

    def _variance(self, H: Sequence[Expr], r: Expr) -> Expr:
        n = self.n
        g = self.s.graph
        gains = [g.total(self.P[self.pk(i, k)] * H[k] for k in range(n)) for i in range(n)]
        return g.total([*(H[i] * gains[i] for i in range(n)), r])

    def _scalar_update(self, j: int, middle: Scope, from_prediction: bool) -> list[str]:
        s, g, n, K, at = self.s, self.s.graph, self.n, self.K, self.at
        q = len(s.y)
        predicted = [g.symbol(f"predicted {x.value}", Level.STATE) for x in s.x]
        H, h = s.H[j], s.h[j]
        if from_prediction:
            at_prediction = {x.index: z for x, z in zip(s.x, predicted, strict=True)}
            H = [substitute(e, at_prediction) for e in H]
            h = substitute(h, at_prediction)
            h = g.total([h, *(H[i] * (s.x[i] - predicted[i]) for i in range(n))])
        names = self._states("x") | {z.index: f"z{i}" for i, z in enumerate(predicted)}
        scope = middle.inner(names, f"v{j}_")
        gains = [g.total(self.P[self.pk(i, k)] * H[k] for k in range(n)) for i in range(n)]
        variance = self._variance(H, s.r[j])
        lines = [f"g{i} = {scope(e)}" for i, e in enumerate(gains)]
        lines += [f"s = {scope(variance)}", f"e = y[{j}] - {_wrap(scope(h))}"]
        tangent: list[str] = []
        if K:
            tangent = self._tangent_update(j, scope, [-h, variance, *gains], predicted if from_prediction else [])
        lines = [*scope.lines, *lines]
        lines += ["if not (s > 0.0 and s < inf):", "    status = 7.0"]
        lines += [f"o[{2 * q + j}] = e", f"o[{3 * q + j}] = s"]
        if self.variant.robust:
            lines += ["hh = w[HUBER] * w[HUBER]", "far = e * e > hh * s"]
            lines += [
                "by_e = 2.0 * e / hh if far else 0.0",
                "by_s = 0.0 if far else 1.0",
                "s = e * e / hh if far else s",
            ]
        lines += ["i = 1.0 / s", "ei = e * i"]
        lines += [f"w[{at['G'] + j * n + a}] = g{a}" for a in range(n)] if self.freezes else []
        lines += tangent
        lines += [f"x{i} = x{i} + g{i} * ei" for i in range(n)]
        for a in range(n):
            lines.append(f"gi = g{a} * i")
            lines += [f"x{n + self.pk(a, b)} = x{n + self.pk(a, b)} - gi * g{b}" for b in range(a, n)]
        return lines

    def _tangent_update(self, j: int, scope: Scope, values: Sequence[Expr], predicted: Sequence[Expr]) -> list[str]:
        """Tangents of x + g e / s and of P - g g' / s, a parameter at a time, all of them in registers."""
        n, K, at = self.n, self.K, self.at
        rows = [f"r{i}" for i in range(self.nz)] + [f"w[{at['TXP'] + i * K} + k]" for i in range(len(predicted))]
        body = [f"r{i} = w[{at['T'] + i * K} + k]" for i in range(self.nz)]
        body += self.tangents(scope, values, [*self.s.x, *self.P, *predicted], rows, "d")
        body += [f"w[{at['DE'] + j * K} + k] = d0", f"w[{at['DS'] + j * K} + k] = d1"]
        if self.freezes:
            body += [f"w[{at['DG'] + (j * n + a) * K} + k] = d{a + 2}" for a in range(n)]
        body += ["d1 = (by_s * d1 + by_e * d0) * i" if self.variant.robust else "d1 = d1 * i"]
        for a in range(n):
            body += [f"w[{at['T'] + a * K} + k] = r{a} + ei * (d{a + 2} - g{a} * d1) + g{a} * i * d0"]
        for a in range(n):
            for b in range(a, n):
                m = n + self.pk(a, b)
                step = f"i * (g{a} * g{b} * d1 - g{b} * d{a + 2} - g{a} * d{b + 2})"
                body.append(f"w[{at['T'] + m * K} + k] = r{m} + {step}")
        return [f"for k in range({K}):", *indent(body)]


def _wrap(name: str) -> str:
    return f"({name})" if name.startswith("-") else name


def generate(system: System, variant: Variant) -> tuple[str, Layout]:
    """Kernel text of one variant of a model, and its workspace layout."""
    generator = Generator(system, variant)
    return generator.text(), generator.layout
