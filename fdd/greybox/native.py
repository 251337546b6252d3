"""Kernel text as machine code: compiled once, kept as an object file, and always run from that file.

Also the process that compiled a kernel loads it from the file, so that every process runs the same bytes. Processes
that want the same kernel at the same time wait for the first; calls release Python's global lock.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import tempfile
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from fdd.greybox import machine, simd
from fdd.greybox.machine import Array

LEVEL = 2
FORMAT = 6  # raise when the same text is compiled to other code
_modules: dict[str, types.ModuleType] = {}
_ITEMS = {"float": np.dtype(np.float64), "int": np.dtype(np.int64), "flag": np.dtype(np.bool_)}
_SCALARS: dict[str, Any] = {"float": ctypes.c_double, "int": ctypes.c_int64, "none": None}


@functools.cache
def _target_machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    return target.create_target_machine(cpu=cpu, features=features, opt=LEVEL, reloc="pic", codemodel="small", jit=True)


@functools.cache
def _engine() -> Any:
    empty = llvm.parse_assembly("")
    empty.triple = _target_machine().triple
    return llvm.create_mcjit_compiler(empty, _target_machine())


def target() -> str:
    """What machine code depends on beside its text: LLVM's version and the processor."""
    features = llvm.get_host_cpu_features().flatten()
    return f"{llvm.llvm_version_info} {llvm.get_process_triple()} {llvm.get_host_cpu_name()} {features} {LEVEL}"


@functools.cache
def width() -> int:
    """How many components a lane kernel steps at once on this processor."""
    return simd.width(llvm.get_host_cpu_features())


def module(text: str, entries: Sequence[str], folder: Path, wide: int = 1) -> types.ModuleType:
    """The entry functions and constants of a kernel text, compiled or taken from ``folder``.

    Functions take arrays of the annotated kinds, C-contiguous, and numbers. Compiled for ``wide`` lanes, a float is a
    vector of so many.
    """
    text = text + simd.text() if wide > 1 else text
    key = hashlib.sha256(f"{FORMAT} {target()} {wide} {' '.join(entries)} {text}".encode()).hexdigest()[:24]
    if key in _modules:
        return _modules[key]
    code = _object(text, key, entries, folder, wide)
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    read = machine.read(text)
    made = types.ModuleType(f"fdd_kernel_{key}")
    made.__dict__.update(read.constants)
    for name in entries:
        address = engine.get_function_address(f"k{key}_{name}")
        made.__dict__[name] = _callable(name, address, read.signatures[name])
    _modules[key] = made
    return made


def _object(text: str, key: str, entries: Sequence[str], folder: Path, wide: int = 1) -> bytes:
    path = folder / f"fdd_kernel_{key}.o"
    code = _stored(path)
    if code is not None:
        return code
    with _alone(folder / f"fdd_kernel_{key}.lock"):
        if (code := _stored(path)) is None:
            made = compiled(text, f"k{key}_", entries, wide)
            with tempfile.NamedTemporaryFile(dir=folder, suffix=".tmp", delete=False) as file:
                file.write(hashlib.sha256(made).digest() + made)
            Path(file.name).replace(path)
            code = _stored(path)
    if code is None:
        raise OSError(f"{path} cannot be read back after writing: is the disk full? Set FDD_CACHE to another folder")
    return code


def _stored(path: Path) -> bytes | None:
    """The object file, None where it is missing or damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return content[32:] if hashlib.sha256(content[32:]).digest() == content[:32] else None


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """One process at a time, where the system has locks; without them the work is only done twice."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def compiled(text: str, prefix: str, entries: Sequence[str], wide: int = 1) -> bytes:
    """Object file of the entry functions of a text."""
    machine_ = _target_machine()
    fma = simd.fuses(llvm.get_host_cpu_features(), llvm.get_process_triple())
    written = machine.assemble(text, prefix, entries, lanes=wide, fma=fma, widest=max(8, 2 * width()))
    code = llvm.parse_assembly(written)
    code.triple = machine_.triple
    code.data_layout = str(machine_.target_data)
    code.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=LEVEL)
    options.loop_vectorization, options.slp_vectorization = False, False
    builder = llvm.create_pass_builder(machine_, options)
    builder.getModulePassManager().run(code, builder)
    return _emitted(machine_, code)


def _emitted(machine_: Any, code: Any) -> bytes:
    return bytes(machine_.emit_object(code))


def _callable(name: str, address: int, signature: machine.Signature) -> Callable[..., Any]:
    kinds = list(signature.arguments.items())
    types_ = [ctypes.c_void_p if isinstance(t, Array) else _SCALARS[t] for _, t in kinds]
    made = ctypes.CFUNCTYPE(_SCALARS[signature.returns], *types_)(address)
    items = [_ITEMS[t.item] if isinstance(t, Array) else None for _, t in kinds]

    def call(*given: Any) -> Any:
        passed = []
        for value, item in zip(given, items, strict=True):
            if item is None:
                passed.append(value)
            elif value.dtype == item and value.flags.c_contiguous:
                passed.append(value.ctypes.data)
            else:
                raise TypeError(f"{name} takes C-contiguous arrays of {item}, not {value.dtype} {value.strides}")
        return made(*passed)

    return call
