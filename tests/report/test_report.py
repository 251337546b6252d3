"""What a report says, checked on a simulated month with known faults."""

from __future__ import annotations

import csv
import io
import json
import re
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from fdd.records import AlarmState
from fdd.report.content import ComponentInfo, Report, ReportError, SiteInfo, gather
from fdd.report.evidence import Catalogue, latest
from fdd.report.render import findings_csv, findings_json, render_html, write_pdf, write_report
from fdd.store.sqlite import SqliteStore

from . import plant


@pytest.fixture(scope="module")
def month(tmp_path_factory: pytest.TempPathFactory) -> tuple[SqliteStore, SiteInfo]:
    store = SqliteStore(tmp_path_factory.mktemp("report") / "store.sqlite")
    return store, plant.full(store)


@pytest.fixture(scope="module")
def report(month: tuple[SqliteStore, SiteInfo]) -> Report:
    return gather(*month)


@pytest.fixture(scope="module")
def html(report: Report) -> str:
    return render_html(report)


@pytest.fixture
def store(tmp_path: Path) -> SqliteStore:
    return SqliteStore(tmp_path / "store.sqlite")


class _Text(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self.links: list[str] = []
        self.stack: list[str] = []
        self.hidden = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.hidden = tag == "style"
        self.links += [v or "" for k, v in attrs if k in ("href", "src", "action", "data", "poster", "srcset")]
        if tag not in ("img", "meta", "br", "link"):
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.stack.pop() == tag
        self.hidden = False

    def handle_data(self, data: str) -> None:
        if not self.hidden:
            self.words.append(data)


def parsed(html: str) -> _Text:
    parser = _Text()
    parser.feed(html)
    assert parser.stack == [], "unclosed elements"
    return parser


def text(html: str) -> str:
    return " ".join(" ".join(parsed(html).words).split())


def test_period_is_the_week_up_to_the_newest_prediction(month: tuple[SqliteStore, SiteInfo], report: Report) -> None:
    assert latest(month[0], Catalogue.of(month[0])) == plant.END
    assert report.end == plant.END + 1
    assert report.start == plant.END + 1 - 7 * plant.DAY


def test_findings_are_the_open_alarms_most_urgent_first(report: Report) -> None:
    assert [f.component for f in report.findings] == ["substation-hx", "radiator-2"]
    assert [f.component for f in report.consequences] == ["radiator-0"]
    assert [f.component for f in report.closed] == ["radiator-1"]


def test_first_actions_take_the_findings_in_turns(report: Report) -> None:
    assert [a.do for a in report.actions] == [
        "Compare the primary return temperature with the secondary return.",
        "Feel the top of the radiator.",
        "Measure the pressure drop on both sides.",
    ]
    assert report.actions[1].expect == "Cold means air."
    assert report.actions[1].where == "Radiator, room 102, second floor, room 102"


def test_page_one_says_the_first_things_and_the_status(html: str) -> None:
    first = text(html).split("Finding 1 of 2")[0]
    assert "2 findings" in first
    assert "Do these three things first" in first
    assert "1 could not be monitored" in first


def test_times_are_local_and_the_zone_is_named(html: str) -> None:
    said = text(html)
    # 2025-11-17 10:00 UTC less 8 days plus 35 min is 11:35 in Copenhagen.
    assert "Sun 9 Nov 2025, 11:35" in said
    assert "Tue 11 Nov 2025, 10:45" in said
    assert "local times in Europe/Copenhagen" in said


def test_no_symbol_chart_name_or_alarm_key_is_left_in_prose(html: str) -> None:
    said = re.sub(r"\b(hx|rad\d+)\.T_\w+", "", text(html))  # point names are what stands on the plant's own screens
    for code in ("T_hot_out", "T_return", ":cusum", "substation-hx", "radiator-2", "C_hot", "explain H"):
        assert code not in said
    assert "The outlet temperature of the hot side is above what the model expects." in said
    assert "The drift chart (CUSUM) of outlet temperature of the hot side passed its limit." in said
    assert "It does not explain the heat transfer to the air." in said


def test_departure_since_onset_is_that_of_the_rows(report: Report, month: tuple[SqliteStore, SiteInfo]) -> None:
    finding = report.findings[1]
    rows = month[0].read("predictions", ["radiator-2/T_return"], finding.since, plant.END + 1)
    mean = float((rows["measured"] - rows["predicted"]).mean())
    assert mean == pytest.approx(0.8 * 0.12 * 0.62, rel=0.1)  # ramp of six days in eight: mean about 0.62 of the shift
    assert any(f"{mean:.2f} K above" in line for line in finding.certainty)


def test_summary_groups_what_is_higher_and_what_is_lower(report: Report) -> None:
    assert report.findings[0].summary == (
        "Outlet temperature of the hot side higher, and outlet temperature of the cold side lower than its healthy "
        "model expects. Most likely deposits on the plates: less heat passes at the same flows."
    )


def test_change_of_a_parameter_is_told_with_its_interval(store: SqliteStore) -> None:
    document = plant.alarm("substation-hx", {})
    numbers = {"symbol": "C_hot", "statistic": 11.0, "limit": 10.0, "direction": -1}
    numbers |= {"change": -0.12, "standard_error": 0.01, "scale": "relative"}
    document["evidence"] = {"charts": {"substation-hx/C_hot:score": numbers}, "points": []}
    document["charts"] = ["substation-hx/C_hot:score"]
    store.put("alarm", document["key"], document)
    (finding,) = gather(store, plant.site(1)).findings
    assert any(
        "film coefficient of the hot side at 1 kg/s was 12 % below its baseline (give or take 2 %)" in line
        for line in finding.certainty
    )
    assert finding.signals[0].words.startswith("Parameter drift chart (score CUSUM) of film coefficient")


def test_readings_compare_measured_with_expected_over_the_last_day(report: Report) -> None:
    hot, cold = report.findings[0].readings
    assert (hot.point, cold.point) == ("hx.T_hot_out", "hx.T_cold_out")
    assert hot.measured - hot.expected == pytest.approx(1.1 * 0.12, abs=4 * 0.12 / np.sqrt(288))
    assert hot.words[2].startswith("+0.1")
    assert cold.words[2].startswith("−0.1")


def test_cost_is_given_with_its_interval_and_said_to_be_unknown_otherwise(html: str) -> None:
    assert "14.20 EUR a day between 9.80 and 18.90" in text(html)
    assert "no estimate for this fault" in text(html)


def test_consequence_names_its_source_in_words(report: Report, html: str) -> None:
    assert report.findings[0].consequences == ("Radiator, room 100",)
    assert "which the alarm of Heat exchanger, substation suspects" in text(html)


def test_healthy_leaves_out_what_is_in_alarm_or_unwatched(report: Report) -> None:
    assert [w.component for w in report.healthy] == ["radiator-1", "radiator-3", "radiator-4"]
    assert all(w.watched == pytest.approx(1.0, abs=2 / 2016) for w in report.healthy)
    assert report.healthy[0].fit == (("water temperature at the outlet", "0.12 K"),)


def test_component_without_baseline_is_unmonitored_with_a_remedy(report: Report) -> None:
    (gap,) = report.unmonitored
    assert (gap.name, gap.what) == ("radiator-5", "everything")
    assert "no healthy baseline" in gap.why
    assert "fdd fit" in gap.remedy


def test_silence_missing_data_learning_and_missing_sensor_are_told_apart(store: SqliteStore) -> None:
    info = plant.site(5)
    outputs = {**info.components["radiator-4"].outputs, "T_room": ("", "degC", "room temperature")}
    changed = {**info.components, "radiator-4": ComponentInfo("Radiator 4", "Water radiator", outputs)}
    info = plant.site(5, components=changed)
    rng = np.random.default_rng(1)
    time_ = plant.END - 7 * plant.DAY + plant.STEP * np.arange(1, 2017)
    with store.transaction():
        for name in info.components:
            plant.keep_baseline(store, plant.baseline(name, 1, {"H": 10.0}))
        plant.write_output(store, "radiator-0", "T_return", time_[:1000], rng, 0.0)
        plant.write_output(store, "radiator-1", "T_return", np.sort(rng.choice(time_, 1000, replace=False)), rng, 0.0)
        plant.write_output(store, "radiator-2", "T_return", time_, rng, 0.0)
        learning = {"phase": np.full(2016, 1.0)}
        store.write(plant.rows("charts", "radiator-2/T_return:cusum", time_, learning))
        plant.write_output(store, "radiator-4", "T_return", time_, rng, 0.0)
    why = {u.name: (u.what, u.why) for u in gather(store, info).unmonitored}
    assert why["radiator-0"][0] == "the end of the period"
    assert why["radiator-0"][1].startswith("no usable data since")
    assert why["radiator-1"][0] == "50 % of the period"
    assert why["radiator-2"] == ("everything", "its charts are still learning what is normal")
    assert why["radiator-3"][1].startswith("there were no usable data")
    assert why["radiator-4"] == ("room temperature", "no sensor is mapped to it")


def test_a_score_chart_that_learns_has_judged(store: SqliteStore) -> None:
    """It may ring while it learns what the baseline is off by; the engine counts that time, too."""
    info, rng = plant.site(1), np.random.default_rng(2)
    info = plant.site(1, components={"radiator-0": info.components["radiator-0"]})
    time_ = plant.END - 7 * plant.DAY + plant.STEP * np.arange(1, 2017)
    with store.transaction():
        plant.keep_baseline(store, plant.baseline("radiator-0", 1, {"H": 10.0}))
        plant.write_output(store, "radiator-0", "T_return", time_, rng, 0.0)
        store.write(plant.rows("charts", "radiator-0/H:score", time_, {"phase": np.full(2016, 1.0)}))
    report = gather(store, info)
    assert report.unmonitored == ()
    assert report.budget is not None
    assert report.budget.years == pytest.approx(7 / 365.25, rel=1e-3)


def test_budget_counts_own_alarms_and_those_judged_false(report: Report) -> None:
    kept = report.budget
    assert kept is not None
    assert kept.false is not None
    assert kept.most is not None
    assert (kept.raised, kept.judged_false, kept.consequences) == (3, 1, 1)
    years = 7 / 365.25 * 6 / 7  # six of seven components could be judged
    assert kept.years == pytest.approx(years, rel=1e-3)
    # Garwood's interval for one event: 0.0253 to 5.572 (Pearson and Hartley, table 40).
    assert kept.false.low == pytest.approx(0.0253 / years, rel=5e-3)
    assert kept.false.high == pytest.approx(5.572 / years, rel=5e-3)


def test_counts_are_the_last_in_words(report: Report) -> None:
    assert {c.words: c.value for c in report.counts}["samples that came too late"] == 12


def test_baseline_in_force_is_the_one_the_pointer_names(report: Report, html: str) -> None:
    found = {b.component: b for b in report.baselines}
    assert (found["substation-hx"].version, found["substation-hx"].versions) == (2, 2)
    assert found["radiator-0"].parameters[1] == ("heat transfer to the air", "10.2 W/Kⁿ", "9.80 to 10.6 W/Kⁿ")
    assert "28 Sep 2025 to 12 Oct 2025" in text(html)


def test_html_holds_all_it_needs(html: str) -> None:
    for link in parsed(html).links:
        assert link.startswith(("#finding-", "data:image/svg+xml;base64,")), link[:60]
    assert "http:" not in html
    assert "https:" not in html
    assert "<script" not in html
    assert "@import" not in html
    assert "url(" not in html


def test_every_link_has_its_target(html: str) -> None:
    targets = set(re.findall(r'id="([^"]+)"', html))
    assert {link[1:] for link in parsed(html).links if link.startswith("#")} <= targets


def test_names_are_escaped(store: SqliteStore) -> None:
    nasty = "<script>alert(1)</script> & Co"
    component = ComponentInfo(nasty, nasty, {"T": ("p<b>", "degC", "temperature <i>")}, {}, location=nasty)
    info = SiteInfo(nasty, "UTC", 1.0, {"r": component})
    document = plant.alarm("r", {"T": 1}, summary=f"r: {nasty}", causes=[{"meaning": nasty, "likelihood": 1.0}])
    document["checks"] = [nasty]
    document["history"].append({"time": plant.END, "state": "acknowledged", "actor": nasty, "comment": nasty})
    with store.transaction():
        plant.write_output(
            store, "r", "T", plant.END - plant.STEP * np.arange(3000)[::-1], np.random.default_rng(1), 1.0
        )
        store.put("alarm", document["key"], document)
    html = render_html(gather(store, info))
    assert "<script" not in html
    assert "<i>" not in html.replace('<i style="', "")
    assert "alert(1)" in text(html)


def test_empty_store_says_what_to_do(store: SqliteStore) -> None:
    html = text(render_html(gather(store, plant.site(2))))
    assert "Nothing has been monitored yet" in html
    assert "no data have been processed yet" in html.lower()
    assert "Radiator, room 101" in html


def test_quiet_plant_reads_well(store: SqliteStore) -> None:
    info = plant.site(2)
    with store.transaction():
        plant.fill(store, info, days=8)
        for name in info.components:
            plant.keep_baseline(store, plant.baseline(name, 1, {"H": 10.0}))
    report = gather(store, info)
    html = text(render_html(report))
    assert report.well
    assert "All well on 3 monitored components" in html
    assert "Nothing needs to be done" in html
    assert "first" not in html.split("Healthy equipment")[0].lower()
    assert report.budget is not None
    assert report.budget.most is not None
    assert report.budget.most.count == 0
    assert report.budget.most.consistent


def test_without_findings_the_first_thing_is_what_cannot_be_watched(store: SqliteStore) -> None:
    info = plant.site(1)
    with store.transaction():
        plant.fill(store, info, days=8)
        plant.keep_baseline(store, plant.baseline("substation-hx", 1, {"C_hot": 8e3}))
    report = gather(store, info)
    assert report.status == "All well on 1 monitored component; 1 could not be monitored"
    assert not report.well
    assert [a.where for a in report.actions] == ["Radiator, room 100"]


@pytest.mark.parametrize("state", list(AlarmState))
def test_each_state_of_an_alarm_has_its_place(store: SqliteStore, state: AlarmState) -> None:
    info = plant.site(3)
    document = plant.air(state=str(state), updated=plant.END - plant.DAY)
    with store.transaction():
        plant.fill(store, info, days=10, faults={"radiator-2": {"T_return": 1.0}})
        store.put("alarm", document["key"], document)
    report = gather(store, info)
    places = {"finding": report.findings, "consequence": report.consequences, "closed": report.closed}
    expected = {AlarmState.SUPPRESSED: "consequence", AlarmState.CLEARED: "closed"}.get(state, "finding")
    assert [name for name, found in places.items() if found] == [expected]
    told = any(a.do == "Feel the top of the radiator." for a in report.actions)
    assert told is (state in (AlarmState.RAISED, AlarmState.ACKNOWLEDGED, AlarmState.RETURNED))
    assert str(state).capitalize() in text(render_html(report)) or state in (AlarmState.SUPPRESSED, AlarmState.CLEARED)


def test_alarm_cleared_before_the_period_is_left_out(month: tuple[SqliteStore, SiteInfo]) -> None:
    assert gather(*month, start=plant.END - plant.DAY).closed == ()


def test_alarm_without_rows_or_diagnosis_still_makes_a_page(store: SqliteStore) -> None:
    document = plant.alarm("gone", {}, summary="", history=[], evidence={})
    store.put("alarm", document["key"], document)
    html = text(render_html(gather(store, plant.site(1))))
    assert "no longer in the site file" in html
    assert "It no longer behaves as its healthy model expects." in html


def test_period_that_is_empty_is_refused(month: tuple[SqliteStore, SiteInfo]) -> None:
    with pytest.raises(ReportError, match="start before the end"):
        gather(*month, start=plant.END, end=plant.END)


def test_unknown_zone_is_refused_with_an_example(store: SqliteStore) -> None:
    with pytest.raises(ReportError, match="Europe/Berlin"):
        gather(store, plant.site(1, zone="Nowhere/Land"))


def test_same_store_gives_the_same_bytes(month: tuple[SqliteStore, SiteInfo], html: str) -> None:
    assert render_html(gather(*month)) == html


def test_json_holds_every_finding_with_units(report: Report) -> None:
    document = json.loads(findings_json(report))
    assert [f["component"] for f in document["findings"]] == ["substation-hx", "radiator-2", "radiator-0", "radiator-1"]
    first = document["findings"][0]
    assert first["since_utc"] == "2025-11-09T10:35:00Z"
    assert first["causes"][0]["likelihood"] == 0.871
    assert first["readings"][0]["unit"] == "degC"
    assert (first["cost_per_day"], first["currency"]) == (14.2, "EUR")
    assert document["unmonitored"][0]["component"] == "radiator-5"


def test_csv_has_a_line_a_finding_and_no_formula(store: SqliteStore, report: Report) -> None:
    lines = list(csv.DictReader(io.StringIO(findings_csv(report))))
    assert [line["state"] for line in lines] == ["raised", "acknowledged", "suppressed by design", "cleared"]
    assert lines[0]["first_check"] == "Compare the primary return temperature with the secondary return."
    document = plant.air("r", checks=["=HYPERLINK(1)"])
    store.put("alarm", document["key"], document)
    line = next(csv.DictReader(io.StringIO(findings_csv(gather(store, plant.site(0))))))
    assert line["first_check"] == "'=HYPERLINK(1)."


def test_pdf_has_the_pages_of_its_sections(month: tuple[SqliteStore, SiteInfo], tmp_path: Path) -> None:
    try:
        import weasyprint
    except (ImportError, OSError) as problem:
        pytest.skip(f"WeasyPrint cannot be loaded: {problem}")
    path = write_report(*month, tmp_path / "out" / "report.html", pdf=tmp_path / "out" / "report.pdf")
    assert path.is_file()
    content = (tmp_path / "out" / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    pages = weasyprint.HTML(string=path.read_text()).render().pages
    sizes = {(round(p.width), round(p.height)) for p in pages}
    assert sizes == {(794, 1123)}  # A4 at 96 dots an inch
    # First page, two findings of one to three pages each, one to three for the rest.
    assert 4 <= len(pages) <= 9
    begins = {name: i for i, p in reversed(list(enumerate(pages))) for name in p.anchors if name.startswith("finding-")}
    assert len(set(begins.values())) == 2, "each finding begins on its own page"


def test_pdf_takes_nothing_from_outside(tmp_path: Path) -> None:
    urls = pytest.importorskip("weasyprint.urls", exc_type=(ImportError, OSError))
    with pytest.raises(urls.FatalURLFetchingError, match="hostname"):
        write_pdf('<img src="file:///etc/hostname"><p>x', tmp_path / "r.pdf")


def test_month_of_twenty_components_takes_seconds(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "store.sqlite")
    info = plant.full(store, radiators=19, days=30)
    begin = time.process_time()
    write_report(store, info, tmp_path / "r.html", start=plant.END - 30 * plant.DAY)
    assert time.process_time() - begin < 5.0


def test_every_alarm_has_a_page_that_its_key_names(tmp_path: Path) -> None:
    from fdd.report.render import write_pages

    store = SqliteStore(tmp_path / "fdd.sqlite")
    info = plant.site()
    plant.fill(store, info, days=10, faults={"substation-hx": {"T_hot_out": 1.0}})
    document = plant.alarm("substation-hx", {"T_hot_out": 1})
    store.put("alarm", document["key"], document)
    written = write_pages(gather(store, info, plant.END - 7 * plant.DAY, plant.END), tmp_path / "reports")
    store.close()
    assert [p.name for p in written] == ["substation-hx@2025-11-11T09:45:00Z.html"]
    text = written[0].read_text(encoding="utf-8")
    assert "Heat exchanger, substation" in text
    assert "Healthy equipment" not in text


def test_no_likelihood_reads_as_impossible_or_certain() -> None:
    from fdd.report.words import likely

    assert [likely(x) for x in (0.0, 0.004, 0.01, 0.5, 0.999)] == ["under 1 %", "under 1 %", "1 %", "50 %", "over 99 %"]


def test_what_an_operator_writes_is_never_touched(store: SqliteStore) -> None:
    said = "supply held at 45 °C by C_hot, rad0.T_return and substation-hx@2025 look odd; not a fault"
    document = plant.fouling()
    document["history"].append({"time": plant.END, "state": "acknowledged", "actor": "anna", "comment": said})
    with store.transaction():
        store.put("alarm", document["key"], document)
    report = gather(store, plant.site(2))
    assert report.findings[0].history[-1].comment == said
    assert said in render_html(report)


def test_a_model_that_no_longer_holds_is_no_finding(store: SqliteStore) -> None:
    info = plant.site(2)
    document = plant.alarm("radiator-1", {}, causes=[{"meaning": "stale", "for": ["it has a memory"]}])
    document["evidence"] = {"kind": "model", "charts": {}}
    with store.transaction():
        plant.fill(store, info, days=8)
        for name in info.components:
            plant.keep_baseline(store, plant.baseline(name, 1, {"H": 10.0}))
        store.put("alarm", document["key"], document)
    report = gather(store, info)
    assert report.findings == ()
    assert [f.component for f in report.models] == ["radiator-1"]
    assert report.status == "All well on 3 monitored components; 1 model needs attention"
    assert "radiator-1" not in [w.component for w in report.healthy]
    page = text(render_html(report))
    assert "The model needs attention Here no fault of the equipment is claimed" in page
    assert "It has a memory." in page
    written = json.loads(findings_json(report))
    assert (len(written["findings"]), [f["kind"] for f in written["models"]]) == (0, ["model"])
    assert [row["kind"] for row in csv.DictReader(io.StringIO(findings_csv(report)))] == ["model"]


def test_what_saves_energy_is_no_cost(store: SqliteStore) -> None:
    document = plant.alarm("radiator-0", {"T_return": 1})
    document["evidence"]["cost_per_day"] = {"value": None, "kWh_per_day": -18.2, "kind": "energy", "basis": "b"}
    store.put("alarm", document["key"], document)
    (found,) = gather(store, plant.site(1)).findings
    assert found.cost == "No extra cost"
    assert found.cost_detail.startswith("18.2 kWh a day less than when healthy")
