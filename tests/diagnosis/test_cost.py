"""The cost of a fault a day against balances done by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.cost import CP, Tariffs, daily_cost, with_cost
from fdd.diagnosis.departure import Departure, Operation
from fdd.evidence import Cause, Cost, Message
from fdd.models.declare import ComponentModel
from fdd.models.registry import get_model

TARIFFS: Tariffs = {"currency": "EUR", "heat": 0.1, "electricity": 0.3}


def moved(model: ComponentModel, symbol: str, change: float, error: float) -> Departure:
    """One parameter has moved by ``change`` on its estimation scale, seen with ``error``; the others are not seen."""
    physical = [p for p in model.parameters if p.kind == "physical"]
    n, j = len(physical), [p.symbol for p in physical].index(symbol)
    information = np.zeros((n, n))
    information[j, j] = 1 / error**2
    score = np.zeros(n)
    score[j] = change / error**2
    outputs = model.symbols["outputs"]
    return Departure(
        symbols=tuple(p.symbol for p in physical),
        values=np.array([p.typical for p in physical]),
        score=score,
        information=information,
        spread=np.ones(n),
        baseline=np.zeros((n, n)),
        outputs=outputs,
        innovation=np.zeros(len(outputs)),
        count=np.ones(len(outputs)),
        jump=np.zeros(len(outputs)),
    )


def hours(**values: float) -> Operation:
    return Operation({s: np.full(24, v) for s, v in values.items()})


def test_an_envelope_that_loses_more_costs_the_extra_heat_of_a_day() -> None:
    model = get_model("zone", nodes="Ti")
    typical = next(p.typical for p in model.parameters if p.symbol == "R_ia")
    found = daily_cost(
        model, moved(model, "R_ia", -0.2, 0.02), hours(T_room=21.0, T_out=1.0, I_solar=0.0, P_heat=0.0), (), TARIFFS
    )
    energy = (np.exp(0.2) - 1) / typical * 20.0 * 24 / 1000
    assert found.energy == pytest.approx(energy)
    assert found.value == pytest.approx(0.1 * energy)
    assert found.lower < found.value < found.upper
    assert found.upper == pytest.approx(0.1 * (np.exp(0.2 + 1.96 * 0.02) - 1) / typical * 20.0 * 24 / 1000)


def test_a_fouled_exchanger_costs_the_heat_that_a_clean_one_would_pass() -> None:
    model = get_model("heat_exchanger", transfer="constant")
    drive, flow, units = 40.0, 0.5, 2.0
    # Equal flows: the effectiveness of N transfer units is N / (1 + N).
    heat = CP * flow * drive * units / (1 + units)
    operation = hours(
        m_flow_hot=flow, m_flow_cold=flow, T_hot_in=80.0, T_cold_in=40.0, T_hot_out=80.0 - heat / (CP * flow),
        T_cold_out=40.0 + heat / (CP * flow),
    )  # fmt: skip
    found = daily_cost(model, moved(model, "UA", np.log(0.8), 0.01), operation, (), TARIFFS)
    clean = CP * flow * drive * (units / 0.8) / (1 + units / 0.8)
    assert found.energy == pytest.approx((clean - heat) * 24 / 1000, rel=0.01)
    assert found.currency == "EUR"


def test_a_radiator_loses_comfort_and_no_energy() -> None:
    model = get_model("radiator", sections=2, surroundings=False)
    found = daily_cost(
        model,
        moved(model, "H", np.log(0.7), 0.01),
        hours(T_supply=60.0, T_room=20.0, m_flow=0.1, T_return=40.0),
        (),
        TARIFFS,
    )
    given, before = CP * 0.1 * 20.0, CP * 0.1 * 40.0 * (1 - 0.5 ** (1 / 0.7))
    assert found.kind == "comfort"
    assert found.value is None
    assert found.why
    assert found.energy == pytest.approx((before - given) * 24 / 1000)


def test_what_cannot_be_told_is_said_in_words() -> None:
    model = get_model("zone", nodes="Ti")
    departure = moved(model, "R_ia", -0.2, 0.02)
    operation = hours(T_room=21.0, T_out=1.0, I_solar=0.0, P_heat=0.0)
    sensor = daily_cost(model, departure, operation, (Cause("bias", Message.of("chance"), kind="sensor"),), TARIFFS)
    unpriced = daily_cost(model, departure, operation, (), {"currency": "EUR", "heat": None})
    unseen = daily_cost(model, departure, Operation({}), (), TARIFFS)
    for found in (sensor, unpriced, unseen):
        assert found.value is None
        assert found.why
    assert unpriced.energy > 0


@pytest.mark.parametrize(
    ("severity", "value", "lower", "upper", "expected"),
    [
        ("medium", 12.0, 1.0, 30.0, "high"),  # dear, and surely a loss
        ("medium", 12.0, -1.0, 30.0, "medium"),  # perhaps no loss at all
        ("medium", 9.9, 5.0, 15.0, "medium"),
        ("medium", 0.1, -0.1, 0.4, "low"),  # surely cheap
        ("medium", 0.1, -0.1, 0.6, "medium"),
        ("high", 100.0, 90.0, 110.0, "high"),
        ("low", 0.1, 0.0, 0.2, "low"),
        ("medium", None, None, None, "medium"),  # no price
    ],
)
def test_severity_follows_cost(
    severity: str, value: float | None, lower: float | None, upper: float | None, expected: str
) -> None:
    cost = Cost(value=value, lower=lower, upper=upper)
    assert with_cost(severity, cost, {"dear": 10.0, "cheap": 0.5}) == expected
