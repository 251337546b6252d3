"""Every chart that the engine can raise has its title in every catalogue."""

from __future__ import annotations

import pytest

from fdd.chiller_eiv.rows import state_chart, weekly_chart
from fdd.evidence import ChartKind, parts_of
from fdd.report.language import language, languages
from fdd.service.engine.engine import Engine
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


def test_a_language_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(ValueError, match=r"'xx'; there are .*en"):
        language("xx")


def test_a_chart_says_in_its_name_what_it_watches() -> None:
    assert parts_of("hx/T_hot_out:cusum") == ("T_hot_out", ChartKind.CUSUM)
    assert parts_of("ahu/mixing of air +") == ("mixing of air", ChartKind.ROW)
    assert parts_of("ahu/steady readings") == ("steady readings", ChartKind.STEADY)
    with pytest.raises(ValueError, match="whim"):
        parts_of("hx/T:whim")
