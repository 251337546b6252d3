"""Every chart that the engine can raise has its title in every catalogue."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import fdd
from fdd.chiller_eiv.rows import state_chart, weekly_chart
from fdd.diagnosis.health import TESTS
from fdd.evidence import ChartKind, parts_of
from fdd.models.registry import MODELS, get_model
from fdd.records import Alarm
from fdd.report.language import language, languages
from fdd.report.telling import Speaker
from fdd.service.engine.engine import Engine
from tests.report import plant
from tests.service import conftest, test_row_monitors


def _charts() -> set[str]:
    """Names of the charts that an engine with filters, rows and chillers writes."""
    filters = Engine(conftest.plan(), conftest.baselines())
    rows = Engine(test_row_monitors.plan(), {})
    outputs = [
        filters.step(conftest.simulate(3, seed=1).batch()),
        rows.step(test_row_monitors.batch([(test_row_monitors.FINE, 8.0)])),
        rows.flush(),
    ]
    written = {n for o in outputs for r in o.rows if r.measurement == "charts" for n in r.names}
    return written | {state_chart("lab"), weekly_chart("lab", "R")}


@pytest.mark.parametrize("code", languages())
def test_every_chart_that_can_ring_has_a_title(code: str) -> None:
    kinds = {parts_of(name)[1] for name in _charts()}
    assert len(kinds) >= 8
    titles = language(code).sections["charts"]
    assert kinds <= set(titles)
    assert set(titles) == set(ChartKind)
    assert len(set(titles.values())) == len(titles)


FDD = Path(fdd.__file__).parent
PLACES = re.compile(r"{(\w+)")


def _codes() -> set[str]:
    """Codes of the messages that the engine can give, from its source."""
    text = "".join(f.read_text() for room in ("diagnosis", "service") for f in (FDD / room).rglob("*.py"))
    plain = set(re.findall(r"(?:Message\.of|_by_service)\(\s*(?:time, |why\.time, )?\"(\w+)\"", text))
    plain |= {f"{what}_{side}" for what in ("parameter", "output") for side in ("above", "below")} | {"jumped"}
    return plain | {*TESTS.values(), "sensor_keeps", "meter_share", "sensor_constant", "check"}


@pytest.mark.parametrize("code", languages())
def test_every_message_has_its_words_with_the_same_arguments(code: str) -> None:
    assert len(_codes()) > 40
    english, other = language("en").sections, language(code).sections
    assert _codes() <= set(other["messages"])
    for section in ("charts", "messages", "words"):
        assert set(english[section]) == set(other[section])
        for key, template in english[section].items():
            assert sorted(PLACES.findall(template)) == sorted(PLACES.findall(other[section][key])), key


@pytest.mark.parametrize("code", sorted(set(languages()) - {"en"}))
def test_every_fault_and_output_of_a_model_has_its_title_in_other_languages(code: str) -> None:
    models = [get_model(name) for name in MODELS if name != "building"]  # a building's rooms have names of their own
    texts = {f.meaning for m in models for f in m.faults} | {q.meaning for m in models for q in m.outputs}
    assert len(texts) > 30
    assert texts <= set(language(code).sections["declared"])


def test_an_alarm_is_told_in_danish_and_a_persons_comment_stands() -> None:
    info = replace(plant.site(1), language="da")
    document = plant.fouling()
    document["history"].append({"time": plant.END, "state": "acknowledged", "actor": "anna", "comment": "set at 45 °C"})
    first = document["causes"][0]
    first["meaning"] = plant.said("declared", text=first["meaning"])
    told = Speaker(info).told(Alarm.read(document))
    assert told["summary"].startswith("substation-hx: mest sandsynligt belægninger på pladerne")
    assert told["history"][0]["comment"].endswith("passerede sin grænse")
    assert told["history"][-1]["comment"] == "set at 45 °C"
    assert told["causes"][0]["for"][0] == "udløbstemperatur på den varme side ligger over det, modellen forventer"


def test_an_alarm_survives_as_a_document_and_one_with_sentences_still_loads() -> None:
    document = plant.fouling()
    alarm = Alarm.read(document)
    assert Alarm.read(json.loads(json.dumps(alarm.document()))) == alarm
    document["causes"][0]["for"] = ["T_hot_out is above what the model expects"]
    document["history"][0]["comment"] = "chart substation-hx/T_hot_out:cusum passed its limit"
    told = Speaker(plant.site(1)).told(Alarm.read(document))
    assert told["causes"][0]["for"] == document["causes"][0]["for"]
    assert told["history"][0]["comment"] == document["history"][0]["comment"]


def test_a_language_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(ValueError, match=r"'xx'; there are .*en"):
        language("xx")


def test_a_chart_says_in_its_name_what_it_watches() -> None:
    assert parts_of("hx/T_hot_out:cusum") == ("T_hot_out", ChartKind.CUSUM)
    assert parts_of("ahu/mixing of air +") == ("mixing of air", ChartKind.ROW)
    assert parts_of("ahu/steady readings") == ("steady readings", ChartKind.STEADY)
    with pytest.raises(ValueError, match="whim"):
        parts_of("hx/T:whim")
