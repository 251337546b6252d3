"""Certificates that the openssl program makes for a test."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

needs_openssl = pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here to make certificates")


def openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True)


def self_signed(folder: Path, name: str, extension: str) -> tuple[Path, Path]:
    """A certificate that signs itself, and its key."""
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    openssl("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}", "-keyout", str(key),
            "-addext", extension, "-out", str(certificate))  # fmt: skip
    return certificate, key


def authority(folder: Path, name: str) -> tuple[Path, Path]:
    """The certificate and key of one who may sign others."""
    return self_signed(folder, name, "basicConstraints=critical,CA:TRUE")


def signed(folder: Path, name: str, by: tuple[Path, Path]) -> tuple[Path, Path]:
    """A certificate for this machine under an authority, and its key."""
    request, certificate, key = (folder / f"{name}.{end}" for end in ("csr", "pem", "key"))
    (folder / "ext").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\nbasicConstraints=CA:FALSE\n")
    openssl("req", "-newkey", "rsa:2048", "-nodes", "-subj", f"/CN={name}", "-keyout", str(key), "-out", str(request))
    openssl("x509", "-req", "-in", str(request), "-CA", str(by[0]), "-CAkey", str(by[1]), "-CAcreateserial",
            "-days", "2", "-extfile", str(folder / "ext"), "-out", str(certificate))  # fmt: skip
    return certificate, key
