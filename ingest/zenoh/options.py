"""Keys of the ``zenoh`` source."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from fdd.config.base import SourceOptions, Strict, refusal
from ingest.source import Refused


class TlsOptions(Strict):
    """Certificates, PEM files; with both sides' the connection is mutual."""

    ca: Path = Field(description="certificate of the authority that signed the other side's")
    certificate: Path | None = Field(default=None, description="own certificate")
    key: Path | None = Field(default=None, description="own private key")
    verify_name: bool = Field(default=True, description="whether the other side's host name must be in its certificate")


class ZenohOptions(SourceOptions):
    """Zenoh: peers connect to each other, or to a router."""

    kind: Literal["zenoh"] = Field(default="zenoh", description="zenoh")
    key: str = Field(default="fdd/**", description="key expression to subscribe to")
    mode: Literal["peer", "client"] = Field(default="peer", description="peer needs no router")
    listen: tuple[str, ...] = Field(default=(), description="endpoints to listen on, such as tcp/127.0.0.1:7447")
    connect: tuple[str, ...] = Field(default=(), description="endpoints to connect to")
    user: str | None = Field(default=None, description="user name")
    password_file: Path | None = Field(default=None, description="file that holds the password")
    password_env: str | None = Field(default=None, description="environment variable that holds the password")
    users_file: Path | None = Field(default=None, description="who may connect to us: lines of user:password")
    tls: TlsOptions | None = Field(default=None, description="certificates")
    queue: int = Field(default=10_000, gt=0, description="messages that may wait before the sender is held back")
    until_end: bool = Field(default=False, description="stop at the publisher's end-of-stream message")

    @model_validator(mode="after")
    def _reachable(self) -> ZenohOptions:
        if not self.listen and not self.connect:
            raise refusal("neither 'listen' nor 'connect' is given", "Add connect: [tcp/HOST:7447].", "key")
        if self.user and not (self.password_file or self.password_env):
            raise refusal("'user' has no password", "Add password_file or password_env.", "user")
        return self

    def password(self, folder: Path) -> str | None:
        """The password from its file or the environment.

        Raises
        ------
        Refused : it is not there.
        """
        if self.password_env:
            if self.password_env not in os.environ:
                raise Refused(f"environment variable {self.password_env} (password_env) is not set")
            return os.environ[self.password_env]
        if self.password_file:
            try:
                return (folder / self.password_file).read_text(encoding="utf-8").strip()
            except OSError as error:
                raise Refused(f"password_file cannot be read ({error})") from None
        return None
