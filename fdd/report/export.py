"""Findings for machines: JSON and CSV with units in the names of the columns."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime
from typing import Any

from fdd.records import NANOSECONDS
from fdd.report.content import Report
from fdd.report.findings import Finding
from fdd.report.words import local

SCHEMA = 2
COLUMNS = (
    "key", "kind", "component", "title", "location", "state", "severity", "since_utc", "raised_utc", "since_local",
    "raised_local", "summary", "likeliest_cause", "likelihood", "first_check", "cost_per_day", "currency",
)  # fmt: skip


def findings_json(report: Report) -> str:
    """Every finding of the period, standing, suppressed or closed, as one JSON object; models that no longer hold
    apart."""
    document = {
        "schema": SCHEMA,
        "site": report.site.name,
        "zone": report.site.zone,
        "start_utc": _utc(report.start),
        "end_utc": _utc(report.end),
        "status": report.status,
        "findings": [_finding(f, report) for f in _all(report)],
        "models": [_finding(f, report) for f in report.models],
        "unmonitored": [
            {"component": u.name, "title": u.title, "what": u.what, "why": u.why, "remedy": u.remedy}
            for u in report.unmonitored
        ],
        "healthy": [w.component for w in report.healthy],
    }
    return json.dumps(document, ensure_ascii=False, indent=2, allow_nan=False) + "\n"


def findings_csv(report: Report) -> str:
    """One line a finding, those of models last (``kind``); columns :data:`COLUMNS`."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for f in (*_all(report), *report.models):
        first = f.causes[0] if f.causes else None
        row = _head(f, report) | {
            "likeliest_cause": first.meaning if first else "",
            "likelihood": first.likelihood if first else "",
            "first_check": f.checks[0].do if f.checks else "",
        }
        writer.writerow({k: _cell(row[k]) for k in COLUMNS})
    return out.getvalue()


def _cell(value: Any) -> Any:
    """Text that a spreadsheet would run as a formula is quoted."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@") else value


def _all(report: Report) -> tuple[Finding, ...]:
    return (*report.findings, *report.consequences, *report.closed)


def _utc(time: int | None) -> str | None:
    return None if time is None else datetime.fromtimestamp(time / NANOSECONDS, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _head(f: Finding, report: Report) -> dict[str, Any]:
    return {
        "key": f.key,
        "kind": f.kind,
        "component": f.component,
        "title": f.info.title,
        "location": f.info.location,
        "state": str(f.state),
        "severity": f.severity,
        "since_utc": _utc(f.since),
        "raised_utc": _utc(f.raised),
        "since_local": local(f.since, report.site.tz),
        "raised_local": local(f.raised, report.site.tz),
        "summary": f.summary,
        "cost_per_day": f.cost_value,
        "currency": report.site.currency if f.cost_value is not None else None,
    }


def _finding(f: Finding, report: Report) -> dict[str, Any]:
    return _head(f, report) | {
        "caused_by": f.caused_by or None,
        "consequences": list(f.consequences),
        "certainty": list(f.certainty),
        "causes": [
            {
                "meaning": c.meaning,
                "likelihood": c.likelihood if c.likelihood == c.likelihood else None,
                "for": list(c.speaks_for),
                "against": list(c.speaks_against),
            }
            for c in f.causes
        ],
        "checks": [{"do": c.do, "expect": c.expect or None} for c in f.checks],
        "signals": [
            {
                "chart": s.name,
                "what": s.words,
                "direction": s.direction,
                "raised_utc": _utc(s.raised),
                "times_limit": s.ratio if s.ratio == s.ratio else None,
            }
            for s in f.signals
        ],
        "readings": [
            {"what": r.meaning, "point": r.point, "unit": r.unit, "measured": r.measured, "expected": r.expected}
            for r in f.readings
        ],
        "history": [
            {"time_utc": _utc(e.time), "state": e.state, "who": e.actor, "comment": e.comment} for e in f.history
        ],
    }
