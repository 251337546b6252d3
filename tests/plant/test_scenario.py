import time

import numpy as np
import pytest

from fdd.config.load import load_site
from fdd.plant.faults import DAY, KINDS, PlantFault, course
from fdd.plant.network import PlantError
from fdd.plant.scenario import Scenario, points, simulate
from fdd.plant.site import demo_site, plant_source
from fdd.plant.source import PlantOptions, PlantSource
from ingest.source import Context, Refused, make_source


@pytest.fixture(scope="module")
def healthy():
    return simulate(Scenario(days=6, seed=3))


def faulty(kind, target, severity, **more):
    return simulate(Scenario(days=6, seed=3, faults=(PlantFault(kind, target, 3 * DAY, severity, **more),)))


def test_a_winter_week_looks_like_one():
    f = simulate(Scenario(start="2024-01-15", days=7))
    assert 18 < f["building.T_south"].mean() < 23
    assert f["hx.T_hot_in"].min() > f["hx.T_cold_out"].max()
    assert (f["hx.T_hot_out"] > f["hx.T_cold_in"]).mean() > 0.99
    primary = 4186 * f["hx.m_flow_hot"] * (f["hx.T_hot_in"] - f["hx.T_hot_out"])
    secondary = 4186 * f["hx.m_flow_cold"] * (f["hx.T_cold_out"] - f["hx.T_cold_in"])
    assert primary.mean() == pytest.approx(secondary.mean(), rel=0.01)
    assert 5e3 < primary.mean() < 5e4


def test_the_same_seed_gives_the_same_numbers(healthy):
    assert simulate(Scenario(days=6, seed=3)).equals(healthy)
    assert not simulate(Scenario(days=6, seed=4)).equals(healthy)


def test_courses():
    t = np.array([0.0, 10.0, 15.0, 20.0, 30.0, 45.0])
    assert course(PlantFault("bias", "x", 10.0, 1.0), t).tolist() == [0, 1, 1, 1, 1, 1]
    assert course(PlantFault("bias", "x", 10.0, 1.0, "ramp", 20.0), t).tolist() == [0, 0, 0.25, 0.5, 1, 1]
    assert course(PlantFault("bias", "x", 10.0, 1.0, "intermittent", 10.0), t).tolist() == [0, 1, 1, 0, 1, 0]


def test_every_kind_says_what_it_means():
    assert all(k.meaning and k.severity for k in KINDS.values())


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (PlantFault("fowling", "hx", 0.0, 0.3), "did you mean 'fouling'"),
        (PlantFault("fouling", "building", 0.0, 0.3), "needs a component"),
        (PlantFault("fouling", "hx", 0.0, 1.5), r"in \[0, 1\)"),
        (PlantFault("leak", "hx", 0.0, 0.3), "valve-south"),
        (PlantFault("bias", "hx", 0.0, 0.3), "measured point"),
        (PlantFault("swap", "hx.T_hot_in", 0.0, 1.0), "two measured points"),
        (PlantFault("swap", "hx.T_hot_in | hx.m_flow_hot", 0.0, 1.0), "different things"),
        (PlantFault("bias", "hx.T_hot_in", 0.0, 1.0, "ramp", 0.0), "above zero"),
    ],
)
def test_impossible_faults_are_refused(fault, words):
    with pytest.raises(PlantError, match=words):
        simulate(Scenario(days=0.1, faults=(fault,)))


@pytest.mark.parametrize(("key", "value"), [("step", 1.0), ("days", 0.0), ("days", 1e5)])
def test_impossible_scenarios_are_refused(key, value):
    with pytest.raises(PlantError, match="outside"):
        Scenario(**{key: value})


def test_source_yields_what_simulate_does_and_resumes(healthy):
    options = PlantOptions(length="6 d", seed=3, batch_rows=500)
    source = PlantSource()
    source.configure(options, Context())
    source.open()
    batches = list(source.batches())
    assert np.array_equal(np.concatenate([b.value for b in batches]), healthy.to_numpy().ravel())
    assert (
        np.concatenate([b.time for b in batches])[:: len(points())].tolist()
        == healthy.index.as_unit("ns").asi8.tolist()
    )
    again = PlantSource()
    again.configure(options, Context())
    again.open(batches[1].position)
    rest = list(again.batches())
    assert np.array_equal(np.concatenate([b.value for b in rest]), np.concatenate([b.value for b in batches[2:]]))


def test_source_refuses_an_impossible_fault():
    options = PlantOptions(faults=({"kind": "fouling", "target": "roof", "severity": 0.2},))
    with pytest.raises(Refused, match="needs a component"):
        PlantSource().configure(options, Context())


def test_demo_site_loads_and_runs_the_same_plant(tmp_path, healthy):
    path = demo_site(tmp_path / "demo", scenario=Scenario(days=6, seed=3))
    site = load_site(path)
    assert set(site.points) == set(points())
    assert set(site.equipment) == {"hx", "radiator-south", "radiator-north", "building"}
    source = make_source(site.sources[0], Context())
    source.open()
    assert next(source.batches()).value[: len(points())].tolist() == healthy.iloc[0].tolist()


def test_site_of_a_faulty_scenario_keeps_its_faults(tmp_path):
    fault = PlantFault("fouling", "hx", 2 * DAY, 0.3, "ramp", 5 * DAY)
    site = load_site(demo_site(tmp_path, scenario=Scenario(faults=(fault,))))
    assert site.sources[0].scenario().faults == (fault,)
    assert plant_source(Scenario())["kind"] == "plant"


def test_a_year_takes_less_than_a_minute():
    begin = time.process_time()
    frame = simulate(Scenario(start="2024-01-01", days=365))
    assert time.process_time() - begin < 60.0
    assert len(frame) == 365 * 288
    assert np.isfinite(frame.to_numpy()).all()
