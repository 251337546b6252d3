"""The one module that touches Zenoh's Python API, and the only one with its unstable part (``zenoh.ext``).

Advanced publisher and subscriber: the publisher keeps a cache, the subscriber asks it for history when it starts (so a
restarted daemon gets what it missed) and for what heartbeats show to be missing. ``BLOCK``: the default congestion
control drops messages in a burst.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh
import zenoh.ext

from ingest.source import NotReady
from ingest.zenoh.options import ZenohOptions

HEARTBEAT_SECONDS = 0.5
# A slow reader holds the writer back this long before the link is cut and recovered from the cache.
_BLOCK_MICROSECONDS = 60_000_000


def open_session(options: ZenohOptions, folder: Path) -> Any:
    """An open session.

    Raises
    ------
    NotReady : the endpoint to listen on is taken, or a required connection does not come about.
    Refused : the password is not there.
    """
    config = zenoh.Config()
    for key, value in _settings(options, folder).items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NotReady(
            f"Zenoh session (listen {list(options.listen)}, connect {list(options.connect)}): {error}. "
            "Is the port taken, or the login refused (it looks like a time-out)?"
        ) from None


def _settings(options: ZenohOptions, folder: Path) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "mode": options.mode,
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        "listen/endpoints": list(options.listen),
        "connect/endpoints": list(options.connect),
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _BLOCK_MICROSECONDS,
    }
    password = options.password(folder)
    if options.user:
        settings["transport/auth/usrpwd/user"] = options.user
        settings["transport/auth/usrpwd/password"] = password
    if options.users_file:
        settings["transport/auth/usrpwd/dictionary_file"] = str(folder / options.users_file)
    if options.tls:
        settings |= _tls(options, folder)
    return settings


def _tls(options: ZenohOptions, folder: Path) -> dict[str, Any]:
    tls = options.tls
    assert tls is not None
    place = "transport/link/tls/"
    settings: dict[str, Any] = {
        place + "root_ca_certificate": str(folder / tls.ca),
        place + "verify_name_on_connect": tls.verify_name,
    }
    if tls.certificate and tls.key:
        certificate, key = str(folder / tls.certificate), str(folder / tls.key)
        settings |= {
            place + "enable_mtls": True,
            place + "listen_certificate": certificate,
            place + "listen_private_key": key,
            place + "connect_certificate": certificate,
            place + "connect_private_key": key,
        }
    return settings


def declare_publisher(session: Any, key: str, cache: int) -> Any:
    """An advanced publisher with a cache of some messages."""
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        cache=zenoh.ext.CacheConfig(max_samples=cache),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=HEARTBEAT_SECONDS, sporadic_heartbeat=None),
        publisher_detection=True,
    )


def declare_matching(session: Any, key: str) -> Any:
    """A plain publisher on the same key, for its ``matching_status``: the advanced one does not tell."""
    return session.declare_publisher(key)


def declare_subscriber(
    session: Any, key: str, receive: Callable[[bytes], None], present: Callable[[str, bool], None]
) -> Any:
    """An advanced subscriber with history and recovery.

    ``receive`` gets each payload, in order within a publisher; ``present`` learns of publishers that come and go.
    """

    def seen(sample: Any) -> None:
        present(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        lambda sample: receive(sample.payload.to_bytes()),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        recovery=zenoh.ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
        subscriber_detection=True,
    )
    return subscriber, subscriber.detect_publishers(seen, history=True)
