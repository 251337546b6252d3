"""The regression forms of the model, declared as sums of monomials so that every derivative is exact.

A form is an equation ``z_0 = theta_1 z_1 + ... + theta_p z_p`` whose terms z_k are sums of monomials in the measured
quantities (T_cdi [K], T_chi [K], Q [W], E [W], and where the form asks for it V or w [1]). Writing a term down as
coefficients and exponents gives its value, its gradient and its Hessian by one loop.

``FRACTIONAL`` is the paper's (Andersen and Reddy 2000, Eq. 6-9). ``DIVISION_FREE`` is the same times Q T_cdi: its terms
are quadratic, so that the moment correction of :mod:`fdd.chiller_eiv.moments` is exact and not an expansion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fdd.chiller_eiv.model import ChillerError
from fdd.records import FloatArray

Monomial = tuple[float, tuple[int, ...]]
"""A coefficient and the exponent of each measured quantity."""

BASE = ("T_cdi", "T_chi", "Q", "E")


@dataclass(frozen=True)
class Form:
    """One way to write the model as a linear regression.

    Attributes
    ----------
    name : short name
    measured : the m measured quantities, in the order of every array of measurements
    parameters : the p parameters, in the order of every estimate
    units : their units
    terms : p + 1 sums of monomials; the first is the left-hand side
    """

    name: str
    measured: tuple[str, ...]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    terms: tuple[tuple[Monomial, ...], ...]

    @cached_property
    def coefficients(self) -> FloatArray:
        """Shape (p + 1, most monomials in a term); zero pads."""
        width = max(len(t) for t in self.terms)
        return np.array([[c for c, _ in t] + [0.0] * (width - len(t)) for t in self.terms])

    @cached_property
    def exponents(self) -> NDArray[np.int64]:
        """Shape (p + 1, most monomials in a term, m)."""
        out = np.zeros((*self.coefficients.shape, len(self.measured)), dtype=np.int64)
        for k, term in enumerate(self.terms):
            for j, (_, exponents) in enumerate(term):
                out[k, j] = exponents
        return out

    def evaluate(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Terms, gradients and Hessians at measurements ``x`` (n, m): (n, q), (n, q, m), (n, q, m, m); q = p + 1."""
        self.check(x)
        return _evaluate(self.coefficients, self.exponents, np.ascontiguousarray(x, dtype=float))

    def check(self, x: FloatArray) -> None:
        """Refuse measurements of the wrong width."""
        if x.ndim != 2 or x.shape[1] != len(self.measured):
            raise ChillerError(
                f"form {self.name!r} wants measurements of shape (n, {len(self.measured)}) in the order "
                f"{', '.join(self.measured)}; got {x.shape}"
            )

    def position(self, parameter: str) -> int:
        """Index of a parameter in every estimate; an unknown one is refused."""
        if parameter not in self.parameters:
            raise ChillerError(
                f"form {self.name!r} has no parameter {parameter!r}; it has {', '.join(self.parameters)}"
            )
        return self.parameters.index(parameter)


@njit(cache=True)
def derivatives(
    coefficients: FloatArray, exponents: NDArray[np.int64], x: FloatArray, z: FloatArray, J: FloatArray, H: FloatArray
) -> None:
    """Write terms z (q,), gradients J (q, m) and Hessians H (q, m, m) at one point x (m,) into the arrays given."""
    m = len(x)
    q, width = coefficients.shape
    z[:] = 0.0
    J[:] = 0.0
    H[:] = 0.0
    for k in range(q):
        for j in range(width):
            value = coefficients[k, j]
            if value == 0.0:
                continue
            for a in range(m):
                for _ in range(exponents[k, j, a]):
                    value *= x[a]
                for _ in range(-exponents[k, j, a]):
                    value /= x[a]
            z[k] += value
            for a in range(m):
                e = exponents[k, j, a]
                if e == 0:
                    continue
                first = value * e / x[a]
                J[k, a] += first
                H[k, a, a] += first * (e - 1) / x[a]
                for b in range(a):
                    f = exponents[k, j, b]
                    if f != 0:
                        second = first * f / x[b]
                        H[k, a, b] += second
                        H[k, b, a] += second


@njit(cache=True)
def _evaluate(
    coefficients: FloatArray, exponents: NDArray[np.int64], x: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, m = x.shape
    q = len(coefficients)
    z = np.empty((n, q))
    J = np.empty((n, q, m))
    H = np.empty((n, q, m, m))
    for i in range(n):
        derivatives(coefficients, exponents, x[i], z[i], J[i], H[i])
    return z, J, H


def _term(*monomials: tuple[float, dict[str, int]], measured: Sequence[str]) -> tuple[Monomial, ...]:
    return tuple((c, tuple(e.get(s, 0) for s in measured)) for c, e in monomials)


def _form(
    name: str,
    measured: tuple[str, ...],
    parameters: Sequence[tuple[str, str]],
    terms: Sequence[Sequence[tuple[float, dict[str, int]]]],
) -> Form:
    return Form(
        name=name,
        measured=measured,
        parameters=tuple(p for p, _ in parameters),
        units=tuple(u for _, u in parameters),
        terms=tuple(_term(*t, measured=measured) for t in terms),
    )


_PARAMETERS = (("dS", "W/K"), ("Q_leak", "W"), ("R", "K/W"))
_Y = ((1.0, {"Q": 1, "T_chi": 1}), (1.0, {"E": 1, "T_chi": 1}), (-1.0, {"Q": 1, "T_cdi": 1}))
_X1 = ((1.0, {"T_chi": 1, "T_cdi": 1}),)
_X2 = ((1.0, {"T_cdi": 1}), (-1.0, {"T_chi": 1}))
_X4 = ((1.0, {"Q": 2, "V": -1}), (1.0, {"Q": 1, "E": 1, "V": -1}))
_X3 = ((1.0, {"Q": 2}), (1.0, {"Q": 1, "E": 1}))

DIVISION_FREE = _form("division-free", BASE, _PARAMETERS, (_Y, _X1, _X2, _X3))
"""Y = dS X1 + Q_leak X2 + R X3 with quadratic terms; the default."""

FRACTIONAL = _form(
    "fractional",
    BASE,
    _PARAMETERS,
    (
        ((1.0, {"T_chi": 1, "T_cdi": -1}), (1.0, {"E": 1, "T_chi": 1, "Q": -1, "T_cdi": -1}), (-1.0, {})),
        ((1.0, {"T_chi": 1, "Q": -1}),),
        ((1.0, {"Q": -1}), (-1.0, {"T_chi": 1, "T_cdi": -1, "Q": -1})),
        ((1.0, {"Q": 1, "T_cdi": -1}), (1.0, {"E": 1, "T_cdi": -1})),
    ),
)
"""The paper's y = dS x1 + Q_leak x2 + R x3 (Eq. 6-9)."""

VARIABLE_FLOW = _form(
    "variable condenser flow",
    (*BASE, "V"),
    (*_PARAMETERS, ("R_flow", "K/W")),
    (_Y, _X1, _X2, _X3, _X4),
)
"""R(V) = R + R_flow / V with V the condenser flow relative to nominal [1] as a fifth sensor.

Within 0.2 % of the effectiveness form (Gordon et al. 2000) from 70 to 120 % flow, and linear. Fouling moves R, not
R_flow. The correction is an expansion to second order here, not exact, because of 1/V.
"""

VARIABLE_SPEED = _form(
    "variable speed",
    (*BASE, "w"),
    (*_PARAMETERS, ("dS_speed", "W/K")),
    (_Y, _X1, _X2, _X3, ((1.0, {"T_chi": 1, "T_cdi": 1, "w": 1}),)),
)
"""dS(w) = dS + dS_speed w with w the compressor speed relative to full speed [1] as a fifth sensor.

Internal losses of a variable-speed machine fall with speed; a constant dS forces that fall into Q_leak and R and makes
them negative. Where the drive's speed is not measured, :func:`variable_speed_by_load` uses the load in its place.
"""


def variable_speed_by_load(reference_load: float) -> Form:
    """The variable-speed form with w = Q / reference_load: refrigerant flow, and so speed, follows the load.

    Parameters
    ----------
    reference_load : load at full speed [W], usually the rated capacity; it only scales ``dS_speed``
    """
    return _form(
        "variable speed by load",
        BASE,
        (*_PARAMETERS, ("dS_speed", "W/K")),
        (_Y, _X1, _X2, _X3, _speed_by_load(reference_load)),
    )


def variable_flow_and_speed_by_load(reference_load: float) -> Form:
    """Variable condenser flow (V measured) and variable speed (by load) together; five parameters.

    For the prediction of power; five parameters are rarely identifiable one by one.
    """
    return _form(
        "variable condenser flow and speed by load",
        (*BASE, "V"),
        (*_PARAMETERS, ("R_flow", "K/W"), ("dS_speed", "W/K")),
        (_Y, _X1, _X2, _X3, _X4, _speed_by_load(reference_load)),
    )


def _speed_by_load(reference_load: float) -> tuple[tuple[float, dict[str, int]], ...]:
    if not reference_load > 0:
        raise ChillerError(f"the reference load must be positive; got {reference_load!r} W: give the rated capacity")
    return ((1.0 / reference_load, {"T_chi": 1, "T_cdi": 1, "Q": 1}),)
