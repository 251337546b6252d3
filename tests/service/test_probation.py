"""Weeks that a fit has not seen, and what a component may say of the plant after them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdd.evidence import AlarmKind
from fdd.records import Baseline
from fdd.service.alarms.book import Command
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import identify
from fdd.service.baselines.probation import on_probation, split
from fdd.service.engine.engine import Engine
from fdd.service.monitoring.power import Foretold
from tests.service.conftest import Truth, plan, simulate

DAY = 288
NS = 86400 * 10**9


def history(truth: Truth) -> History:
    site = plan()
    return History(site.points, truth.time, np.column_stack([truth.points[p] for p in site.points]))


@pytest.fixture(scope="module")
def long() -> Truth:
    return simulate(45 * DAY, seed=21)


@pytest.fixture(scope="module")
def fitted(long: Truth) -> dict[str, Baseline]:
    """Fitted to two weeks, with the two after them on probation."""
    site, record = plan(), history(long)
    mid, end = int(long.time[14 * DAY]), int(long.time[28 * DAY])
    found = {}
    for c in site.components:
        baseline, _ = identify(site, c, record.between(None, mid))
        found[c.name] = on_probation(site, c, baseline, record.between(None, end), mid)
    return found


@pytest.mark.parametrize(("days", "held"), [(20, 0), (34, 0), (36, 8), (60, 28), (100, 28)])
def test_the_fit_keeps_four_weeks_and_less_than_one_is_not_worth_holding_back(days: int, held: int) -> None:
    time = np.arange(days * 24, dtype=np.int64) * 3600 * 10**9
    mine, rest = split(History(("x",), time, np.zeros((len(time), 1))))
    assert len(rest) == held * 24
    assert len(mine) + len(rest) == len(time)


def test_charts_that_had_their_probation_judge_from_the_first_day(long: Truth, fitted: dict[str, Baseline]) -> None:
    engine, fresh = Engine(plan(), fitted), Engine(plan(), {k: without(b) for k, b in fitted.items()})
    for e in (engine, fresh):
        e.step(long.batch(28 * DAY, 31 * DAY))
    assert {t["state"] for t in engine.trust.values()} == {"watching"}
    assert {t["state"] for t in fresh.trust.values()} == {"calibrating"}
    assert all(t["judged"] == t["days"] >= 2 for t in engine.trust.values())
    assert all(t["judged"] == 0 for t in fresh.trust.values())


def without(b: Baseline) -> Baseline:
    return replace(b, diagnostics={k: v for k, v in b.diagnostics.items() if k != "probation"})


def test_the_engine_learns_online_what_the_fit_would_have_learned(long: Truth, fitted: dict[str, Baseline]) -> None:
    """The same days, frame by frame in the service, after the same days to settle on."""
    b = without(fitted["south"])
    e = Engine(plan(), {"south": b})
    e.step(long.batch(0, 28 * DAY))
    online = e._charts.taught("south")["day"]["T_room"]
    offline = on_probation(plan(), plan().components[0], b, history(long).between(None, int(long.time[28 * DAY])), 0)
    told = offline.diagnostics["probation"]["day"]["T_room"]
    assert online["days"] == told["days"] >= 26
    assert online["coefficients"] == pytest.approx(told["coefficients"], abs=1e-9)


def test_foretold_fault_is_found_and_half_of_it_is_not_promised(long: Truth, fitted: dict[str, Baseline]) -> None:
    rows = [Foretold(**f) for f in fitted["south"].diagnostics["probation"]["foretold"]]
    power = next(f for f in rows if f.fault.startswith("power P_heat"))
    assert power.size is not None
    assert power.size < 0.5
    heat = long.points["south.heat"].copy()
    heat[28 * DAY :] /= 1 - 2 * power.size  # the meter says so much more than the room gets
    e = Engine(plan(), fitted)
    alarms = e.step(Truth(long.time, {**long.points, "south.heat": heat}).batch(28 * DAY)).alarms
    assert {a.component for a in alarms if a.evidence.kind is AlarmKind.PLANT} == {"south"}


def test_a_fault_nobody_finds_makes_the_component_doubt_itself(fitted: dict[str, Baseline]) -> None:
    """Every alarm is cleared without a word: from the third on nobody is accused, unless a fault was found."""
    truth = simulate(30 * DAY, seed=22, loss=2500.0, onset=2 * DAY)

    def heard(comment: str) -> tuple[int, Engine]:
        e, count = Engine(plan(), fitted), 0
        for d in range(30):
            e.step(truth.batch(d * DAY, (d + 1) * DAY))
            while e.alarms.open:  # what an alarm explains is closed with it
                a = e.alarms.open[0]
                count += a.evidence.kind is AlarmKind.PLANT
                e.command(Command(a.key, "clear", "me", 0, comment))
        return count, e

    silent, doubting = heard("")
    assert silent == 2
    assert doubting.trust["south"]["state"] == "void"
    assert "nobody has found" in doubting.trust["south"]["reason"]
    found, believed = heard("found: the valve was stuck")
    assert found > silent
    assert believed.trust["south"]["state"] != "void"
