import time

import numpy as np
import pytest

from fdd.config.load import load_site
from fdd.models.registry import get_model
from fdd.plant.faults import DAY, KINDS, PlantFault, course, effects
from fdd.plant.network import Network, PlantError
from fdd.plant.scenario import Scenario, points, simulate
from fdd.plant.simulate import Simulator
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


def test_nothing_changes_before_the_onset(healthy):
    for kind, target, severity in (
        ("fouling", "hx", 0.3),
        ("bias", "hx.T_hot_out", 1.0),
        ("stuck", "valve-south", 1.0),
    ):
        f = faulty(kind, target, severity)
        assert f[: 3 * 288].equals(healthy[: 3 * 288])
        assert not f[3 * 288 + 2 :].equals(healthy[3 * 288 + 2 :])


def late(frame, point):
    return frame[point].to_numpy()[4 * 288 :]


@pytest.mark.parametrize(
    ("kind", "target", "severity", "point", "sign"),
    [
        ("fouling", "hx", 0.3, "hx.T_hot_out", 1),
        ("air", "radiator-south", 0.4, "radiator-south.T_return", 1),
        ("sludge", "radiator-north", 0.5, "radiator-north.m_flow", -1),
        ("leak", "valve-south", 0.3, "radiator-south.m_flow", 1),
        ("bias", "hx.T_hot_out", 1.0, "hx.T_hot_out", 1),
        ("drift", "building.T_south", -1.0, "building.T_south", -1),
        ("scaling", "hx.m_flow_cold", 0.1, "hx.m_flow_cold", 1),
    ],
)
def test_fault_moves_its_point_the_right_way(healthy, kind, target, severity, point, sign):
    change = late(faulty(kind, target, severity), point) - late(healthy, point)
    assert np.sign(change.mean()) == sign


def test_frozen_sensor_keeps_its_value():
    assert np.ptp(late(faulty("freeze", "building.T_north", 1.0), "building.T_north")) == 0.0


def test_noisy_sensor_is_noisier(healthy):
    rough, calm = (
        np.diff(late(f, "radiator-south.T_return")).std()
        for f in (faulty("noise", "radiator-south.T_return", 9.0), healthy)
    )
    assert rough > 3 * calm


def test_swapped_sensors_exchange_their_values(healthy):
    f = faulty("swap", "building.T_south | building.T_north", 1.0)
    assert late(f, "building.T_south").mean() < late(f, "building.T_north").mean() or (
        np.corrcoef(late(f, "building.T_south"), late(healthy, "building.T_north"))[0, 1] > 0.8
    )


def test_stuck_valve_holds_the_flow():
    assert late(faulty("stuck", "valve-north", 1.0), "radiator-north.m_flow").std() < 1e-3


def test_sticking_valve_moves_less_often(healthy):
    def moves(f):
        return np.mean(np.abs(np.diff(late(f, "radiator-south.m_flow"))) > 0.002)

    assert moves(faulty("stick", "valve-south", 0.2)) < 0.7 * moves(healthy)


def test_hunting_controller_swings(healthy):
    swing = [np.abs(np.diff(late(f, "hx.T_cold_out"))).mean() for f in (faulty("hunting", "controller", 25.0), healthy)]
    assert swing[0] > 1.5 * swing[1]


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


def test_worn_pump_gives_less_head_from_its_onset_in_proportion_to_its_shape():
    plant = Network()
    plant.add("pump", get_model("pump"))
    for symbol, unit in (("speed", "1"), ("m_flow", "kg/s")):
        plant.signal(f"in.{symbol}", unit)
        plant.connect(f"in.{symbol}", f"pump.{symbol}")
    plant.sensor("pump.dp_pump")
    outside = {"in.speed": np.full(400, 1.0), "in.m_flow": np.full(400, 1.0)}
    seconds = np.arange(400) * 60.0
    fault = PlantFault("wear", "pump", 200 * 60.0, 0.2, "ramp", 100 * 60.0)
    changes, sensors = effects(plant, (fault,), seconds)
    head = np.concatenate([b.measured for b in Simulator(plant, 60.0, 1).run(outside, changes, sensors)])[:, 0]
    before, half, worn = head[100:200].mean(), head[245:256].mean(), head[320:].mean()
    assert before - worn == pytest.approx(0.2 * 6e4, rel=0.05)  # p_0 s^2 falls by a fifth
    assert before - half == pytest.approx(0.5 * (before - worn), rel=0.15)
