"""``fdd audit``: alarms that came, of those promised, with every alarm cleared after a day."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.drifting_room import POINTS, START, Course, plan, simulate
from fdd.cli import app
from fdd.evidence import AlarmKind
from fdd.records import NANOSECONDS, Baseline, Batch
from fdd.service.alarms.book import iso
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.engine.engine import Engine
from fdd.service.site.errors import UsageError
from fdd.service.verbs.audit import DAY, LOOK, WATCHED, Counter, Kept, pieces, verdict
from tests.service.room_site import SITE
from tests.service.test_row_monitors import LEAK
from tests.service.test_row_monitors import batch as rows_batch
from tests.service.test_row_monitors import plan as rows_plan

RUNNER = CliRunner()
LEARNING, DAYS, BUDGET = 21, 35, 2.0
FAULT = Course(DAYS, step=0.5, onset=24.0)


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    """Of a healthy room's first weeks; budget as the default site's."""
    healthy = simulate(Course(LEARNING), 4)
    return identify(plan(BUDGET), plan(BUDGET).components[0], healthy)[0]


def written(history: History, path: Path) -> Path:
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["time", *history.columns])
        out.writerows([iso(t), *row] for t, row in zip(history.time.tolist(), history.values.tolist(), strict=True))
    return path


def folder_of(tmp_path: Path, course: Course) -> tuple[Path, Path]:
    """A site file without a baseline, and a record."""
    (tmp_path / "site.yaml").write_text(SITE)
    return tmp_path / "site.yaml", written(simulate(course, 4), tmp_path / "data.csv")


def test_an_alarm_that_stands_hides_no_others(baseline: Baseline) -> None:
    """A room that loses half as much again rings anew after every clearing; left alone it rings once."""
    history = simulate(FAULT, 4)
    batch = Batch.of_table(POINTS, history.time, history.values)
    alone = Engine(plan(BUDGET), {"room": baseline})
    standing = {a.key for a in alone.step(batch).alarms if a.evidence.kind is AlarmKind.PLANT}
    counter = Counter(engine := Engine(plan(BUDGET), {"room": baseline}))
    for piece in pieces(batch):
        counter.take(engine.step(piece))
    counter.take(engine.flush())
    found = counter.result()
    after = [a for a in found.alarms if a["raised"] >= iso(START + 24 * DAY) and a["kind"] == "plant"]
    assert len(standing) == 1
    # It rings within a day, each time cleared a day to a day and a quarter later, until it is believed no longer.
    assert 2 <= len(after) <= 11
    times = [np.datetime64(a["raised"].rstrip("Z")) for a in after]
    assert all(b - a >= np.timedelta64(1, "D") for a, b in pairwise(times))
    assert found.whole((WATCHED,)).alarms == sum(a["part"] == WATCHED for a in found.alarms)


def test_what_is_promised_over_all_places_is_the_budget_over_the_time(baseline: Baseline) -> None:
    """Two a year over 35 days are 0.1916, whatever the charts are; no chart judges all of it."""
    assert sum(Engine(plan(BUDGET), {"room": baseline}).promised.values()) == pytest.approx(BUDGET)
    history = simulate(Course(DAYS), 4)
    counter = Counter(engine := Engine(plan(BUDGET), {"room": baseline}))
    for piece in pieces(Batch.of_table(POINTS, history.time, history.values)):
        counter.take(engine.step(piece))
    counter.take(engine.flush())
    found = counter.result()
    parts = found.by(lambda p: p.part)
    whole = sum(k.due for k in parts.values())
    assert whole == pytest.approx(BUDGET * DAYS / 365.25, rel=1e-6)
    assert parts["fitted"].due / whole == pytest.approx(LEARNING / DAYS, abs=0.25 / DAYS)
    # In the first week of its probation the chart of days rings for gross faults only: promised, but not judged.
    assert 0.75 * whole < sum(k.promised for k in parts.values()) < whole
    held = replace(baseline, diagnostics={**baseline.diagnostics, "probation": {"end": baseline.end + 7 * DAY}})
    counter = Counter(engine := Engine(plan(BUDGET), {"room": held}))
    for piece in pieces(Batch.of_table(POINTS, history.time, history.values)):
        counter.take(engine.step(piece))
    calibrated = counter.result().by(lambda p: p.part)
    assert calibrated["probation"].due == pytest.approx(BUDGET * 7 / 365.25, rel=0.05)
    assert sum(k.due for k in calibrated.values()) == pytest.approx(whole, rel=0.02)
    months = found.by(lambda p: p.month)
    assert list(months) == ["2025-10", "2025-11"]


def test_what_rings_after_a_component_has_declared_its_promise_void_counts_apart(baseline: Baseline) -> None:
    """A room that loses half as much again, with nobody who finds it: after three alarms it accuses nobody."""
    history = simulate(replace(FAULT, days=50), 4)
    counter = Counter(engine := Engine(plan(BUDGET), {"room": baseline}))
    for piece in pieces(Batch.of_table(POINTS, history.time, history.values)):
        counter.take(engine.step(piece))
    parts = counter.result().by(lambda p: p.part)
    assert engine.trust["room"]["state"] == "void"
    assert parts["void"].due > 0
    assert sum(k.due for k in parts.values()) == pytest.approx(BUDGET * 50 / 365.25, rel=0.01)


@pytest.mark.parametrize(
    ("count", "low", "high"),
    [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.390), (20, 12.217, 30.888)],
)
def test_intervals_are_those_of_the_published_table(count: int, low: float, high: float) -> None:
    """Garwood (1936), Biometrika 28, table of 95 % limits; Ulm (1990), Am J Epidemiol 131, 373-375."""
    told = Kept(count, promised=2.0, due=2.5).document()
    assert told["low"] == pytest.approx(low / 2, abs=0.0006)
    assert told["high"] == pytest.approx(high / 2, abs=0.0006)
    assert (told["ratio"], told["share_judged"]) == (count / 2, 0.8)


def test_verdicts_doubt_where_time_is_short() -> None:
    assert verdict(Kept(10, 0.5, 0.5)).startswith("Not kept")
    assert verdict(Kept(0, 0.1, 0.1)).startswith("Too little time")
    assert verdict(Kept(9, 10.0, 10.0)).startswith("Kept")
    assert "Nothing was judged" in verdict(Kept())


def test_pieces_are_the_batch_again_and_end_with_their_span() -> None:
    time = START + np.arange(300) * 900 * NANOSECONDS
    batch = Batch.of_table(("a", "b"), time, np.zeros((300, 2)))
    parts = list(pieces(batch))
    assert np.array_equal(np.concatenate([p.time for p in parts]), batch.time)
    assert all(len(np.unique(p.time // LOOK)) == 1 for p in parts)
    assert len(parts) == len(np.unique(batch.time // LOOK))
    assert list(pieces(batch.slice(0, 0))) == []


def test_a_fit_for_the_audit_changes_nothing_in_the_store(tmp_path: Path) -> None:
    site, data = folder_of(tmp_path, Course(DAYS))
    until = iso(START + LEARNING * DAY)
    said = RUNNER.invoke(app, ["audit", str(site), str(data), "--fit-until", until, "--from", until, "--json"])
    assert said.exit_code == 0, said.output
    found = json.loads(said.stdout)
    assert found["from"] == iso(START + LEARNING * DAY)
    # Three weeks are too few to hold any back: a week of probation, another that is watched; one a year by default.
    assert set(found["parts"]) == {"probation", WATCHED}
    assert found["all"]["promised"] == pytest.approx(7 / 365.25, rel=0.15)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data.csv", "site.yaml"]  # no store was made
    table = RUNNER.invoke(app, ["audit", str(site), str(data), "--fit-until", until])
    assert "part of the record" in table.stdout
    assert "promised over the time judged" in table.stdout


def test_json_is_all_that_stdout_gets_where_a_site_file_has_former_words(tmp_path: Path) -> None:
    site, data = folder_of(tmp_path, Course(28))
    site.write_text(SITE.replace("T_room: T}", "T_in: T}").replace("T_room:", "T_in:"))
    until = iso(START + LEARNING * DAY)
    command = [sys.executable, "-m", "fdd", "audit", str(site), str(data), "--fit-until", until, "--json"]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(said.stdout)["site"] == "room"
    assert "is called 'T_room' now" in said.stderr


def test_without_a_baseline_it_says_what_to_do(tmp_path: Path) -> None:
    site, data = folder_of(tmp_path, Course(2))
    said = RUNNER.invoke(app, ["audit", str(site), str(data)])
    assert isinstance(said.exception, UsageError)
    assert "fdd fit SITE DATA" in str(said.exception)


def test_consequences_are_not_counted_and_do_not_outlive_their_cause(baseline: Baseline) -> None:
    """Two rooms, the second downstream of the first and as faulty: its alarm is the first's, cleared or not."""
    one = plan(BUDGET)
    first = one.components[0]
    second = replace(first, name="next", inputs=first.inputs, outputs=("T2",), upstream=frozenset({"room"}))
    both = replace(one, points=(*POINTS, "T2"), components=(first, second))
    history = simulate(FAULT, 4)
    late = np.where(np.arange(len(history)) < 26 * 96, simulate(Course(DAYS), 4).values[:, 3], history.values[:, 3])
    batch = Batch.of_table(both.points, history.time, np.column_stack([history.values, late]))
    counter = Counter(engine := Engine(both, {"room": baseline, "next": replace(baseline, component="next")}))
    for piece in pieces(batch):
        counter.take(engine.step(piece))
    found = counter.result()
    assert found.consequences >= 1
    assert not [a for a in found.alarms if a["component"] == "next" and a["raised"] > iso(START + 25 * DAY)][1:]


def test_equipment_watched_by_rows_counts_as_one_kind_from_its_first_day() -> None:
    """Twelve days of an air handler whose heating valve leaks, without a baseline; its whole budget is the rows'."""
    site = rows_plan()
    assert Engine(site, {}).promised == {("ahu", "rows"): pytest.approx(2.0)}
    counter = Counter(engine := Engine(site, {}))
    for piece in pieces(rows_batch([(LEAK, 8.0 + day) for day in range(12)])):
        counter.take(engine.step(piece))
    counter.take(engine.flush())
    found = counter.result()
    assert set(found.by(lambda p: (p.chart, p.part))) == {("rows", WATCHED)}
    assert found.whole().alarms == len(found.alarms) >= 2
    assert found.whole().promised == pytest.approx(2.0 * 12 / 365.25, rel=0.01)
