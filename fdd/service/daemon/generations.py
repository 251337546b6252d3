"""The saved state as files: the last one and the one before, each with its checksum, each replaced in one step.

A file begins with one line, ``hvac-fdd state SCHEMA SHA256 BYTES``, and goes on with what :mod:`codec` wrote. A file
that is damaged is set aside under another name, and the generation before is taken: the journal goes back that far.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import structlog

from fdd.records import JsonObject
from fdd.service.daemon.codec import DamagedError, decode

log = structlog.get_logger()

SCHEMA = 4
READABLE = (3, SCHEMA)
_MAGIC = b"hvac-fdd state "
_HEAD_BYTES = 200


class OtherSchemaError(RuntimeError):
    """A whole file of a form that this version does not read; ``schema`` says which."""

    def __init__(self, file: Path, schema: object) -> None:
        self.file, self.schema = file, schema
        super().__init__(f"{file} has schema {schema}")


class Generations:
    """The files ``path.saved`` and ``path.saved.1``."""

    def __init__(self, path: Path) -> None:
        self.last, self.before = Path(f"{path}.saved"), Path(f"{path}.saved.1")
        self.new = Path(f"{path}.saved.new")
        self.stepped_back: list[str] = []

    def write(self, data: bytes) -> None:
        """Replace the last generation by an encoded state; what was the last becomes the one before."""
        head = _MAGIC + f"{SCHEMA} {hashlib.sha256(data).hexdigest()} {len(data)}\n".encode()
        with self.new.open("wb") as out:
            os.fchmod(out.fileno(), 0o600)
            out.write(head)
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
        with suppress(FileNotFoundError):
            self.last.replace(self.before)
        self.new.replace(self.last)
        folder = os.open(self.last.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # a journal may be shortened only once the new name is safe, too
        finally:
            os.close(folder)

    def read(self) -> JsonObject | None:
        """The newest whole generation; None where there is none and never was one.

        Raises
        ------
        OtherSchemaError : a whole file of another form.
        DamagedError : files are there, and none is whole.
        """
        damaged = []
        for file in (self.last, self.before):
            try:
                return _whole(file)
            except FileNotFoundError:
                continue
            except (DamagedError, OSError) as error:
                damaged.append(f"{file.name}: {error}")
                self._set_aside(file, str(error))
        if damaged:
            raise DamagedError("; ".join(damaged))
        return None

    def _set_aside(self, file: Path, why: str) -> None:
        aside = next(p for p in _names(file) if not p.exists())
        with suppress(OSError):
            file.replace(aside)
        self.stepped_back.append(f"{file.name} is damaged ({why}); it is kept as {aside.name}")
        log.error("saved state is damaged, stepping back one generation", file=str(file), kept=str(aside), reason=why)


def _names(file: Path) -> Iterator[Path]:
    n = 0
    while True:
        n += 1
        yield file.with_name(f"{file.name}.damaged-{n}")


def _whole(file: Path) -> JsonObject:
    with file.open("rb") as opened:
        data = opened.read()
    if data.startswith(b"PK"):
        return _of_known_schema(file, decode(data))  # schema 3 had neither a head nor a checksum
    head, _, _ = data[:_HEAD_BYTES].partition(b"\n")
    try:
        if not head.startswith(_MAGIC):
            raise ValueError
        schema, digest, size = head.removeprefix(_MAGIC).decode("ascii").split(" ")
        body, number = data[len(head) + 1 :], int(schema)
        whole = int(size) == len(body) and hashlib.sha256(body).hexdigest() == digest
    except ValueError:
        raise DamagedError("its first line is none of a state") from None
    if not whole:
        raise DamagedError("its checksum does not fit")
    if number not in READABLE:
        raise OtherSchemaError(file, number)
    return _of_known_schema(file, decode(body))


def _of_known_schema(file: Path, tree: JsonObject) -> JsonObject:
    if tree.get("schema") not in READABLE:
        raise OtherSchemaError(file, tree.get("schema"))
    return tree
