"""Raw samples to points in SI: conversions, rejections and their counters."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.config import parse_site
from fdd.records import Batch, Quality, Sample
from ingest.mapping import PointMap

SITE = parse_site(
    """
name: test
points:
  supply: {column: AI-1, unit: degF, range: [-40, 220], missing: [0, -9999]}
  flow: {unit: gpm, fluid: 1000}
  lift: {column: "SAT - RAT", unit: degF, quantity: difference}
  fan: {unit: "%", missing: [255]}
  heat: {expression: "4186 [J/(kg*K)] * flow * lift"}
"""
)


def mapped(*samples: Sample) -> tuple[PointMap, list[tuple[str, float, Quality]]]:
    points = PointMap(SITE.measured)
    batch = points(Batch.of(samples, {"row": 7}))
    assert batch.position == {"row": 7}
    rows = zip(batch.point.tolist(), batch.value.tolist(), batch.quality.tolist(), strict=True)
    return points, [(batch.names[i], v, Quality(q)) for i, v, q in rows]


def test_values_become_si_under_their_points_names() -> None:
    _, rows = mapped(
        Sample("AI-1", 1, 50.0), Sample("flow", 1, 100.0), Sample("SAT - RAT", 1, 18.0), Sample("fan", 1, 40.0)
    )
    assert [r[0] for r in rows] == ["supply", "flow", "lift", "fan"]
    np.testing.assert_allclose([r[1] for r in rows], [10.0, 6.30902, 10.0, 0.4], rtol=1e-6)
    assert all(r[2] == Quality.GOOD for r in rows)


def test_each_rejection_is_counted_by_its_reason_and_still_moves_time() -> None:
    points, rows = mapped(
        Sample("AI-1", 1, None),
        Sample("AI-1", 2, float("inf")),
        Sample("AI-1", 3, 0.0),
        Sample("AI-1", 4, -9999.0),
        Sample("AI-1", 5, 400.0),
        Sample("AI-1", 6, 60.0, Quality.BAD),
        Sample("AI-1", 7, 60.0, Quality.UNCERTAIN),
        Sample("fan", 8, 255.0),
        Sample("fan", 9, 0.0),
        Sample("AI-99", 10, 1.0),
    )
    assert points.counters() == {
        "no value": {"AI-1": 2},
        "missing value": {"AI-1": 2, "fan": 1},
        "out of range": {"AI-1": 1},
        "bad quality": {"AI-1": 1},
        "unknown point": {"AI-99": 1},
    }
    assert points.totals()["missing value"] == 3
    assert points.samples == 10
    assert len(rows) == 9
    assert [q for _, _, q in rows] == [Quality.BAD] * 6 + [Quality.UNCERTAIN, Quality.BAD, Quality.GOOD]
    assert np.isnan([v for _, v, _ in rows[:6]]).all()


def test_derived_points_are_not_expected_from_the_source() -> None:
    assert PointMap(SITE.measured).columns == ("AI-1", "flow", "SAT - RAT", "fan")


def test_a_flood_of_unknown_names_keeps_a_bounded_list() -> None:
    points = PointMap(SITE.measured)
    for i in range(30):
        points(Batch.of([Sample(f"ghost-{i}-{k}", 1, 1.0) for k in range(100)]))
    assert points.totals() == {"unknown point": 3000}
    assert len(points.counters()["unknown point"]) <= 1001


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(st.sampled_from(["AI-1", "flow", "fan", "ghost"]), st.floats(-1e4, 1e4) | st.none()), max_size=40
    ),
    st.lists(st.integers(0, 40), max_size=5),
)
def test_outcome_does_not_depend_on_how_the_stream_is_cut(
    samples: list[tuple[str, float | None]], cuts: list[int]
) -> None:
    batch = Batch.of([Sample(p, i, v) for i, (p, v) in enumerate(samples)])
    whole, parts = PointMap(SITE.measured), PointMap(SITE.measured)
    once = whole(batch)
    edges = [0, *sorted(c for c in cuts if c <= len(batch)), len(batch)]
    pieces = [parts(batch.slice(a, b)) for a, b in pairwise(edges)]
    for column in ("point", "time", "value", "quality"):
        joined = np.concatenate([getattr(p, column) for p in pieces])
        np.testing.assert_array_equal(getattr(once, column), joined)
    assert whole.counters() == parts.counters()


def test_mapping_keeps_up_with_half_a_million_samples_a_second() -> None:
    n = 500_000
    rng = np.random.default_rng(1)
    batch = Batch(
        ("AI-1", "flow", "SAT - RAT", "fan", "ghost"),
        np.tile(np.arange(5, dtype=np.int32), n // 5),
        np.repeat(np.arange(n // 5), 5),
        rng.normal(60, 30, n),
        np.zeros(n, np.uint8),
    )
    points = PointMap(SITE.measured)
    began = time.perf_counter()
    points(batch)
    assert n / (time.perf_counter() - began) > 500_000
