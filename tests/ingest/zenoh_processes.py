"""Run as a script: a publisher or a subscriber in a process of its own, so that it can be killed."""

from __future__ import annotations

import json
import sqlite3
import sys
import time

import numpy as np

from fdd.records import Batch
from ingest.source import Context
from ingest.zenoh import ZenohOptions, ZenohPublisher, ZenohSource

NAMES = ("T_supply", "T_return", "flow")
START = 1_700_000_000_000_000_000


def batch(number: int) -> Batch:
    """Two rows of three points; every value is different."""
    time_ = START + np.repeat(np.arange(2 * number, 2 * number + 2), 3) * 1_000_000_000
    value = (6 * number + np.arange(6)).astype(np.float64)
    return Batch(NAMES, np.tile(np.arange(3, dtype=np.int32), 2), time_, value, np.zeros(6, np.uint8))


def publish(endpoint: str) -> None:
    """Publish as many messages as each line of standard input says, a few milliseconds apart; 0 is the end."""
    number = 0
    with ZenohPublisher(ZenohOptions(listen=(endpoint,)), "test/plant", publisher="plant") as publisher:
        for line in sys.stdin:
            for _ in range(int(line)):
                publisher.publish(batch(number))
                number += 1
                time.sleep(0.003)
            if int(line) == 0:
                publisher.end()


def subscribe(endpoint: str, database: str) -> None:
    """Keep every value and the position of its batch in one transaction, as the daemon does."""
    store = sqlite3.connect(database)
    store.execute("PRAGMA journal_mode=WAL")
    store.execute("CREATE TABLE IF NOT EXISTS sample (point TEXT, time INTEGER, value REAL)")
    store.execute("CREATE TABLE IF NOT EXISTS position (id INTEGER PRIMARY KEY, document TEXT)")
    row = store.execute("SELECT document FROM position").fetchone()
    source = ZenohSource()
    source.configure(ZenohOptions(connect=(endpoint,), key="test/**", until_end=True), Context())
    source.open(json.loads(row[0]) if row else None)
    for item in source.batches():
        names = [item.names[i] for i in item.point]
        with store:
            rows = zip(names, item.time.tolist(), item.value.tolist(), strict=True)
            store.executemany("INSERT INTO sample VALUES (?,?,?)", rows)
            store.execute("REPLACE INTO position VALUES (1, ?)", (json.dumps(item.position),))
    print(json.dumps(source.counters()), flush=True)
    source.close()
    store.close()


if __name__ == "__main__":
    if sys.argv[1] == "publish":
        publish(sys.argv[2])
    else:
        subscribe(sys.argv[2], sys.argv[3])
