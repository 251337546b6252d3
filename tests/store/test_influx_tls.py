"""A server with a certificate that signs itself: trusted where the site names it, refused otherwise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fdd.store.influx import InfluxStore
from fdd.store.store import StoreConfig, StoreError, StoreUnavailableError
from tests.certificates import needs_openssl, self_signed
from tests.store.influxd import ORG, own_server

pytestmark = pytest.mark.integration


@needs_openssl
def test_a_server_is_trusted_by_its_certificate_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = self_signed(tmp_path, "influxd", "subjectAltName=IP:127.0.0.1")
    with own_server(tmp_path / "server", tls=pair) as server:
        server.set_up()
        monkeypatch.setenv("FDD_TEST_TOKEN", server.admin_token)
        config = StoreConfig("influx", "n", url=server.url, org=ORG, bucket="first", token_env="FDD_TEST_TOKEN")
        trusting = InfluxStore(replace(config, ca_file=pair[0]))
        assert trusting.series("charts") == []
        trusting.close()
        with pytest.raises(StoreUnavailableError, match=r"(?i)certificate"):
            InfluxStore(config).series("charts")
        with pytest.raises(StoreError, match="ca_file"):
            InfluxStore(replace(config, ca_file=tmp_path / "nowhere.pem"))
