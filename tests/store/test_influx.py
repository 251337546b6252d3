"""The InfluxDB store against a real server: the conformance suite, and what only a server can do to one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdd.store.influx import InfluxStore
from fdd.store.opening import open_store
from fdd.store.store import StoreConfig, StoreError, StoreUnavailableError
from tests.store.conformance import StoreConformance, rows
from tests.store.influxd import ORG, Influxd

pytestmark = pytest.mark.integration


@pytest.fixture
def config(influxd: Influxd, monkeypatch: pytest.MonkeyPatch) -> StoreConfig:
    monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
    return StoreConfig(
        kind="influx",
        site="north, wing=1",
        url=influxd.url,
        org=ORG,
        bucket=influxd.new_bucket(),
        token_env="FDD_TEST_TOKEN",
    )


class TestInfluxStore(StoreConformance):
    @pytest.fixture
    def store(self, config: StoreConfig) -> InfluxStore:
        return InfluxStore(config)


def test_sites_in_one_bucket_do_not_see_each_other(config: StoreConfig) -> None:
    here, there = InfluxStore(config), InfluxStore(replace(config, site="south"))
    here.write(rows(n=3))
    here.put("alarm", "k", {"x": 1})
    assert len(there.read("charts")) == 0
    assert there.get("alarm", "k") is None


def test_hundreds_of_series_are_read_by_name(config: StoreConfig) -> None:
    store = InfluxStore(config)
    names = tuple(f"c{i:03}/x" for i in range(230))
    store.write(rows("samples", names, 100, value=np.arange(23_000.0)))
    found = store.read("samples", names[5:205])
    assert found["series"].unique().tolist() == sorted(names[5:205])
    np.testing.assert_array_equal(found["value"].to_numpy(), np.arange(500.0, 20_500.0))


def test_killed_server_keeps_what_it_accepted(config: StoreConfig, influxd: Influxd) -> None:
    store = InfluxStore(config)
    store.write(rows("samples", ("p",), 5000, value=np.arange(5000.0)))
    store.put("alarm", "k", {"x": 1})
    influxd.kill()
    with pytest.raises(StoreUnavailableError, match="does not answer"):
        store.write(rows())
    with pytest.raises(StoreUnavailableError, match="does not answer"):
        store.read("samples")
    influxd.start()
    np.testing.assert_array_equal(store.read("samples")["value"].to_numpy(), np.arange(5000.0))
    assert store.get("alarm", "k") == {"x": 1}


def test_a_wrong_token_or_bucket_is_refused_with_the_remedy(
    config: StoreConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(StoreError, match=r"404.*check org .* and bucket"):
        InfluxStore(replace(config, bucket="nowhere")).write(rows())
    monkeypatch.setenv("FDD_TEST_TOKEN", "not-the-token")
    with pytest.raises(StoreError, match=r"401.*token is not valid") as refused:
        InfluxStore(config).write(rows())
    assert "not-the-token" not in str(refused.value)


def test_more_series_than_the_bound_are_refused(config: StoreConfig) -> None:
    store = InfluxStore(config, max_series=2)
    store.write(rows(series=("a/1", "a/2")))
    with pytest.raises(StoreError, match="bound is 2"):
        store.write(rows(series=("a/3",)))


def test_open_store_read_only_reads_the_server(config: StoreConfig) -> None:
    InfluxStore(config).write(rows(n=3))
    assert len(open_store(config, read_only=True).read("charts")) == 3
