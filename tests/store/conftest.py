"""The real server, for the tests of this folder."""

from tests.store.influxd import influxd, influxd_server

__all__ = ["influxd", "influxd_server"]
