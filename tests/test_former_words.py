"""Words of the version before are taken, told, and mean what the present ones mean."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest

from fdd.config import ConfigError, check_site, parse_site
from fdd.records import Baseline
from fdd.service.baselines.versions import accept, in_force
from fdd.store.sqlite import SqliteStore

PRESENT = """
name: house
step: 5 min
points:
  outdoor: {unit: degC}
  sun: {unit: W/m^2}
  heater: {unit: W}
  indoor: {unit: degC}
reidentify: {deadband: 0.03}
equipment:
  house:
    model: zone
    inputs: {T_out: outdoor, I_solar: sun, P_heat: heater}
    outputs: {T_room: indoor}
    charts: {kinds: [cusum, flatline], exclude: [T_room]}
"""
FORMER = PRESENT.replace("T_room", "T_in").replace("flatline", "still").replace("deadband", "slack")


def test_former_site_file_is_the_present_one_and_says_the_new_words() -> None:
    former, present = parse_site(FORMER), parse_site(PRESENT)
    assert former.model_dump() == present.model_dump()
    told = {str(f) for f in check_site(former)} - {str(f) for f in check_site(present)}
    assert len(told) == 4
    assert any("equipment.house.outputs: 'T_in' is called 'T_room' now" in t for t in told)
    assert any("reidentify: 'slack' is called 'deadband' now" in t for t in told)


def test_a_former_and_a_present_word_together_are_refused() -> None:
    with pytest.raises(ConfigError, match="slack"):
        parse_site(PRESENT.replace("{deadband: 0.03}", "{deadband: 0.03, slack: 0.02}"))


def test_a_symbol_that_another_model_still_has_is_left_alone() -> None:
    pipe = """
name: pipe
step: 5 min
points: {a: {unit: degC}, b: {unit: kg/s}, c: {unit: degC}, d: {unit: degC}}
equipment:
  pipe: {model: pipe_thermal, inputs: {T_in: a, m_flow: b, T_around: c}, outputs: {T_out: d}}
"""
    site = parse_site(pipe)
    assert site.equipment["pipe"].inputs["T_in"] == "a"
    assert not site.former


def test_baseline_of_the_version_before_is_read_in_present_words(tmp_path) -> None:
    b = Baseline(
        component="house", version=1, model="zone", model_version="1", options={}, parameters={"C_i": 1.0},
        standard_errors={}, covariance=[], start=0, end=1, samples=1, log_likelihood=0.0,
        innovation={"T_in": {"mean": 0.0, "sd": 1.0}},
        diagnostics={"still": {"T_in": {"runs": 3}}, "score_together": 0.5},
    )  # fmt: skip
    store = SqliteStore(tmp_path / "store.sqlite")
    accept(store, b)
    exchanger = replace(b, component="hx", model="heat_exchanger", parameters={"U": 4e3}, innovation={}, diagnostics={})
    accept(store, exchanger)
    found = in_force(store, ["house", "hx"])
    assert list(found["house"].innovation) == ["T_room"]
    assert asdict(found["house"])["diagnostics"] == {"flatline": {"T_room": {"runs": 3}}, "effective_share": 0.5}
    assert found["hx"].parameters == {"UA": 4e3}
    store.close()
