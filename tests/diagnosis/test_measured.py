"""Causes ranked by the likelihood of a departure made by hand from physics, not from the signatures."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.departure import Departure
from fdd.diagnosis.likelihood import log_density
from fdd.diagnosis.measured import measured_causes
from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model
from fdd.plant.district import models
from fdd.records import FloatArray
from fdd.report.telling import Speaker


def departure(
    model: ComponentModel, shift: dict[str, float], mean: dict[str, float], jump: dict[str, float]
) -> Departure:
    """Parameters seen with a standard error of 1 % each for themselves, a thousand samples of each output."""
    physical = [p for p in model.parameters if p.kind == "physical"]
    symbols = tuple(p.symbol for p in physical)
    information = np.eye(len(symbols)) * 1e4

    def column(table: dict[str, float], order: tuple[str, ...]) -> FloatArray:
        return np.array([table.get(s, 0.0) for s in order])

    outputs = model.symbols["outputs"]
    return Departure(
        symbols=symbols,
        values=np.array([p.typical for p in physical]),
        score=information @ column(shift, symbols),
        information=information,
        spread=np.ones(len(symbols)),
        baseline=np.eye(len(symbols)) * 1e-4,
        outputs=outputs,
        innovation=1000 * column(mean, outputs),
        count=np.full(len(outputs), 1000.0),
        jump=column(jump, outputs),
    )


@pytest.mark.parametrize(
    ("component", "shift", "mean", "jump", "name", "where"),
    [
        # More heat leaves the south room, which is colder than foretold; the other room does not notice.
        ("building", {"B_out_south": 0.25}, {"T_south": -1.2}, {}, "open-window-south", ""),
        # The reading of one room jumps, and its neighbour seems to lose heat to it.
        ("building", {"B_out_south": -0.06}, {"T_south": 0.35, "T_north": -0.1}, {"T_south": 11.0}, "bias-south",
         "T_south"),
        # One outlet alone is off: heat given off and taken up no longer agree.
        ("hx", {"C": -0.05, "y": -0.1}, {"T_cold_out": 10.0}, {"T_cold_out": 12.0}, "bias", "T_cold_out"),
    ],
)  # fmt: skip
def test_physics_made_by_hand_is_rightly_named(
    component: str, shift: dict[str, float], mean: dict[str, float], jump: dict[str, float], name: str, where: str
) -> None:
    model = models()[component]
    causes = measured_causes(model, departure(model, shift, mean, jump))
    assert (causes[0].name, causes[0].where) == (name, where), causes
    assert causes[0].likelihood > 0.5
    assert causes[0].checks
    assert all(": " in Speaker().say(check, "") for check in causes[0].checks)


def test_likelihoods_with_that_of_the_model_add_up_to_one() -> None:
    building = models()["building"]
    causes = measured_causes(building, departure(building, {"B_out_south": 0.25}, {"T_south": -1.2}, {}))
    assert sum(c.likelihood for c in causes) == pytest.approx(1.0, abs=0.03)


def test_what_no_signature_explains_is_told_as_such() -> None:
    radiator = models()["radiator-south"]
    causes = measured_causes(radiator, departure(radiator, {"C": 0.9, "H": -0.9}, {"T_return": -6.0}, {}))
    assert causes[0].name == "model"


def test_a_model_that_nobody_measured_is_left_to_its_declared_signs() -> None:
    pump = get_model("pump")
    p = [q for q in pump.parameters if q.kind == "physical"]
    n = len(p)
    seen = Departure(
        tuple(q.symbol for q in p), np.ones(n), np.zeros(n), np.eye(n), np.ones(n), np.zeros((n, n)),
        pump.symbols["outputs"], np.ones(2), np.ones(2), np.zeros(2),
    )  # fmt: skip
    assert measured_causes(pump, seen) == ()


ZONE = ("C_i", "C_e", "R_ie", "R_ea", "A_w")


@pytest.mark.parametrize(
    ("shift", "mean", "jump", "name", "where"),
    [
        # A heater that gives 0.8 of what is metered: the balance divided by 0.8 has larger C and A_w and smaller R.
        ({s: 0.223 * (-1 if s.startswith("R") else 1) for s in ZONE}, -2.0, 0.0, "heater", ""),
        # A window that stands open: only the resistance to the outside falls.
        ({"R_ea": -0.262}, -2.0, 0.0, "open-window", ""),
        # A sensor that is off from one sample to the next: the reading jumps, the physics stays.
        ({"R_ea": 0.03}, 0.3, 25.0, "bias", "T_room"),
    ],
)
def test_a_zone_tells_its_sensor_from_its_heater(
    shift: dict[str, float], mean: float, jump: float, name: str, where: str
) -> None:
    model = get_model("zone", nodes="TiTe")
    assert tuple(p.symbol for p in model.parameters if p.kind == "physical") == ZONE
    causes = measured_causes(model, departure(model, shift, {"T_room": mean}, {"T_room": jump}))
    assert (causes[0].name, causes[0].where) == (name, where), causes
    assert all(": " in Speaker().say(check, "") for cause in causes[:3] for check in cause.checks)


def test_signatures_of_another_form_of_the_model_are_not_used() -> None:
    from fdd.diagnosis.hypotheses import hypotheses

    for nodes in ("Ti", "TiTe", "TiTeTh"):
        model = get_model("zone", nodes=nodes)
        physical = tuple(p.symbol for p in model.parameters if p.kind == "physical")
        names = [(h.name, h.where) for h in hypotheses(model, physical) if h.measured]
        assert len(names) == len(set(names)) == 5, nodes
    model = get_model("zone", nodes="TiTh")
    assert not any(h.measured for h in hypotheses(model, tuple(p.symbol for p in model.parameters)))


def test_a_covariance_indefinite_by_rounding_alone_is_judged() -> None:
    rng = np.random.default_rng(0)
    wide = rng.standard_normal((40, 3)) * 1e9
    covariance = wide @ wide.T + np.eye(40)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(covariance)
    along, across = wide[:, 0], np.full(40, 1e8)
    assert log_density(along, covariance) > log_density(across, covariance)


def test_density_is_that_of_the_normal_distribution() -> None:
    rng = np.random.default_rng(1)
    root, white = rng.standard_normal((12, 12)) * np.geomspace(1e-3, 1e3, 12)[:, None], rng.standard_normal(12)
    exact = -0.5 * white @ white - np.linalg.slogdet(root)[1]
    assert log_density(root @ white, root @ root.T) == pytest.approx(exact, rel=1e-6)
