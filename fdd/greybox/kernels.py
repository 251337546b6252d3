"""Compiled kernels: generated text on disk, compiled by numba, found again by its hash.

The cache folder is ``FDD_CACHE``, else ``XDG_CACHE_HOME/hvac-fdd``, else ``~/.cache/hvac-fdd``. The key is the hash of
the generated text and of the versions it was compiled with, so that a stale kernel is never used.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fdd.greybox import codegen
from fdd.greybox.codegen import Layout, Variant
from fdd.greybox.equations import System, trace
from fdd.models.declare import ComponentModel

_COMPILED = """import numba
from math import cos, exp, fabs, inf, log, nan, sin, sqrt, tanh

jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
"""
_PLAIN = """from numpy import cos, exp, fabs, inf, log, nan, sin, sqrt, tanh


def jit(function):
    return function
"""


@dataclass(frozen=True)
class Kernel:
    """The functions of one generated module, and where things stand in its workspace."""

    system: System
    variant: Variant
    layout: Layout
    module: Any
    key: str

    def workspace(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """A fresh workspace."""
        return np.zeros(self.module.SIZE)

    def constants(self, rows: int | None = None) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Room for what depends on parameters only."""
        return np.zeros(self.module.NC if rows is None else (rows, self.module.NC))


_loaded: dict[tuple[int, Variant, bool], Kernel] = {}


def method_of(system: System) -> codegen.Method:
    """Exact discretisation where the drift is linear in the states, Runge-Kutta with automatic substeps elsewhere."""
    return "exact" if system.linear else "rk4"


def kernel(
    model: ComponentModel,
    *,
    method: codegen.Method | None = None,
    hold: codegen.Hold = "zero",
    tangents: bool = False,
    plain: bool = False,
) -> Kernel:
    """The kernel of a model; ``plain`` runs the same text as ordinary Python, slowly, as an oracle."""
    system = trace(model)
    variant = Variant(method or _method(system, hold), hold, tangents)
    name = (id(model), variant, plain)
    known = _loaded.get(name)
    if known is not None and known.system is system:
        return known
    text, layout = codegen.generate(system, variant)
    key = _key(text)
    module = _plain(text, key) if plain else _compiled(text, key)
    if len(_loaded) > 256:
        _loaded.clear()
    _loaded[name] = made = Kernel(system, variant, layout, module, key)
    return made


def _method(system: System, hold: codegen.Hold) -> codegen.Method:
    # An interpolated input inside A is no longer a constant matrix over the step.
    return "rk4" if hold == "first" and system.varying else method_of(system)


def _key(text: str) -> str:
    import numba

    versions = f"{codegen.FORMAT} {numba.__version__} {np.__version__} {sys.version_info[:3]} {_COMPILED}"
    return hashlib.sha256((versions + text).encode()).hexdigest()[:24]


def cache_folder() -> Path:
    """Where generated kernels are kept; falls back to a temporary folder where home cannot be written."""
    base = os.environ.get("FDD_CACHE")
    if base is None:
        base = str(Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "hvac-fdd")
    folder = Path(base) / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"hvac-fdd-{os.getuid()}" / "kernels"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return folder


def _compiled(text: str, key: str) -> types.ModuleType:
    name = f"fdd_kernel_{key}"
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.exists():
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(_COMPILED + "\n\n" + text)
        Path(file.name).replace(path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _plain(text: str, key: str) -> types.ModuleType:
    module = types.ModuleType(f"fdd_plain_{key}")
    exec(compile(_PLAIN + "\n\n" + text, f"<kernel {key}>", "exec"), module.__dict__)
    return module
