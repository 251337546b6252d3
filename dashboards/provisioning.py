"""Files that Grafana reads at its start: data source, dashboards, contact point, routing, alert rules.

Addresses and secrets come from Grafana's environment: ``FDD_INFLUX_URL``, ``FDD_INFLUX_ORG``, ``FDD_INFLUX_BUCKET``,
``FDD_ALERT_WEBHOOK``, and the token from the file that :mod:`dashboards.settings` names.
"""

from __future__ import annotations

from typing import Any

from dashboards import settings
from dashboards.alerts import RULES, provisioned

CONTACT = "fdd-operators"


def data_source() -> dict[str, Any]:
    """InfluxDB 2 by Flux, with the token that can only read."""
    source = {
        "name": "InfluxDB (fault detection)",
        "uid": settings.DATA_SOURCE,
        "type": "influxdb",
        "access": "proxy",
        "url": "$FDD_INFLUX_URL",
        "isDefault": True,
        "editable": False,
        "jsonData": {
            "version": "Flux",
            "organization": "$FDD_INFLUX_ORG",
            "defaultBucket": "$FDD_INFLUX_BUCKET",
            "tlsSkipVerify": False,
        },
        "secureJsonData": {"token": f"$__file{{{settings.TOKEN_FILE}}}"},
    }
    return {"apiVersion": 1, "prune": True, "datasources": [source]}


def dashboard_folder() -> dict[str, Any]:
    """Where the generated dashboards are mounted."""
    provider = {
        "name": "fdd",
        "orgId": 1,
        "folder": settings.FOLDER,
        "folderUid": "fdd",
        "type": "file",
        "disableDeletion": True,
        "allowUiUpdates": False,
        "updateIntervalSeconds": 60,
        "options": {"path": "/etc/grafana/dashboards", "foldersFromFilesStructure": False},
    }
    return {"apiVersion": 1, "providers": [provider]}


def contact_points() -> dict[str, Any]:
    """Where alerts go: a webhook, which every mail, chat or work-order system can take."""
    receiver = {
        "uid": CONTACT,
        "type": "webhook",
        "settings": {"url": "$FDD_ALERT_WEBHOOK", "httpMethod": "POST"},
        "disableResolveMessage": False,
    }
    return {"apiVersion": 1, "contactPoints": [{"orgId": 1, "name": CONTACT, "receivers": [receiver]}]}


def policies() -> dict[str, Any]:
    """One message for one alarm, repeated daily while nobody takes it."""
    policy = {
        "orgId": 1,
        "receiver": CONTACT,
        "group_by": ["alertname", "site", "component"],
        "group_wait": "30s",
        "group_interval": "5m",
        "repeat_interval": "24h",
    }
    return {"apiVersion": 1, "policies": [policy]}


def rules() -> dict[str, Any]:
    """The alert rules."""
    group = {
        "orgId": 1,
        "name": "fdd",
        "folder": settings.FOLDER,
        "interval": "1m",
        "rules": [provisioned(r) for r in RULES],
    }
    return {"apiVersion": 1, "groups": [group]}


FILES = {
    "datasources/influxdb.yaml": data_source,
    "dashboards/fdd.yaml": dashboard_folder,
    "alerting/contact-points.yaml": contact_points,
    "alerting/policies.yaml": policies,
    "alerting/rules.yaml": rules,
}
