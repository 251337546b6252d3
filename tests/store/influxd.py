"""A real InfluxDB server on a loopback port, in a folder of its own; tests that need it skip where there is none.

The binary is looked for in FDD_INFLUXD, in the cache that ``deploy/influxd/build.sh`` fills, and in PATH.
"""

from __future__ import annotations

import itertools
import os
import shutil
import ssl
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from influxdb_client import InfluxDBClient, OnboardingRequest, SetupService

from tests.ports import free_port

ORG = "plant"
_numbers = itertools.count()


def find_influxd() -> Path | None:
    """The server's binary, if this machine has one."""
    if named := os.environ.get("FDD_INFLUXD"):
        return Path(named)
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hvac-fdd" / "influxd"
    built = sorted(cache.glob("influxd-*[0-9]"))
    in_path = shutil.which("influxd")
    return built[-1] if built else Path(in_path) if in_path else None


def needed_influxd() -> Path:
    """The server's binary; the test is skipped where there is none."""
    binary = find_influxd()
    if binary is None:
        pytest.skip("no influxd here: run deploy/influxd/build.sh or set FDD_INFLUXD")
    return binary


class Influxd:
    """A server that can be killed and started again on the same port and data."""

    def __init__(self, binary: Path, folder: Path, tls: tuple[Path, Path] | None = None) -> None:
        self.binary, self.folder, self.tls = binary, folder, tls  # certificate and key, signed by itself
        self.port = free_port()
        self.url = f"http{'s' if tls else ''}://127.0.0.1:{self.port}"
        self.admin_token = "test-admin-token"
        self.process: subprocess.Popen[bytes] | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def start(self) -> None:
        paths = [
            f"--bolt-path={self.folder}/bolt",
            f"--engine-path={self.folder}/engine",
            f"--sqlite-path={self.folder}/sql",
        ]
        more = [f"--http-bind-address=127.0.0.1:{self.port}", "--reporting-disabled", "--log-level=error"]
        trusted = None
        if self.tls:
            more += [f"--tls-cert={self.tls[0]}", f"--tls-key={self.tls[1]}"]
            trusted = ssl.create_default_context(cafile=str(self.tls[0]))
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen([self.binary, *paths, *more], stdout=log, stderr=log)
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            try:
                with urllib.request.urlopen(f"{self.url}/health", timeout=1, context=trusted):
                    return
            except (urllib.error.URLError, OSError):
                time.sleep(0.05)
        self.kill()
        raise RuntimeError(f"influxd did not answer on {self.url}: {(self.folder / 'log').read_text()[-2000:]}")

    def kill(self) -> None:
        """kill -9, as a machine that loses power does to its processes."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def set_up(self) -> None:
        """Onboard a server that was never used: the organisation and an administrator with a known token."""
        trusted = None if self.tls is None else str(self.tls[0])
        with InfluxDBClient(self.url, token=self.admin_token, ssl_ca_cert=trusted) as client:
            request = OnboardingRequest("admin", "test-password", ORG, "first", token=self.admin_token)
            SetupService(client.api_client).post_setup(onboarding_request=request)

    def count(self, bucket: str, measurement: str, field: str) -> int:
        """How many points the server holds, counted by itself."""
        flux = (
            f'from(bucket: "{bucket}") |> range(start: 0) |> filter(fn: (r) => r._measurement == "{measurement}" '
            f'and r._field == "{field}") |> count() |> group() |> sum()'
        )
        with InfluxDBClient(self.url, token=self.admin_token, org=ORG, timeout=120_000) as client:
            tables = client.query_api().query(flux)
        return sum(int(r.get_value()) for table in tables for r in table.records)

    def new_bucket(self) -> str:
        """A fresh bucket with its bucket of documents; returns its name."""
        name = f"site{next(_numbers)}"
        with InfluxDBClient(self.url, token=self.admin_token, org=ORG) as client:
            for bucket in (name, f"{name}_documents"):
                client.buckets_api().create_bucket(bucket_name=bucket, org=ORG)
        return name


@contextmanager
def own_server(folder: Path, tls: tuple[Path, Path] | None = None) -> Iterator[Influxd]:
    """A server of the test's own that was never used; skips where there is none."""
    server = Influxd(needed_influxd(), folder, tls)
    server.start()
    try:
        yield server
    finally:
        server.kill()


@pytest.fixture(scope="session")
def influxd_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Influxd]:
    """One server for the session, set up with an organisation and an administrator."""
    with own_server(tmp_path_factory.mktemp("influxd")) as server:
        server.set_up()
        yield server


@pytest.fixture
def influxd(influxd_server: Influxd) -> Influxd:
    """The session's server, running whatever an earlier test did to it."""
    if influxd_server.process is None or influxd_server.process.poll() is not None:
        influxd_server.start()
    return influxd_server
