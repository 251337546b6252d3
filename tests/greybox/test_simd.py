from __future__ import annotations

from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest

from fdd.greybox import codegen, native, simd
from fdd.greybox.equations import trace
from fdd.greybox.filter_bank import STATUS, FilterBank, Step
from fdd.greybox.kernels import BANK_ENTRIES
from tests.greybox import problems
from tests.greybox.records import kernel_record

EXTENDED = np.finfo(np.longdouble).eps < np.finfo(np.float64).eps
FIELDS = ("predicted", "innovation", "variance", "standardised", "score", "information")
TEXT = """LANES = {width}


def one(n: int, x: each, y: each, o: each):
    for b in range(n // LANES):
        r = b * LANES
        o[r] = {call}
"""


def call(folder: Path, expression: str, x: np.ndarray, y: np.ndarray, width: int) -> np.ndarray:
    made = native.module(TEXT.format(width=width, call=expression), ["one"], folder, width)
    full = -(-len(x) // width) * width
    out = np.empty(full)
    made.one(full, np.resize(x, full), np.resize(y, full), out)
    return out[: len(x)]


def units(got: np.ndarray, exact: np.ndarray) -> float:
    """Largest error in units of the last place, where that is neither beyond the range nor denormal."""
    with np.errstate(over="ignore"):
        rounded = np.abs(exact.astype(np.float64))
    normal = (rounded < np.inf) & (rounded > 2.3e-308)
    assert normal.mean() > 0.9
    return float(np.max(np.abs(got.astype(np.longdouble) - exact)[normal] / np.spacing(rounded[normal])))


CASES: dict[str, tuple[str, Any, float]] = {
    "exp": ("exp(x[r])", lambda x, y: np.exp(x), 1.02),
    "log": ("log(x[r])", lambda x, y: np.log(x), 1.0),
    "tanh": ("tanh(x[r])", lambda x, y: np.tanh(x), 1.6),
    "pow": ("x[r] ** y[r]", lambda x, y: x**y, 1.05),
}


def arguments(name: str, n: int = 100_000) -> list[tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(0)
    normal, wide = random.normal(size=n), np.exp(random.uniform(-700, 700, n))
    if name == "exp":
        return [(normal, normal), (random.uniform(-708, 709.7, n), normal)]
    if name == "log":
        return [(wide, normal), (random.uniform(0.5, 2, n), normal)]
    if name == "tanh":
        return [(3 * normal, normal), (1e-3 * normal, normal)]
    return [
        (random.uniform(0, 1000, n) + 1e-4, np.full(n, 0.15)),
        (np.exp(normal), 100 * normal),
        (wide, random.uniform(-1, 1, n)),
        (random.uniform(0.9, 1.1, n), random.uniform(-1000, 1000, n)),
    ]


@pytest.mark.skipif(not EXTENDED, reason="no extended precision to compare with")
@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("name", list(CASES))
def test_functions_of_lanes_are_good_to_the_last_place(
    name: str, fused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not fused:  # products by halves, as on a processor without fused sums; kept apart by its folder
        monkeypatch.setattr(simd, "fuses", lambda *_: False)
        monkeypatch.setattr(native, "_modules", {})
        monkeypatch.setattr(native, "FORMAT", -1)
    expression, exact, bound = CASES[name]
    for x, y in arguments(name):
        want = exact(x.astype(np.longdouble), y.astype(np.longdouble))
        assert units(call(tmp_path, expression, x, y, native.width()), want) < bound


@pytest.mark.parametrize("name", list(CASES))
def test_functions_of_lanes_know_what_is_special(name: str, tmp_path: Path) -> None:
    special = np.array([0, 1, -1, 2, -2, 0.5, -0.5, 3, -3, np.inf, -np.inf, np.nan, 5e-324, 1e-310, 1e300, -1e300, 700])
    x, y = (a.ravel() for a in np.meshgrid(special, special))
    expression, exact, _ = CASES[name]
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(call(tmp_path, expression, x, y, native.width()), exact(x, y), rtol=4e-16)


def stepped(name: str, width: int, parameters: np.ndarray, *, score: bool = True, seed: int = 1) -> list[Step]:
    """Components with outputs and inputs missing now and then, uneven steps and rests, each from its own seed."""
    m, d = problems.KERNEL_PROBLEMS[name](), kernel_record(name)
    bank, out = FilterBank(m, parameters, score=score, lanes=width), []
    randoms = [np.random.default_rng([seed, i]) for i in range(len(parameters))]
    for k in range(40):
        y, u, dt, on = [], [], [], []
        for r in randoms:
            y.append(np.where(r.random(d.y.shape[1]) < 0.2, np.nan, d.y[k] + 0.02 * r.normal(size=d.y.shape[1])))
            u.append(np.where(r.random(d.u.shape[1]) < 0.02, np.nan, d.u[k]))
            dt.append(d.dt[0] * r.integers(0 if k % 7 == 0 else 1, 4))
            on.append(r.random() < 0.9)
        out.append(bank.step(dt, u, y, on))
    return out


def scattered(name: str, n: int) -> np.ndarray:
    typical = np.array([q.typical for q in problems.KERNEL_PROBLEMS[name]().parameters])
    spread = [np.random.default_rng(i).normal(size=len(typical)) for i in range(n)]
    return typical * np.exp(0.1 * np.array(spread))


@pytest.mark.parametrize("score", [False, True])
@pytest.mark.parametrize("name", list(problems.KERNEL_PROBLEMS))
def test_lanes_give_what_one_by_one_gives(name: str, score: bool) -> None:
    parameters = scattered(name, 13)
    alone, together = (stepped(name, width, parameters, score=score) for width in (1, native.width()))
    assert {"good", "not active", "started", "time did not increase", "input missing, last value held"} <= {
        STATUS[code] for s in together for code in s.status
    }
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a.status, b.status)
        for field in FIELDS:
            x, y = getattr(a, field), getattr(b, field)
            np.testing.assert_array_equal(np.isnan(x), np.isnan(y))
            axes = tuple(range(1, x.ndim))
            size = np.nanmax(np.abs(x), axis=axes, initial=0.0, keepdims=True)  # of this component's numbers
            if field in ("innovation", "standardised"):  # a difference of readings is as good as these are
                size = np.maximum(size, np.nanmax(np.abs(a.predicted), axis=1, initial=0.0, keepdims=True))
            assert np.nanmax(np.abs(x - y) - 1e-12 * size, initial=-1.0) <= 0.0, field


@pytest.mark.parametrize("name", ["radiator", "heat_exchanger"])
def test_what_a_component_computes_depends_on_no_other(name: str) -> None:
    """To the bit, whatever its lane, however many others, however wide lanes are, whatever they hold."""
    m, d, parameters = problems.KERNEL_PROBLEMS[name](), kernel_record(name), scattered(name, 5)
    alone = FilterBank(m, parameters[3:4])
    together = [FilterBank(m, parameters, lanes=w) for w in (2, 4, 8)]
    random = np.random.default_rng(0)
    for k in range(30):
        y, u = np.tile(d.y[k], (5, 1)), np.tile(d.u[k], (5, 1))
        y[[0, 2]] = random.choice([1e300, -1e300, np.nan, np.inf], size=(2, 1))
        u[[1, 4]] = random.choice([1e200, 0.0, np.nan], size=(2, 1))
        dt = np.array([1e9, 1e-9, np.nan, 1.0, 7.0]) * d.dt[0]
        one = alone.step(d.dt[:1], u[3:4], y[3:4])
        for bank in together:
            many = bank.step(dt, u, y, [True, True, k % 2 == 0, True, k % 3 == 0])
            assert many.status[3] == one.status[0]
            for field in FIELDS:
                np.testing.assert_array_equal(getattr(many, field)[3], getattr(one, field)[0])
    np.testing.assert_array_equal(together[0].export_state()["state"][3], alone.export_state()["state"][0])


def test_state_goes_from_one_width_to_another() -> None:
    """A checkpoint knows nothing of lanes: a processor with wider vectors goes on where another stopped."""
    m, d, parameters = problems.radiator(), kernel_record("radiator"), scattered("radiator", 5)
    narrow, wide = FilterBank(m, parameters, lanes=2), FilterBank(m, parameters, lanes=8)
    for k in range(20):
        if k == 10:
            wide.restore_state(narrow.export_state())
        given = np.full(5, d.dt[0]), np.tile(d.u[k], (5, 1)), np.tile(d.y[k], (5, 1))
        a, b = narrow.step(*given), wide.step(*given)
        np.testing.assert_array_equal(a.innovation, b.innovation)
        np.testing.assert_array_equal(a.score, b.score)


@pytest.mark.parametrize(
    ("triple", "cpu", "width", "words"),
    [
        ("x86_64-unknown-linux-gnu", "x86-64", 2, "mulpd"),
        ("x86_64-unknown-linux-gnu", "haswell", 4, "vfmadd"),
        ("x86_64-unknown-linux-gnu", "skylake-avx512", 8, "zmm"),
        ("aarch64-unknown-linux-gnu", "cortex-a72", 2, "fmla"),
    ],
)
def test_lanes_are_vectors_on_every_processor(triple: str, cpu: str, width: int, words: str,
                                              monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, reloc="pic", opt=2)
    monkeypatch.setattr(native, "_target_machine", lambda: machine)
    monkeypatch.setattr(simd, "fuses", lambda *_: cpu != "x86-64")
    text, _ = codegen.generate(trace(problems.radiator()), codegen.Variant("rk4", lanes=width))
    kept: list[str] = []
    monkeypatch.setattr(native, "_emitted", lambda m, code: kept.append(m.emit_assembly(code)) or b"")
    native.compiled(text + simd.text(), "x_", BANK_ENTRIES, width)
    assert words in kept[0]


def test_the_oldest_processors_compute_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SSE2 alone: two lanes, nothing fused."""
    if not llvm.get_process_triple().startswith("x86_64"):
        pytest.skip("another family of processors")
    here = stepped("radiator", native.width(), scattered("radiator", 3))
    old = llvm.Target.from_default_triple().create_target_machine(
        cpu="x86-64", opt=2, reloc="pic", codemodel="small", jit=True
    )
    monkeypatch.setenv("FDD_CACHE", str(tmp_path))
    monkeypatch.setattr(native, "_target_machine", lambda: old)
    monkeypatch.setattr(native, "target", lambda: "x86-64 alone")
    monkeypatch.setattr(simd, "fuses", lambda *_: False)
    for a, b in zip(here, stepped("radiator", 2, scattered("radiator", 3)), strict=True):
        np.testing.assert_array_equal(a.status, b.status)
        np.testing.assert_allclose(a.predicted, b.predicted, rtol=1e-12)
        np.testing.assert_allclose(a.variance, b.variance, rtol=1e-12)
        np.testing.assert_allclose(a.information, b.information, rtol=1e-9, atol=1e-9 * np.nanmax(a.information))
