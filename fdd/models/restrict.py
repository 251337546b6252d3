"""Narrow a model: parameters held at known values, or made equal to another parameter.

Known sizes (a pipe's length, a window's area) and common noise levels need no estimating; every parameter less makes
the rest sharper. The equations stay as they are: they see the held or shared value under the old symbol.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from fdd.models.declare import ComponentModel, Equations, ModelError, Namespace


class _Narrowed:
    """Parameters as the equations know them, from the fewer that are estimated."""

    __slots__ = ("_fixed", "_p", "_tied")

    def __init__(self, p: Namespace, fixed: Mapping[str, float], tied: Mapping[str, str]) -> None:
        self._p, self._fixed, self._tied = p, fixed, tied

    def __getattr__(self, symbol: str) -> Any:
        symbol = self._tied.get(symbol, symbol)
        return self._fixed[symbol] if symbol in self._fixed else getattr(self._p, symbol)


def restrict(
    model: ComponentModel, *, fixed: Mapping[str, float] | None = None, tied: Mapping[str, str] | None = None
) -> ComponentModel:
    """The same model with parameters held (``fixed``: symbol to value) or shared (``tied``: symbol to symbol).

    Raises
    ------
    ModelError : a symbol the model does not have, a value outside the parameter's bounds, or a chain of ties
    """
    fixed, tied = dict(fixed or {}), dict(tied or {})
    if not fixed and not tied:
        return model
    _check(model, fixed, tied)

    def narrow(equations: Equations) -> Equations:
        return _with_parameters(equations, lambda p: _Narrowed(p, fixed, tied))

    return replace(
        model,
        parameters=tuple(p for p in model.parameters if p.symbol not in fixed and p.symbol not in tied),
        drift=narrow(model.drift),
        diffusion=narrow(model.diffusion),
        observe=narrow(model.observe),
        noise=narrow(model.noise),
        start=narrow(model.start),
        options={**model.options, **({"fixed": fixed} if fixed else {}), **({"tied": tied} if tied else {})},
        plausible=tuple(replace(c, of=_of_all(c.of, fixed, tied)) for c in model.plausible),
        faults=tuple(
            replace(f, shows={s: v for s, v in f.shows.items() if s not in fixed and s not in tied})
            for f in model.faults
        ),
    )


def _of_all(
    of: Callable[[Mapping[str, float]], float], fixed: Mapping[str, float], tied: Mapping[str, str]
) -> Callable[[Mapping[str, float]], float]:
    """A number of all parameters, from the fewer that are estimated."""

    def number(p: Mapping[str, float]) -> float:
        known = {**p, **fixed}
        return of({**known, **{symbol: known[other] for symbol, other in tied.items()}})

    return number


def _with_parameters(equations: Equations, change: Callable[[Namespace], Namespace]) -> Equations:
    return lambda first, second, p: equations(first, second, change(p))


def _check(model: ComponentModel, fixed: Mapping[str, float], tied: Mapping[str, str]) -> None:
    known = {p.symbol: p for p in model.parameters}
    for symbol in (*fixed, *tied, *tied.values()):
        if symbol not in known:
            raise ModelError(
                f"{model.name}: no parameter {symbol!r} to hold or to tie; its parameters: {', '.join(known)}"
            )
    for symbol, value in fixed.items():
        p = known[symbol]
        if not p.lower <= value <= p.upper:
            raise ModelError(
                f"{model.name}: {symbol} cannot be held at {value} {p.unit}, outside [{p.lower}, {p.upper}] {p.unit}"
            )
    for symbol, other in tied.items():
        if other in tied:
            raise ModelError(f"{model.name}: {symbol} is tied to {other}, itself tied; tie both to {tied[other]}")
        if symbol in fixed:
            raise ModelError(f"{model.name}: {symbol} is both held at {fixed[symbol]} and tied to {other}; keep one")
