"""The study and the online monitor on a simulated machine whose condenser fouls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fdd.chiller_eiv.baseline import ChillerBaseline
from fdd.chiller_eiv.checks import check_balance, diagnose
from fdd.chiller_eiv.config import ChillerConfig, config_of_table
from fdd.chiller_eiv.cost import extra_cost
from fdd.chiller_eiv.drift import Isolation
from fdd.chiller_eiv.errors import Instrumentation, SensorError
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.online import ChillerMonitor, ChillerOutputs
from fdd.chiller_eiv.rows import output_rows
from fdd.chiller_eiv.simulate import LAB_CHILLER, operate, raw_week
from fdd.chiller_eiv.study import ChillerData, StudyResult, study
from fdd.chiller_eiv.study_report import write_html
from fdd.chiller_eiv.vector import DAY
from fdd.records import Rows

PERIOD = 900 * 10**9
BASE, DAYS = 70, 126
START = 20_000 * DAY


def fouling(day: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    one = np.ones_like(day)
    return one, 1 + 0.25 * (day >= 84), 0 * one


@pytest.fixture(scope="module")
def data() -> ChillerData:
    """A quarter-hourly record, two days of it lost and nights off in one week."""
    o = operate(DAYS, 4, noise=0.0, fault=fouling, first_day=120)
    n = DAYS * 96
    raw = {k: v[::3] for k, v in raw_week(o, 1, samples=DAYS * 288).items()}
    rng = np.random.default_rng(2)
    truth = np.repeat(o.truth, 4, axis=0)
    raw["flow_cd"] = 0.6 * (1 + 0.005 * rng.standard_normal(n))
    raw["T_cdo"] = raw["T_cdi"] + (truth[:, 2] + truth[:, 3]) / 4190 / 0.6
    # The whole rise of the resistance is the condenser's.
    resistance = LAB_CHILLER.R * (fouling(np.arange(n) / 96)[1] - 0.5)
    raw["T_sat_cd"] = raw["T_cdo"] + resistance * truth[:, 2] + 0.05 * rng.standard_normal(n)
    raw["power"][96 * 40 : 96 * 40 + 30] = 0.0
    time = START + np.arange(n, dtype=np.int64) * PERIOD
    keep = (np.arange(n) < 96 * 50) | (np.arange(n) >= 96 * 52)
    return ChillerData(time[keep], {k: v[keep] for k, v in raw.items()})


CONFIG = ChillerConfig(
    "lab",
    10.5e3,
    Instrumentation(
        {
            "T_cdi": SensorError(0.05),
            "T_chi": SensorError(0.05),
            "T_cho": SensorError(0.05),
            "flow_ch": SensorError(relative=0.005),
            "power": SensorError(relative=0.002),
        }
    ),
    baseline_days=BASE,
    price=0.2,
    currency="EUR",
)


@pytest.fixture(scope="module")
def result(data: ChillerData) -> StudyResult:
    return study(data, CONFIG)


def replay(data: ChillerData, monitor: ChillerMonitor, first: int, last: int) -> list[ChillerOutputs]:
    out: list[ChillerOutputs] = []
    for i in range(first, last):
        out += monitor.update(int(data.time[i]), {k: float(v[i]) for k, v in data.raw.items()})
    return out


@pytest.fixture(scope="module")
def outputs(data: ChillerData, result: StudyResult) -> list[ChillerOutputs]:
    monitor = ChillerMonitor(CONFIG, result.baseline)
    return [*replay(data, monitor, 0, len(data.time)), *monitor.finish()]


def test_the_study_finds_the_fouled_condenser(result: StudyResult) -> None:
    assert result.finding is not None
    assert result.finding.cause in ("condenser fouling", "condenser side")
    assert "condenser approach up" in result.finding.sentence
    assert "heat-exchanger resistance up 2" in result.finding.sentence
    assert result.cost is not None
    assert result.cost.energy_day > 3 * result.cost.energy_day_se > 0
    assert result.judged > 0.8
    truth = LAB_CHILLER.R
    assert result.decision.fit.values()["R"] == pytest.approx(truth, rel=0.05)


def test_the_study_is_quiet_before_the_fault(result: StudyResult) -> None:
    onset = START + 84 * DAY
    assert not any(v.alarm for v in (*result.states, *result.weekly) if v.time <= onset)


def test_the_page_holds_everything_and_loads_nothing(result: StudyResult, tmp_path: Path) -> None:
    text = write_html(result, tmp_path / "study.html").read_text()
    for word in ("capped", "orthogonal", "temperature not steady", "Weekly charts", "kWh a day", "<svg"):
        assert word in text
    assert "<script" not in text
    assert 'src="http' not in text


def test_online_finds_the_same_as_the_study(outputs: list[ChillerOutputs], result: StudyResult) -> None:
    findings = [o.finding for o in outputs if o.finding is not None]
    assert result.finding is not None
    assert findings[-1].cause == result.finding.cause
    onset = START + 84 * DAY
    assert not any(o.alarm for o in outputs if START + BASE * DAY < o.time <= onset)
    first = next(o for o in outputs if o.alarm and o.time > onset)
    assert first.time <= onset + 3 * DAY
    assert first.since is not None
    assert abs(first.since - onset) <= 2 * DAY
    assert any(o.cost is not None and o.cost.money_day > 0 for o in outputs)


def test_online_is_the_same_after_a_restart_in_the_middle_of_a_day(
    data: ChillerData, result: StudyResult, outputs: list[ChillerOutputs]
) -> None:
    cuts = (96 * 30 + 17, 96 * 90 + 50)
    monitor, out, first = ChillerMonitor(CONFIG, result.baseline), [], 0
    for cut in (*cuts, len(data.time)):
        out += replay(data, monitor, first, cut)
        state = monitor.export_state()
        monitor = ChillerMonitor(CONFIG, result.baseline)
        monitor.restore_state(state)
        first = cut
    out += monitor.finish()
    assert len(out) == len(outputs)
    for a, b in zip(out, outputs, strict=True):
        assert a.time == b.time
        assert [v.statistic for v in a.states] == [v.statistic for v in b.states]
        assert a.finding == b.finding
        assert a.since == b.since
        assert a.cost == b.cost


def test_online_counts_every_sample(data: ChillerData, outputs: list[ChillerOutputs]) -> None:
    told = sum(sum(o.rejected.values()) for o in outputs)
    assert len(data.time) - 3 < told <= len(data.time)  # an unfinished window may still be held
    assert outputs[-1].seen == len(data.time)


def test_online_refuses_time_that_goes_back(result: StudyResult) -> None:
    monitor = ChillerMonitor(CONFIG, result.baseline)
    monitor.update(10, {"power": 1.0})
    with pytest.raises(ChillerError, match="order samples"):
        monitor.update(10, {"power": 1.0})


def test_a_baseline_survives_export(result: StudyResult) -> None:
    state = result.baseline.export_state()
    again = ChillerBaseline.of_state(state, CONFIG)
    assert again.vector.layout == result.baseline.vector.layout
    assert again.steady == result.baseline.steady
    np.testing.assert_array_equal(again.vector.coefficients, result.baseline.vector.coefficients)
    assert again.drift is not None
    assert result.baseline.drift is not None
    np.testing.assert_array_equal(again.drift.estimate, result.baseline.drift.estimate)
    with pytest.raises(ChillerError, match="schema"):
        ChillerBaseline.of_state({**state, "schema": 1}, CONFIG)


def test_a_low_flow_reading_is_named_before_fouling() -> None:
    rng = np.random.default_rng(0)
    before, now = 0.01 * rng.standard_normal(200), 0.04 + 0.01 * rng.standard_normal(50)
    isolation = Isolation("R", "heat-exchanger resistance", 0.99, 0.11, 0.08, 0.14, {}, 4)
    finding = diagnose(isolation, "2025-03-03", check_balance(before, now))
    assert finding.cause == "sensor"
    assert "evaporator flow" in finding.sentence
    unchecked = diagnose(isolation, "2025-03-03", check_balance(before, np.zeros(0)))
    assert unchecked.sentence.endswith("check flow meter first")
    assert unchecked.checks[0] == "flow meter"
    clean = diagnose(isolation, "2025-03-03", check_balance(before, now - 0.04))
    assert "up 11 % (8 to 14 %) since 2025-03-03" in clean.sentence


def test_a_parameter_that_went_down_is_no_fault_of_the_machine() -> None:
    down = Isolation("R", "heat-exchanger resistance", 0.99, -0.11, -0.14, -0.08, {}, 4)
    finding = diagnose(down, "2025-03-03", check_balance(np.zeros(0), np.zeros(0)))
    assert "down 11 % (8 to 14 %)" in finding.sentence
    assert finding.cause == "better than when it was learned"
    assert not any("fouling" in c for c in finding.checks)


def test_cost_is_extra_power_times_running_hours() -> None:
    expected = np.full(30, 1500.0)
    c = extra_cost(expected + 100.0, expected, hours_a_day=10.0, price=0.25)
    assert c.energy_day == pytest.approx(1.0)
    assert c.money_day == pytest.approx(0.25)
    with pytest.raises(ChillerError, match="between 0 and 24"):
        extra_cost(expected, expected, hours_a_day=25.0)


def test_config_says_what_must_be_measured() -> None:
    assert CONFIG.quantities() == ("T_cdi", "T_chi", "T_cho", "flow_ch", "power")
    with pytest.raises(ChillerError, match="nominal_flow_cd"):
        ChillerConfig("a", 1e6, CONFIG.instruments, condenser_flow="measured")
    with pytest.raises(ChillerError, match="rated_load"):
        ChillerConfig("a", 0.0, CONFIG.instruments)


def test_online_expects_the_power_of_each_point(outputs: list[ChillerOutputs]) -> None:
    healthy = [o for o in outputs if len(o.points) and o.time < START + 84 * DAY]
    ratio = np.concatenate([o.points.raw["power"] / o.expected for o in healthy])
    assert np.isfinite(ratio).mean() > 0.9
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.005)


def test_rows_fit_the_stores_schema(data: ChillerData, result: StudyResult) -> None:
    monitor = ChillerMonitor(CONFIG, result.baseline)
    rows: list[Rows] = []
    for o in replay(data, monitor, 0, len(data.time)):
        rows += output_rows(monitor, o)
    seen = {r.measurement for r in rows}
    assert seen == {"gates", "charts", "parameters", "predictions"}
    keys = [(r.measurement, r.names[0], int(t)) for r in rows for t in r.time]
    assert len(set(keys)) == len(keys)
    names = {r.names[0] for r in rows}
    assert {"lab/steady", "lab/power", "lab/all:cluster", "lab/R:weekly", "lab/R"} <= names
    for r in rows:
        assert all(len(v) == len(r) for v in r.fields.values())
    last = [r for r in rows if r.names == ("lab/R",)][-1]
    assert last.fields["lower"][0] < last.fields["value"][0] < last.fields["upper"][0]
    assert last.fields["value"][0] == pytest.approx(1.25 * LAB_CHILLER.R, rel=0.05)


def test_every_verdict_in_alarm_has_words(outputs: list[ChillerOutputs]) -> None:
    alarmed = [o for o in outputs if o.alarm and (o.states or o.weekly is not None)]
    assert alarmed
    assert all(o.finding is not None for o in alarmed)


def test_a_table_of_plain_values_gives_the_same_declaration() -> None:
    table = {
        "rated_load": 10.5e3,
        "errors": {
            "T_cdi": {"random": 0.05},
            "T_chi": {"random": 0.05},
            "T_cho": {"random": 0.05},
            "flow_ch": {"relative": 0.005},
            "power": {"relative": 0.002},
        },
        "baseline_days": BASE,
        "price": 0.2,
        "currency": "EUR",
    }
    assert config_of_table("lab", table) == CONFIG
    more = config_of_table(
        "lab",
        {**table, "leak": 2700.0, "priors": {"R": {"lower": 0.0}}, "drift": {"false_alarms": 0.3}, "auxiliary": 200.0},
    )
    assert more.priors["R"].lower == 0.0
    assert more.drift.false_alarms == 0.3
    assert more.instruments.auxiliary == 200.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rated_laod": 1.0}, "did you mean 'rated_load'"),
        ({"steady": {"windw": 1.0}}, "did you mean 'window'"),
        ({"errors": {"T_cdi": {"sigma": 0.1}}}, "unknown key 'sigma'"),
        ({"errors": {"T_condenser": {"random": 0.1}}}, "unknown chiller quantity"),
    ],
)
def test_a_wrong_table_is_refused_with_a_suggestion(change: dict[str, object], words: str) -> None:
    with pytest.raises(ChillerError, match=words):
        config_of_table("lab", {"rated_load": 1e4, "errors": {}, **change})


def test_a_table_without_rated_load_is_refused() -> None:
    with pytest.raises(ChillerError, match="lacks 'rated_load'"):
        config_of_table("lab", {"errors": {}})
