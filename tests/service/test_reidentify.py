"""Re-identification: seasons are followed, faults are not learned, a killed job changes nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks.drifting_room import START, Course, plan, simulate
from benchmarks.plant_years import Case, live
from fdd.diagnosis.gates import Outcome, Policy
from fdd.records import Baseline
from fdd.service.baselines.candidate import Candidate, consider
from fdd.service.baselines.identify import identify
from fdd.service.baselines.pool import Failure, side_by_side
from fdd.service.baselines.reidentify import reidentify_site
from fdd.service.baselines.revisions import change_baseline, list_baselines
from fdd.service.baselines.versions import accept, approve, chain, in_force, propose, roll_back, versions
from fdd.service.baselines.window import avoided, choose, without
from tests.service.room_site import DAY_NS, make_site

QUIET = Console(quiet=True)


def month_after_month(course: Course, seed: int, every: int = 14) -> tuple[list[Candidate], list[Baseline]]:
    """Identify from three weeks, then consider the last four weeks again and again, as the daemon's job does."""
    p = plan()
    room, history = p.components[0], simulate(course, seed)
    line = [identify(p, room, history.between(None, START + 21 * DAY_NS))[0]]
    found, suspected = [], False
    for day in range(35, course.days, every):
        part = history.between(START + (day - 28) * DAY_NS, START + day * DAY_NS)
        found.append(consider(p, room, part, line, Policy(), suspected=suspected))
        if found[-1].outcome is Outcome.ACCEPTED and found[-1].baseline:
            line.append(replace(found[-1].baseline, version=line[-1].version + 1))
        suspected = found[-1].outcome is Outcome.SUSPECTED or (suspected and not found[-1].gates[-1].passed)
    return found, line


def test_a_season_is_followed() -> None:
    course = Course(130, season=0.06)
    found, line = month_after_month(course, seed=11)
    assert {f.outcome for f in found} == {Outcome.ACCEPTED, Outcome.REFUSED}
    day = (line[-1].start + line[-1].end) // 2 - START
    truth = course.resistance()[int(day // plan().step)]
    assert line[-1].parameters["R_ia"] == pytest.approx(truth, rel=0.015)
    assert line[-1].parameters["R_ia"] > 1.02 * line[0].parameters["R_ia"]


def test_a_growing_fault_is_refused_and_named() -> None:
    found, line = month_after_month(Course(120, growth=0.10, onset=45), seed=12)
    assert found[-1].outcome is Outcome.SUSPECTED
    assert "R_ia -" in found[-1].reason
    assert line[-1].parameters["R_ia"] > 0.93 * line[0].parameters["R_ia"]


def test_a_step_inside_the_window_is_refused() -> None:
    found, line = month_after_month(Course(64, step=0.15, onset=50), seed=13)
    assert found[-1].outcome is Outcome.SUSPECTED
    assert len(line) == 1


def test_without_a_change_there_is_no_reason_to_change() -> None:
    found, _ = month_after_month(Course(64), seed=14)
    assert {f.outcome for f in found} == {Outcome.REFUSED}
    assert all("better" in f.reason for f in found)


def test_data_under_alarms_and_around_them_are_left_out() -> None:
    history, room = simulate(Course(10), 1), plan().components[0]
    alarm = {"since": START + 3 * DAY_NS, "updated": START + 5 * DAY_NS, "state": "cleared", "evidence": {"points": []}}
    elsewhere = {**alarm, "component": "boiler"}
    reads = {**elsewhere, "evidence": {"points": ["outside"]}}
    own = {**alarm, "component": "room"}
    assert avoided([elsewhere], room) == []
    for case in (own, reads):
        kept = without(history, avoided([case], room))
        assert not ((kept.time >= START + 2 * DAY_NS) & (kept.time < START + 6 * DAY_NS)).any()
        assert len(kept) == 6 * 96 + 1 - 1
    still_open = without(history, avoided([{**own, "state": "raised"}], room))
    assert still_open.time.max() < START + 2 * DAY_NS


def test_a_window_without_excitation_is_passed_over() -> None:
    p = plan()
    history = simulate(Course(40), 2)
    base = identify(p, p.components[0], history.between(None, START + 14 * DAY_NS))[0]
    assert choose(p, p.components[0], history, base).end == START + 40 * DAY_NS + DAY_NS
    dull = history.values.copy()
    late = history.time > START + 34 * DAY_NS
    dull[late] = np.nan
    quiet = replace(history, values=dull)
    window = choose(p, p.components[0], quiet, base, (14,))
    assert window.start < START + 34 * DAY_NS


def test_versions_are_kept_proposed_approved_and_rolled_back(tmp_path: Path) -> None:
    opened = make_site(tmp_path, Course(22), seed=3)
    store = opened.store()
    first = in_force(store, ["room"])["room"]
    second = accept(store, replace(first, diagnostics={"automatic": True, "follows": 1}))
    third = propose(store, replace(first, diagnostics={"automatic": True, "follows": 2}))
    assert (second.version, third.version) == (2, 3)
    assert in_force(store, ["room"])["room"].version == 2
    assert [b.version for b in chain(versions(store, "room"), second)] == [1, 2]
    approve(store, "room", 3, "anna")
    assert [b.version for b in chain(versions(store, "room"), in_force(store, ["room"])["room"])] == [3]
    roll_back(store, "room", 1)
    store.close()
    assert [(b["version"], b["status"]) for b in list_baselines(tmp_path / "site.yaml")] == [
        (1, "in force"), (2, ""), (3, "")
    ]  # fmt: skip
    change_baseline(tmp_path / "site.yaml", rollback=("room", 2), approved=None, by="anna")
    assert [b["version"] for b in list_baselines(tmp_path / "site.yaml") if b["status"]] == [2]


def test_the_verb_changes_the_baseline_in_force_with_its_reasons(tmp_path: Path) -> None:
    opened = make_site(tmp_path, Course(60, season=0.09), seed=4)
    found = reidentify_site(tmp_path / "site.yaml", console=QUIET)
    assert found.kept == {"room": 2}
    store = opened.store(read_only=True)
    now, runs = in_force(store, ["room"])["room"], store.list("run")
    store.close()
    assert now.version == 2
    assert now.diagnostics["follows"] == 1
    assert {g[0] for g in now.diagnostics["gates"]} >= {"converged", "better", "no fault"}
    assert now.end - now.start <= 28 * DAY_NS
    assert runs[-1]["components"][0]["outcome"] == "accepted"
    # a proposal changes nothing that is in force
    reidentify_site(tmp_path / "site.yaml", console=QUIET, propose_only=True, policy=Policy(evidence=-1e9, level=0.0))
    assert [b["status"] for b in list_baselines(tmp_path / "site.yaml")][1] == "in force"


def test_a_job_killed_in_the_middle_leaves_the_baseline_and_the_next_one_succeeds(tmp_path: Path) -> None:
    opened = make_site(tmp_path, Course(60, season=0.09), seed=4)
    store = opened.store(read_only=True)
    before = asdict(in_force(store, ["room"])["room"])
    command = [sys.executable, "-m", "fdd", "reidentify", str(tmp_path / "site.yaml"), "--json"]
    for wait in (0.0, 0.3):
        job = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _until_it_has_workers(job)
        time.sleep(wait)
        started = _descendants(job.pid)
        job.kill()
        job.wait()
        _until_gone(started)
        assert repr(asdict(in_force(store, ["room"])["room"])) == repr(before)
        assert len(versions(store, "room")) == 1
    store.close()
    assert reidentify_site(tmp_path / "site.yaml", console=QUIET).kept == {"room": 2}


def _until_it_has_workers(job: subprocess.Popen[bytes]) -> None:
    children = Path(f"/proc/{job.pid}/task/{job.pid}/children")
    if not children.exists():
        pytest.skip("this system does not tell a process's children")
    for _ in range(600):
        if children.read_text().strip():
            return
        assert job.poll() is None, "the job ended before it had started a worker"
        time.sleep(0.02)
    pytest.fail("the job never started a worker")


def _descendants(pid: int) -> list[int]:
    own = [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [*own, *(d for p in own for d in _descendants(p))]


def _until_gone(processes: list[int]) -> None:
    """Nothing that a killed job had started stays behind."""
    assert processes
    for _ in range(600):
        if not any(Path(f"/proc/{p}").exists() for p in processes):
            return
        time.sleep(0.05)
    pytest.fail("the killed job's workers are still there")


def _work(n: int) -> int:
    if n == 2:
        os._exit(9)
    if n == 3:
        raise ValueError("three")
    return n * n


@pytest.mark.slow
def test_a_task_that_fails_or_dies_takes_no_other_with_it() -> None:
    results: dict[int, int | Failure] = {}
    side_by_side(_work, [0, 1, 2, 3, 4], lambda i, r: results.__setitem__(i, r), workers=2)
    assert (results[0], results[1], results[4]) == (0, 1, 16)
    assert results[3] == Failure("ValueError: three")
    assert isinstance(results[2], Failure)
    assert "died" in results[2].reason


@pytest.mark.slow
def test_a_season_is_followed_without_an_alarm_and_a_growing_fault_is_alarmed_and_not_learned() -> None:
    season, growing = Case(Course(126, season=0.03), 5), Case(Course(126, growth=0.10, onset=70), 6)
    followed, faulty = live([season, growing])
    assert followed["accepted"] > 0
    assert followed["false_alarms"] == 0
    assert abs(followed["error"]) < 0.02  # the year's season has moved by 2.6 % since the first baseline
    assert faulty["alarmed"]
    assert not faulty["learned"]
    assert faulty["false_alarms"] == 0
