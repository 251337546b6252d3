"""Keys of the ``zenoh`` source."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from fdd.tables import Duration, Strict, refusal
from ingest.login import LoginOptions
from ingest.trust import TrustOptions


class TlsOptions(Strict):
    """Certificates, PEM files; with both sides' the connection is mutual."""

    ca: Path = Field(description="certificate of the authority that signed the other side's")
    certificate: Path | None = Field(default=None, description="own certificate")
    key: Path | None = Field(default=None, description="own private key")
    verify_name: bool = Field(default=True, description="whether the other side's host name must be in its certificate")


class ZenohLink(LoginOptions):
    """How a Zenoh session is reached: peers connect to each other, or to a router."""

    kind: Literal["zenoh"] = Field(default="zenoh", description="zenoh")
    mode: Literal["peer", "client"] = Field(default="peer", description="peer needs no router")
    listen: tuple[str, ...] = Field(default=(), description="endpoints to listen on, such as tcp/127.0.0.1:7447")
    connect: tuple[str, ...] = Field(default=(), description="endpoints to connect to")
    users_file: Path | None = Field(default=None, description="who may connect to us: lines of user:password")
    tls: TlsOptions | None = Field(default=None, description="certificates")

    @model_validator(mode="after")
    def _reachable(self) -> Self:
        if not self.listen and not self.connect:
            raise refusal("neither 'listen' nor 'connect' is given", "Add connect: [tcp/HOST:7447].", "key")
        return self


class ZenohOptions(ZenohLink, TrustOptions):
    """Samples over Zenoh."""

    key: str = Field(default="fdd/**", description="key expression to subscribe to")
    queue: int = Field(default=10_000, gt=0, description="messages that may wait before the sender is held back")
    until_end: bool = Field(default=False, description="stop at the publisher's end-of-stream message")


class Person(Strict):
    """Somebody who may see and handle alarms."""

    role: Literal["read", "acknowledge", "clear", "approve"] = Field(
        description="read lists; acknowledge also shelves; clear also clears; approve also sets back event time"
    )


class OperatorOptions(ZenohLink):
    """Where operators ask for alarms and say what they did about them."""

    key: str = Field(default="", description="key of the queries; fdd/NAME OF THE SITE/alarms where it is not given")
    people: dict[str, Person] | None = Field(
        default=None,
        description="name (user of users_file, or common name of a certificate) to role; without it nobody commands",
    )
    longest_shelving: Duration = Field(default=90 * 86400.0, description="an alarm is shelved for so long at most")

    @model_validator(mode="after")
    def _known_people(self) -> Self:
        for name in self.people or {}:
            if not name or any(c in name for c in "/*$#?@ "):
                raise refusal(f"{name!r} cannot stand in a key", "Use letters, digits, dots and dashes.", "people")
        mutual = self.tls is not None and self.tls.certificate is not None and self.tls.key is not None
        if self.people and self.listen and not (self.users_file or mutual):
            raise refusal(
                "people connect to us, and nothing says who they are",
                "Add users_file, or tls with certificate and key on both sides.",
                "people",
            )
        return self
