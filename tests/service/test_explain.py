"""What ``fdd explain`` makes of an alarm's data when it looks at them again."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.detection import DAY, ONSET, STEP, Fault, simulate
from fdd.diagnosis.single_parameter import alone
from fdd.greybox.likelihood import Likelihood
from fdd.plant.district import TRUTH
from fdd.plant.site import demo_site
from fdd.records import NANOSECONDS, Baseline, FloatArray, IntArray, JsonObject, Rows
from fdd.service.baselines.history import History, runs
from fdd.service.baselines.versions import accept
from fdd.service.baselines.window import record
from fdd.service.site.plan import Component
from fdd.service.site.site_context import SiteContext, open_site
from fdd.service.verbs.explain import explained_by, looked_at_again, story

DAYS = 2.0
CASES = [
    ("radiator-north", "H", 0.2),
    ("radiator-south", "C", 0.2),
    ("hx", "y", 0.3),
    ("building", "B_floor_south", 0.3),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return demo_site(tmp_path_factory.mktemp("explain"))


@pytest.fixture(scope="module")
def context(site: Path) -> SiteContext:
    return open_site(site)


def component_of(context: SiteContext, name: str) -> Component:
    return next(c for c in context.plan.components if c.name == name)


def healthy(component: Component, end: int) -> Baseline:
    """The simulator's own physical parameters; noise as typical."""
    values = {**{p.symbol: p.typical for p in component.model.parameters}, **TRUTH[component.name]}
    of = component.model
    return Baseline(component.name, 1, of.name, of.version, {}, values, {}, [], end - 1, end, 1, 0.0, {})


@cache
def faulty(name: str, symbol: str, size: float, early: float = 0.0) -> tuple[IntArray, FloatArray]:
    """Frames of a house with one parameter lower by this share, from the onset on or some days ``early``."""
    time, values = simulate([Fault(name, symbol, size)], 5, ONSET + DAYS)
    first = round((ONSET - early) * DAY / STEP)
    return time[first:], values[first:]


@pytest.mark.parametrize("early", [0.0, 0.5])
@pytest.mark.parametrize(("name", "symbol", "size"), CASES)
def test_the_parameter_that_has_changed_explains_most(
    context: SiteContext, name: str, symbol: str, size: float, early: float
) -> None:
    """And its change is found: within four standard errors, and 3 % of it for inputs that are measured with errors."""
    time, values = faulty(name, symbol, size, early)
    component = component_of(context, name)
    history = History(context.plan.columns, time, context.plan.derive(values))
    best, second, *_ = explained_by(context.plan, component, history, healthy(component, int(time[0])))
    assert best.symbol == symbol
    assert best.gain > second.gain + 9
    if component.model.parameters[[p.symbol for p in component.model.parameters].index(symbol)].transform == "log":
        change = np.log(1 - size)
        assert abs(best.change - change) < 4 * best.error + 0.03 * abs(change)


def test_sums_of_scores_alone_take_a_radiators_surface_for_its_water(context: SiteContext) -> None:
    """Why the data are looked at again: 20 % less surface is far outside what is linear."""
    time, values = faulty("radiator-north", "H", 0.2)
    component = component_of(context, "radiator-north")
    history = History(context.plan.columns, time, context.plan.derive(values))
    baseline = healthy(component, int(time[0]))
    at = [p.symbol for p in component.model.parameters]
    likelihood = Likelihood(component.model, [record(r) for r in runs(context.plan, component, history)])
    linear = likelihood.evaluate(np.array([baseline.parameters[s] for s in at]))
    gain = linear.gradient**2 / np.diag(linear.information)
    assert gain[at.index("C")] > gain[at.index("H")]


def test_parameters_the_baseline_left_open_are_left_out(context: SiteContext) -> None:
    time, values = faulty("radiator-north", "H", 0.2)
    component = component_of(context, "radiator-north")
    history = History(context.plan.columns, time, context.plan.derive(values))
    baseline = healthy(component, int(time[0]))
    baseline.diagnostics["unidentifiable"] = ["H"]
    assert [a.symbol for a in explained_by(context.plan, component, history, baseline)] == ["C"]


def test_no_data_explain_nothing(context: SiteContext) -> None:
    component = component_of(context, "hx")
    columns = context.plan.columns
    history = History(columns, np.empty(0, dtype=np.int64), np.empty((0, len(columns))))
    assert explained_by(context.plan, component, history, healthy(component, 0)) == []


def test_a_filter_that_fails_explains_nothing(context: SiteContext) -> None:
    time, values = faulty("radiator-north", "H", 0.2)
    component = component_of(context, "radiator-north")
    history = History(context.plan.columns, time, context.plan.derive(values))
    likelihood = Likelihood(component.model, [record(r) for r in runs(context.plan, component, history)])
    wrong = np.array([np.nan for _ in component.model.parameters])
    assert alone(component.model, likelihood, wrong) == []


def alarm_of(component: str, time: IntArray) -> JsonObject:
    return {
        "component": component, "since": int(time[0]), "updated": int(time[-1]), "raised": int(time[-1]),
        "summary": "", "state": "raised", "since_local": "", "raised_local": "",
        "evidence": {"charts": {}}, "causes": [], "checks": [], "history": [],
    }  # fmt: skip


def test_the_story_tells_what_the_stored_data_say(context: SiteContext, site: Path) -> None:
    time, values = faulty("radiator-north", "H", 0.2)
    component = component_of(context, "radiator-north")
    alarm = alarm_of(component.name, time)
    store = context.store()
    points = context.plan.points
    series = np.tile(np.arange(len(points), dtype=np.int32), len(time))
    store.write(Rows("samples", points, series, np.repeat(time, len(points)), {"value": values.ravel()}))
    store.close()
    assert looked_at_again(context, alarm) == []  # no baseline yet
    store = context.store()
    accept(store, healthy(component, int(time[0])))
    store.close()
    assert looked_at_again(context, alarm)[0].symbol == "H"
    told = story(site, alarm).splitlines()
    first = told[told.index("Refitted alone to the data since then, explains most:") + 1]
    assert first.startswith("  H  ")
    assert "-20 %" in first
    assert looked_at_again(context, alarm | {"evidence": {"charts": {}, "kind": "model"}}) == []
    assert looked_at_again(context, alarm | {"since": int(time[0]) - NANOSECONDS}) == []  # the baseline has seen it
