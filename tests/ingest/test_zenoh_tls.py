"""Zenoh over TLS on loopback, with an authority of one's own: who has no certificate of it gets no samples."""

from __future__ import annotations

import shutil
import socket
import subprocess
from pathlib import Path

import pytest
from test_zenoh import _collect, _source, _values
from zenoh_processes import batch

from ingest.zenoh import ZenohOptions, ZenohPublisher
from ingest.zenoh.options import TlsOptions

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here to make certificates")


def openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True)


def authority(folder: Path, name: str) -> tuple[Path, Path]:
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    openssl("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}", "-keyout", str(key),
            "-addext", "basicConstraints=critical,CA:TRUE", "-out", str(certificate))  # fmt: skip
    return certificate, key


def signed(folder: Path, name: str, by: tuple[Path, Path]) -> TlsOptions:
    """A certificate for this machine under an authority, as the options of a peer that trusts that authority."""
    request, certificate, key = (folder / f"{name}.{end}" for end in ("csr", "pem", "key"))
    (folder / "ext").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\nbasicConstraints=CA:FALSE\n")
    openssl("req", "-newkey", "rsa:2048", "-nodes", "-subj", f"/CN={name}", "-keyout", str(key), "-out", str(request))
    openssl("x509", "-req", "-in", str(request), "-CA", str(by[0]), "-CAkey", str(by[1]), "-CAcreateserial",
            "-days", "2", "-extfile", str(folder / "ext"), "-out", str(certificate))  # fmt: skip
    return TlsOptions(ca=by[0], certificate=certificate, key=key)


def test_samples_come_over_tls_to_who_has_a_certificate_of_the_same_authority(tmp_path: Path) -> None:
    ours, theirs = authority(tmp_path, "ours"), authority(tmp_path, "theirs")
    building, daemon = signed(tmp_path, "building", ours), signed(tmp_path, "daemon", ours)
    stranger = signed(tmp_path, "stranger", theirs).model_copy(update={"ca": ours[0]})  # knows us, we do not know it
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tls/localhost:{probe.getsockname()[1]}"
    with ZenohPublisher(ZenohOptions(listen=(endpoint,), tls=building), "fdd/plant") as publisher:
        for number in range(5):
            publisher.publish(batch(number))
        publisher.end()
        for tls in (stranger, None):
            intruder = _source(endpoint if tls else endpoint.replace("tls/", "tcp/"), tls=tls, until_end=True)
            intruder.open()
            assert len(next(intruder.batches())) == 0
            assert intruder.counters()["publishers present"] == 0
            intruder.close()
        friend = _source(endpoint, tls=daemon, until_end=True)
        friend.open()
        assert _values(_collect(friend)) == [float(i) for i in range(30)]
        friend.close()
