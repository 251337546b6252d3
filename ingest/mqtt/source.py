"""Subscribes at an MQTT broker, with a session that the broker keeps while the daemon is away.

Quality of service 1: a message is acknowledged only when the reader asks for more, so a crash makes the broker send it
again. Messages of this project carry a sequence number and are then recognised; bare values come again with a new time.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, ClassVar

import structlog

from fdd.records import Batch, JsonObject
from fdd.tables import SourceOptions
from ingest.live import Inbox, Letter
from ingest.message import Message, decode
from ingest.mqtt.options import MqttOptions
from ingest.mqtt.payload import bare_value, json_object
from ingest.source import Context, NotReady, Refused
from ingest.trust import Trust

log = structlog.get_logger()

CONNECT_SECONDS = 10.0


class MqttSource:
    """Messages, bare values or JSON objects from the topics of a broker."""

    options: ClassVar[type[SourceOptions]] = MqttOptions
    needs: ClassVar[tuple[str, ...]] = ("paho.mqtt",)

    def __init__(self, now: Callable[[], int] = clock.time_ns) -> None:
        """``now``: wall clock [ns], for payloads that carry no time."""
        self._now = now
        self._client: Any = None
        self._session = 0
        self._disconnects = 0
        self._refusal = ""

    def configure(self, options: MqttOptions, context: Context) -> None:
        """Keep the options."""
        self._options, self._context = options, context
        self._inbox = Inbox(options.queue, options.until_end, trust=Trust(options, _covers, self._now))

    def open(self, position: JsonObject | None = None) -> None:
        """Connect and subscribe; afterwards the client connects again by itself.

        Raises
        ------
        NotReady : no broker answers.
        Refused : it refuses the login, or the MQTT library is not installed.
        """
        try:
            from paho.mqtt import client as mqtt
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError:
            raise Refused("the MQTT library is not installed; install hvac-fdd[mqtt]") from None
        self._inbox.restore(position)
        options = self._options
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2, client_id=options.client_id, clean_session=False, manual_ack=True
        )
        if options.user:
            client.username_pw_set(options.user, options.password(self._context.folder))
        if options.ca:
            client.tls_set(str(self._context.folder / options.ca))
        client.on_connect, client.on_disconnect, client.on_message = self._connected, self._lost, self._message
        client.reconnect_delay_set(1, 30)
        try:
            client.connect(options.host, options.port, keepalive=30)
        except OSError as error:
            raise NotReady(f"MQTT broker {options.host}:{options.port} does not answer ({error})") from None
        self._client = client
        client.loop_start()
        self._wait(client)

    def _wait(self, client: Any) -> None:
        deadline = clock.monotonic() + CONNECT_SECONDS
        while not self._session and not self._refusal and clock.monotonic() < deadline:
            clock.sleep(0.01)
        if self._refusal or not client.is_connected():
            self.close()
            where = f"MQTT broker {self._options.host}:{self._options.port}"
            if self._refusal:
                raise Refused(f"{where} refuses us: {self._refusal}; check user and password")
            raise NotReady(f"{where} did not accept the session within {CONNECT_SECONDS:g} s")

    def _connected(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self._refusal = str(reason)
            return
        client.subscribe([(topic, 1) for topic in self._options.topics])
        self._session += 1
        log.info("broker here", host=self._options.host)

    def _lost(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if self._client is not None and self._session:
            self._disconnects += 1
            log.warning("broker lost", host=self._options.host, reason=str(reason))

    def _message(self, client: Any, _data: Any, message: Any) -> None:
        session = self._session

        def done() -> None:
            # Message numbers start afresh with each connection: an old one must not acknowledge a new message.
            if session == self._session:
                client.ack(message.mid, message.qos)

        self._inbox.receive(Letter(message.payload, self._decoder(message.topic), done, message.topic))

    def _decoder(self, topic: str) -> Callable[[bytes], Message]:
        options, now = self._options, self._now()
        if options.payload == "message":
            return decode
        if options.payload == "value":
            return partial(_swapped, bare_value, topic, now)
        read = partial(json_object, value_key=options.value_key, time_key=options.time_key, time_unit=options.time_unit)
        return partial(_swapped, read, topic, now)

    def batches(self) -> Iterator[Batch]:
        """Batches as they come."""
        return self._inbox.batches()

    def position(self) -> JsonObject:
        """Last message taken of every publisher's run."""
        return self._inbox.position()

    def counters(self) -> dict[str, int]:
        """Messages by outcome, and how often the broker was lost."""
        return self._inbox.counters() | ({"broker lost": self._disconnects} if self._disconnects else {})

    def notes(self) -> list[str]:
        """The first messages that were malformed or lost."""
        return list(self._inbox.notes)

    def stop(self) -> None:
        """End :meth:`batches` soon."""
        self._inbox.stop()

    def close(self) -> None:
        """Disconnect; the broker goes on keeping messages for us."""
        self._inbox.stop()
        client, self._client = self._client, None
        if client is not None:
            client.disconnect()
            client.loop_stop()


def _covers(rule: str, topic: str) -> bool:
    from paho.mqtt.client import topic_matches_sub

    return bool(topic_matches_sub(rule, topic))


def _swapped(read: Callable[[str, bytes, int], Message], topic: str, now: int, payload: bytes) -> Message:
    return read(topic, payload, now)
