"""The radiator's likelihood in CasADi, as its users write it: a symbolic step, mapped over the samples, derived by AD.

Equations and covariance are scalar expressions (SX, packed covariance, common terms shared), four Runge-Kutta substeps;
``mapaccum`` carries the state over the record and reverse mode gives the gradient. Its virtual machine is the standard
form; C code by its own generator and the machine's compiler is the fast one.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.greybox.likelihood import Data

FloatArray = NDArray[np.float64]
PARAMETERS = ("Cr", "Hr", "Cl", "Bl", "a", "b", "sT", "sL", "sA", "r")


def _drift(x: Any, u: Any, p: dict[str, Any], ca: Any) -> Any:
    n, k = 1.3, 4.18

    def g(d: Any) -> Any:
        return d * (d * d + 1e-4) ** ((n - 1) / 2)

    g1, g2 = g(x[0] - x[2]), g(x[1] - x[2])
    area, hydronic = x[3], k * u[2] / p["Cr"]
    return ca.vertcat(
        hydronic / area * (u[0] - 2 * x[0] + x[1]) - p["Hr"] / p["Cr"] * g1,
        hydronic / (1 - area) * (x[0] - x[1]) - p["Hr"] / p["Cr"] * g2,
        p["Hr"] / p["Cl"] * (area * g1 + (1 - area) * g2) - p["Bl"] / p["Cl"] * (x[2] - u[1]),
        p["a"] * u[2] - p["b"] * area,
    )


def _step(ca: Any, dt: float, substeps: int) -> Any:
    """One sample: predict over ``dt`` with the inputs before, update with y; z is (x, packed P), out its NLL term."""
    z, u, y, theta = ca.SX.sym("z", 14), ca.SX.sym("u", 3), ca.SX.sym("y"), ca.SX.sym("p", 10)
    p = {name: theta[i] for i, name in enumerate(PARAMETERS)}
    s = ca.SX.sym("s", 14)
    P = ca.SX(4, 4)
    at = [(i, j) for i in range(4) for j in range(i, 4)]
    for m, (i, j) in enumerate(at):
        P[i, j] = P[j, i] = s[4 + m]
    f = _drift(s[:4], u, p, ca)
    A = ca.jacobian(f, s[:4])
    M = A @ P
    dP = M + M.T + ca.diag(ca.vertcat(p["sT"] ** 2, p["sT"] ** 2, p["sL"] ** 2, p["sA"] ** 2))
    slope = ca.Function("slope", [s, u, theta], [ca.vertcat(f, *(dP[i, j] for i, j in at))])
    h, now = dt / substeps, z
    for _ in range(substeps if dt else 0):
        k1 = slope(now, u, theta)
        k2 = slope(now + h / 2 * k1, u, theta)
        k3 = slope(now + h / 2 * k2, u, theta)
        k4 = slope(now + h * k3, u, theta)
        now = now + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    gain = ca.vertcat(*(now[4 + at.index((min(i, 1), max(i, 1)))] for i in range(4)))
    S, e = gain[1] + p["r"] ** 2, y - now[1]
    after = ca.vertcat(now[:4] + gain * e / S, *(now[4 + m] - gain[i] * gain[j] / S for m, (i, j) in enumerate(at)))
    term = 0.5 * (e * e / S + ca.log(S) + np.log(2 * np.pi))
    return ca.Function("step", [z, u, y, theta], [after, term], {"cse": True})


def missing() -> bool:
    """Whether CasADi is not installed."""
    return importlib.util.find_spec("casadi") is None


def radiator(d: Data, compiled: bool = False) -> dict[str, Callable[[FloatArray], Any]] | None:
    """Likelihood ("value") and both likelihood and gradient ("gradient") of the radiator's record.

    None where CasADi is not installed, or where ``compiled`` is wanted and there is no C compiler.
    """
    if missing():
        return None
    ca = importlib.import_module("casadi")
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiled and compiler is None:
        return None
    steps = np.unique(d.dt)
    assert np.ptp(steps) < 1e-9, "a record of even steps is what mapaccum is written for here"
    theta = ca.MX.sym("p", 10)
    start = ca.DM([45, 40, 26, 0.5, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0.01])
    first, first_term = _step(ca, 0.0, 4)(start, d.u[0], d.y[0], theta)
    every = _step(ca, float(d.dt[0]), 4).mapaccum("record", len(d) - 1)
    _, terms = every(first, ca.DM(d.u[:-1].T), ca.DM(d.y[1:].T), ca.repmat(theta, 1, len(d) - 1))
    total = first_term + ca.sum2(terms)
    options: dict[str, Any] = {}
    if compiled:
        flags = ["-O3", "-march=native", "-fno-math-errno"]
        shell = {"compiler": compiler, "flags": flags, "cleanup": False}
        options = {"jit": True, "jit_cleanup": False, "compiler": "shell", "jit_options": shell}
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # its compiler leaves files where it stands
        try:
            value = ca.Function("nll", [theta], [total], options)
            gradient = ca.Function("both", [theta], [total, ca.gradient(total, theta)], options)
        finally:
            os.chdir(before)
    return {"value": lambda p: float(value(p)), "gradient": lambda p: [np.asarray(a).ravel() for a in gradient(p)]}
