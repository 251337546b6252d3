"""Samples over Zenoh, peer to peer."""

from ingest.zenoh.options import OperatorOptions, TlsOptions, ZenohLink, ZenohOptions
from ingest.zenoh.publisher import ZenohPublisher
from ingest.zenoh.source import ZenohSource

__all__ = ["OperatorOptions", "TlsOptions", "ZenohLink", "ZenohOptions", "ZenohPublisher", "ZenohSource"]
