"""Every kind of fault does to the signals what it says: from its onset on, by its severity, in its shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
import pytest

from fdd.models.registry import get_model
from fdd.plant.district import district_plant
from fdd.plant.faults import DAY, KINDS, PlantFault, course, effects
from fdd.plant.network import Network, PlantError
from fdd.plant.scenario import Scenario, simulate
from fdd.plant.simulate import Simulator

ONSET, DAYS, STEPS = 2, 6, 288
RETURN = "radiator-south.T_return"  # no controller sees it
Effect = Callable[[pd.DataFrame, pd.DataFrame], float]


def shift(point: str) -> Effect:
    """How much higher a point is than in health, on average."""
    return lambda faulty, healthy: float((faulty[point] - healthy[point]).mean())


def roughness(point: str) -> Effect:
    """How much more a point moves from sample to sample than in health."""
    return lambda faulty, healthy: float(np.log(faulty[point].diff().abs().mean() / healthy[point].diff().abs().mean()))


def flat_runs(point: str) -> Effect:
    """Share of the steps in which a flow stands still, less that in health: the meter's own error is below 0.5 %."""

    def still(frame: pd.DataFrame) -> float:
        return float((frame[point].diff().abs() < 0.005 * frame[point]).mean())

    return lambda faulty, healthy: still(faulty) - still(healthy)


def frozen(point: str) -> Effect:
    """Share of the samples that repeat the one before, to the last digit, less that in health."""
    return lambda faulty, healthy: float((faulty[point].diff() == 0).mean() - (healthy[point].diff() == 0).mean())


def apart(point: str) -> Effect:
    """How far a point is from what it would read in health, on average."""
    return lambda faulty, healthy: float((faulty[point] - healthy[point]).abs().mean())


def lowest(point: str) -> Effect:
    """How much higher the lowest flow is than in health."""
    return lambda faulty, healthy: float(faulty[point].min() - healthy[point].min())


@dataclass(frozen=True)
class Shown:
    """Where a fault of a severity shows, with its sign and at least how much of it."""

    target: str
    severity: float
    effect: Effect
    sign: int
    least: float
    graded: bool = True


SHOWN = {
    "fouling": Shown("hx", 0.3, shift("hx.T_hot_out"), 1, 1.0),
    "air": Shown("radiator-south", 0.4, shift(RETURN), 1, 1.0),
    "sludge": Shown("radiator-north", 0.5, shift("radiator-north.m_flow"), -1, 0.005),
    "leak": Shown("valve-south", 0.3, lowest("radiator-south.m_flow"), 1, 0.02),
    "stick": Shown("valve-south", 0.2, flat_runs("radiator-south.m_flow"), 1, 0.3),
    "stuck": Shown("valve-north", 1.0, flat_runs("radiator-north.m_flow"), 1, 0.6, graded=False),
    "hunting": Shown("controller", 25.0, roughness("hx.T_cold_out"), 1, 0.41),
    "bias": Shown(RETURN, 1.0, shift(RETURN), 1, 0.9),
    "drift": Shown(RETURN, -1.0, shift(RETURN), -1, 0.5),
    "noise": Shown(RETURN, 9.0, roughness(RETURN), 1, 1.1),
    "scaling": Shown("radiator-south.m_flow", 0.1, shift("radiator-south.m_flow"), 1, 0.002),
    "freeze": Shown(RETURN, 1.0, frozen(RETURN), 1, 0.99, graded=False),
    "swap": Shown(f"{RETURN} | radiator-north.T_return", 1.0, apart(RETURN), 1, 0.5, graded=False),
}


@cache
def run(fault: PlantFault | None = None) -> pd.DataFrame:
    """Six days of the house."""
    return simulate(Scenario(days=DAYS, seed=3, faults=(fault,) if fault else ()))


def made(kind: str, share: float = 1.0, shape: str = "step", duration: float = DAY) -> PlantFault:
    """The kind's fault; a drift has no step."""
    if kind == "drift" and shape == "step":
        shape, duration = "ramp", 1.0
    shown = SHOWN[kind]
    return PlantFault(kind, shown.target, ONSET * DAY, share * shown.severity, shape, duration)  # type: ignore[arg-type]


def seen(kind: str, fault: PlantFault, first: float, last: float) -> float:
    """The effect between two days after the start, in the direction that the fault shall have."""
    part = slice(round(first * STEPS), round(last * STEPS))
    return SHOWN[kind].sign * SHOWN[kind].effect(run(fault).iloc[part], run().iloc[part])


def test_every_kind_is_shown():
    assert set(SHOWN) | {"wear"} == set(KINDS)  # the house has no pump; the worn pump has a plant of its own below


@pytest.mark.parametrize("kind", SHOWN)
class TestKind:
    def test_nothing_changes_before_the_onset(self, kind):
        assert run(made(kind))[: ONSET * STEPS].equals(run()[: ONSET * STEPS])

    def test_the_signal_changes_as_said(self, kind):
        assert seen(kind, made(kind), ONSET + 1, DAYS) > SHOWN[kind].least

    def test_more_of_it_shows_more(self, kind):
        full, half = (seen(kind, made(kind, share), ONSET + 1, DAYS) for share in (1.0, 0.5))
        if SHOWN[kind].graded:
            assert 0 < half < full
        else:  # it is there or not
            assert half == full

    def test_a_ramp_is_less_than_a_step_at_first_and_there_in_the_end(self, kind):
        fault = made(kind, shape="ramp", duration=3 * DAY)
        early, late = seen(kind, fault, ONSET, ONSET + 1), seen(kind, fault, ONSET + 2, ONSET + 3)
        if SHOWN[kind].graded:
            assert early < 0.7 * seen(kind, made(kind), ONSET, ONSET + 1)
            assert late > 0
        else:
            assert late == seen(kind, made(kind), ONSET + 2, ONSET + 3)

    def test_an_intermittent_fault_comes_and_goes(self, kind):
        fault = made(kind, shape="intermittent")
        assert seen(kind, fault, ONSET + 0.2, ONSET + 1) > 0
        away = slice(round((ONSET + 1.9) * STEPS), round((ONSET + 2) * STEPS))
        gap = (run(fault) - run()).iloc[away].abs()
        at_first = (run(fault) - run()).iloc[ONSET * STEPS : (ONSET + 1) * STEPS].abs()
        assert gap.max().max() < 0.5 * at_first.max().max()
        # Four days hold the fault, nothing, the fault, nothing.
        assert seen(kind, fault, ONSET + 2.2, ONSET + 3) > 0


STEADY = np.arange(0.0, DAYS * DAY, 300.0)


@pytest.mark.parametrize("shape", ["step", "ramp", "intermittent"])
@pytest.mark.parametrize("kind", ["bias", "drift", "scaling", "noise", "freeze", "swap"])
def test_a_sensor_errs_by_exactly_its_severity_times_its_course(kind, shape):
    if kind == "drift" and shape == "step":
        pytest.skip("a drift has no step")
    fault = made(kind, shape=shape, duration=1.5 * DAY)
    extent, point = course(fault, STEADY), fault.target.partition(" ")[0]
    value, healthy = run(fault)[point].to_numpy(), run()[point].to_numpy()
    change = value - healthy
    if kind in ("bias", "drift"):
        assert change == pytest.approx(fault.severity * extent, abs=1e-9)
    elif kind == "scaling":
        assert change == pytest.approx(fault.severity * extent * healthy, abs=1e-9)
    elif kind == "noise":
        z = change[extent > 0] / extent[extent > 0] / (fault.severity * 0.05)
        assert z.std() == pytest.approx(1.0, abs=5 / np.sqrt(2 * len(z)))
        assert abs(z.mean()) < 5 / np.sqrt(len(z))
    elif kind == "freeze":
        for block in np.split(value, np.flatnonzero(np.diff(extent > 0)) + 1)[1::2]:
            assert np.ptp(block) == 0.0
        assert (change[extent == 0] == 0.0).all()
    else:
        other = run()["radiator-north.T_return"].to_numpy()
        off = (value - other)[extent > 0]
        assert np.abs(off).max() < 6 * 0.05 * np.sqrt(2)  # each sensor keeps its own error
        assert (change[extent == 0] == 0.0).all()


@pytest.mark.parametrize(
    ("kind", "target", "symbols"),
    [("fouling", "hx", ["hx.C"]), ("air", "radiator-south", ["radiator-south.H", "radiator-south.C"]),
     ("sludge", "radiator-north", ["radiator-north.H", "valve-north.m_full"])],
)  # fmt: skip
def test_what_a_fault_takes_away_follows_its_course(kind, target, symbols):
    plant, fault = district_plant(), PlantFault(kind, target, DAY, 0.4, "ramp", 2 * DAY)
    changes, sensors = effects(plant, (fault,), STEADY)
    assert not sensors
    assert [c.target for c in changes] == symbols
    extent = course(fault, STEADY)
    for change in changes:
        loss = 1.0 - change.values / change.values[0]
        full = {"radiator-south.C": 0.2, "radiator-north.H": 0.2}.get(change.target, 0.4)
        assert loss == pytest.approx(full * extent, abs=1e-12)


def test_a_drift_that_jumps_is_refused():
    with pytest.raises(PlantError, match="bias"):
        effects(district_plant(), (PlantFault("drift", RETURN, 0.0, 1.0),), STEADY)


@cache
def heads(shape: str, severity: float) -> np.ndarray:
    """Measured head of a pump at steady speed and flow, every minute; the fault begins in the middle."""
    plant = Network()
    plant.add("pump", get_model("pump"))
    for symbol, unit in (("speed", "1"), ("m_flow", "kg/s")):
        plant.signal(f"in.{symbol}", unit)
        plant.connect(f"in.{symbol}", f"pump.{symbol}")
    plant.sensor("pump.dp_pump")
    fault = PlantFault("wear", "pump", 200 * 60.0, severity, shape, 100 * 60.0)  # type: ignore[arg-type]
    changes, sensors = effects(plant, (fault,), np.arange(400) * 60.0)
    outside = {"in.speed": np.full(400, 1.0), "in.m_flow": np.full(400, 1.0)}
    return np.concatenate([b.measured for b in Simulator(plant, 60.0, 1).run(outside, changes, sensors)])[:, 0]


@pytest.mark.parametrize("severity", [0.1, 0.2])
def test_a_worn_pump_loses_head_by_its_severity_in_its_shape(severity):
    lost = severity * 6e4  # p_0 at full speed
    for shape, early, late in (("step", 1.0, 1.0), ("ramp", 0.5, 1.0), ("intermittent", 1.0, 0.0)):
        head = heads(shape, severity)
        assert np.array_equal(head[:200], heads("step", 0.0)[:200])
        fell = heads("step", 0.0) - head
        assert fell[245:256].mean() == pytest.approx(early * lost, rel=0.05, abs=0.01 * lost)
        assert fell[320:390].mean() == pytest.approx(late * lost, rel=0.05, abs=0.01 * lost)
