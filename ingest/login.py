"""User name and password of a source; the password never stands in a site file."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field, model_validator

from fdd.tables import SourceOptions, refusal
from ingest.source import Refused


class LoginOptions(SourceOptions):
    """Keys of sources that log in."""

    user: str | None = Field(default=None, description="user name")
    password_file: Path | None = Field(default=None, description="file that holds the password")
    password_env: str | None = Field(default=None, description="environment variable that holds the password")

    @model_validator(mode="after")
    def _with_password(self) -> LoginOptions:
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
