"""Samples over Zenoh, peer to peer."""

from ingest.zenoh.options import TlsOptions, ZenohOptions
from ingest.zenoh.publisher import ZenohPublisher
from ingest.zenoh.source import ZenohSource

__all__ = ["TlsOptions", "ZenohOptions", "ZenohPublisher", "ZenohSource"]
