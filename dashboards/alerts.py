"""Alert rules: on the service's alarms, and on its silence. Each is one Flux query, a reduction and a threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from dashboards import settings
from dashboards.queries import ALARM_COLUMNS, DOCUMENTS, condition, flux_list
from fdd.store.schema import PHASES

State = Literal["OK", "Alerting", "NoData"]


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule: it fires for every series whose last value is above ``above`` for ``lasting``.

    ``flux`` gives a value a series with ``_time`` and ``_value``; the group key becomes the labels of the alert.
    """

    uid: str
    title: str
    summary: str
    flux: str
    above: float
    range_seconds: int
    lasting: str
    severity: str
    no_data: State = "OK"


def _now(flux: str) -> str:
    """Stamp values with the present: they are states, whatever the age of the data behind them."""
    return f"{flux}\n  |> map(fn: (r) => ({{r with _time: now()}}))"


def _alarms() -> str:
    """1 for every alarm that nobody has taken yet, labelled by site, component, severity and key."""
    fields = " or ".join(f'r._field == "{c}"' for c in ALARM_COLUMNS)
    labels = flux_list(("site", "component", "severity", "key", "summary"))
    return _now(
        f"from(bucket: {DOCUMENTS})\n  |> range(start: 0, stop: 1)\n"
        f'  |> filter(fn: (r) => r._measurement == "alarm" and r.part == "0" and ({fields}))\n'
        '  |> keep(columns: ["site", "key", "_field", "_value"])\n  |> group()\n'
        '  |> pivot(rowKey: ["site", "key"], columnKey: ["_field"], valueColumn: "_value")\n'
        '  |> filter(fn: (r) => r.state == "raised")\n'
        "  |> map(fn: (r) => ({site: r.site, component: r.component, severity: r.severity, key: r.key, "
        f"summary: r.summary, _value: 1.0}}))\n  |> group(columns: {labels})"
    )


def _points(measurement: str, field: str, more: str = "true") -> str:
    return (
        "from(bucket: v.defaultBucket)\n  |> range(start: v.timeRangeStart, stop: v.timeRangeStop)\n"
        f"  |> filter(fn: (r) => {condition(measurement, (field,))} and {more})"
    )


def _silence() -> str:
    """Minutes since the newest event that was judged, a series a site."""
    return _now(
        _points("charts", "phase") + '\n  |> last()\n  |> group(columns: ["site"])\n  |> max(column: "_time")\n'
        "  |> map(fn: (r) => ({site: r.site, _value: float(v: int(v: now()) - int(v: r._time)) / 60000000000.0}))\n"
        '  |> group(columns: ["site"])'
    )


def _unseen() -> str:
    """Share of charts that have no data, a series a site."""
    code = float(PHASES.index("no data"))
    return _now(
        _points("charts", "phase") + f"\n  |> last()\n  |> map(fn: (r) => ({{r with _value: if r._value == {code} "
        'then 1.0 else 0.0}))\n  |> group(columns: ["site"])\n  |> mean()'
    )


def _waiting() -> str:
    """Bytes that have waited on disk for the database throughout the range, a series a site."""
    where = 'r.component == "store" and r.name == "spool_bytes"'
    return _now(_points("health", "value", where) + '\n  |> group(columns: ["site"])\n  |> min()')


def _lost() -> str:
    """Rows that the full spool dropped or the database refused within the range, a series a site."""
    where = 'r.component == "store" and (r.name == "dropped_rows" or r.name == "refused_rows")'
    return _now(_points("counts", "value", where) + '\n  |> spread()\n  |> group(columns: ["site"])\n  |> sum()')


def _problems() -> str:
    """How many problems kept the service from watching throughout the range, a series a site."""
    where = 'r.component == "service" and r.name == "problems"'
    return _now(_points("health", "value", where) + '\n  |> group(columns: ["site"])\n  |> min()')


RULES: tuple[Rule, ...] = (
    Rule(
        "fdd-alarm",
        "Plant alarm",
        "{{ $labels.component }} at {{ $labels.site }}: {{ $labels.summary }}",
        _alarms(),
        above=0.5,
        range_seconds=3600,
        lasting="0s",
        severity="{{ $labels.severity }}",
    ),
    Rule(
        "fdd-silent",
        "Fault detection is silent",
        f"No verdict for {{{{ $labels.site }}}} for more than {settings.SILENT_MINUTES} minutes: "
        "the service, its sources or its database have stopped",
        _silence(),
        above=settings.SILENT_MINUTES,
        range_seconds=2 * 86_400,
        lasting="5m",
        severity="critical",
        no_data="Alerting",
    ),
    Rule(
        "fdd-unseen",
        "Charts without data",
        f"More than {settings.NO_DATA_SHARE:.0%} of the charts of {{{{ $labels.site }}}} have no data",
        _unseen(),
        above=settings.NO_DATA_SHARE,
        range_seconds=6 * 3600,
        lasting="1h",
        severity="medium",
    ),
    Rule(
        "fdd-not-watching",
        "Fault detection does not watch",
        "Something has kept the service of {{ $labels.site }} from watching for 15 minutes; fdd status says what",
        _problems(),
        above=0,
        range_seconds=900,
        lasting="0s",
        severity="critical",
    ),
    Rule(
        "fdd-spool",
        "Results wait on disk",
        "Results of {{ $labels.site }} have waited on disk for 15 minutes: the database is away or too slow",
        _waiting(),
        above=0,
        range_seconds=900,
        lasting="0s",
        severity="high",
    ),
    Rule(
        "fdd-lost",
        "Results were lost",
        "The spool of {{ $labels.site }} was full or the database refused rows",
        _lost(),
        above=0,
        range_seconds=3600,
        lasting="0s",
        severity="high",
    ),
)


def provisioned(rule: Rule) -> dict[str, Any]:
    """A rule as Grafana's file provisioning wants it."""
    window = {"from": rule.range_seconds, "to": 0}
    expression = {"type": "__expr__", "uid": "__expr__"}
    reduce: dict[str, Any] = {
        "refId": "B",
        "type": "reduce",
        "expression": "A",
        "reducer": "last",
        "datasource": expression,
    }
    evaluator = {"type": "gt", "params": [rule.above]}
    threshold: dict[str, Any] = {
        "refId": "C",
        "type": "threshold",
        "expression": "B",
        "datasource": expression,
        "conditions": [{"type": "query", "evaluator": evaluator}],
    }
    query: dict[str, Any] = {
        "refId": "A",
        "query": rule.flux,
        "datasource": {"type": "influxdb", "uid": settings.DATA_SOURCE},
        "intervalMs": 60_000,
        "maxDataPoints": 1000,
    }
    data: list[dict[str, Any]] = [
        {"refId": "A", "relativeTimeRange": window, "datasourceUid": settings.DATA_SOURCE, "model": query}
    ]
    data += [
        {"refId": m["refId"], "relativeTimeRange": window, "datasourceUid": "__expr__", "model": m}
        for m in (reduce, threshold)
    ]
    return {
        "uid": rule.uid,
        "title": rule.title,
        "condition": "C",
        "data": data,
        "noDataState": rule.no_data,
        "execErrState": "Alerting",
        "for": rule.lasting,
        "annotations": {"summary": rule.summary, "runbook_url": f"{settings.RUNBOOK}#{rule.uid}"},
        "labels": {"service": "hvac-fdd", "severity": rule.severity},
        "isPaused": False,
    }
