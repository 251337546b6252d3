"""Steady states as vectors: on simulated machines that the signatures were not made from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from fdd.chiller_eiv.causes import BETTER, FAULTS, library, name_cause
from fdd.chiller_eiv.checks import describe
from fdd.chiller_eiv.clusters import HOUR, Clustering, Clusters, cluster, point_rows
from fdd.chiller_eiv.errors import Instrumentation
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.steady_state import SteadyPoints
from fdd.chiller_eiv.vector import VectorBaseline, learn_vector
from fdd.chiller_eiv.watch import VectorMonitor, VectorVerdict

pytest.importorskip("CoolProp", reason="the simulated chiller needs the extra 'fluids'")

from fdd.plant.chiller_cycle import Condition, Fault, Machine, steady_state
from fdd.plant.chiller_operation import REFRIGERANT, Sensors, conditions, readings, running_machine, sensors

INSTRUMENTS = Instrumentation({})
RATED = 1e6
SEVEN = REFRIGERANT


def clusters(raw: Mapping[str, np.ndarray], without: tuple[str, ...] = ()) -> Clusters:
    n = len(raw["power"])
    start = np.arange(n, dtype=np.int64) * 4 * HOUR
    load = 4190.0 * raw["flow_ch"] * (raw["T_chi"] - raw["T_cho"])
    kept = {k: v for k, v in raw.items() if k not in without}
    return Clusters(start, start + HOUR, np.ones(n, dtype=np.int64), {**kept, "load": load})


def watch(baseline: VectorBaseline, c: Clusters) -> list[VectorVerdict]:
    monitor = VectorMonitor(baseline, 0.25)
    return [monitor.update(c.select(np.array([i]))) for i in range(len(c))]


class Plant:
    """One machine with sensors of its own, learned from 40 states."""

    def __init__(self, seed: int, without: tuple[str, ...] = ()) -> None:
        self.rng, self.without = np.random.default_rng(seed), without
        self.machine = running_machine(self.rng, wide=1.3)
        raw = readings(self.machine, conditions(self.rng, 40), sensors(self.rng), self.rng)
        self.baseline = learn_vector(clusters(raw, without), INSTRUMENTS, RATED)

    def later(
        self, n: int, fault: Fault | None = None, *, seed: int = 1, **bias: Mapping[str, float]
    ) -> list[VectorVerdict]:
        rng = np.random.default_rng(seed)
        own = sensors(rng).biased(**bias)
        raw = readings(self.machine, conditions(rng, n), own, rng, fault)
        return watch(self.baseline, clusters(raw, self.without))


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(7)


def test_the_simulated_machine_closes_its_energy_balance() -> None:
    s = steady_state(Machine(drive=1.0), Condition(load=0.7))
    load = 4190 * s["flow_ch"] * (s["T_chi"] - s["T_cho"])
    assert load == pytest.approx(0.7e6, rel=1e-9)
    assert 4190 * s["flow_cd"] * (s["T_cdo"] - s["T_cdi"]) == pytest.approx(load + s["power"], rel=1e-6)


def test_the_rated_state_has_the_approaches_of_the_declaration() -> None:
    m = Machine(approach_cd=2.5, approach_ev=1.5, best_load=1.0, gas_blanket=0.0)
    s = steady_state(m, Condition())
    assert s["T_sat_cd"] - s["T_cdo"] == pytest.approx(2.5, abs=0.02)
    assert s["T_cho"] - s["T_sat_ev"] == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize(
    ("fault", "up", "down"),
    [
        # Comstock and Braun, RP-1043 (1999), and Comstock, Braun and Groll, HVAC&R Research 7 (2001): the signs.
        (Fault(gas=0.02), ("approach_cd", "subcooling", "power"), ()),
        (Fault(fouling_cd=0.2), ("approach_cd", "power"), ()),
        (Fault(fouling_ev=0.2), ("approach_ev", "power"), ()),
        (Fault(flow_cd=-0.2), ("range_cd", "power"), ("flow_cd",)),
        (Fault(flow_ch=-0.2), ("range_ch",), ("flow_ch",)),
        (Fault(charge=-0.2), (), ("subcooling",)),
        (Fault(charge=0.2), ("subcooling",), ()),
        (Fault(efficiency=0.1), ("power", "superheat"), ()),
    ],
)
def test_faults_move_the_readings_as_published(fault: Fault, up: tuple[str, ...], down: tuple[str, ...]) -> None:
    def features(s: Mapping[str, float]) -> dict[str, float]:
        return {
            **s,
            "approach_cd": s["T_sat_cd"] - s["T_cdo"],
            "approach_ev": s["T_cho"] - s["T_sat_ev"],
            "range_cd": s["T_cdo"] - s["T_cdi"],
            "range_ch": s["T_chi"] - s["T_cho"],
            "subcooling": s["T_sat_cd"] - s["T_liquid"],
            "superheat": s["T_discharge"] - s["T_sat_cd"],
        }

    healthy, faulty = (features(steady_state(Machine(), Condition(load=0.8), f)) for f in (None, fault))
    for k in up:
        assert faulty[k] > 1.01 * healthy[k], k
    for k in down:
        assert faulty[k] < 0.99 * healthy[k], k


def test_the_library_has_every_fault_of_every_machine() -> None:
    lib = library()
    assert {kind for kind, _ in FAULTS.values()} == set(lib.change)
    assert all(v.shape == (14, 4, 8) for v in lib.change.values())
    assert all(np.isfinite(v).all() for v in lib.change.values())


def test_a_healthy_machine_is_quiet(plant: Plant) -> None:
    verdicts = plant.later(120)
    assert not any(v.alarm for v in verdicts)
    assert np.mean([v.judged for v in verdicts]) > 0.8


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        (Fault(flow_cd=-0.1), "low condenser flow"),
        (Fault(flow_ch=-0.1), "low chilled-water flow"),
        (Fault(oil=0.6), "oil excess"),
    ],
)
def test_strong_faults_are_named_within_five_states(plant: Plant, fault: Fault, cause: str) -> None:
    verdicts = plant.later(10, fault)
    first = next(i for i, v in enumerate(verdicts) if v.alarm)
    assert first < 5
    assert verdicts[-1].finding is not None
    assert verdicts[-1].finding.named.cause == cause


def test_gas_is_found_on_the_condenser_side(plant: Plant) -> None:
    found = plant.later(10, Fault(gas=0.02))[-1].finding
    assert found is not None
    assert found.named.cause in ("non-condensable gas", "condenser side")
    words = describe(found, plant.baseline, "2025-03-03")
    assert "condenser approach up" in words.sentence
    assert "since 2025-03-03" in words.sentence
    assert {"non-condensable gas", "condenser tubes (fouling)"} & set(words.checks)


@pytest.mark.parametrize(
    ("sensor", "bias"),
    [
        ("flow_cd", {"share": {"flow_cd": -0.1}}),
        ("T_cdo", {"added": {"T_cdo": 1.0}}),
        ("T_cho", {"added": {"T_cho": -1.0}}),
        ("T_sat_cd", {"added": {"T_sat_cd": 2.0}}),
    ],
)
def test_a_biased_sensor_is_named_and_never_a_fault(
    plant: Plant, sensor: str, bias: dict[str, Mapping[str, float]]
) -> None:
    (size,) = next(iter(bias.values())).values()
    named = []
    for seed in range(5):
        found = plant.later(12, seed=seed, **bias)[-1].finding
        assert found is not None
        assert found.named.sensor or (found.named.probability < 1.0 and "meter" in found.named.cause)
        if found.named.cause == f"{sensor} sensor":
            named.append(found.named.probability)
            assert ("high" if size > 0 else "low") in found.bias
    assert len(named) >= 4
    assert min(named) >= 0.8


def test_flow_faults_are_named_with_the_usual_seven_points() -> None:
    plant = Plant(11, without=SEVEN)
    assert plant.baseline.layout.features == ("chilled-water flow", "condenser flow", "heat balance", "power")
    for fault, cause in ((Fault(flow_cd=-0.1), "low condenser flow"), (Fault(flow_ch=-0.1), "low chilled-water flow")):
        verdicts = plant.later(8, fault)
        assert next(i for i, v in enumerate(verdicts) if v.alarm) < 5
        assert verdicts[-1].finding is not None
        assert dict(verdicts[-1].finding.named.ranked)[cause] >= 0.7


def test_more_subcooling_is_never_too_little_refrigerant(plant: Plant) -> None:
    found = plant.later(12, added={"T_liquid": -2.0})[-1].finding
    assert found is not None
    assert dict(found.named.ranked).get("low charge", 0.0) < 0.05


def test_an_approach_that_went_down_is_no_fault_of_an_exchanger(plant: Plant) -> None:
    rng = np.random.default_rng(9)
    dirty = readings(plant.machine, conditions(rng, 40), Sensors(), rng, Fault(fouling_cd=0.5))
    clean = readings(plant.machine, conditions(rng, 12), Sensors(), rng)
    found = watch(learn_vector(clusters(dirty), INSTRUMENTS, RATED), clusters(clean))[-1].finding
    assert found is not None
    assert found.change[plant.baseline.layout.features.index("condenser approach")] < 0
    p = dict(found.named.ranked)
    assert p.get("condenser fouling", 0.0) + p.get("non-condensable gas", 0.0) < 0.02
    assert found.named.cause in (*BETTER, "better than when it was learned", "a sensor")


def test_a_new_set_point_is_not_judged_and_no_alarm(plant: Plant) -> None:
    states = [Condition(c.load, c.T_cdi, c.T_cho + 5.0) for c in conditions(np.random.default_rng(5), 20)]
    raw = readings(plant.machine, states, Sensors(), np.random.default_rng(8))
    verdicts = watch(plant.baseline, clusters(raw))
    assert not any(v.judged or v.alarm for v in verdicts)


def test_a_flow_that_varies_without_a_driver_is_refused_with_what_to_add(plant: Plant) -> None:
    rng = np.random.default_rng(3)
    speed = rng.uniform(0.6, 1.0, 60)
    states = [
        Condition(c.load, c.T_cdi, c.T_cho, flow_cd=float(s)) for c, s in zip(conditions(rng, 60), speed, strict=True)
    ]
    raw = readings(plant.machine, states, Sensors(), rng)
    bare = learn_vector(clusters(raw), INSTRUMENTS, RATED)
    assert "condenser flow" not in bare.layout.features
    assert "flow_cd" in bare.layout.drivers
    assert "drive_cd" in bare.notes[0]
    driven = learn_vector(clusters({**raw, "drive_cd": 50 * speed}), INSTRUMENTS, RATED)
    assert driven.notes == ()
    assert {"condenser flow", "drive_cd"} <= {*driven.layout.features, *driven.layout.drivers}


def test_one_odd_state_is_no_alarm(plant: Plant) -> None:
    raw = readings(plant.machine, conditions(np.random.default_rng(5), 12), Sensors(), np.random.default_rng(8))
    raw["power"][6] *= 1.13
    assert not any(v.alarm for v in watch(plant.baseline, clusters(raw)))


def test_the_onset_is_the_first_state_that_shows_it(plant: Plant) -> None:
    states, own = conditions(np.random.default_rng(5), 30), sensors(np.random.default_rng(6))
    before = readings(plant.machine, states[:15], own, np.random.default_rng(8))
    after = readings(plant.machine, states[15:], own, np.random.default_rng(8), Fault(flow_cd=-0.1))
    found = watch(plant.baseline, clusters({k: np.concatenate([v, after[k]]) for k, v in before.items()}))[-1].finding
    assert found is not None
    assert abs(found.onset - 15 * 4 * HOUR) <= 4 * HOUR


def test_the_chart_goes_on_from_its_state(plant: Plant) -> None:
    c = clusters(
        readings(
            plant.machine,
            conditions(np.random.default_rng(5), 20),
            sensors(np.random.default_rng(6)),
            np.random.default_rng(8),
            Fault(flow_ch=-0.1),
        )
    )
    whole = watch(plant.baseline, c)
    again = VectorBaseline.of_state(plant.baseline.export_state())
    got = []
    monitor = VectorMonitor(again, 0.25)
    for i in range(len(c)):
        got.append(monitor.update(c.select(np.array([i]))))
        state = monitor.export_state()
        monitor = VectorMonitor(again, 0.25)
        monitor.restore_state(state)
    assert [v.statistic for v in got] == [v.statistic for v in whole]
    assert [v.finding and (v.finding.onset, v.finding.named) for v in got] == [
        v.finding and (v.finding.onset, v.finding.named) for v in whole
    ]


def test_too_few_states_are_refused_in_words(plant: Plant) -> None:
    raw = readings(plant.machine, conditions(np.random.default_rng(5), 5), Sensors(), np.random.default_rng(8))
    with pytest.raises(ChillerError, match="8 are needed"):
        learn_vector(clusters(raw), INSTRUMENTS, RATED)


def test_a_name_needs_four_fifths_and_a_group_what_is_left() -> None:
    names = ("non-condensable gas", "condenser fouling", "T_cdo sensor", "none of these")
    assert name_cause(names, np.array([0.85, 0.05, 0.05, 0.05])).cause == "non-condensable gas"
    assert name_cause(names, np.array([0.5, 0.4, 0.05, 0.05])).cause == "condenser side"
    assert name_cause(names, np.array([0.05, 0.04, 0.85, 0.06])).cause == "T_cdo sensor"
    assert name_cause(names, np.array([0.1, 0.1, 0.2, 0.6])).cause == ""


def test_points_at_like_drivers_are_one_cluster_one_by_one_or_together() -> None:
    n, window = 12, HOUR // 2
    time = np.arange(1, n + 1, dtype=np.int64) * window
    T_cho = np.repeat([6.0, 9.0, 6.0], 4)
    raw = {"T_cho": T_cho, "T_cdi": np.full(n, 25.0), "power": np.full(n, 1e5)}
    points = SteadyPoints(time, np.full(n, 6), raw)
    load = np.full(n, 5e5)
    whole = cluster(points, load, window, RATED)
    assert whole.points.tolist() == [4, 4, 4]
    clustering, parts = Clustering(RATED), []
    for t, row in zip(time, point_rows(points, load), strict=True):
        if (done := clustering.add(int(t), window, row)) is not None:
            parts.append(done)
        other = Clustering(RATED)
        other.restore_state(clustering.export_state())
        clustering = other
    assert clustering.tick(int(time[-1]) + 3 * HOUR) is not None
    assert [int(p.end[0]) for p in parts] == whole.end[:2].tolist()


def test_a_sensor_that_is_gone_takes_only_its_own_features_along(plant: Plant) -> None:
    rng = np.random.default_rng(2)
    raw = readings(plant.machine, conditions(rng, 12), Sensors(), rng, Fault(flow_cd=-0.1))
    raw["T_oil"] = np.full(12, np.nan)
    raw["T_liquid"][6:] = np.nan
    found = watch(plant.baseline, clusters(raw))[-1].finding
    assert found is not None
    assert found.named.cause == "low condenser flow"
    assert "condenser flow down" in describe(found, plant.baseline, "2025-03-03").sentence


def test_differences_that_a_plant_reads_as_such_are_watched_alike(plant: Plant) -> None:
    rng = np.random.default_rng(2)
    raw = readings(plant.machine, conditions(rng, 40), Sensors(), rng)
    raw["subcooling"] = raw["T_sat_cd"] - raw.pop("T_liquid")
    raw["superheat"] = raw.pop("T_discharge") - raw["T_sat_cd"]
    baseline = learn_vector(clusters(raw), INSTRUMENTS, RATED)
    assert {"subcooling", "discharge superheat"} <= set(baseline.layout.features)
