"""Equipment watched by rows inside the engine: from the first day, by any batches, one finding a place."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fdd.config import check_site, parse_site
from fdd.diagnosis.equipment import Knowledge
from fdd.evidence import Message, check
from fdd.models.expectation import Day
from fdd.records import NANOSECONDS, Alarm, AlarmState, Batch, Sample
from fdd.report.telling import Speaker
from fdd.service.baselines.fitting import fit_site
from fdd.service.daemon.checkpoint import decode, encode
from fdd.service.engine.engine import Engine, Outputs
from fdd.service.site.plan import Plan, plan_of
from fdd.service.verbs.replay import replay_site
from tests.diagnosis.air_days import STEP, Plant, air_day

DAY = 86400
START = 20_000 * DAY  # a midnight in UTC
ROLES = ("T_supply", "T_supply_set", "T_mixed", "T_return", "T_out", "fan", "damper", "cool", "heat")
UNITS = {"fan": "1", "damper": "1", "cool": "1", "heat": "1"}
SITE = "name: house\nstep: 5 min\nlateness: 0 s\nfalse_alarms_per_year: 2\npoints:\n"
SITE += "".join(f"  ahu.{r}: {{unit: '{UNITS.get(r, 'degC')}'}}\n" for r in ROLES)
SITE += "equipment:\n  ahu:\n    model: air_handler\n    inputs: {" + ", ".join(f"{r}: ahu.{r}" for r in ROLES) + "}\n"

LEAK, DAMPER, FINE = Plant(heat_leak=0.3), Plant(damper=1.0), Plant()
QUIET = Console(quiet=True)


def plan() -> Plan:
    return plan_of(parse_site(SITE))


def batch(days: list[tuple[Plant, float]]) -> Batch:
    """Days one after the other, every point at every step."""
    samples = []
    for number, (plant, outside) in enumerate(days):
        day = air_day(plant, outside, seed=number)
        samples += [
            Sample(f"ahu.{role}", int(START + number * DAY + t) * NANOSECONDS, float(day[role][k]))
            for k, t in enumerate(day.time.tolist())
            for role in ROLES
        ]
    return Batch.of(samples)


def told(outputs: list[Outputs]) -> str:
    """Verdicts and alarms as text, whatever batches they came in."""
    charts = [
        (r.names[s], int(t), float(x), int(p))
        for o in outputs
        for r in o.rows
        if r.measurement == "charts"
        for s, t, x, p in zip(r.series, r.time, r.fields["statistic"], r.fields["phase"], strict=True)
    ]
    return json.dumps([charts, [a.document() for o in outputs for a in o.alarms]])


def last(outputs: list[Outputs]) -> dict[str, Alarm]:
    return {a.key: a for o in outputs for a in o.alarms}


def test_a_leak_is_found_on_the_first_day_without_any_baseline() -> None:
    engine = Engine(plan(), {})
    assert [w.name for w in engine.watched] == ["ahu"]
    got = [engine.step(batch([(LEAK, 14.0)])), engine.flush()]
    (alarm,) = last(got).values()
    assert alarm.raised < (START + DAY) * NANOSECONDS
    assert alarm.causes[0].name.startswith("heating valve")
    assert alarm.evidence.notes["watched_by"] == Message.of("rows_declared")
    assert alarm.checks


def test_healthy_days_of_all_seasons_are_quiet_and_every_test_is_told() -> None:
    engine = Engine(plan(), {})
    got = [engine.step(batch([(FINE, t) for t in (-10.0, 0.0, 8.0, 14.0, 20.0, 30.0)])), engine.flush()]
    assert last(got) == {}
    assert {n for o in got for r in o.rows if r.measurement == "charts" for n in r.names} >= {
        "ahu/air over shut coils +",
        "ahu/steady readings",
    }


@pytest.mark.parametrize("cuts", [[100], [7, 2500, 2600], list(range(300, 7500, 300))])
def test_verdicts_are_the_same_bytes_in_any_batches_and_across_restarts(cuts: list[int]) -> None:
    whole = batch([(LEAK, 14.0), (FINE, 10.0), (DAMPER, -8.0)])
    engine = Engine(plan(), {})
    once = [engine.step(whole), engine.flush()]
    engine, many = Engine(plan(), {}), []
    edges = [0, *cuts, len(whole)]
    for a, b in pairwise(edges):
        many.append(engine.step(_part(whole, a, b)))
        state = decode(encode(engine.export_state()))
        engine = Engine(plan(), {})
        engine.restore_state(state)
    many.append(engine.flush())
    assert told(many) == told(once)


def _part(whole: Batch, a: int, b: int) -> Batch:
    fields = {f: getattr(whole, f) for f in whole.__dataclass_fields__}
    return replace(whole, **{f: v[a:b] for f, v in fields.items() if isinstance(v, np.ndarray)})


def test_a_new_cause_is_a_new_finding_and_one_that_stands_hides_none() -> None:
    engine = Engine(plan(), {})
    got = [engine.step(batch([(LEAK, 14.0), (DAMPER, -8.0), (LEAK, 14.0), (FINE, 12.0), (FINE, 9.0)])), engine.flush()]
    kinds = {a.evidence.place: a for a in last(got).values()}
    assert set(kinds) == {"heating-valve", "outdoor-air-damper"}
    assert kinds["outdoor-air-damper"].raised < (START + 2 * DAY) * NANOSECONDS
    # Two leaking days are one finding; what no day shows any more has returned to normal.
    assert len(last(got)) == 2
    assert {a.state for a in kinds.values()} == {AlarmState.RETURNED}


def test_equipment_that_fails_is_counted_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("a day that nobody thought of")

    monkeypatch.setattr("fdd.service.monitoring.row_monitors.judge_day", fails)
    engine = Engine(plan(), {})
    engine.step(batch([(LEAK, 14.0)]))
    engine.flush()
    assert engine.counts["equipment failed: ahu (ZeroDivisionError)"] == 1
    assert engine.notes == ["ahu: a day that nobody thought of"]


def test_a_stranger_fits_normal_days_and_replays_a_faulty_one(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(SITE.replace("T_mixed: ahu.T_mixed", "Mixed_Air_Temperature_Sensor: ahu.T_mixed"))

    def file(name: str, days: list[Day]) -> Path:
        lines = ["time," + ",".join(f"ahu.{r}" for r in ROLES)]
        for number, day in enumerate(days):
            for k, t in enumerate(day.time.tolist()):
                at = np.datetime64(int(START + number * DAY + t), "s")
                lines.append(f"{at}Z," + ",".join(f"{day[r][k]:.4f}" for r in ROLES))
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return path

    def replayed(path: Path) -> list[Alarm]:
        found = replay_site(site, path, since=None, until=None, verdicts=None, console=QUIET)
        return list(found.alarms.values())

    normal = [air_day(FINE, outside, seed) for seed, outside in enumerate((10.0, 12.0, 14.0, 16.0, 13.0, 15.0))]
    small = file("small.csv", [air_day(Plant(heat_leak=0.06), 14.0, 9)])
    assert replayed(small) == []
    (fitted,) = fit_site(
        site, file("normal.csv", normal), since=None, until=None, only=None, html=None, starts=1, console=QUIET
    )
    assert "6 days judged" in fitted.summary()
    assert Knowledge.of(fitted.baseline.diagnostics["rows"]).days == 6
    (alarm,) = replayed(small)
    assert alarm.evidence.place == "heating-valve"
    assert alarm.evidence.notes["watched_by"] == Message.of("rows_learned", days=6)


def test_days_are_those_of_the_sites_zone() -> None:
    # 14:00 UTC is midnight in Brisbane: a record from 00:00 UTC touches two local days.
    engine = Engine(replace(plan(), zone="Australia/Brisbane"), {})
    got = [engine.step(batch([(FINE, 12.0)])), engine.flush()]
    times = {int(t) for o in got for r in o.rows if r.measurement == "charts" for t in r.time}
    assert min(times) == (START + 14 * 3600 - int(STEP)) * NANOSECONDS


def test_what_a_site_lacks_is_said_with_a_remedy() -> None:
    few = SITE.replace("cool: ahu.cool, ", "").replace("T_supply_set: ahu.T_supply_set, ", "T_sply: ahu.T_supply_set, ")
    found = [str(f) for f in check_site(parse_site(few))]
    assert any("role cool (cooling valve position) has no point. Add `cool: POINT` [1]" in f for f in found)
    assert any("T_sply: the model has no such role" in f and "T_supply" in f for f in found)
    assert any("expectations cannot be judged without" in f for f in found)


RULES = """
rules:
  supply air too warm:
    expect: ahu.T_supply - ahu.T_supply_set
    when: ahu.fan > 0.5
    held: 1 h
    tolerance: 3.6
    unit: degF
    says: the supply air is far above its set point
    checks: ["look at the coil: cold"]
"""


def test_a_rule_of_the_sites_own_rings_by_its_tolerance_and_has_its_share_of_the_budget() -> None:
    plan = plan_of(parse_site(SITE + RULES))
    assert sum(e.false_alarms_per_year for e in plan.equipment) == pytest.approx(2.0)
    hot = Plant(cool=0.0)
    for days, rings in (([(FINE, 30.0)], False), ([(hot, 30.0)], True)):
        engine = Engine(plan, {})
        got = [engine.step(batch(days)), engine.flush()]
        found = [a for a in last(got).values() if a.component == "supply air too warm"]
        assert bool(found) == rings
        for alarm in found:
            assert Speaker().summary(alarm).startswith("supply air too warm: the supply air is far above its set point")
            assert alarm.checks == (check("look at the coil", "cold"),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (RULES.replace("ahu.T_supply - ahu.T_supply_set", "ahu.T_supply"), "not zero where all is well"),
        (RULES.replace("unit: degF", "unit: Pa"), "does not fit the expression, which is in K"),
    ],
)
def test_a_rule_without_sense_is_refused_with_a_remedy(text: str, said: str) -> None:
    (found,) = [f for f in check_site(parse_site(SITE + text)) if f.severity == "error"]
    assert said in str(found)


def test_the_report_tells_a_finding_of_rows_in_its_own_words(tmp_path: Path) -> None:
    from fdd.service.site.site_context import open_site
    from fdd.service.verbs.reporting import report_site

    site = tmp_path / "site.yaml"
    site.write_text(SITE)
    context = open_site(site)
    engine = Engine(context.plan, {})
    got = [engine.step(batch([(FINE, 12.0), (LEAK, 14.0)])), engine.flush()]
    store = context.store()
    for outputs in got:
        for rows in outputs.rows:
            store.write(rows)
        for alarm in outputs.alarms:
            store.put("alarm", alarm.key, alarm.document())
    store.close()
    page = tmp_path / "report.html"
    report_site(site, page)
    text = page.read_text()
    assert "gets hotter than its surroundings" in text
    assert "no healthy baseline" not in text
    assert "than its healthy model expects" not in text


def test_per_cent_without_a_unit_is_said_with_a_remedy() -> None:
    day = batch([(FINE, 30.0)])
    cool = np.asarray(day.point) == day.names.index("ahu.cool")
    engine = Engine(plan(), {})
    got = [engine.step(replace(day, value=np.where(cool, 100 * day.value, day.value))), engine.flush()]
    assert last(got) == {}
    assert engine.counts["equipment failed: ahu (ShareError)"] == 1
    assert engine.notes[0].startswith("ahu: cool (cooling valve position) reads up to 8")
    assert "give its point the unit '%'" in engine.notes[0]
