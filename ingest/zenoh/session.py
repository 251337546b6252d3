"""The one module that touches Zenoh's Python API; it keeps to the stable part.

A publisher keeps its latest messages and answers ``KEY/_history`` with those that come after what the asker has; a
subscriber asks when it starts, when a sequence number is missing, and when it hears nothing. Zenoh's own advanced
publisher and subscriber (marked unstable) were tried first: about one late reader in twenty-five got no history,
because its single query left before the publisher's cache was known to it. Asking until an answer comes has no such
gap. The keys hold no ``@``, so that an access rule for ``fdd/**`` covers them. ``BLOCK``: the default congestion
control drops messages in a burst.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import zenoh

from fdd.limits import ANSWER_BYTES
from ingest.source import NotReady
from ingest.zenoh.options import OperatorOptions, ZenohLink

HISTORY, PUBLISHER = "_history", "_publisher"
_HISTORY_SECONDS = 5.0
_ANSWERS = 1_000
# A slow reader holds the writer back this long before the link is cut and recovered from the history.
_BLOCK_MICROSECONDS = 60_000_000


def open_session(options: ZenohLink, folder: Path, questions: str = "") -> Any:
    """An open session; ``questions`` is the key of an operator's, where access is limited to the people named.

    Raises
    ------
    NotReady : the endpoint to listen on is taken, or a required connection does not come about.
    Refused : the password is not there.
    """
    config = zenoh.Config()
    settings = _settings(options, folder)
    if isinstance(options, OperatorOptions) and options.people and options.listen:
        settings["access_control"] = _access(options, questions)
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NotReady(
            f"Zenoh session (listen {list(options.listen)}, connect {list(options.connect)}): {error}. "
            "Is the port taken, or the login refused (it looks like a time-out)?"
        ) from None


def _settings(options: ZenohLink, folder: Path) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "mode": options.mode,
        "scouting/multicast/enabled": False,
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


def _tls(options: ZenohLink, folder: Path) -> dict[str, Any]:
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


def _access(options: OperatorOptions, key: str) -> dict[str, Any]:
    """Who may ask at which key: everybody who may connect lists alarms, each person uses the key with their name."""

    def rule(name: str, keys: list[str]) -> dict[str, Any]:
        return {"id": name, "permission": "allow", "flows": ["ingress"], "messages": ["query"], "key_exprs": keys}

    own = {
        "id": "own",
        "permission": "allow",
        "flows": ["egress", "ingress"],
        "messages": ["reply", "declare_queryable"],
        "key_exprs": [key, f"{key}/**"],
    }
    people = [rule(f"as {name}", [key, f"{key}/as/{name}"]) for name in options.people or {}]
    field = "usernames" if options.users_file else "cert_common_names"
    subjects = [{"id": name, field: [name]} for name in options.people or {}]
    policies = [{"rules": [f"as {name}", "own"], "subjects": [name]} for name in options.people or {}]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [own, *people],
        "subjects": subjects,
        "policies": policies,
    }


def declare_publisher(session: Any, key: str, name: str, history: Callable[[bytes], bytes]) -> tuple[Any, ...]:
    """A publisher, the answerer of its history, and the sign that it is alive; the publisher comes first.

    ``history`` turns a question's payload into an answer's.
    """

    def answer(query: Any) -> None:
        with query:
            asked = query.payload.to_bytes() if query.payload is not None else b"{}"
            query.reply(f"{key}/{HISTORY}", history(asked))

    return (
        session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK, reliability=zenoh.Reliability.RELIABLE
        ),
        session.declare_queryable(f"{key}/{HISTORY}", answer),
        session.liveliness().declare_token(f"{key}/{PUBLISHER}/{name}"),
    )


def declare_subscriber(
    session: Any, key: str, receive: Callable[[str, bytes], None], present: Callable[[str, bool], None]
) -> tuple[Any, ...]:
    """A subscriber, and one that learns of publishers that come and go.

    ``receive`` gets each key and payload, in order within a publisher, from one of Zenoh's threads.
    """

    def seen(sample: Any) -> None:
        present(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    return (
        session.declare_subscriber(key, lambda sample: receive(str(sample.key_expr), sample.payload.to_bytes())),
        session.liveliness().declare_subscriber(f"{key}/{PUBLISHER}/*", seen, history=True),
    )


def ask_history(session: Any, key: str, have: Mapping[str, int]) -> list[tuple[str, bytes]]:
    """Every reachable publisher's answer to what it has after ``have`` (stream to last number), with its key."""
    question = json.dumps({"have": dict(have)}).encode()
    replies = _replies(session, f"{key}/{HISTORY}", question, _HISTORY_SECONDS)
    found = [(str(ok.key_expr).removesuffix(f"/{HISTORY}"), ok.payload) for ok in replies]
    return [(name, payload.to_bytes()) for name, payload in found[:_ANSWERS] if len(payload) <= ANSWER_BYTES]


def covers(rule: str, key: str) -> bool:
    """Whether a key expression includes a key."""
    try:
        return bool(zenoh.KeyExpr(rule).includes(zenoh.KeyExpr(key)))
    except zenoh.ZError:
        return False


AS = "as"
"""What stands between the key of questions and the name of who asks."""


def declare_questions(session: Any, key: str, receive: Callable[[Question], None]) -> tuple[Any, ...]:
    """Take questions on ``key`` and on ``key/as/NAME``.

    ``receive`` gets each from one of Zenoh's threads and may answer it from any other.
    """

    def take(query: Any) -> None:
        receive(Question(query, key))

    return session.declare_queryable(key, take), session.declare_queryable(f"{key}/{AS}/*", take)


class Question:
    """A query that waits for its answer; its parameters (after ``?`` in the selector), payload, and who asks.

    ``person`` is the name in the key that was used; empty for a key without, or with a wild card.
    """

    def __init__(self, query: Any, key: str) -> None:
        self._query = query
        self._key = str(query.key_expr)
        self.parameters = dict(query.parameters)
        self.payload = b"" if query.payload is None else query.payload.to_bytes()
        name = self._key.removeprefix(f"{key}/{AS}/")
        self.person = "" if name == self._key or "*" in name or "/" in name else name

    def answer(self, payload: bytes) -> None:
        """Answer, once."""
        with self._query:
            if "*" not in self._key:  # a wild card names nobody to answer as
                self._query.reply(self._key, payload)


def ask(session: Any, selector: str, payload: bytes = b"", seconds: float = 10.0) -> list[bytes]:
    """The answers of everybody who takes questions on the selector's key, within so many seconds."""
    return [ok.payload.to_bytes() for ok in _replies(session, selector, payload, seconds)]


def _replies(session: Any, selector: str, payload: bytes, seconds: float) -> list[Any]:
    replies = session.get(
        selector,
        payload=payload or None,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=seconds,
    )
    return [reply.ok for reply in replies if reply.ok is not None]
