"""Causes are ranked by how their signatures agree with what rang."""

from __future__ import annotations

import pytest

from fdd.diagnosis.advice import advice, checks_of
from fdd.diagnosis.hypotheses import hypotheses
from fdd.diagnosis.ranking import diagnose, severity
from fdd.evidence import ChartEvidence, ChartKind, Evidence
from fdd.models.heat_exchanger import heat_exchanger
from fdd.models.registry import MODELS, get_model
from fdd.records import Alarm, AlarmState, JsonObject
from fdd.report.telling import Speaker


def alarm(**given: JsonObject) -> Alarm:
    charts = {f"hx/{c['symbol']}:cusum": ChartEvidence.read(f"hx/{c['symbol']}:cusum", c) for c in given.values()}
    return Alarm(
        key="hx@t",
        component="hx",
        state=AlarmState.RAISED,
        since=0,
        raised=1,
        updated=1,
        charts=tuple(charts),
        evidence=Evidence(charts),
    )


def test_less_transfer_and_both_outlets_apart_is_fouling() -> None:
    found = diagnose(
        heat_exchanger(),
        alarm(
            a={"symbol": "T_hot_out", "direction": 1},
            b={"symbol": "T_cold_out", "direction": -1},
        ),
    )
    assert found.causes[0].name == "fouling"
    assert found.causes[0].likelihood > 0.5
    assert "deposits" in Speaker().say(found.causes[0].meaning, "hx")
    assert found.checks


def test_one_outlet_alone_speaks_for_its_sensor_more_than_two_outlets_do() -> None:
    one = diagnose(heat_exchanger(), alarm(a={"symbol": "T_hot_out", "direction": 1}))
    two = diagnose(
        heat_exchanger(),
        alarm(a={"symbol": "T_hot_out", "direction": 1}, b={"symbol": "T_cold_out", "direction": -1}),
    )

    def share(found: object, name: str) -> float:
        return next(c.likelihood for c in found.causes if c.name == name)  # type: ignore[attr-defined, no-any-return]

    assert share(one, "fouling") < share(two, "fouling")


def test_a_correlated_parameter_does_not_speak_against_the_cause_that_explains_its_twin() -> None:
    model = heat_exchanger()
    names = [p.symbol for p in model.parameters if p.kind == "physical"]
    fouling = next(f for f in model.faults if f.name == "fouling")
    moved = next(s for s in fouling.shows if s in names)
    twin = next(s for s in names if s not in fouling.shows)
    strong = {"change": -0.1, "standard_error": 0.01}
    found = diagnose(
        model,
        alarm(
            a={"symbol": moved, "direction": fouling.shows[moved], **strong},
            b={"symbol": twin, "direction": 1, **strong},
        ),
    )
    cause = next(c for c in found.causes if c.name == "fouling")
    assert cause.speaks_against == ()


def test_likelihoods_add_up_to_one() -> None:
    found = diagnose(heat_exchanger(), alarm(a={"symbol": "T_hot_out", "direction": -1}))
    assert abs(sum(c.likelihood for c in found.causes) - 1) < 0.01


@pytest.mark.parametrize(
    ("change", "error", "expected"),
    [
        (-0.05, 0.01, "low"),
        (-0.12, 0.01, "medium"),
        (0.12, 0.05, "low"),  # 2.4 standard errors
        (-0.3, 0.02, "high"),
        (-0.3, 0.15, "medium"),
    ],
)
def test_severity_is_size_and_certainty(change: float, error: float, expected: str) -> None:
    chart = ChartEvidence("C", ChartKind.SCORE, change=change, standard_error=error, scale="relative")
    assert severity([ChartEvidence("T_out", ChartKind.CUSUM), chart]) == expected


def test_severity_without_a_size_is_medium() -> None:
    assert severity([ChartEvidence("T_out", ChartKind.CUSUM, 20.0)]) == "medium"


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_check_of_every_model_says_what_reading_to_expect(name: str) -> None:
    model = get_model(name, **({"rooms": ("a", "b")} if name == "building" else {}))
    physical = tuple(p.symbol for p in model.parameters if p.kind == "physical")
    for h in hypotheses(model, physical):
        checks = advice(h, h.size)
        assert checks, (name, h.name)
        assert [c for c in checks if ": " not in Speaker().say(c, "")] == [], (name, h.name)
    for fault in model.faults:
        assert [c for c in checks_of(fault.name, fault.checks) if c.code != "check"] == [], (name, fault.name)
