"""Every query of every dashboard and rule on a real server, on data that the store wrote; and Grafana's own schema."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from influxdb_client import InfluxDBClient

from dashboards import settings
from dashboards.alerts import RULES, Rule
from dashboards.service import GAUGES
from fdd.records import Rows
from fdd.store.influx import InfluxStore
from fdd.store.influx_setup import Plan, downsampling
from fdd.store.schema import MEASUREMENTS, PHASES
from fdd.store.store import StoreConfig
from tests.dashboards.render import render
from tests.dashboards.test_build import BOARDS, panels
from tests.store.influxd import ORG, Influxd

pytestmark = pytest.mark.integration
MINUTE = 60 * 10**9
HOUR = 60 * MINUTE
SITE = 'north "A"'  # a name that breaks a query which does not quote
SERIES = {
    "samples": ("T_supply",),
    "predictions": ("hx 1/T_out", "hx 1/T_back", "chiller/E"),
    "charts": ("hx 1/T_out:cusum", "hx 1/T_back:cusum", "chiller/R:drift"),
    "parameters": ("hx 1/U", "chiller/dS", "chiller/Q_leak", "chiller/R"),
    "scores": ("hx 1/U",),
    "gates": ("chiller/steady",),
    "counts": ("ingest/accepted", "ingest/late", "store/dropped_rows", "store/refused_rows"),
    "health": (
        *("service/sample_rate", "service/lag", "service/rss", "store/spool_bytes"),
        *(f"service/alarms_a_year_{k}" for k in ("realised", "low", "high", "promised")),
    ),
}


ALARMS = (
    ("hx 1", "raised", "high"),
    ("hx 1", "acknowledged", "low"),
    ("hx 1", "cleared", "critical"),
    ("chiller", "raised", "medium"),
    ("chiller", "shelved", "info"),
    ("chiller", "suppressed by design", "info"),
    ("chiller", "returned to normal", "low"),
)


def alarm(key: str, state: str, severity: str, since: int) -> dict[str, object]:
    return {
        "key": key, "component": key.partition("@")[0], "state": state, "severity": severity,
        "summary": 'fouled, "badly"',
        "since": since, "raised": since + HOUR, "updated": since + 2 * HOUR, "history": [{"state": "raised"}],
    }  # fmt: skip


def write_plant(store: InfluxStore, now: int) -> None:
    """Six hours of every measurement, a value a minute, and alarms in several states."""
    stamps = now - np.arange(360, 0, -1) * MINUTE
    for name, series in SERIES.items():
        n = len(series)
        values = np.tile(np.linspace(1, 2, len(stamps)), n)
        fields = {f: values.copy() for f in MEASUREMENTS[name].field_names}
        if name == "charts":
            fields["phase"] = np.repeat([3.0, 2.0, 0.0], len(stamps))
        index = np.repeat(np.arange(n, dtype=np.int32), len(stamps))
        store.write(Rows(name, series, index, np.tile(stamps, n), fields))
    for i, (component, state, severity) in enumerate(ALARMS):
        key = f"{component}@{i}"
        store.put("alarm", key, alarm(key, state, severity, now - 5 * HOUR))
    store.put("baseline", "hx 1/000001", {"component": "hx 1", "version": 1})


class Plant:
    """A bucket of its own, filled, and a way to ask it."""

    def __init__(self, influxd: Influxd, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("FDD_TEST_TOKEN", influxd.admin_token)
        self.influxd, self.bucket = influxd, influxd.new_bucket()
        with self.client() as client:
            client.buckets_api().create_bucket(bucket_name=f"{self.bucket}_hourly", org=ORG)
        self.config = StoreConfig(
            "influx", SITE, url=influxd.url, org=ORG, bucket=self.bucket, token_env="FDD_TEST_TOKEN"
        )
        self.store = InfluxStore(self.config)
        self.now = time.time_ns()
        self.span: tuple[int, int] | None = None  # of the data, where that is not the present

    def client(self) -> InfluxDBClient:
        return InfluxDBClient(self.influxd.url, token=self.influxd.admin_token, org=ORG)

    def ask(self, flux: str, variables: Mapping[str, str], span: int = 6 * HOUR) -> list[dict[str, str]]:
        now = time.time_ns()
        start, stop = self.span or (now - span, now)
        text = render(flux, variables, bucket=self.bucket, start=start, stop=stop)
        with self.client() as client:
            answer = client.query_api().query_raw(text, dialect={"header": True, "annotations": []}).read().decode()
        found, header = [], []
        for row in csv.reader(io.StringIO(answer)):
            if not row:
                header = []
            elif not header:
                header = row
            else:
                found.append(dict(zip(header, row, strict=True)))
        assert "error" not in header, answer
        return found


@pytest.fixture
def plant(influxd: Influxd, monkeypatch: pytest.MonkeyPatch) -> Plant:
    return Plant(influxd, monkeypatch)


def variable_sets(plant: Plant, name: str) -> list[dict[str, str]]:
    """Every choice of a dashboard's variables, found by the variables' own queries."""
    sets: list[dict[str, str]] = [{}]
    for variable in BOARDS[name]["templating"]["list"]:
        if variable["type"] == "query":
            grown = []
            for chosen in sets:
                values = [r["_value"] for r in plant.ask(variable["query"], chosen)]
                assert values or chosen.get("component") == "chiller", f"variable {variable['name']} of {name} is empty"
                if variable["name"] in ("output", "stream", "parameter"):
                    values = values[:2]
                grown += [{**chosen, variable["name"]: v} for v in values]
            sets = grown
        elif variable["name"] == "resolution":
            sets = [{**s, "resolution": r} for s in sets for r in ("raw", "hourly")]
    return sets


@pytest.mark.parametrize("name", BOARDS)
def test_every_panel_of_every_dashboard_shows_something(plant: Plant, name: str) -> None:
    write_plant(plant.store, plant.now)
    with plant.client() as client:
        client.query_api().query_raw(downsampling(Plan(ORG, plant.bucket))).read()
    sets = variable_sets(plant, name)
    assert sets
    shown: dict[str, int] = {}
    for chosen in sets:
        if name == "component" and chosen["component"] != "hx 1":
            continue
        for panel in panels(BOARDS[name]):
            for target in panel["targets"]:
                rows = plant.ask(target["query"], chosen)
                assert rows, f"{panel['title']} is empty for {chosen}:\n{target['query']}"
                empty = [c for c in rows[0] if c not in ("", "result") and all(r[c] == "" for r in rows)]
                assert not empty, f"{panel['title']}: columns {empty} hold nothing\n{target['query']}"
                shown[panel["title"]] = len(rows)
    assert len(shown) == len({p["title"] for p in panels(BOARDS[name])})


def test_site_and_chiller_variables_offer_what_was_written(plant: Plant) -> None:
    write_plant(plant.store, plant.now)
    InfluxStore(replace(plant.config, site="south")).write(
        Rows("charts", ("pump/dp:cusum",), np.zeros(1, np.int32), np.array([plant.now]), {"phase": np.array([2.0])})
    )
    found = {v["name"]: v["query"] for b in BOARDS.values() for v in b["templating"]["list"] if v["type"] == "query"}
    assert {r["_value"] for r in plant.ask(found["site"], {})} == {SITE, "south"}
    chiller = next(v["query"] for v in BOARDS["chiller"]["templating"]["list"] if v["name"] == "component")
    assert [r["_value"] for r in plant.ask(chiller, {"site": SITE})] == ["chiller"]
    component = next(v["query"] for v in BOARDS["component"]["templating"]["list"] if v["name"] == "component")
    assert {r["_value"] for r in plant.ask(component, {"site": SITE})} == {"hx 1", "chiller"}
    assert {r["_value"] for r in plant.ask(component, {"site": "south"})} == {"pump"}


def test_dashboards_show_what_the_demo_wrote(plant: Plant, tmp_path: Path) -> None:
    """The demo itself, with its daemon writing to the server; of the service's own health, what the present shows."""
    command = [sys.executable, "-m", "fdd", "demo", "--weeks", "2", "--folder", str(tmp_path), "--store", "influx"]
    server = {"URL": plant.influxd.url, "ORG": ORG, "BUCKET": plant.bucket, "TOKEN": plant.influxd.admin_token}
    environment = {**os.environ, **{f"FDD_INFLUX_{k}": v for k, v in server.items()}}
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, timeout=600, env=environment)
    assert done.returncode == 0, done.stderr[-3000:]
    demo = json.loads(done.stdout)
    plant.store = InfluxStore(replace(plant.config, site="demo"))
    times = plant.store.read("charts")["time"]
    plant.span = (int(times.min()), int(times.max()) + 1)
    for name in ("plant", "component", "alarms"):
        sets = [s for s in variable_sets(plant, name) if name == "alarms" or s["resolution"] == "raw"]
        chosen = next(s for s in sets if s.get("component", demo["faulty_component"]) == demo["faulty_component"])
        for panel in panels(BOARDS[name]):
            assert plant.ask(panel["targets"][0]["query"], chosen), f"{name}: {panel['title']} is empty"
    listed = plant.ask(
        next(p for p in panels(BOARDS["alarms"]) if p["type"] == "table")["targets"][0]["query"], {"site": "demo"}
    )
    assert {r["component"] for r in listed} >= set(demo["components_alarmed"])
    plant.span = None
    for series in ("service/sample_rate", "service/lag", "service/rss", "store/spool_bytes"):
        title = {s: t for s, t, *_ in GAUGES}[series]
        panel = next(p for p in panels(BOARDS["service"]) if p["title"] == title)
        assert plant.ask(panel["targets"][0]["query"], {"site": "demo", "resolution": "raw"}), title


def test_counts_are_zero_where_there_is_no_alarm(plant: Plant) -> None:
    chart_rows(plant, [2], 1)
    assert [r["_value"] for r in panel_rows(plant, "plant", "Open alarms")] == ["0"]


def panel_rows(plant: Plant, board: str, title: str) -> list[dict[str, str]]:
    panel = next(p for p in panels(BOARDS[board]) if p["title"] == title)
    chosen = {"site": SITE, "resolution": "raw", "component": "hx 1", "output": "T_out"}
    return plant.ask(panel["targets"][0]["query"], chosen)


def test_numbers_of_the_plant_overview_are_right(plant: Plant) -> None:
    write_plant(plant.store, plant.now)
    numbers = {
        t: panel_rows(plant, "plant", t)[0]["_value"] for t in ("Open alarms", "High priority", "Unacknowledged")
    }
    assert numbers == {"Open alarms": "6", "High priority": "1", "Unacknowledged": "2"}
    # hx 1 has one chart in alarm and one quiet: its worst phase counts. The chiller has no data.
    states = {t: float(panel_rows(plant, "plant", t)[0]["_value"]) for t in ("Quiet", "Learning", "No data")}
    assert states == {"Quiet": 0, "Learning": 0, "No data": 1}


def test_newest_verdict_is_as_old_as_the_newest_chart(plant: Plant) -> None:
    chart_rows(plant, [2], 20)
    assert float(panel_rows(plant, "service", "Newest verdict")[0]["_value"]) == pytest.approx(1200, abs=60)


def test_alarm_list_puts_the_most_urgent_first_with_times(plant: Plant) -> None:
    write_plant(plant.store, plant.now)
    listed = panel_rows(plant, "alarms", "Alarms")
    assert [r["priority"] for r in listed] == ["critical", "high", "medium", "low", "low", "info", "info"]
    assert np.datetime64(listed[0]["since"].rstrip("Z"), "ns").astype(int) == plant.now - 5 * HOUR
    assert listed[0]["summary"] == 'fouled, "badly"'


def test_band_is_prediction_plus_and_minus_two_standard_deviations(plant: Plant) -> None:
    cells = {"measured": 22.0, "predicted": 20.0, "sd": 0.25, "innovation": 8.0}
    fields = {name: np.array([value]) for name, value in cells.items()}
    stamp = np.array([plant.now - 30 * MINUTE])
    plant.store.write(Rows("predictions", ("hx 1/T_out",), np.zeros(1, np.int32), stamp, fields))
    (row,) = panel_rows(plant, "component", "${output}: measured and predicted")
    assert [float(row[c]) for c in ("measured", "predicted", "lower", "upper")] == [22.0, 20.0, 19.5, 20.5]


# ---- alert rules: the query on the server, then Grafana's "last" and "above" on each series


def fires(plant: Plant, uid: str) -> dict[str, str] | bool:
    """Labels of the first series that fires, or False; no series at all is the rule's ``no_data``."""
    rule: Rule = next(r for r in RULES if r.uid == uid)
    rows = plant.ask(rule.flux, {}, rule.range_seconds * 10**9)
    if not rows:
        return rule.no_data == "Alerting"
    for row in rows:  # every query gives one row a series
        if float(row["_value"]) > rule.above:
            return row
    return False


def chart_rows(plant: Plant, phases: list[float], age_minutes: float, last: int = 10) -> None:
    names = tuple(f"c{i}/T:cusum" for i in range(len(phases)))
    end = plant.now - int(age_minutes * MINUTE)
    stamps = end - np.arange(last) * MINUTE
    index = np.repeat(np.arange(len(phases), dtype=np.int32), last)
    plant.store.write(
        Rows("charts", names, index, np.tile(stamps, len(phases)), {"phase": np.repeat(np.array(phases, float), last)})
    )


def gauge(plant: Plant, measurement: str, series: str, values: list[float]) -> None:
    stamps = plant.now - np.arange(len(values))[::-1] * MINUTE - MINUTE
    plant.store.write(
        Rows(measurement, (series,), np.zeros(len(values), np.int32), stamps, {"value": np.array(values)})
    )


@pytest.mark.parametrize(
    ("state", "expected"), [("raised", True), ("acknowledged", False), ("shelved", False), ("cleared", False)]
)
def test_alarm_rule_fires_for_raised_alarms_only(plant: Plant, state: str, expected: bool) -> None:
    plant.store.put("alarm", "k", alarm("hx 1@k", state, "high", plant.now))
    found = fires(plant, "fdd-alarm")
    assert bool(found) is expected
    if isinstance(found, dict):
        assert (found["component"], found["severity"], found["site"]) == ("hx 1", "high", SITE)


def test_alarm_rule_stops_firing_once_the_alarm_is_acknowledged(plant: Plant) -> None:
    plant.store.put("alarm", "k", alarm("hx 1@k", "raised", "high", plant.now))
    assert fires(plant, "fdd-alarm")
    plant.store.put("alarm", "k", alarm("hx 1@k", "acknowledged", "high", plant.now))
    assert not fires(plant, "fdd-alarm")


@pytest.mark.parametrize(
    ("age", "expected"),
    [(1, False), (settings.SILENT_MINUTES - 2, False), (settings.SILENT_MINUTES + 2, True), (1000, True)],
)
def test_silence_rule_fires_when_the_newest_verdict_is_old(plant: Plant, age: int, expected: bool) -> None:
    chart_rows(plant, [2, 2], age)
    assert bool(fires(plant, "fdd-silent")) is expected


def test_silence_rule_fires_when_there_is_nothing_at_all(plant: Plant) -> None:
    assert fires(plant, "fdd-silent") is True


def test_silence_of_one_site_is_not_hidden_by_another(plant: Plant) -> None:
    chart_rows(plant, [2], 500)
    plant.store = InfluxStore(replace(plant.config, site="south"))
    chart_rows(plant, [2], 1)
    found = fires(plant, "fdd-silent")
    assert isinstance(found, dict)
    assert found["site"] == SITE


@pytest.mark.parametrize(("dead", "expected"), [(0, False), (2, False), (3, True), (10, True)])
def test_unseen_rule_fires_above_its_share_of_charts(plant: Plant, dead: int, expected: bool) -> None:
    chart_rows(plant, [float(PHASES.index("no data"))] * dead + [2.0] * (10 - dead), 1)
    assert bool(fires(plant, "fdd-unseen")) is expected


@pytest.mark.parametrize(
    ("waiting", "expected"), [([0.0] * 14, False), ([5000.0] * 13 + [0.0], False), ([9000.0] * 14, True)]
)
def test_spool_rule_fires_only_when_results_wait_throughout(plant: Plant, waiting: list[float], expected: bool) -> None:
    gauge(plant, "health", "store/spool_bytes", waiting)
    assert bool(fires(plant, "fdd-spool")) is expected


@pytest.mark.parametrize(
    ("dropped", "expected"), [([0.0] * 20, False), ([700.0] * 20, False), ([0.0] * 19 + [40.0], True)]
)
def test_lost_rule_fires_when_the_count_grows_and_not_for_an_old_loss(
    plant: Plant, dropped: list[float], expected: bool
) -> None:
    gauge(plant, "counts", "store/dropped_rows", dropped)
    gauge(plant, "counts", "store/refused_rows", [3.0] * 20)
    assert bool(fires(plant, "fdd-lost")) is expected


# ---- Grafana's own types


def validate(folder: Path, *files: Path) -> str:
    done = subprocess.run(
        ["node", "validate.mjs", *map(str, files)], cwd=folder, capture_output=True, text=True, timeout=120
    )
    assert not done.stderr, done.stderr
    return done.stdout


def test_dashboards_fit_grafanas_schema(grafana_schema: Path) -> None:
    from dashboards.build import HERE

    assert validate(grafana_schema, *sorted((HERE / "generated").glob("*.json"))) == ""


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["panels", 0, "titel"], "typo"),
        (["panels", 0, "gridPos", "w"], "wide"),
        (["templating", "list", 0, "auto"], True),
    ],
)
def test_the_schema_finds_a_typo_and_a_wrong_type(
    grafana_schema: Path, tmp_path: Path, path: list[str], value: object
) -> None:
    board = json.loads(json.dumps(BOARDS["plant"]))
    place = board
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    (tmp_path / "bad.json").write_text(json.dumps(board))
    assert "bad.json" in validate(grafana_schema, tmp_path / "bad.json")
