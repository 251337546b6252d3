"""Zenoh over TLS on loopback, with an authority of one's own: who has no certificate of it gets no samples."""

from __future__ import annotations

from pathlib import Path

from test_zenoh import _collect, _source, _values
from zenoh_processes import batch

from ingest.zenoh import ZenohOptions, ZenohPublisher
from ingest.zenoh.options import TlsOptions
from tests.certificates import authority, needs_openssl, signed
from tests.ports import free_port

pytestmark = needs_openssl


def options(folder: Path, name: str, by: tuple[Path, Path]) -> TlsOptions:
    """Those of a peer with a certificate of an authority, which it trusts."""
    certificate, key = signed(folder, name, by)
    return TlsOptions(ca=by[0], certificate=certificate, key=key)


def test_samples_come_over_tls_to_who_has_a_certificate_of_the_same_authority(tmp_path: Path) -> None:
    ours, theirs = authority(tmp_path, "ours"), authority(tmp_path, "theirs")
    building, daemon = options(tmp_path, "building", ours), options(tmp_path, "daemon", ours)
    stranger = options(tmp_path, "stranger", theirs).model_copy(update={"ca": ours[0]})  # knows us, we do not know it
    endpoint = f"tls/localhost:{free_port()}"
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
