"""Hourly values of an SQLite store: what reports and plots over months read instead of every row.

Every write notes the oldest hour it touched, in its own transaction; rolling up does those hours again. So the hourly
values are exact for whatever came late or was written again, at the cost of the hours that changed. How a field is
reduced (mean, worst, last) stands in the schema.
"""

from __future__ import annotations

import sqlite3

from fdd.store.schema import MEASUREMENTS, Measurement

HOUR = 3_600_000_000_000
_SQL = {"mean": 'avg("{0}")', "max": 'max("{0}")'}


def create(link: sqlite3.Connection) -> None:
    """Tables for the hourly values, beside those of the rows."""
    link.execute("CREATE TABLE IF NOT EXISTS rollup (measurement TEXT PRIMARY KEY, changed INTEGER, pruned INTEGER)")
    for m in MEASUREMENTS.values():
        columns = ", ".join(f'"{f}" REAL' for f in m.field_names)
        link.execute(
            f"CREATE TABLE IF NOT EXISTS {m.name}_hourly (series INTEGER NOT NULL, time INTEGER NOT NULL, {columns}, "
            "PRIMARY KEY (series, time)) WITHOUT ROWID"
        )


def note(link: sqlite3.Connection, measurement: str, oldest: int) -> None:
    """Rows from ``oldest`` on have been written since the last roll-up."""
    link.execute(
        "INSERT INTO rollup (measurement, changed) VALUES (?, ?) ON CONFLICT (measurement) DO UPDATE "
        "SET changed = min(coalesce(changed, excluded.changed), excluded.changed)",
        (measurement, oldest),
    )


def roll_up(link: sqlite3.Connection, until: int) -> None:
    """Bring the hourly values up to the last whole hour before ``until`` [ns]; later rows wait for the next time."""
    end = until // HOUR * HOUR
    found = link.execute("SELECT measurement, changed, pruned FROM rollup WHERE changed IS NOT NULL").fetchall()
    for name, changed, pruned in found:
        start = changed // HOUR * HOUR
        if pruned is not None:  # the rows behind older hours are gone, their values stand
            start = max(start, pruned)
        if start >= end:
            continue
        _reduce(link, MEASUREMENTS[name], start, end)
        (rest,) = link.execute(f"SELECT min(time) FROM {name} WHERE time >= ?", (end,)).fetchone()
        link.execute("UPDATE rollup SET changed = ? WHERE measurement = ?", (rest, name))


def _reduce(link: sqlite3.Connection, m: Measurement, start: int, end: int) -> None:
    hour = f"time - time % {HOUR}"
    span = f"time >= {start} AND time < {end}"
    at_once = [f for f in m.fields if f.hourly in _SQL]
    values = "".join(f", {_SQL[f.hourly].format(f.name)}" for f in at_once)
    names = "".join(f', "{f.name}"' for f in at_once)
    link.execute(
        f"INSERT OR REPLACE INTO {m.name}_hourly (series, time{names}) "
        f"SELECT series, {hour}{values} FROM {m.name} WHERE {span} GROUP BY 1, 2"
    )
    for f in m.fields:
        if f.hourly == "last":  # with max(time), SQLite takes the other columns from that very row
            link.execute(
                f'UPDATE {m.name}_hourly SET "{f.name}" = latest.value FROM '
                f'(SELECT series, {hour} AS hour, "{f.name}" AS value, max(time) FROM {m.name} '
                f'WHERE {span} AND "{f.name}" IS NOT NULL GROUP BY 1, 2) AS latest '
                f"WHERE {m.name}_hourly.series = latest.series AND {m.name}_hourly.time = latest.hour"
            )


def prune(link: sqlite3.Connection, before: int) -> int:
    """Delete rows older than the hour of ``before`` [ns] that the hourly values cover; returns how many."""
    edge, gone = before // HOUR * HOUR, 0
    for name, changed, pruned in link.execute("SELECT measurement, changed, pruned FROM rollup").fetchall():
        covered = edge if changed is None else min(edge, changed // HOUR * HOUR)
        gone += link.execute(f"DELETE FROM {name} WHERE time < ?", (covered,)).rowcount
        link.execute("UPDATE rollup SET pruned = ? WHERE measurement = ?", (max(covered, pruned or covered), name))
    return gone
