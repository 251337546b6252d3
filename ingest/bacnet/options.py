"""Keys of the ``bacnet`` source."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fdd.tables import Duration, SourceOptions


class BacnetOptions(SourceOptions):
    """BACnet/IP devices that are polled with ReadPropertyMultiple."""

    kind: Literal["bacnet"] = Field(default="bacnet", description="bacnet")
    address: str = Field(description="own address, such as 10.0.0.5/24:47808")
    devices: dict[str, str] = Field(min_length=1, description="name of a device to its address, such as 10.0.0.12")
    interval: Duration = Field(default=60.0, description="time between two polls")
    timeout: Duration = Field(default=3.0, description="how long a device may take to answer a request")
    objects_per_request: int = Field(default=20, gt=0, description="objects in one request; fewer for small devices")
    device_id: int = Field(default=4_190_000, ge=0, lt=4_194_303, description="own device instance number")
