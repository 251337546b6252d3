"""Local linearisation: prediction of stiff models whose drift is not linear in the states.

Over a (sub)step the drift is replaced by its tangent at the current state (Ozaki 1992; Jimenez and Ozaki 2003), whose
moments are known exactly: x+ = x + Ph f(x), P+ = Ad P Ad' + Qd with Ad = exp(A h), Ph its integral. That is stable at
any stiffness, where Runge-Kutta needs steps of the fastest time constant. The covariance takes its first half step with
the Jacobian at the beginning and its second with that at the end: of second order, and right for fast states, which
follow the slow ones as they are at the end. Substeps follow how far drift and Jacobian bend away from the tangent,
which near the slow manifold of a stiff model is little.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fdd.greybox.trace import Expr

Generator = Any  # those of fdd.greybox.codegen, which calls this module
Scope = Any

_TEMPLATE = '''BEND = 0.0005  # error of a predicted state that one step may make, in standard deviations
TURN = 0.005  # relative error of a predicted covariance
MOST_LOCAL = 4096.0


def move(w: array):
    """State and tangents of x + Ph f + Ph2 df/dt; f stands in C0, its slope over the step in C1."""
    for k in range(K):
        for i in range(N):
            d = w[T + i * K + k]
            for j in range(N):
                at = i * N + j
                d += w[TPH + at * K + k] * w[C0 + j] + w[PH + at] * w[TC0 + j * K + k]
                if FIRST:
                    d += w[TPH2 + at * K + k] * w[C1 + j] + w[PH2 + at] * w[TC1 + j * K + k]
            w[TN + i * K + k] = d
        for i in range(N):
            w[T + i * K + k] = w[TN + i * K + k]
    for i in range(N):
        for j in range(N):
            w[X + i] += w[PH + i * N + j] * w[C0 + j]
            if FIRST:
                w[X + i] += w[PH2 + i * N + j] * w[C1 + j]


def march(w: array):
    """The drift of the tangent at the end of what ``move`` went: Ad f + Ph df/dt, with tangents."""
    for k in range(K):
        for i in range(N):
            d = wide(0.0)
            for j in range(N):
                at = i * N + j
                d += w[TAD + at * K + k] * w[C0 + j] + w[AD + at] * w[TC0 + j * K + k]
                if FIRST:
                    d += w[TPH + at * K + k] * w[C1 + j] + w[PH + at] * w[TC1 + j * K + k]
            w[TN + i * K + k] = d
        for i in range(N):
            w[TC0 + i * K + k] = w[TN + i * K + k]
    for i in range(N):
        t = 0.0
        for j in range(N):
            t += w[AD + i * N + j] * w[C0 + j]
            if FIRST:
                t += w[PH + i * N + j] * w[C1 + j]
        w[C2 + i] = t
    for i in range(N):
        w[C0 + i] = w[C2 + i]


def keep(w: array):
    """Remember drift and Jacobian that the tangent foretells for the end of a step."""
    for i in range(N):
        w[C2 + i] = w[C0 + i]
    for i in range(N * N):
        w[A0 + i] = w[A + i]


def pieces(w: array) -> float:
    """How many steps a step should have been, from how drift and Jacobian at its end differ from those of the tangent.

    The drift's bend grows with the square of time, so that a third of what it would do at full size is its effect.
    """
    n = 1.0
    for i in range(N):
        sd = sqrt(fabs(w[P + i * N - i * (i - 1) // 2]))
        t = 0.0
        turn = 0.0
        for j in range(N):
            t += 2.0 * w[PH + i * N + j] * (w[C0 + j] - w[C2 + j]) / 3.0
            for m in range(N):
                at = m * N + j
                turn += fabs(2.0 * w[PH + i * N + m] * (w[A + at] - w[A0 + at]))
        far = sqrt(fabs(t) / (BEND * sd + 1e-12 * fabs(w[X + i]) + 1e-300))
        n = far if far > n else n
        turn = sqrt(turn * (0.125 / TURN))
        n = turn if turn > n else n
        if not (t - t == 0.0 and turn - turn == 0.0):
            return 16.0
    if n > MOST_LOCAL:
        return -1.0
    return floor(n) + 1.0 if n > 1.0 else 1.0'''


def functions(gen: Generator) -> str:
    """``predict`` by local linearisation, and what it calls."""
    step = "w: array, c: array, h: float, f0: float, f1: float, u0: array, u1: array"
    whole = "w: array, c: array, dt: float, u0: array, u1: array, n: float"
    return "\n\n\n".join([
        _TEMPLATE,
        _function(f"linearise({step})", _linearise(gen)),
        _function(f"advance({whole})", _advance(gen)),
        _function(f"predict({whole}) -> float", _predict(gen)),
    ])  # fmt: skip


def _function(head: str, lines: list[str]) -> str:
    return "\n".join([f"def {head}:", *(f"    {line}" for line in lines)])


def _scope(gen: Generator, inputs: str) -> Scope:
    """Scope of states (and inputs that move), nested in that of parameters (and inputs that are held)."""
    top, middle = gen.scopes("u0")
    moving = gen.variant.hold == "first"
    names = {x.index: f"x{i}" for i, x in enumerate(gen.s.x)}
    names |= {u.index: f"{inputs}{i}" for i, u in enumerate(gen.s.u)} if moving else {}
    return (top if moving else middle).inner(names, {"ui": "v", "ul": "l"}[inputs])


def _load(gen: Generator, inputs: str, fraction: str) -> list[str]:
    """States as names, and inputs at a fraction of the step."""
    lines = [f"x{i} = w[X + {i}]" for i in range(gen.n)]
    if gen.variant.hold == "first":
        lines += [f"{inputs}{i} = u0[{i}] + {fraction} * (u1[{i}] - u0[{i}])" for i in range(gen.layout.inputs)]
    return lines


def _lines(scope: Scope) -> list[str]:
    return [*(_lines(scope.outer) if scope.outer is not None else []), *scope.lines]


def _tangents(gen: Generator, scope: Scope, values: Sequence[Expr], to: int) -> list[str]:
    """Total derivatives of the values with respect to every parameter, at ``to`` in the workspace."""
    K, at = gen.K, gen.at["T"]
    if not K:
        return []
    body = [f"r{i} = w[{at + i * K} + k]" for i in range(gen.n)]
    body += gen.tangents(scope, values, gen.s.x, [f"r{i}" for i in range(gen.n)], "d")
    body += [f"w[{to + i * K} + k] = d{i}" for i in range(len(values))]
    return [f"for k in range({K}):", *(f"    {line}" for line in body)]


def _linearise(gen: Generator) -> list[str]:
    """Drift, Jacobian and noise at the state into C0, A and Q, with tangents; the drift's slope in time into C1."""
    n, at, s = gen.n, gen.at, gen.s
    scope = _scope(gen, "ui")
    jacobian = [a for row in s.A for a in row]
    noise = [s.q[i] if i == j else s.graph.zero for i in range(n) for j in range(n)]
    body: list[str] = []
    for name, values in (("A", jacobian), ("Q", noise), ("C0", s.f)):
        body += [f"w[{name} + {i}] = {scope(e)}" for i, e in enumerate(values)]
        body += _tangents(gen, scope, values, at["T" + name])
    lines = [*_load(gen, "ui", "f0"), *_lines(scope), *body]
    return lines if gen.variant.hold == "zero" else [*lines, *_slope(gen)]


def _slope(gen: Generator) -> list[str]:
    """How fast moving inputs change the drift while the state stays."""
    later = _scope(gen, "ul")
    body = [f"w[C1 + {i}] = ({later(f)} - w[C0 + {i}]) / h" for i, f in enumerate(gen.s.f)]
    body += _tangents(gen, later, gen.s.f, gen.at["TC1"])
    if gen.K:
        size = gen.n * gen.K
        body += [f"for i in range({size}):", "    w[TC1 + i] = (w[TC1 + i] - w[TC0 + i]) / h"]
    return [*_load(gen, "ul", "f1"), *_lines(later), *body]


def _advance(gen: Generator) -> list[str]:
    spread = [*(["propagate_covariance_tangents(w)"] if gen.K else []), *gen.propagate_covariance()]
    step = [
        "linearise(w, c, h, sub / n, (sub + 1.0) / n, u0, u1)",
        "discretise(w, 0.5 * h)",
        *spread,
        "for half in range(2):",
        "    move(w)",
        "    march(w)",
        "keep(w)",
        "linearise(w, c, h, (sub + 1.0) / n, (sub + 1.0) / n, u0, u1)",
        "discretise(w, 0.5 * h)",
        *spread,
    ]
    return ["h = dt / n", "for sub in range(int(n)):", *(f"    {line}" for line in step)]


def _predict(gen: Generator) -> list[str]:
    """Where the number of substeps is not given, one is tried and judged first."""
    nz, size = gen.nz, gen.nz * gen.K
    keep = [f"for i in range({nz}):", "    w[BEFORE + i] = w[X + i]"]
    keep += [f"for i in range({size}):", f"    w[BEFORE + {nz} + i] = w[T + i]"] if size else []
    back = [f"for i in range({nz}):", "    w[X + i] = w[BEFORE + i]"]
    back += [f"for i in range({size}):", f"    w[T + i] = w[BEFORE + {nz} + i]"] if size else []
    return [
        "if n != 0.0:",  # fewer than none is a component that rests
        "    advance(w, c, dt, u0, u1, n)",
        "    return n",
        *keep,
        "advance(w, c, dt, u0, u1, 1.0)",
        "m = pieces(w)",
        "if m > 1.0:",
        *(f"    {line}" for line in back),
        "    advance(w, c, dt, u0, u1, m)",
        "return m",
    ]
