"""Keys of the ``mqtt`` source."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from ingest.login import LoginOptions
from ingest.trust import TrustOptions


class MqttOptions(LoginOptions, TrustOptions):
    """A broker and what to listen to."""

    kind: Literal["mqtt"] = Field(default="mqtt", description="mqtt")
    host: str = Field(description="the broker's host")
    port: int = Field(default=1883, gt=0, lt=65536, description="the broker's port")
    topics: tuple[str, ...] = Field(min_length=1, description="topics to subscribe to, with + and # as wild cards")
    payload: Literal["message", "value", "json"] = Field(
        default="message", description="message (format of this project), value (a bare number) or json (an object)"
    )
    value_key: str = Field(default="value", description="payload json: key of the value")
    time_key: str | None = Field(default=None, description="payload json: key of the time; time of arrival without it")
    time_unit: Literal["ns", "us", "ms", "s"] = Field(default="s", description="unit of the time since 1970, UTC")
    client_id: str = Field(default="hvac-fdd", description="name the broker keeps messages for while we are away")
    ca: Path | None = Field(default=None, description="certificate of the broker's authority; turns TLS on")
    queue: int = Field(default=10_000, gt=0, description="messages that may wait before the sender is held back")
    until_end: bool = Field(default=False, description="stop at the publisher's end-of-stream message")
