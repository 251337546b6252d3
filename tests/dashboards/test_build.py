"""The dashboards as data: committed files are current, and every panel, query and rule keeps to the house rules."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import pytest
from ruamel.yaml import YAML

from dashboards import build, settings
from dashboards.alerts import RULES
from dashboards.queries import condition, rows
from fdd.report.render import page_of

BOARDS = {name: json.loads((build.HERE / "generated" / f"{name}.json").read_text()) for name in build.BOARDS}
each_board = pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)


def panels(board: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for panel in board["panels"]:
        if panel["type"] != "row":
            yield panel
        yield from panel.get("panels", [])


def queries(board: dict[str, Any]) -> Iterator[str]:
    for panel in panels(board):
        yield from (t["query"] for t in panel["targets"])
    yield from (v["query"] for v in board["templating"]["list"] if v["type"] == "query")


def test_committed_files_are_what_the_code_generates() -> None:
    assert build.stale() == []


def test_a_changed_or_orphaned_file_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "HERE", tmp_path)
    for path, text in build.generated().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    assert build.stale() == []
    changed, orphan = tmp_path / "generated" / "plant.json", tmp_path / "generated" / "old.json"
    changed.write_text("{}")
    orphan.write_text("{}")
    assert build.stale() == [orphan, changed]


@each_board
def test_every_panel_says_how_to_read_it_and_has_a_unit_and_a_source(board: dict[str, Any]) -> None:
    for panel in panels(board):
        assert len(panel["description"]) > 10, panel["title"]
        assert panel["fieldConfig"]["defaults"]["unit"], panel["title"]
        assert panel["datasource"]["uid"] == settings.DATA_SOURCE
        assert all(t["datasource"]["uid"] == settings.DATA_SOURCE for t in panel["targets"])


@each_board
def test_queries_use_declared_variables_only_and_quote_them(board: dict[str, Any]) -> None:
    declared = {v["name"] for v in board["templating"]["list"]}
    for query in queries(board):
        for name, form in re.findall(r"\$\{(\w+)(?::(\w+))?\}", query):
            assert name in declared, (name, query)
            assert form == "doublequote" or name == "resolution", (name, query)
        assert "from(bucket" not in query or "v.defaultBucket" in query
    links = re.findall(r"\$\{(\w+)\}", json.dumps([p["fieldConfig"]["overrides"] for p in panels(board)]))
    assert {n for n in links if not n.startswith("__")} <= declared
    assert {p.get("repeat") for p in panels(board)} <= declared | {None}


@each_board
def test_variables_are_declared_before_those_that_use_them(board: dict[str, Any]) -> None:
    seen: set[str] = set()
    for variable in board["templating"]["list"]:
        if variable["type"] == "query":
            assert set(re.findall(r"\$\{(\w+)", variable["query"])) <= seen
        seen.add(variable["name"])


@each_board
def test_panels_do_not_overlap(board: dict[str, Any]) -> None:
    boxes = [p["gridPos"] for p in board["panels"]]
    for a, b in combinations(boxes, 2):
        apart = (
            a["x"] + a["w"] <= b["x"]
            or b["x"] + b["w"] <= a["x"]
            or a["y"] + a["h"] <= b["y"]
            or b["y"] + b["h"] <= a["y"]
        )
        assert apart, (a, b)
    assert all(p["x"] >= 0 and p["x"] + p["w"] <= 24 for p in boxes)


def test_dashboards_have_their_own_ids_and_links_lead_to_one_of_them() -> None:
    uids = [b["uid"] for b in BOARDS.values()]
    assert len(set(uids)) == len(uids)
    used = set(re.findall(r"/d/([\w-]+)", json.dumps(BOARDS)))
    assert used
    assert used <= set(uids)


def test_alarm_lists_link_to_component_report_and_runbook() -> None:
    for name in ("alarms", "plant", "component", "chiller"):
        table = next(p for p in panels(BOARDS[name]) if "larms" in p["title"] and p["type"] == "table")
        text = json.dumps(table["fieldConfig"]["overrides"])
        assert all(part in text for part in ("/d/fdd-component", "${reports}/", "${runbook}"))


def test_the_link_of_an_alarm_leads_to_the_page_that_the_report_wrote() -> None:
    """Grafana puts the key in, percent-encoded; a web server decodes it."""
    table = next(p for p in panels(BOARDS["alarms"]) if p["type"] == "table")
    (link,) = re.findall(r"\$\{reports\}/[^\"]*", json.dumps(table["fieldConfig"]["overrides"]))
    for key in ("hx 1@2026-03-01T00:00:00Z", "hx:model@2026-03-01T00:00:00Z", "50 % 'AHU' #2?@x"):
        url = link.replace("${__value.raw:percentencode}", quote(key, safe=""))
        assert unquote(url.removeprefix("${reports}/")) == page_of(key)
        assert Path(page_of(key)).name == page_of(key)


def test_an_unknown_field_or_measurement_fails_the_build() -> None:
    with pytest.raises(ValueError, match="no field limits"):
        condition("charts", ("limits",))
    with pytest.raises(ValueError, match="no measurement"):
        rows("chart", "limit")


def test_every_rule_has_a_runbook_page_and_reaches_a_provisioned_contact_point() -> None:
    yaml = YAML(typ="safe")
    folder = build.HERE / "provisioning" / "alerting"
    rules = yaml.load((folder / "rules.yaml").read_text())["groups"][0]["rules"]
    contacts = {c["name"] for c in yaml.load((folder / "contact-points.yaml").read_text())["contactPoints"]}
    assert {p["receiver"] for p in yaml.load((folder / "policies.yaml").read_text())["policies"]} == contacts
    runbook = (build.HERE.parent / "docs" / "runbook.md").read_text()
    assert [r["uid"] for r in rules] == [r.uid for r in RULES]
    for rule in rules:
        assert rule["annotations"]["runbook_url"] == f"{settings.RUNBOOK}#{rule['uid']}"
        assert f'<a id="{rule["uid"]}"></a>' in runbook
        refs = {d["refId"] for d in rule["data"]}
        assert rule["condition"] in refs
        assert {d["model"]["refId"] for d in rule["data"]} == refs
        assert all(d["model"]["expression"] in refs for d in rule["data"] if d["datasourceUid"] == "__expr__")
        assert all(d["datasourceUid"] in ("__expr__", settings.DATA_SOURCE) for d in rule["data"])


def test_no_secret_stands_in_a_provisioned_file() -> None:
    source = (build.HERE / "provisioning" / "datasources" / "influxdb.yaml").read_text()
    assert re.search(r"token: \$__file\{/run/", source)
