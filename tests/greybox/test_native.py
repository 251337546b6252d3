from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fdd.greybox import native
from fdd.greybox.machine import UnsupportedTextError

TEXT = """SIZE = 13
TEN = 10


def mean(a: array, n: int) -> float:
    t = 0.0
    for i in range(n):
        t += a[i]
    return t / n


def pick(a: array, table: indices[2], n: int) -> float:
    t = 0.0
    for i in range(n):
        t += a[table[i, 0]] * a[table[i, 1]]
    return t


def work(a: array, b: rows[SIZE], which: flags, counts: integers, x: float) -> float:
    for k in range(SIZE):
        t = wide(0.0)
        for i in range(2):
            t += b[i, k] * x
        a[k] = t - (x if k == 9 else 0.0)
    n = 0
    while n < TEN and not (a[n] > 100.0):
        if which[n]:
            counts[n] += 1
        n += 1
    if n == TEN:
        return mean(a, SIZE) ** 2
    return -exp(fabs(a[0])) if x < 0.0 else floor(x) + (n // 2)
"""


def by_hand(a: np.ndarray, b: np.ndarray, which: np.ndarray, counts: np.ndarray, x: float) -> float:
    a[:] = (b[0] + b[1]) * x
    a[9] -= x
    beyond = np.flatnonzero(a[:10] > 100)
    n = int(beyond[0]) if len(beyond) else 10
    counts[:n] += which[:n]
    if n == 10:
        return float(a.mean() ** 2)
    return float(-np.exp(abs(a[0])) if x < 0 else np.floor(x) + n // 2)


@pytest.mark.parametrize("x", [1.25, -1.5, 40.5, -40.0])
def test_machine_code_does_what_the_text_says(tmp_path: Path, x: float) -> None:
    made = native.module(TEXT, ["work"], tmp_path)
    random = np.random.default_rng(0)
    b, which = random.normal(size=(2, 13)), random.random(10) < 0.5
    results = []
    for call in (made.work, by_hand):
        a, counts = np.zeros(13), np.zeros(10, dtype=np.int64)
        results.append((call(a, b, which, counts, x), a, counts))
    assert results[0][0] == pytest.approx(results[1][0], rel=1e-14)
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-14)
    np.testing.assert_array_equal(results[0][2], results[1][2])


def test_tables_of_whole_numbers_are_indices(tmp_path: Path) -> None:
    a, table = np.array([2.0, 3.0, 5.0, 7.0]), np.array([[0, 1], [3, 2], [1, 1]])
    assert native.module(TEXT, ["pick"], tmp_path).pick(a, table, 3) == 2 * 3 + 7 * 5 + 3 * 3


def test_arrays_of_another_kind_are_refused(tmp_path: Path) -> None:
    made = native.module(TEXT, ["work"], tmp_path)
    good = np.zeros(13), np.zeros((2, 13)), np.zeros(10, dtype=bool), np.zeros(10, dtype=np.int64)
    for i, bad in enumerate((np.zeros(13, dtype=np.float32), np.zeros((13, 2)).T, np.zeros(10), np.zeros(10))):
        given = [*good[:i], bad, *good[i + 1 :]]
        with pytest.raises(TypeError, match="C-contiguous arrays of"):
            made.work(*given, 1.0)


def test_text_outside_the_language_is_refused() -> None:
    with pytest.raises(UnsupportedTextError, match="import math"):
        native.compiled("def f(a: array):\n    import math\n", "x_", ["f"])


def test_the_same_text_gives_the_same_bytes_whatever_was_compiled_before() -> None:
    first = native.compiled(TEXT, "x_", ["work"])
    native.compiled(TEXT.replace("** 2", "** 3"), "y_", ["mean", "work"])
    assert native.compiled(TEXT, "x_", ["work"]) == first


RUN = """
import sys
import numpy as np
from fdd.greybox.likelihood import Likelihood
from tests.greybox import problems
from tests.greybox.records import kernel_record
from fdd.greybox.filter_bank import FilterBank

d, found = kernel_record("building"), []
m = problems.building()
values = np.array([q.typical for q in m.parameters])
if "first" in sys.argv:  # something else of the same sizes is compiled and loaded before
    FilterBank(problems.building(), [values], hold="first")
e = Likelihood(m, d).evaluate(values)
bank = FilterBank(m, [values])
for k in range(200):
    step = bank.step([d.dt[0]], d.u[k : k + 1], d.y[k : k + 1])
print(e.value.hex(), e.gradient.tobytes().hex(), step.standardised.tobytes().hex(), step.score.tobytes().hex())
"""


def test_compiling_and_loading_processes_give_the_same_bits(tmp_path: Path) -> None:
    root = str(Path(__file__).resolve().parents[2])
    environment = {**os.environ, "FDD_CACHE": str(tmp_path), "PYTHONPATH": root}
    outputs = []
    for more in ([], [], ["first"]):  # compiles, loads, compiles something else and loads
        done = subprocess.run(
            [sys.executable, "-c", RUN, *more], env=environment, capture_output=True, text=True, check=True
        )
        outputs.append(done.stdout)
    assert outputs[0]
    assert outputs[0] == outputs[1] == outputs[2]
    assert list(tmp_path.glob("kernels/*.o"))


def test_a_damaged_object_file_is_made_anew(tmp_path: Path) -> None:
    text = TEXT + "\n\nMARK = 1\n"
    native.module(text, ["work"], tmp_path)
    (path,) = tmp_path.glob("*.o")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    native._modules.clear()
    # The engine knows the symbols of the first load: another process is what meets the damaged file.
    assert native._stored(path) is None
    key = path.stem.removeprefix("fdd_kernel_")
    assert native._object(text, key, ["work"], tmp_path) == whole[32:]
    assert path.read_bytes() == whole
