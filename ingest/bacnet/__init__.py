"""Samples polled from BACnet/IP devices."""

from ingest.bacnet.options import BacnetOptions
from ingest.bacnet.source import BacnetSource

__all__ = ["BacnetOptions", "BacnetSource"]
