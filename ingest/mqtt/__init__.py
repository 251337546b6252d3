"""Samples over MQTT."""

from ingest.mqtt.options import MqttOptions
from ingest.mqtt.source import MqttSource

__all__ = ["MqttOptions", "MqttSource"]
