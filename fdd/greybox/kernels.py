"""Compiled kernels: generated text, machine code on disk, found again by its hash.

The cache folder is ``FDD_CACHE``, else ``XDG_CACHE_HOME/hvac-fdd``, else ``~/.cache/hvac-fdd``. The key is the hash of
the generated text, of the versions it was compiled with and of the processor, so that a stale kernel is never used.
"""

from __future__ import annotations

import math
import os
import stat
import tempfile
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fdd.greybox import codegen, native
from fdd.greybox.codegen import Layout, Variant
from fdd.greybox.equations import System, trace
from fdd.models.declare import ComponentModel

_PLAIN = """from __future__ import annotations
from numpy import cos, exp, fabs, floor, inf, log, nan, sin, sqrt, tanh


def wide(a):
    return a


def highest(a):
    return a
"""
ENTRIES = ("prepare", "start", "predict", "update", "run")
BANK_ENTRIES = ("prepare_bank", "bank")


@dataclass(frozen=True)
class Kernel:
    """The functions of one generated module, and where things stand in its workspace."""

    system: System
    variant: Variant
    layout: Layout
    module: Any
    text: str

    def workspace(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """A fresh workspace."""
        return aligned(self.module.SIZE * self.lanes)

    @property
    def lanes(self) -> int:
        """How many components share every place of a workspace."""
        return max(1, self.variant.lanes)

    def constants(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Room for what depends on parameters only."""
        return np.zeros(self.module.NC)


def aligned(*shape: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Zeros that begin with a cache line."""
    size = math.prod(shape)
    room = np.zeros(size + codegen.LINE)
    first = -(room.ctypes.data // room.itemsize) % codegen.LINE
    return room[first : first + size].reshape(shape)


_loaded: dict[tuple[int, Variant, bool], Kernel] = {}


def kernel(
    model: ComponentModel,
    *,
    method: codegen.Method | None = None,
    hold: codegen.Hold = "zero",
    tangents: bool = False,
    robust: bool = False,
    plain: bool = False,
    lanes: int = 0,
) -> Kernel:
    """The kernel of a model; ``plain`` runs the same text as ordinary Python, slowly, as an oracle.

    With ``lanes`` it is that of a bank which steps so many components at once, else that of a record's likelihood.
    """
    system = trace(model)
    variant = Variant(method or default_method(model, hold), hold, tangents, robust, lanes)
    name = (id(model), variant, plain)
    known = _loaded.get(name)
    if known is not None and known.system is system:
        return known
    text, layout = codegen.generate(system, variant)
    entries = BANK_ENTRIES if lanes else ENTRIES
    module = _plain(text) if plain else native.module(text, entries, cache_folder(), max(1, lanes))
    if len(_loaded) > 256:
        _loaded.clear()
    _loaded[name] = made = Kernel(system, variant, layout, module, text)
    return made


def default_method(model: ComponentModel, hold: codegen.Hold = "zero") -> codegen.Method:
    """Exact discretisation where the drift is linear in the states, Runge-Kutta with automatic substeps elsewhere."""
    system = trace(model)
    # An interpolated input inside A is no longer a constant matrix over the step.
    return "exact" if system.linear and not (hold == "first" and system.varying) else "rk4"


class CacheError(RuntimeError):
    """A cache folder that others may write: what lies there is run as machine code."""


def cache_folder() -> Path:
    """Where generated kernels are kept; falls back to a temporary folder where home cannot be written.

    Raises
    ------
    CacheError : others own the folder or may write there.
    """
    base = os.environ.get("FDD_CACHE")
    if base is None:
        base = str(Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "hvac-fdd")
    folder = Path(base) / "kernels"
    try:
        _make(folder)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"hvac-fdd-{os.getuid()}" / "kernels"
        _make(folder)
    for place in (folder, folder.parent):
        found = place.stat()
        if found.st_uid not in (os.getuid(), 0) or found.st_mode & stat.S_IWOTH:
            raise CacheError(
                f"others may write the cache folder {place} (owner {found.st_uid}, mode {found.st_mode & 0o777:o}); "
                "what lies there is run: remove it, or name another as FDD_CACHE"
            )
    return folder


def _make(folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.mkdir(exist_ok=True, mode=0o700)


def _plain(text: str) -> types.ModuleType:
    module = types.ModuleType("fdd_plain_kernel")
    exec(compile(_PLAIN + "\n\n" + text, "<kernel>", "exec"), module.__dict__)
    return module
