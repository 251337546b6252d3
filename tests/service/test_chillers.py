"""A simulated chiller from CSV in American units: declared in a site file, fitted, replayed, and reported on."""

from __future__ import annotations

import html
import json
import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from fdd.chiller_eiv.gate import GateLimits
from fdd.chiller_eiv.simulate import LAB_CHILLER, operate, raw_week
from fdd.evidence import ChartEvidence, ChartKind
from fdd.records import Alarm, AlarmState, Baseline, Batch
from fdd.report.render import write_report
from fdd.report.telling import Speaker
from fdd.service.alarms.book import Command, Ring
from fdd.service.baselines.chiller_fit import FittedChiller, learn_chiller
from fdd.service.baselines.fitting import fit_site, read_span
from fdd.service.baselines.identify import IdentifyError
from fdd.service.baselines.versions import accept, in_force
from fdd.service.daemon.checkpoint import Checkpoint, decode, encode
from fdd.service.daemon.daemon import Daemon
from fdd.service.daemon.ready import ready_engine
from fdd.service.engine.engine import Engine, EngineError, Outputs
from fdd.service.monitoring.chillers import Chillers
from fdd.service.site.errors import UsageError
from fdd.service.site.feed import Feed
from fdd.service.site.naming import site_info, speaker_of
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.check import check_all
from fdd.service.verbs.chiller_study import study_site
from fdd.service.verbs.replay import ReplayResult, replay_site
from fdd.store.opening import open_store
from fdd.store.store import StoreConfig
from tests.service.conftest import Truth, baselines, plan

DAY = 86_400 * 10**9
START = 20_000 * DAY
BASE, DAYS, ONSET = 70, 119, 84
QUIET = Console(quiet=True)

SITE = """
name: Laboratory
step: 15 min
tariffs: {currency: EUR, electricity: 0.2}
store: {kind: sqlite, path: lab.sqlite}
source: {kind: csv, path: data.csv, batch_rows: 1000, time: {column: time}}
points:
  T_cdi: {unit: degF, sensor_sd: 0.09}
  T_chi: {unit: degF, sensor_sd: 0.09}
  T_cho: {unit: degF, sensor_sd: 0.09}
  T_cdo: {unit: degF}
  T_sat: {unit: degF}
  flow: {unit: gpm, fluid: 1000 kg/m3}
  flow_cd: {unit: gpm, fluid: 1000 kg/m3}
  power: {unit: kW}
  enabled: {unit: on/off}
equipment:
  lab:
    title: Laboratory chiller
    location: basement
    model: gordon_ng
    inputs: {T_cdi: T_cdi, T_cdo: T_cdo, T_chi: T_chi, T_cho: T_cho, flow_ch: flow, flow_cd: flow_cd, T_sat_cd: T_sat,
             power: power}
    when: enabled > 0.5
    options:
      rated_load: 10.5e3
      errors: {flow_ch: {relative: 0.005}, power: {relative: 0.002}}
      baseline_days: 70
"""


def write_site(folder: Path, rise: float) -> Path:
    """A site whose heat-exchanger resistance rises by a share on day 84; two days of the record are lost."""

    def fault(day: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        one = np.ones_like(day)
        return one, 1 + rise * (day >= ONSET), 0 * one

    o = operate(DAYS, 4, noise=0.0, fault=fault, first_day=120)
    n = DAYS * 96
    raw = {k: v[::3] for k, v in raw_week(o, 1, samples=DAYS * 288).items()}
    rng = np.random.default_rng(2)
    truth = np.repeat(o.truth, 4, axis=0)
    flow_cd = 0.6 * (1 + 0.005 * rng.standard_normal(n))
    T_cdo = raw["T_cdi"] + (truth[:, 2] + truth[:, 3]) / 4190 / 0.6
    # The whole rise of the resistance is the condenser's.
    resistance = LAB_CHILLER.R * (fault(np.arange(n) / 96)[1] - 0.5)
    T_sat = T_cdo + resistance * truth[:, 2] + 0.05 * rng.standard_normal(n)
    table = pd.DataFrame(
        {
            "time": pd.to_datetime(START + (np.arange(n) + 1) * 900 * 10**9, utc=True).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "T_cdi": 32 + 1.8 * raw["T_cdi"],
            "T_chi": 32 + 1.8 * raw["T_chi"],
            "T_cho": 32 + 1.8 * raw["T_cho"],
            "T_cdo": 32 + 1.8 * T_cdo,
            "T_sat": 32 + 1.8 * T_sat,
            "flow": raw["flow_ch"] / 0.0630901964,
            "flow_cd": flow_cd / 0.0630901964,
            "power": raw["power"] / 1e3,
            "enabled": np.where((np.arange(n) >= 96 * 40) & (np.arange(n) < 96 * 40 + 30), "off", "on"),
        }
    )
    table = table[(np.arange(n) < 96 * 50) | (np.arange(n) >= 96 * 52)]
    folder.mkdir(exist_ok=True)
    table.to_csv(folder / "data.csv", index=False, float_format="%.5f")
    path = folder / "site.yaml"
    path.write_text(SITE)
    return path


def date_of(day: float) -> str:
    return str(pd.Timestamp(START + int(day * DAY), tz="UTC"))


def fitted(path: Path) -> FittedChiller:
    (found,) = fit_site(path, None, since=None, until=date_of(BASE), only=None, html=None, starts=1, console=QUIET)
    assert isinstance(found, FittedChiller)
    return found


@dataclass(frozen=True)
class Lab:
    """A site with a baseline in force, its plan and its whole stream."""

    path: Path
    context: SiteContext
    baseline: FittedChiller
    stream: Batch

    def engine(self) -> Engine:
        return Engine(self.context.plan, {"lab": self.baseline.baseline})


def lab(folder: Path, rise: float) -> Lab:
    path = write_site(folder, rise)
    baseline = fitted(path)
    context = open_site(path)
    feed = Feed(context.site)
    feed.open()
    parts = list(feed.batches())
    feed.close()
    stream = Batch(
        parts[0].names,
        np.concatenate([b.point for b in parts]),
        np.concatenate([b.time for b in parts]),
        np.concatenate([b.value for b in parts]),
        np.concatenate([b.quality for b in parts]),
    )
    assert all(b.names == parts[0].names for b in parts)
    return Lab(path, context, baseline, stream)


@pytest.fixture(scope="module")
def fouled(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return lab(tmp_path_factory.mktemp("fouled"), 0.25)


@pytest.fixture(scope="module")
def well(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return lab(tmp_path_factory.mktemp("well"), 0.0)


def replayed(site: Lab, verdicts: Path | None = None) -> ReplayResult:
    return replay_site(site.path, None, since=None, until=None, verdicts=verdicts, console=QUIET)


@pytest.fixture(scope="module")
def outputs(fouled: Lab) -> Outputs:
    return fouled.engine().step(fouled.stream)


def last_alarm(outputs: Outputs) -> Alarm:
    return outputs.alarms[-1]


def test_the_fit_finds_the_machine_behind_the_units(fouled: Lab) -> None:
    b = fouled.baseline.baseline
    assert b.parameters["R"] == pytest.approx(LAB_CHILLER.R, rel=0.05)
    assert b.parameters["dS"] == pytest.approx(LAB_CHILLER.dS, rel=0.05)
    assert b.diagnostics["reasons"] == [] or b.diagnostics["level"] != "all parameters"
    assert "lab: " in fouled.baseline.summary()
    assert "machine off" in fouled.baseline.summary()


def test_the_baseline_is_plain_json(fouled: Lab) -> None:
    b = fouled.baseline.baseline
    assert json.loads(json.dumps(b.diagnostics)) == b.diagnostics


def test_a_healthy_machine_raises_no_alarm(well: Lab) -> None:
    result = replayed(well)
    assert result.watched == ["lab"]
    assert result.alarms == {}
    assert result.notes == []


def test_a_fouled_condenser_is_one_alarm_rightly_named(fouled: Lab) -> None:
    result = replayed(fouled)
    (alarm,) = result.alarms.values()
    assert alarm.component == "lab"
    assert START + ONSET * DAY < alarm.raised <= START + (ONSET + 3) * DAY
    assert abs(alarm.since - (START + ONSET * DAY)) <= 2 * DAY
    summary = result.speaker.summary(alarm)
    assert summary.startswith("lab: condenser")
    assert "condenser approach up" in summary
    assert "heat-exchanger resistance up 2" in summary
    assert alarm.causes[0].name in ("condenser fouling", "condenser side")
    assert alarm.causes[0].likelihood > 0.8
    assert any("brush the tubes" in result.speaker.say(c, "lab") for c in alarm.checks)
    assert {"lab/all:cluster", "lab/R:weekly"} <= set(alarm.charts)
    cost = alarm.document()["evidence"]["cost_per_day"]
    assert cost["lower"] < cost["value"] < cost["upper"]
    assert cost["currency"] == "EUR"
    # The same form as every other equipment's.
    assert set(cost) >= {"value", "lower", "upper", "currency", "kWh_per_day", "kind", "basis", "why"}
    # Fouled by a quarter: as severe as any parameter that moved so far, give or take what it costs.
    assert alarm.severity in ("medium", "high")


def test_verdicts_of_a_chiller_are_written_like_any_other(fouled: Lab, tmp_path: Path) -> None:
    replayed(fouled, tmp_path / "verdicts.jsonl")
    lines = [json.loads(line) for line in (tmp_path / "verdicts.jsonl").read_text().splitlines()]
    phases = {line["phase"] for line in lines if line.get("chart") == "lab/R:weekly"}
    assert phases == {"quiet", "alarm"}


def cells(outputs: list[Outputs]) -> tuple[list[tuple[object, ...]], str]:
    """Everything that outputs say, whatever batches they came in."""
    found = []
    for rows in (r for o in outputs for r in o.rows if r.measurement != "samples"):
        for i in range(len(rows)):
            values = tuple(sorted((k, float(v[i]).hex()) for k, v in rows.fields.items()))
            found.append((rows.measurement, int(rows.time[i]), rows.names[rows.series[i]], values))
    return sorted(found), json.dumps([a.document() for o in outputs for a in o.alarms])


def test_verdicts_are_the_same_in_any_batches_and_across_restarts(fouled: Lab, outputs: Outputs) -> None:
    cuts = np.sort(np.random.default_rng(7).integers(0, len(fouled.stream), 12)).tolist()
    engine, got = fouled.engine(), []
    for start, stop in pairwise([0, *cuts, len(fouled.stream)]):
        got.append(engine.step(fouled.stream.slice(start, stop)))
        again = fouled.engine()
        again.restore_state(decode(encode(engine.export_state())))
        engine = again
    assert cells(got) == cells([outputs])


def test_an_alarm_stands_until_it_is_cleared_and_rings_again(fouled: Lab) -> None:
    engine = fouled.engine()
    at = int(np.searchsorted(fouled.stream.time, START + (ONSET + 14) * DAY))
    engine.step(fouled.stream.slice(0, at))
    (alarm,) = engine.alarms.open
    cleared = engine.command(Command(alarm.key, "clear", "anna", alarm.raised))
    assert cleared.alarms[0].state is AlarmState.CLEARED
    assert engine.alarms.open == ()
    again = engine.step(fouled.stream.slice(at, len(fouled.stream)))
    assert again.alarms[0].key != alarm.key
    assert again.alarms[0].raised > alarm.raised


def test_absurd_readings_cost_their_own_day_only(fouled: Lab, outputs: Outputs) -> None:
    stream = fouled.stream
    value = stream.value.copy()
    power = stream.point == stream.names.index("power")
    day = (stream.time > START + 10 * DAY) & (stream.time <= START + 11 * DAY) & power
    value[day] = np.where(np.arange(day.sum()) % 2, 1e308, -1e308)
    engine = fouled.engine()
    got = engine.step(replace(stream, value=value))
    assert got.frames == outputs.frames
    assert "condenser approach up" in Speaker().line(last_alarm(got))


def test_a_chiller_that_fails_is_counted_and_the_others_do_not_notice(fouled: Lab, outputs: Outputs) -> None:
    chiller = fouled.context.plan.chillers[0]
    # Nothing in a site file can make a chiller fail; a price that is no number, past every check, does.
    broken = replace(chiller, name="broken", config=replace(chiller.config, name="broken", price="none"))
    pair = replace(fouled.context.plan, chillers=(broken, chiller))
    own = fouled.baseline.baseline
    engine = Engine(pair, {"lab": own, "broken": replace(own, component="broken")})
    got = engine.step(fouled.stream)
    assert got.frames == outputs.frames
    assert last_alarm(got) == last_alarm(outputs)
    ((what, times),) = [(k, n) for k, n in engine.counts.items() if k.startswith("chiller failed: broken")]
    assert times >= 1
    assert len(engine.notes) == 1
    assert engine.notes[0].startswith("broken: ")
    assert what in engine.counts


def test_the_stores_dashboards_find_parameters_gate_and_power(outputs: Outputs) -> None:
    names = {(r.measurement, n) for r in outputs.rows for n in r.names}
    for expected in (
        ("parameters", "lab/dS"),
        ("parameters", "lab/Q_leak"),
        ("parameters", "lab/R"),
        ("gates", "lab/steady"),
        ("predictions", "lab/power"),
        ("charts", "lab/all:cluster"),
    ):
        assert expected in names


def test_a_new_baseline_starts_the_charts_afresh(fouled: Lab) -> None:
    engine, own = fouled.engine(), fouled.baseline.baseline
    at = int(np.searchsorted(fouled.stream.time, START + (ONSET + 14) * DAY))
    engine.step(fouled.stream.slice(0, at))
    state = engine.export_state()["chillers"]
    same, other = (Chillers(fouled.context.plan, {"lab": b}) for b in (own, replace(own, version=2)))
    same.restore_state(state)
    other.restore_state(state)
    assert not same.is_normal("lab")
    assert other.is_normal("lab")


def test_the_state_of_a_site_without_the_chiller_is_refused(fouled: Lab) -> None:
    with pytest.raises(EngineError, match="start afresh"):
        Engine(fouled.context.plan, {}).restore_state(fouled.engine().export_state())


def test_a_baseline_that_does_not_fit_the_declaration_is_refused(fouled: Lab) -> None:
    b: Baseline = fouled.baseline.baseline
    with pytest.raises(UsageError, match="fdd fit SITE DATA --only lab"):
        Engine(fouled.context.plan, {"lab": replace(b, diagnostics={})})


def test_check_counts_what_became_of_the_samples(fouled: Lab) -> None:
    result = check_all(fouled.path, fouled.path.parent / "data.csv")
    assert result.findings == []
    (row,) = result.components
    assert row["equipment"] == "lab"
    assert row["steady points"] > 1000
    assert row["rejected"]["machine off"] == 30


def test_the_study_says_the_same_and_writes_its_page(fouled: Lab, tmp_path: Path) -> None:
    page = tmp_path / "pages" / "lab.html"
    (study,) = study_site(fouled.path, None, since=None, until=date_of(BASE), only=None, html=page, console=QUIET)
    told = study.document()
    assert told["finding"]["cause"] in ("condenser fouling", "condenser side")
    assert told["watched"]["judged"] > 0.8
    assert set(told["estimates"]) >= {"ols", "cls", "capped", "tls"}
    low, high = told["estimates"]["capped"]["intervals"]["R"]
    assert low < LAB_CHILLER.R < high
    assert "<svg" in page.read_text()
    console = Console(record=True, width=200)
    study.print(console)
    text = console.export_text()
    assert "K/kW" in text
    assert "steady points" in text
    with pytest.raises(UsageError, match="there are lab"):
        study_site(fouled.path, None, since=None, until=None, only=["lob"], html=None, console=QUIET)


def run_daemon(site: Lab, state: Path, batches: int | None = None) -> None:
    """Run the site's own file through the daemon, stopping dead after some batches."""
    store, checkpoint, feed = site.context.store(), Checkpoint(state), Feed(site.context.site)
    daemon = Daemon(ready_engine(site.context), store, checkpoint, save_every=500)
    if batches is not None:
        left = iter(range(batches))
        daemon._watch = lambda _: feed.stop() if next(left, None) is None else None
    feed.open(daemon.recover() or None)
    daemon.run(feed)
    if batches is None:
        daemon.finish()
    feed.close()
    store.close()
    checkpoint.close()


def test_the_daemon_and_the_replay_say_the_same_and_the_report_tells_it(fouled: Lab, tmp_path: Path) -> None:
    run_daemon(fouled, tmp_path / "state.sqlite", batches=2)
    run_daemon(fouled, tmp_path / "state.sqlite")
    (told,) = replayed(fouled).alarms.values()
    store = fouled.context.store(read_only=True)
    (kept,) = store.list("alarm")
    assert kept == speaker_of(fouled.context.plan, fouled.context.site).stored(told)
    page = write_report(
        store, site_info(fouled.context.plan, fouled.context.site), tmp_path / "report.html"
    ).read_text()
    store.close()
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", page)))
    for words in (
        "eat-exchanger resistance up 2",
        "Laboratory chiller: the machine's own physics",
        "Internal entropy production",
        "condenser approach up",
        "of the expected power (median",
        "steady points in this period",
        "Weekly drift chart (CUSUM) of heat-exchanger resistance over its limit",
        "kWh a day more than the healthy machine",
        "open and brush the tubes where it is high. Expected reading: 1 to 3 K when clean.",
        "Chart of steady states",
    ):
        assert words in text, words


def test_what_cannot_be_identified_is_said_with_its_reason_and_its_power_is_watched(
    fouled: Lab, tmp_path: Path
) -> None:
    whole, site = fouled.context.plan, site_info(fouled.context.plan, fouled.context.site)
    # Two weeks of healthy data under a gate that wants 30 days.
    strict = replace(whole.chillers[0], config=replace(whole.chillers[0].config, gate=GateLimits(days=30)))
    short_plan = replace(whole, chillers=(strict,))
    short = learn_chiller(short_plan, strict, read_span(fouled.context, None, date_of(14)))
    assert short.baseline.diagnostics["level"] == "power residual only"
    assert any("14 days of baseline" in w for w in short.warnings)
    store = open_store(StoreConfig.of({"kind": "sqlite", "path": tmp_path / "short.sqlite", "site": "short"}))
    accept(store, short.baseline)
    got = Engine(short_plan, in_force(store, ["lab"])).step(fouled.stream.between(None, START + 30 * DAY))
    assert got.alarms == []
    assert {n for r in got.rows for n in r.names if r.measurement == "charts"} == {"lab/all:cluster"}
    assert not any(r.measurement == "parameters" for r in got.rows)
    store.write(got.rows)
    page = write_report(store, site, tmp_path / "report.html").read_text()
    store.close()
    assert "Its parameters cannot be identified" in page
    assert "30 are needed" in page or "30 needed" in page


def test_a_history_without_steady_points_has_no_baseline(fouled: Lab) -> None:
    context = fouled.context
    history = read_span(context, None, date_of(0.02))
    with pytest.raises(IdentifyError, match="lab"):
        learn_chiller(context.plan, context.plan.chillers[0], history)


LABORATORY = """
name: Test stand
step: 1 min
store: {kind: sqlite, path: stand.sqlite}
source: {kind: csv, path: normal.csv, time: {column: time}}
points:
  T_chi: {unit: degC, sensor_sd: 0.05}
  T_cho: {unit: degC, sensor_sd: 0.05}
  T_cdi: {unit: degC, sensor_sd: 0.05}
  T_cdo: {unit: degC, sensor_sd: 0.05}
  flow_ch: {unit: kg/s}
  flow_cd: {unit: kg/s}
  power: {unit: W}
equipment:
  stand:
    model: gordon_ng
    inputs: {T_chi: T_chi, T_cho: T_cho, T_cdi: T_cdi, T_cdo: T_cdo, flow_ch: flow_ch, flow_cd: flow_cd, power: power}
    options: {rated_load: 1.0e6, errors: {flow_ch: {relative: 0.01}, power: {relative: 0.01}}}
"""


def test_one_day_on_a_test_stand_is_learned_and_flow_faults_are_named_the_next_week(tmp_path: Path) -> None:
    """The usual seven points, twenty states of half an hour; the default options of a stranger's first site file."""
    pytest.importorskip("CoolProp", reason="the simulated chiller needs the extra 'fluids'")
    from fdd.plant.chiller_cycle import Fault
    from fdd.plant.chiller_operation import REFRIGERANT, conditions, readings, record, running_machine, sensors

    rng = np.random.default_rng(5)
    machine = running_machine(rng)
    (tmp_path / "site.yaml").write_text(LABORATORY)
    cases = {"normal": None, "again": None, "low": Fault(flow_cd=-0.1), "chilled": Fault(flow_ch=-0.1)}
    for week, (name, fault) in enumerate(cases.items()):
        raw = record(readings(machine, conditions(rng, 24), sensors(rng), rng, fault), rng, hold=22, rise=10)
        time = pd.Timestamp("2024-01-01", tz="UTC") + pd.to_timedelta(
            7 * 1440 * week + np.arange(len(raw["power"])), "min"
        )
        kept = {k: v for k, v in raw.items() if k not in REFRIGERANT}
        table = pd.DataFrame({"time": time.strftime("%Y-%m-%dT%H:%M:%SZ"), **kept})
        table.to_csv(tmp_path / f"{name}.csv", index=False, float_format="%.5g")
    path = tmp_path / "site.yaml"
    (found,) = fit_site(path, None, since=None, until=None, only=None, html=None, starts=1, console=QUIET)
    assert "kW per ton" in found.summary()
    told = {}
    for name in ("again", "low", "chilled"):
        data = tmp_path / f"{name}.csv"
        result = replay_site(path, data, since=None, until=None, verdicts=None, console=QUIET)
        told[name] = list(result.alarms.values())
    assert told["again"] == []
    for name, cause in (("low", "low condenser flow"), ("chilled", "low chilled-water flow")):
        (alarm,) = told[name]
        assert {c.name: c.likelihood for c in alarm.causes}[cause] >= 0.7
        assert alarm.raised - alarm.since <= 5 * 32 * 60 * 10**9


def test_filters_do_not_notice_a_chiller_beside_them(fouled: Lab, healthy: Truth) -> None:
    alone = plan()
    chiller = fouled.context.plan.chillers[0]
    points = (*alone.points, *fouled.context.plan.points)
    both = replace(alone, points=points, chillers=(replace(chiller, when=None),))
    beside = Engine(both, {**baselines(), "lab": fouled.baseline.baseline})
    assert [w.name for w in beside.watched] == ["south", "north", "lab"]
    got = beside.step(healthy.batch())
    assert beside.counts.get("chiller failed: lab (ValueError)") is None
    expected = Engine(alone, baselines()).step(healthy.batch())
    own = [c for c in cells([got])[0] if not str(c[2]).startswith("lab/")]
    assert own == cells([expected])[0]
    assert {c[2] for c in cells([got])[0] if str(c[2]).startswith("lab/")} >= {"lab/steady"}


def test_a_chiller_has_its_place_in_the_plant(fouled: Lab, tmp_path: Path) -> None:
    """What it cools names it as upstream: its alarm explains theirs, and a tower's before it explains its own."""
    cooled = """
  hall:
    model: zone
    inputs: {T_out: T_cdi, I_solar: enabled, P_heat: power}
    outputs: {T_room: T_chi}
    upstream: [lab]
"""
    path = tmp_path / "site.yaml"
    path.write_text(SITE.replace("  enabled: {unit: on/off}", "  enabled: {unit: W/m2}").replace(
        "    when: enabled > 0.5\n", "    upstream: [tower]\n"
    ) + cooled + cooled.replace("hall", "tower").replace("[lab]", "[]"))  # fmt: skip
    context = open_site(path)
    place = {c.name: c.upstream for c in context.plan.watched}
    assert place == {"hall": {"lab"}, "tower": set(), "lab": {"tower"}}
    book = Engine(context.plan, {}).alarms
    (rung,) = [a for a in replayed(fouled).alarms.values() if a.component == "lab"]
    ring = Ring("hall", "hall/T_room:cusum", None, rung.raised, ChartEvidence("T_room", ChartKind.CUSUM, 9.0))
    chiller = Ring("lab", rung.charts[0], None, rung.raised, rung.evidence.charts[rung.charts[0]])
    states = {a.component: a.state for a in [*book.ring(rung.raised, [ring]), *book.ring(rung.raised + DAY, [chiller])]}
    assert states == {"hall": AlarmState.SUPPRESSED, "lab": AlarmState.RAISED}
    tower = Ring("tower", "tower/T_room:cusum", None, rung.raised, ChartEvidence("T_room", ChartKind.CUSUM, 9.0))
    book.ring(rung.raised + 2 * DAY, [tower])
    assert {a.component: a.state for a in book.open} == {
        "tower": AlarmState.RAISED, "lab": AlarmState.SUPPRESSED, "hall": AlarmState.SUPPRESSED
    }  # fmt: skip


def test_the_real_chiller_is_not_identifiable(shared_data: Path) -> None:
    site = Path(__file__).resolve().parents[2] / "docs" / "studies" / "real-chiller.yaml"
    data = shared_data / "esb_chiller1_raw_5min.csv.gz"
    (found,) = study_site(site, data, since=None, until=None, only=None, html=None, console=QUIET)
    told = found.document()
    assert sum(told["samples"].values()) == 12798
    assert told["gate"]["level"] == "power residual only"
    assert "not identifiable, because" in told["verdict"]
    assert "independent ones" in told["verdict"]
    assert told["finding"] is None
