"""Kernel speed: likelihood, gradient, lanes and fits, side by side with other programs in one run."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def radiator_rk4(
    x: FloatArray, P: FloatArray, u: FloatArray, p: dict[str, float], Q: FloatArray, dt: float, substeps: int
) -> tuple[FloatArray, FloatArray]:
    """Prediction of the radiator of the kernel problems in plain matrices, written independently of the tracer."""

    def slopes(x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        f, A = _radiator(x[:, 0], u, p)
        return f[:, None], A @ P + P @ A.T + Q

    h = dt / substeps
    for _ in range(substeps):
        a, A = slopes(x, P)
        b, B = slopes(x + h / 2 * a, P + h / 2 * A)
        c, C = slopes(x + h / 2 * b, P + h / 2 * B)
        d, D = slopes(x + h * c, P + h * C)
        x, P = x + h / 6 * (a + 2 * b + 2 * c + d), P + h / 6 * (A + 2 * B + 2 * C + D)
    return x, P


def _radiator(x: FloatArray, u: FloatArray, p: dict[str, float]) -> tuple[FloatArray, FloatArray]:
    n, k = 1.3, 4.18
    (T1, T2, Tl, A), (Tf, Ta, q) = x, u

    def g(d: float) -> tuple[Any, Any]:
        s = d * d + 1e-4
        return d * s ** ((n - 1) / 2), s ** ((n - 1) / 2) + d * d * (n - 1) * s ** ((n - 3) / 2)

    g1, s1 = g(T1 - Tl)
    g2, s2 = g(T2 - Tl)
    r, l, m1, m2 = p["Hr"] / p["Cr"], p["Hr"] / p["Cl"], k * q / (p["Cr"] * A), k * q / (p["Cr"] * (1 - A))  # noqa: E741
    f = np.array([
        m1 * (Tf - 2 * T1 + T2) - r * g1,
        m2 * (T1 - T2) - r * g2,
        l * (A * g1 + (1 - A) * g2) - p["Bl"] / p["Cl"] * (Tl - Ta),
        p["a"] * q - p["b"] * A,
    ])  # fmt: skip
    J = np.array([
        [-2 * m1 - r * s1, m1, r * s1, -m1 / A * (Tf - 2 * T1 + T2)],
        [m2, -m2 - r * s2, r * s2, m2 / (1 - A) * (T1 - T2)],
        [l * A * s1, l * (1 - A) * s2, -l * (A * s1 + (1 - A) * s2) - p["Bl"] / p["Cl"], l * (g1 - g2)],
        [0.0, 0.0, 0.0, -p["b"]],
    ])  # fmt: skip
    return f, J
