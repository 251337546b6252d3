"""What every store must do, whatever is behind it: a base class of tests; subclasses give the ``store`` fixture."""

from __future__ import annotations

import itertools
import threading

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fdd.records import Rows
from fdd.store.schema import MEASUREMENTS, SchemaError
from fdd.store.store import Store

T0 = 1_700_000_000_123_456_789  # nanoseconds that a float cannot hold
NAN = float("nan")
EXAMPLES = itertools.count()
# The suite runs over several stores on purpose, and the examples of one run share theirs.
SHARED = [HealthCheck.function_scoped_fixture, HealthCheck.differing_executors]


def rows(
    measurement: str = "charts", series: tuple[str, ...] = ("hx/T_out:cusum",), n: int = 3, **fields: object
) -> Rows:
    """``n`` rows of each series, a second apart."""
    k = len(series)
    columns = fields or {f: np.arange(n * k) + 0.5 for f in MEASUREMENTS[measurement].field_names}
    return Rows(
        measurement,
        series,
        np.repeat(np.arange(k, dtype=np.int32), n),
        np.tile(T0 + np.arange(n) * 1_000_000_000, k),
        {name: np.asarray(c, dtype=float) for name, c in columns.items()},
    )


class StoreConformance:
    """One suite over every store."""

    @pytest.fixture
    def store(self) -> Store:
        raise NotImplementedError

    @pytest.mark.parametrize("measurement", MEASUREMENTS)
    def test_rows_come_back_bit_for_bit(self, store: Store, measurement: str) -> None:
        written = rows(measurement, ("b/x", "a/y", "c"), 4)
        store.write(written)
        found = store.read(measurement)
        assert list(found.columns) == ["time", "series", *MEASUREMENTS[measurement].field_names]
        assert found["time"].dtype == np.int64
        assert found["series"].tolist() == ["a/y"] * 4 + ["b/x"] * 4 + ["c"] * 4
        assert found["time"].tolist() == written.time[:4].tolist() * 3
        order = [4, 5, 6, 7, 0, 1, 2, 3, 8, 9, 10, 11]
        for name, column in written.fields.items():
            np.testing.assert_array_equal(found[name].to_numpy(), column[order])

    def test_extreme_values_come_back(self, store: Store) -> None:
        values = np.array([5e-324, -1.7976931348623157e308, 0.1 + 0.2, -0.0, 1e15 + 0.3])
        store.write(rows("samples", ("p",), 5, value=values))
        np.testing.assert_array_equal(store.read("samples")["value"].to_numpy(), values)

    def test_writing_twice_is_writing_once(self, store: Store) -> None:
        store.write(rows(n=50))
        once = store.read("charts")
        store.write([rows(n=50), rows(n=20)])
        pd.testing.assert_frame_equal(store.read("charts"), once)

    def test_a_later_write_of_a_row_wins(self, store: Store) -> None:
        store.write(rows("samples", ("p",), 3, value=[1, 2, 3], quality=[0, 0, 0]))
        store.write(rows("samples", ("p",), 3, value=[7, 8, 9]))
        found = store.read("samples")
        assert found["value"].tolist() == [7, 8, 9]
        assert found["quality"].tolist() == [0, 0, 0]

    def test_the_last_of_equal_keys_in_one_write_wins(self, store: Store) -> None:
        twice = Rows("samples", ("p",), np.zeros(2, np.int32), np.array([T0, T0]), {"value": np.array([1.0, 2.0])})
        store.write(twice)
        assert store.read("samples")["value"].tolist() == [2.0]

    def test_equal_keys_in_one_write_are_merged_field_by_field(self, store: Store) -> None:
        fields = {"value": np.array([1.0, np.nan, 3.0, np.nan]), "quality": np.array([np.nan, 2.0, np.nan, 1.0])}
        store.write(Rows("samples", ("p",), np.zeros(4, np.int32), np.full(4, T0), fields))
        assert store.read("samples").loc[0, ["value", "quality"]].tolist() == [3.0, 1.0]

    def test_nan_leaves_what_stood_there(self, store: Store) -> None:
        store.write(rows("samples", ("p",), 3, value=[1, 2, 3]))
        store.write(rows("samples", ("p",), 3, value=[np.nan, 5, np.nan]))
        assert store.read("samples")["value"].tolist() == [1, 5, 3]

    def test_an_infinite_field_is_missing(self, store: Store) -> None:
        store.write(rows(n=3, statistic=[1, 2, 3], limit=[np.inf, -np.inf, 5]))
        np.testing.assert_array_equal(store.read("charts")["limit"].to_numpy(), [np.nan, np.nan, 5])

    def test_a_missing_field_is_nan(self, store: Store) -> None:
        store.write(rows("samples", ("p",), 2, value=[np.nan, 1], quality=[2, np.nan]))
        found = store.read("samples")
        np.testing.assert_array_equal(found["value"].to_numpy(), [np.nan, 1])
        np.testing.assert_array_equal(found["quality"].to_numpy(), [2, np.nan])

    def test_a_row_without_any_value_is_not_kept(self, store: Store) -> None:
        store.write(rows("samples", ("p",), 2, value=[np.nan, 1], quality=[np.nan, 0]))
        assert len(store.read("samples")) == 1

    def test_start_is_included_and_end_is_not(self, store: Store) -> None:
        store.write(rows(n=5))
        found = store.read("charts", start=T0 + 1_000_000_000, end=T0 + 3_000_000_000)
        assert (found["time"] - T0).tolist() == [1_000_000_000, 2_000_000_000]

    def test_neighbouring_nanoseconds_are_different_rows(self, store: Store) -> None:
        time = T0 + np.arange(3)
        store.write(Rows("samples", ("p",), np.zeros(3, np.int32), time, {"value": np.arange(3.0)}))
        assert store.read("samples", start=T0 + 1, end=T0 + 2)["value"].tolist() == [1.0]

    def test_rows_written_out_of_order_are_read_in_order(self, store: Store) -> None:
        shuffled = np.random.default_rng(5).permutation(100)
        store.write(Rows("samples", ("p",), np.zeros(100, np.int32), T0 + shuffled, {"value": shuffled.astype(float)}))
        assert store.read("samples")["value"].tolist() == list(range(100))

    def test_only_the_series_asked_for_are_read(self, store: Store) -> None:
        store.write(rows(series=("a/1", "b/1", "b/2")))
        assert store.read("charts", ["b/2", "a/1", "unknown"])["series"].unique().tolist() == ["a/1", "b/2"]
        assert store.series("charts") == ["a/1", "b/1", "b/2"]

    def test_an_empty_selection_has_the_same_columns(self, store: Store) -> None:
        store.write(rows())
        for found in (store.read("charts", []), store.read("charts", ["no/such"]), store.read("predictions")):
            assert len(found) == 0
            assert found["time"].dtype == np.int64
            assert found.columns[1] == "series"

    def test_awkward_names_come_back(self, store: Store) -> None:
        names = (
            "ahu 1/T,sup=x",
            'Büro "Süd"/ρ',
            "a/b/c/d",
            "a'b/c|d",
            "$x/{y}",
            "/lead",
            "trail/",
            "#c/-1",
        )
        store.write(rows("samples", names, 1, value=np.arange(len(names))))
        found = store.read("samples")
        assert dict(zip(found["series"], found["value"], strict=True)) == {n: float(i) for i, n in enumerate(names)}
        assert store.read("samples", [names[1]])["value"].tolist() == [1.0]

    @pytest.mark.parametrize("name", ["", " a", "a ", "a\nb", "a\tb", "a\\b", "-/a", "x" * 300, "a\x00b"])
    def test_a_name_that_no_store_can_keep_is_refused(self, store: Store, name: str) -> None:
        with pytest.raises(SchemaError, match="series"):
            store.write(rows("samples", (name,), 1, value=[1]))
        with pytest.raises(SchemaError, match="key"):
            store.put("run", name, {})

    @pytest.mark.parametrize(
        ("bad", "says"),
        [
            (Rows("temperatures", ("p",), np.zeros(1, np.int32), np.array([T0]), {}), "no measurement 'temperatures'"),
            (rows("samples", ("p",), 1, valeu=[1]), "no field valeu"),
            (rows("samples", ("p",), 2, value=[1]), "shape"),
            (
                Rows("samples", ("p",), np.ones(1, np.int32), np.array([T0]), {"value": np.ones(1)}),
                "index 1..1 outside",
            ),
        ],
    )
    def test_rows_outside_the_schema_are_refused_and_nothing_is_written(
        self, store: Store, bad: Rows, says: str
    ) -> None:
        with pytest.raises(SchemaError, match=says):
            store.write([rows("samples", ("good",), 1, value=[1]), bad])
        assert len(store.read("samples")) == 0

    def test_documents_come_back_with_their_arrays(self, store: Store) -> None:
        document = {
            "text": 'ä "quoted" \\ \n line', "number": 0.1, "nan": float("nan"), "inf": float("-inf"), "big": 2**62,
            "list": [1, None, True, {"x": []}], "array": np.random.default_rng(1).normal(size=(3, 4, 5)),
            "ints": np.arange(3, dtype=np.int32), "empty": np.empty((0, 2)), "scalar": np.float64(2.5),
        }  # fmt: skip
        store.put("state", "engine", document)
        found = store.get("state", "engine")
        assert found is not None
        assert list(found) == list(document)
        for name, value in document.items():
            np.testing.assert_array_equal(found[name], value)
            if isinstance(value, np.ndarray):
                assert found[name].dtype == value.dtype

    def test_a_document_replaces_the_one_before(self, store: Store) -> None:
        store.put("baseline", "hx/1", {"a": 1, "long": "x" * 200_000})
        store.put("baseline", "hx/1", {"b": 2})
        assert store.get("baseline", "hx/1") == {"b": 2}

    def test_a_document_of_megabytes_comes_back(self, store: Store) -> None:
        array = np.random.default_rng(2).normal(size=200_000)
        store.put("state", "engine", {"array": array, "umlauts": "ä€😀" * 50_000})
        found = store.get("state", "engine")
        assert found is not None
        np.testing.assert_array_equal(found["array"], array)
        assert found["umlauts"] == "ä€😀" * 50_000

    def test_documents_are_listed_by_key(self, store: Store) -> None:
        for key in ("b/2", "a/10", "a/1", "ü, x=1"):
            store.put("alarm", key, {"key": key})
        store.put("run", "a/0", {"key": "other kind"})
        assert [d["key"] for d in store.list("alarm")] == sorted(["b/2", "a/10", "a/1", "ü, x=1"])
        assert list(store.items("alarm")) == sorted(["b/2", "a/10", "a/1", "ü, x=1"])
        assert store.list("command") == []
        assert store.get("alarm", "no such") is None

    def test_what_is_no_document_is_refused(self, store: Store) -> None:
        with pytest.raises(SchemaError, match="kind"):
            store.put("alarms", "k", {})
        with pytest.raises(SchemaError, match="plain data"):
            store.put("alarm", "k", {"x": object()})
        with pytest.raises(SchemaError, match="dict"):
            store.put("alarm", "k", [1])  # type: ignore[arg-type]

    def test_a_transaction_writes_everything(self, store: Store) -> None:
        with store.transaction():
            store.write(rows())
            store.put("state", "engine", {"position": 3})
        assert len(store.read("charts")) == 3
        assert store.get("state", "engine") == {"position": 3}

    def test_a_failed_transaction_writes_nothing_and_the_store_goes_on(self, store: Store) -> None:
        with pytest.raises(ZeroDivisionError), store.transaction():  # noqa: PT012
            store.write(rows(series=("new/series",)))
            with store.transaction():
                store.put("state", "engine", {"position": 3})
            _ = 1 / 0
        assert len(store.read("charts")) == 0
        assert store.get("state", "engine") is None
        store.write(rows(series=("new/series", "another/series")))
        assert store.series("charts") == ["another/series", "new/series"]
        assert len(store.read("charts", ["new/series"])) == 3

    def test_a_thread_reads_while_another_is_in_a_transaction(self, store: Store) -> None:
        store.write(rows(n=2))
        seen: list[int] = []
        with store.transaction():
            store.write(rows(n=5))
            reader = threading.Thread(target=lambda: seen.append(len(store.read("charts"))))
            reader.start()
            reader.join(20)
        assert seen == [2]
        assert len(store.read("charts")) == 5

    def test_closing_twice_does_nothing(self, store: Store) -> None:
        store.write(rows())
        store.close()
        store.close()

    @settings(deadline=None, max_examples=25, suppress_health_check=SHARED)
    @given(
        st.lists(
            st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5), st.floats(-1e6, 1e6) | st.just(NAN)), max_size=12),
            max_size=5,
        )
    )
    def test_any_sequence_of_writes_equals_a_dictionary(
        self, store: Store, writes: list[list[tuple[int, int, float]]]
    ) -> None:
        example = next(EXAMPLES)  # the store is shared by the examples, their series are not
        names = tuple(f"run{example}/s{i}" for i in range(4))
        model: dict[tuple[str, int], float] = {}
        for write in writes:
            s, t, v = (np.array(c) for c in zip(*write, strict=True)) if write else (np.zeros(0),) * 3
            store.write(Rows("samples", names, s.astype(np.int32), T0 + t.astype(np.int64), {"value": v.astype(float)}))
            model.update({(names[a], T0 + b): c for a, b, c in write if not np.isnan(c)})
        found = store.read("samples", names)
        assert dict(zip(zip(found["series"], found["time"], strict=True), found["value"], strict=True)) == model
