"""Frames depend on the order of the samples alone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.records import NANOSECONDS, Batch, Quality, Sample
from fdd.service.filtering.framing import Framer

SECOND = NANOSECONDS


def framer(lateness: int = 0) -> Framer:
    return Framer(("a", "b"), step=10 * SECOND, lateness=lateness * SECOND, max_jump=1000 * SECOND)


def batch(*rows: tuple[str, float, float | None]) -> Batch:
    return Batch.of([Sample(p, round(t * SECOND), v) for p, t, v in rows])


def test_frame_holds_the_last_value_at_or_before_its_time() -> None:
    f = framer()
    frames = f.add(batch(("a", 1, 1.0), ("a", 10, 2.0), ("b", 9, 3.0), ("a", 11, 9.0)))
    assert frames.time.tolist() == [10 * SECOND]
    assert frames.values.tolist() == [[2.0, 3.0]]


def test_sample_after_its_frame_closed_is_counted_late_and_changes_nothing() -> None:
    f = framer()
    f.add(batch(("a", 5, 1.0), ("a", 12, 2.0)))
    assert len(f.add(batch(("b", 6, 7.0)))) == 0
    assert f.counts["late"] == 1


def test_lateness_keeps_a_frame_open() -> None:
    f = framer(lateness=5)
    assert len(f.add(batch(("a", 5, 1.0), ("a", 12, 2.0), ("b", 6, 7.0)))) == 0
    assert f.add(batch(("a", 15.1, 2.0))).values.tolist() == [[1.0, 7.0]]


def test_duplicate_is_counted_once_and_first_value_stays() -> None:
    f = framer()
    frames = f.add(batch(("a", 5, 1.0), ("a", 5, 2.0), ("a", 12, 0.0)))
    assert frames.values[0, 0] == 1.0
    assert f.counts["duplicate"] == 1


def test_nan_moves_time_forward_without_a_value() -> None:
    f = framer()
    frames = f.add(batch(("a", 5, 1.0), ("b", 20, None)))
    assert frames.values[0, 0] == 1.0
    assert f.counts["no_value"] == 1


def test_lone_leap_into_the_future_is_dropped_and_a_confirmed_one_is_a_gap() -> None:
    f = framer()
    f.add(batch(("a", 5, 1.0)))
    assert len(f.add(batch(("a", 1e6, 5.0), ("a", 6, 2.0)))) == 0
    assert f.counts["clock_jump"] == 1
    frames = f.add(batch(*[("a", 1e6 + i, float(i)) for i in range(5)]))
    assert frames.time.tolist() == [10 * SECOND]
    assert f.counts["clock_jump"] == 5


def test_unknown_point_is_counted() -> None:
    f = framer()
    f.add(batch(("z", 5, 1.0)))
    assert f.counts["unknown_point"] == 1


samples = st.lists(
    st.tuples(
        st.sampled_from(["a", "b", "z"]),
        st.integers(0, 200),
        st.one_of(st.none(), st.floats(-1e3, 1e3)),
        st.sampled_from(list(Quality)),
    ),
    max_size=60,
)


@settings(deadline=None, max_examples=200)
@given(rows=samples, cuts=st.lists(st.integers(0, 60), max_size=6), lateness=st.integers(0, 30), restart=st.booleans())
def test_frames_and_counts_do_not_depend_on_batches_or_restarts(
    rows: list[tuple[str, int, float | None, Quality]], cuts: list[int], lateness: int, restart: bool
) -> None:
    whole = Batch.of([Sample(p, t * SECOND, v, q) for p, t, v, q in rows])
    one = framer(lateness)
    expected = [one.add(whole), one.flush()]
    many = framer(lateness)
    edges = [0, *sorted(min(c, len(whole)) for c in cuts), len(whole)]
    parts = []
    for start, stop in pairwise(edges):
        parts.append(many.add(whole.slice(start, stop)))
        if restart:
            again = framer(lateness)
            again.restore_state(many.export_state())
            many = again
    parts.append(many.flush())
    assert many.counts == one.counts
    for name in ("time", "values"):
        left = np.concatenate([getattr(f, name) for f in expected])
        right = np.concatenate([getattr(f, name) for f in parts])
        assert left.tobytes() == right.tobytes()
