"""A server with a certificate that signs itself: trusted where the site names it, refused otherwise."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from fdd.store.influx import InfluxStore
from fdd.store.store import StoreConfig, StoreError, StoreUnavailableError
from tests.store.influxd import ORG, Influxd, find_influxd

pytestmark = pytest.mark.integration


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here to make a certificate")
def test_a_server_is_trusted_by_its_certificate_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    binary = find_influxd()
    if binary is None:
        pytest.skip("no influxd here: run deploy/influxd/build.sh or set FDD_INFLUXD")
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=influxd"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-out", str(certificate), "-keyout", str(key)]
    subprocess.run(command, check=True, capture_output=True)
    server = Influxd(binary, tmp_path / "server", tls=(certificate, key))
    server.start()
    try:
        server.set_up()
        monkeypatch.setenv("FDD_TEST_TOKEN", server.admin_token)
        config = StoreConfig("influx", "n", url=server.url, org=ORG, bucket="first", token_env="FDD_TEST_TOKEN")
        trusting = InfluxStore(replace(config, ca_file=certificate))
        assert trusting.series("charts") == []
        trusting.close()
        with pytest.raises(StoreUnavailableError, match=r"(?i)certificate"):
            InfluxStore(config).series("charts")
        with pytest.raises(StoreError, match="ca_file"):
            InfluxStore(replace(config, ca_file=tmp_path / "nowhere.pem"))
    finally:
        server.kill()
