"""Generated plant functions, compiled once and kept beside the filters' kernels."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numba
import numpy as np

from fdd.greybox import native
from fdd.greybox.kernels import Kernel, cache_folder
from fdd.records import FloatArray, IntArray

_HEADER = """import numba
import numpy as np
from math import cos, exp, fabs, log, sin, sqrt, tanh

jit = numba.njit(cache=True, nogil=True, error_model="numpy")
"""

# Written after the text of a kernel, in the language of its functions (fdd/greybox/machine.py).
_ADVANCE = '''PIECES = {pieces}


def draw(w: array, L: array, z: array):
    """Add to the mean in w a normal with the packed covariance at w[P:]; a zero pivot draws nothing."""
    at = P
    for i in range(N):
        for j in range(i, N):
            t = w[at]
            at += 1
            for m in range(i):
                t -= L[i * N + m] * L[j * N + m]
            if i == j:
                L[i * N + i] = sqrt(t) if t > 0.0 else 0.0
            else:
                L[j * N + i] = t / L[i * N + i] if L[i * N + i] > 0.0 else 0.0
    for i in range(N):
        for m in range(i + 1):
            w[i] += L[i * N + m] * z[m]


def simulate(
    n: int, x: array, s: array, inputs: indices[NU], first: integers, constants: rows[NC], work: rows[SIZE], dt: float,
    z: rows[PIECES, N], L: array, u: array
):
    """One step of all components of a kind: mean and covariance by the kernel, then a draw."""
    for c in range(n):
        for i in range(NU):
            u[i] = s[inputs[c, i]]
        for i in range(N):
            work[c, i] = x[first[c] + i]
        for piece in range(PIECES):
            for i in range(N, NZ):
                work[c, i] = 0.0
            predict(work[c], constants[c], dt / PIECES, u, u, 0.0)
            draw(work[c], L, z[c, piece])
        for i in range(N):
            x[first[c] + i] = work[c, i]'''


def advance_function(kernel: Kernel, pieces: int) -> Callable[..., None]:
    """``advance(x, s, inputs, first, constants, work, dt, z)`` for the components of one model."""
    text = f"{kernel.text}\n\n{_ADVANCE.format(pieces=pieces)}\n"
    made = native.module(text, ["simulate"], cache_folder()).simulate
    n, inputs = kernel.layout.n, kernel.layout.inputs
    L, u = np.zeros(n * n), np.zeros(inputs)

    def advance(x: FloatArray, s: FloatArray, where: IntArray, first: IntArray, c: FloatArray, work: FloatArray,
                dt: float, z: FloatArray) -> None:  # fmt: skip
        made(len(first), x, s, where, first, c, work, dt, np.ascontiguousarray(z), L, u)

    return advance


def compiled(text: str) -> ModuleType:
    """The module of a generated text; its machine code is kept on disk under the hash of the text."""
    content = _HEADER + "\n\n" + text
    versions = f"{numba.__version__} {sys.version_info[:3]}"
    name = f"fdd_plant_{hashlib.sha256((versions + content).encode()).hexdigest()[:24]}"
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.exists():
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(content)
        Path(file.name).replace(path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
