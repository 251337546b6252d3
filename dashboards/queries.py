"""Flux, and how a panel asks it.

Queries read ``v.defaultBucket`` of the data source, so that no dashboard names a bucket, and quote variables by
Grafana's ``doublequote`` format, so that any name of a site or component is safe.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from grafana_foundation_sdk.cog import builder as cogbuilder
from grafana_foundation_sdk.cog import variants as cogvariants
from grafana_foundation_sdk.models.dashboard import DataSourceRef

from dashboards import settings
from fdd.store.schema import measurement_of

SOURCE = DataSourceRef(type_val="influxdb", uid=settings.DATA_SOURCE)
SITE = "${site:doublequote}"
COMPONENT = "${component:doublequote}"
DOCUMENTS = 'v.defaultBucket + "_documents"'
_BUCKET = 'if "${resolution}" == "hourly" then v.defaultBucket + "_hourly" else v.defaultBucket'
ALARM_COLUMNS = ("component", "state", "severity", "summary", "since", "raised", "updated")


class FluxQuery(cogvariants.Dataquery):
    """A Flux query of a panel; the SDK has no model of its own for it."""

    def __init__(self, flux: str, ref_id: str) -> None:
        self.flux, self.ref_id = flux, ref_id

    def to_json(self) -> dict[str, Any]:
        """As Grafana keeps it."""
        return {"refId": self.ref_id, "datasource": SOURCE, "query": self.flux}


class Flux(cogbuilder.Builder[cogvariants.Dataquery]):
    """Builder of a :class:`FluxQuery`."""

    def __init__(self, flux: str, ref_id: str = "A") -> None:
        self._query = FluxQuery(flux, ref_id)

    def build(self) -> FluxQuery:
        """The query."""
        return self._query


def flux_list(names: Iterable[str]) -> str:
    """A Flux list of texts."""
    return "[" + ", ".join(f'"{n}"' for n in names) + "]"


def condition(measurement: str, fields: tuple[str, ...]) -> str:
    """A Flux condition on fields that the schema has; anything else fails the build."""
    known = measurement_of(measurement).field_names
    missing = [f for f in fields if f not in known]
    if missing:
        raise ValueError(f"measurement {measurement} has no field {', '.join(missing)}; it has {', '.join(known)}")
    either = " or ".join(f'r._field == "{f}"' for f in fields)
    return f'r._measurement == "{measurement}" and ({either})'


def rows(measurement: str, *fields: str, where: str = "", long: bool = True) -> str:
    """Points of the site in the time range; ``long``: from the bucket that the variable ``resolution`` picks."""
    more = f"\n  |> filter(fn: (r) => {where})" if where else ""
    return (
        f"from(bucket: {_BUCKET if long else 'v.defaultBucket'})\n"
        "  |> range(start: v.timeRangeStart, stop: v.timeRangeStop)\n"
        f"  |> filter(fn: (r) => {condition(measurement, fields)})\n"
        f"  |> filter(fn: (r) => r.site == {SITE}){more}"
    )


def windowed(flux: str, function: str = "mean") -> str:
    """One value a pixel or so."""
    return f"{flux}\n  |> aggregateWindow(every: v.windowPeriod, fn: {function}, createEmpty: false)"


def wide(flux: str, *columns: str) -> str:
    """One frame with a column a field, named by the field."""
    return (
        f'{flux}\n  |> pivot(rowKey: ["_time"], columnKey: ["_field"], valueColumn: "_value")\n'
        f"  |> group()\n  |> keep(columns: {flux_list(('_time', *columns))})\n"
        '  |> sort(columns: ["_time"])'
    )


def alarms(where: str = "true") -> str:
    """One row an alarm of the site, as it stands now; documents carry time 0."""
    fields = " or ".join(f'r._field == "{c}"' for c in ALARM_COLUMNS)
    return (
        f"from(bucket: {DOCUMENTS})\n  |> range(start: 0, stop: 1)\n"
        f'  |> filter(fn: (r) => r._measurement == "alarm" and r.part == "0" and ({fields}))\n'
        f"  |> filter(fn: (r) => r.site == {SITE})\n"
        '  |> keep(columns: ["key", "_field", "_value"])\n  |> group()\n'
        '  |> pivot(rowKey: ["key"], columnKey: ["_field"], valueColumn: "_value")\n'
        f"  |> filter(fn: (r) => {where})"
    )


def count_alarms(where: str) -> str:
    """How many alarms, zero included: a query that finds none would otherwise answer nothing."""
    one = f'{alarms(where)}\n  |> map(fn: (r) => ({{r with _value: 1}}))\n  |> keep(columns: ["_value"])'
    return f'import "array"\nunion(tables: [\n{one},\narray.from(rows: [{{_value: 0}}])])\n  |> sum()'


def tag_values(measurement: str, tag: str, where: str = "") -> str:
    """Values of a tag among the site's points in the time range, for a variable."""
    measurement_of(measurement)
    site = "" if tag == "site" else f" and r.site == {SITE}"
    more = f" and {where}" if where else ""
    return (
        'import "influxdata/influxdb/schema"\n'
        f'schema.tagValues(bucket: v.defaultBucket, tag: "{tag}", '
        f'predicate: (r) => r._measurement == "{measurement}"{site}{more}, '
        "start: v.timeRangeStart, stop: v.timeRangeStop)"
    )
