"""The functions a model's equations may use, beside ``+ - * / **`` and comparisons.

Each works alike on floats (debugging), on the traced expressions of :mod:`fdd.greybox.trace` (kernels) and on SymPy
symbols (documentation). Write ``where(condition, a, b)`` for a branch; Python's ``if``, ``max`` and ``math`` see one
value only and cannot be traced.
"""

from __future__ import annotations

import math
from typing import Any

__all__ = [
    "absolute", "cos", "exp", "forward", "gpow", "log", "logistic", "maximum", "minimum",
    "sin", "smooth_maximum", "smooth_sign", "softplus", "sqrt", "tanh", "where",
]  # fmt: skip

_FLOAT: dict[str, Any] = {
    "exp": math.exp,
    "log": math.log,
    "sqrt": math.sqrt,
    "tanh": math.tanh,
    "sin": math.sin,
    "cos": math.cos,
    "abs": abs,
    "min": min,
    "max": max,
    "where": lambda condition, a, b: a if condition else b,
}


def _call(name: str, *arguments: Any) -> Any:
    for a in arguments:
        traced = getattr(a, "traced_call", None)
        if traced is not None:
            return traced(name, arguments)
    if any(hasattr(a, "free_symbols") for a in arguments):
        return _symbolic(name, arguments)
    return _FLOAT[name](*arguments)


def _symbolic(name: str, arguments: tuple[Any, ...]) -> Any:
    import sympy

    if name == "where":
        condition, a, b = arguments
        return sympy.Piecewise((a, condition), (b, True))
    return getattr(sympy, {"abs": "Abs", "min": "Min", "max": "Max"}.get(name, name))(*arguments)


def exp(a: Any) -> Any:
    """e to the power ``a``."""
    return _call("exp", a)


def log(a: Any) -> Any:
    """Natural logarithm; ``a`` must be positive."""
    return _call("log", a)


def sqrt(a: Any) -> Any:
    """Square root; its derivative is infinite at zero."""
    return _call("sqrt", a)


def tanh(a: Any) -> Any:
    """Hyperbolic tangent."""
    return _call("tanh", a)


def sin(a: Any) -> Any:
    """Sine of an angle in radians."""
    return _call("sin", a)


def cos(a: Any) -> Any:
    """Cosine of an angle in radians."""
    return _call("cos", a)


def absolute(a: Any) -> Any:
    """Absolute value; its derivative jumps at zero."""
    return _call("abs", a)


def minimum(a: Any, b: Any) -> Any:
    """The smaller of two; its derivative jumps where they meet."""
    return _call("min", a, b)


def maximum(a: Any, b: Any) -> Any:
    """The larger of two; its derivative jumps where they meet. Smooth sibling: :func:`smooth_maximum`."""
    return _call("max", a, b)


def where(condition: Any, a: Any, b: Any) -> Any:
    """``a`` where the condition holds, else ``b``; both are evaluated, only the chosen one counts."""
    return _call("where", condition, a, b)


def forward(flow: Any) -> Any:
    """A flow in the direction that a model is made for; below zero counts as none.

    Meters of a machine at rest read a little below zero. The temperature of what really flows back is not among a
    model's inputs, so that its heat is unknown; heat taken from water that does not come would be made of nothing.
    """
    return maximum(flow, 0.0)


def gpow(d: Any, n: Any) -> Any:
    """Signed power: close to sign(d) abs(d)**n, and smooth at zero, for a driving difference ``d`` [K].

    Andersen (2001), Paper D prints (T - T_l)**n, which is undefined below T_l; this form is odd in ``d`` and its
    derivative at zero is small and finite: d (d**2 + 1e-4)**((n - 1)/2).
    """
    return d * (d * d + 1e-4) ** ((n - 1) / 2)


def smooth_maximum(a: Any, b: Any, width: Any) -> Any:
    """Larger of two, rounded over ``width`` (same unit): 1/2 (a + b + sqrt((a - b)**2 + width**2))."""
    return (a + b + sqrt((a - b) ** 2 + width * width)) / 2


def smooth_sign(a: Any, width: Any) -> Any:
    """Sign of ``a``, rounded over ``width`` (same unit): tanh(a / width)."""
    return tanh(a / width)


def logistic(a: Any) -> Any:
    """1 / (1 + exp(-a)), written with tanh so that it never overflows."""
    return (1 + tanh(a / 2)) / 2


def softplus(a: Any) -> Any:
    """log(1 + exp(a)), without overflow: a smooth, positive version of max(a, 0)."""
    return maximum(a, 0.0) + log(1 + exp(-absolute(a)))
