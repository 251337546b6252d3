"""Generated plant functions, compiled once and kept beside the filters' kernels."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import numba

from fdd.greybox.kernels import Kernel, cache_folder

_HEADER = """import numba
import numpy as np
from math import cos, exp, fabs, log, sin, sqrt, tanh

jit = numba.njit(cache=True, nogil=True, error_model="numpy")
"""

_ADVANCE = '''from {kernel} import P, predict

N = {states}
PIECES = {pieces}


@jit
def draw(w, L, z):
    """Add to the mean in w a normal with the packed covariance at w[P:]; a zero pivot draws nothing."""
    at = P
    for i in range(N):
        for j in range(i, N):
            t = w[at]
            at += 1
            for m in range(i):
                t -= L[i, m] * L[j, m]
            if i == j:
                L[i, i] = sqrt(t) if t > 0.0 else 0.0
            else:
                L[j, i] = t / L[i, i] if L[i, i] > 0.0 else 0.0
    for i in range(N):
        for m in range(i + 1):
            w[i] += L[i, m] * z[m]


@jit
def advance(x, s, inputs, first, constants, work, dt, z):
    """One step of all components of a kind: mean and covariance by the kernel, then a draw."""
    L = np.empty((N, N))
    for c in range(len(first)):
        u = s[inputs[c]]
        w = work[c]
        w[:N] = x[first[c] : first[c] + N]
        for piece in range(PIECES):
            w[P : P + N * (N + 1) // 2] = 0.0
            predict(w, constants[c], dt / PIECES, u, u, 0)
            draw(w, L, z[c, piece])
        x[first[c] : first[c] + N] = w[:N]
'''


def advance_module(kernel: Kernel, states: int, pieces: int) -> ModuleType:
    """Module with ``advance`` for the components of one model."""
    return compiled(_ADVANCE.format(kernel=kernel.module.__name__, states=states, pieces=pieces))


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
