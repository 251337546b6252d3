import json

import numpy as np
import pytest

from fdd.greybox.equations import trace
from fdd.models.declare import ModelError
from fdd.models.registry import MODELS, get_model, register
from tests.models.numeric import drift, typical


@pytest.mark.parametrize("name", sorted(MODELS))
class TestEveryModel:
    def test_traces(self, name):
        trace(get_model(name))

    def test_options_rebuild_the_same_model_after_json(self, name):
        model = get_model(name)
        again = get_model(name, **json.loads(json.dumps(dict(model.options))))
        assert again.symbols == model.symbols
        assert again.parameters == model.parameters

    def test_faults_show_through_what_the_model_has(self, name):
        model = get_model(name)
        parameters = {p.symbol for p in model.parameters if p.kind == "physical"}
        outputs = {f"innovation:{q.symbol}" for q in model.outputs}
        assert model.faults
        for fault in model.faults:
            assert fault.shows.keys() <= parameters | outputs, fault.name
            assert fault.checks, fault.name

    def test_declares_units_sources_and_where_it_holds(self, name):
        model = get_model(name)
        known = {q.symbol for q in (*model.inputs, *model.outputs)}
        assert model.references
        assert all(p.source and p.unit and p.meaning for p in model.parameters)
        assert model.valid
        assert model.valid.keys() <= known


def test_unknown_model_and_option_are_refused_with_the_nearest():
    with pytest.raises(ModelError, match="did you mean 'radiator'"):
        get_model("radiatr")
    with pytest.raises(ModelError, match="did you mean 'sections'"):
        get_model("radiator", section=2)


def test_registering_a_name_twice_is_an_error():
    with pytest.raises(ModelError, match="already registered"):
        register("radiator", MODELS["radiator"])


def test_fixed_and_tied_parameters_leave_the_table_but_not_the_equations():
    full = get_model("heat_exchanger")
    less = get_model("heat_exchanger", fixed={"M_hot": 4.0}, tied={"C_cold": "C_hot", "M_cold": "M_hot"})
    assert {p.symbol for p in full.parameters} - {p.symbol for p in less.parameters} == {"M_hot", "M_cold", "C_cold"}
    u = {"m_flow_hot": 0.4, "m_flow_cold": 0.5, "T_hot_in": 75.0, "T_cold_in": 35.0}
    x = np.array([70.0, 60, 50, 38, 45, 50])
    expected = drift(full, x, u, typical(full, M_hot=4.0, M_cold=4.0, C_hot=7e3, C_cold=7e3))
    assert drift(less, x, u, typical(less, C_hot=7e3)) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fixed": {"M": 1.0}}, "no parameter 'M'"),
        ({"fixed": {"M_hot": -1.0}}, "outside"),
        ({"tied": {"M_hot": "M_cold", "M_cold": "M_hot"}}, "itself tied"),
        ({"fixed": {"M_hot": 4.0}, "tied": {"M_hot": "M_cold"}}, "keep one"),
    ],
)
def test_restrictions_that_make_no_sense_are_refused(options, words):
    with pytest.raises(ModelError, match=words):
        get_model("heat_exchanger", **options)
