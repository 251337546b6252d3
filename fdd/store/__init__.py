"""The store port and its two ends: SQLite, embedded, and InfluxDB 2."""
