"""Sources of samples: Zenoh, CSV and Parquet replay, MQTT, BACnet; the mapping of points and units."""
