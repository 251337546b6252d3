"""The committed matrix of faults against parameters is complete, is its own page, and is what is measured."""

import pytest

from benchmarks.fault_matrix import FAULTS, FOLDER, HOUSE, SHOWN, differences, measured, measured_house, page, stored
from fdd.models.registry import MODELS, get_model


def test_the_page_is_made_of_the_stored_matrix():
    assert (FOLDER / "matrix.md").read_text(encoding="utf-8") == page(stored())


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_declared_fault_was_measured_with_the_model_as_it_is(name):
    model, table = get_model(name), stored()["models"][name]
    assert table["version"] == model.version, "equations have changed: python -m benchmarks.fault_matrix --write"
    declared = {f.name for f in model.faults}
    assert declared == {f.name for f in FAULTS[name]} == set(table["faults"])


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_fault_shows_and_declared_signs_are_those_measured(name):
    for fault in get_model(name).faults:
        row = stored()["models"][name]["faults"][fault.name]
        assert max(abs(z) for z in row.values()) >= SHOWN, fault.name
        if "bias" in fault.name or fault.name in ("scaling", "stuck"):
            continue  # an instrument errs to either side
        for target, sign in fault.shows.items():
            z = row.get(target.replace("innovation:", "mean of "), 0.0)
            assert abs(z) < SHOWN or sign == 0 or z * sign > 0, (fault.name, target, z)


@pytest.mark.parametrize("name", ["control_valve", "heat_exchanger", "pump", "thermostatic_valve", "zone"])
def test_stored_shifts_are_those_measured_today(name):
    assert differences(stored()["models"][name]["faults"], measured(name), name) == []


def test_a_moved_cell_is_told():
    old = stored()["models"]["pump"]["faults"]
    new = {**old, "wear": {**old["wear"], "p_0": 0.9 * old["wear"]["p_0"]}}
    assert len(differences(old, new, "pump")) == 1
    assert len(differences({}, old, "pump")) == sum(map(len, old.values()))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(MODELS))
def test_stored_shifts_of_all_models_are_those_measured_today(name):
    assert differences(stored()["models"][name]["faults"], measured(name), name) == []


@pytest.mark.slow
def test_stored_shifts_of_the_house_are_those_measured_today():
    assert differences(stored()["house"], measured_house(), "house") == []
    assert set(stored()["house"]) == set(HOUSE)
