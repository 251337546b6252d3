import numpy as np
import pytest

from fdd.models.declare import Quantity
from fdd.models.registry import get_model
from fdd.plant.blocks import actuator, mixer
from fdd.plant.network import Block, Network, PlantError, measured
from fdd.plant.simulate import Simulator


def chain() -> Network:
    """Outside -> radiator, its return measured."""
    plant = Network()
    for name, unit in (("source.T", "degC"), ("room.T", "degC"), ("source.m_flow", "kg/s")):
        plant.signal(name, unit)
    plant.add("radiator", get_model("radiator", sections=2, surroundings=False))
    plant.connect("source.T", "radiator.T_supply")
    plant.connect("room.T", "radiator.T_room")
    plant.connect("source.m_flow", "radiator.m_flow")
    plant.sensor("radiator.T_return", noise=0.05)
    return plant


def outside(n):
    return {"source.T": np.full(n, 60.0), "room.T": np.full(n, 20.0), "source.m_flow": np.full(n, 0.02)}


def test_chain_settles_where_the_model_does():
    blocks = list(Simulator(chain(), 300.0, 1).run(outside(2000)))
    settled = np.concatenate([b.measured for b in blocks])[500:, 0]
    # Steady two-section radiator at typical parameters, solved by hand-written bisection.
    flow, H = 4186 * 0.02, 10.0
    temperatures, before = [], 60.0
    for _ in range(2):
        low, high = 20.0, before
        for _ in range(60):
            t = 0.5 * (low + high)
            low, high = (t, high) if flow * (before - t) > H / 2 * (t - 20) ** 1.3 else (low, t)
        before = low
        temperatures.append(low)
    spread = settled.std() / np.sqrt(len(settled) / 20)  # neighbouring samples depend on each other
    assert settled.mean() == pytest.approx(temperatures[1], abs=4 * spread)


def test_results_do_not_depend_on_the_chunk():
    runs = [
        np.concatenate([b.measured for b in Simulator(chain(), 300.0, 7).run(outside(700), chunk=c)]) for c in (97, 700)
    ]
    assert np.array_equal(runs[0], runs[1])


def test_seed_decides():
    a, b = (next(Simulator(chain(), 300.0, seed).run(outside(50))).measured for seed in (1, 2))
    assert not np.array_equal(a, b)


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda p: p.connect("source.m_flow", "radiator.T_room"), "units differ"),
        (lambda p: p.connect("room.T", "radiator.T_supply"), "already fed"),
        (lambda p: p.connect("room.T", "radiator.T_sup"), "did you mean 'radiator.T_supply'"),
        (lambda p: p.connect("radiator.T_retrun", "radiator.T_room"), "did you mean 'radiator.T_return'"),
        (lambda p: p.connect(measured("nothing"), "radiator.T_room"), "no sensor measures"),
        (lambda p: p.add("radiator", get_model("radiator")), "already has"),
        (lambda p: p.add("other", get_model("radiator"), Cr=1.0), "no parameter 'Cr'"),
        (lambda p: p.add("other", get_model("radiator"), C=-1.0), "outside"),
        (lambda p: p.add("other", get_model("radiator"), {"T_9": 1.0}), "no state"),
        (lambda p: p.control("valve", actuator(), leek=0.1), "did you mean 'leak'"),
        (lambda p: p.sensor("radiator.T_return"), "already measured"),
    ],
)
def test_wiring_mistakes_are_named(act, words):
    with pytest.raises(PlantError, match=words):
        act(chain())


def test_an_open_port_is_named():
    plant = chain()
    plant.control("mixer", mixer(1))
    with pytest.raises(PlantError, match=r"mixer.m_flow_1 \[kg/s\] is not connected"):
        plant.order()


def test_blocks_that_wait_for_each_other_are_named():
    plant = chain()
    same = Block("same", (Quantity("a", "1", ""),), (Quantity("b", "1", ""),), lambda m, u, p: ({"b": u.a}, {}))
    for name in ("one", "two"):
        plant.control(name, same)
    plant.connect("one.b", "two.a")
    plant.connect("two.b", "one.a")
    with pytest.raises(PlantError, match=r"wait for each other: (one|two) -> "):
        plant.order()


def test_mixer_conserves_heat():
    step = mixer(2).step

    class U:
        m_flow_1, m_flow_2, T_1, T_2 = 0.1, 0.3, 60.0, 20.0

    out, _ = step(None, U, None)
    assert out["m_flow"] == pytest.approx(0.4)
    assert out["T"] == pytest.approx(30.0)


def test_many_components_step_as_the_few():
    plant = chain()
    for i in range(2, 6):
        plant.add(f"radiator{i}", get_model("radiator", sections=2, surroundings=False))
        for source, port in (("source.T", "T_supply"), ("room.T", "T_room"), ("source.m_flow", "m_flow")):
            plant.connect(source, f"radiator{i}.{port}")
        plant.sensor(f"radiator{i}.T_return")
    measured_values = np.concatenate([b.measured for b in Simulator(plant, 300.0, 3).run(outside(2000))])[500:]
    means = measured_values.mean(axis=0)
    assert np.ptp(means) < 0.2
    assert means.std() > 0  # each has its own noise
