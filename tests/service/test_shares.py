"""What charts are promised of the plant's false alarms, by family and component."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdd.records import NANOSECONDS, Baseline
from fdd.residual_monitors.budget import YEAR
from fdd.service.filtering.filters import FilterGroup
from fdd.service.monitoring.charting import FAMILIES, _budgets
from fdd.service.monitoring.flatline_charts import FLATLINE
from fdd.service.site.plan import Plan
from tests.service.conftest import plan, simulate
from tests.service.test_health_and_flatline import watched

DAY, LEARNING = 288, 10


@pytest.fixture(scope="module")
def known() -> dict[str, Baseline]:
    return watched(simulate(LEARNING * DAY, seed=12))


def promised(site: Plan, baselines: dict[str, Baseline]) -> tuple[dict[str, float], list[dict[str, float]]]:
    """False alarms a year of each component, and the mean frames between those of each of its charts, by family."""
    group = FilterGroup(site.components, baselines, site.columns, hold=site.hold, max_gap=site.max_gap)
    budgets = _budgets(site, [group])
    year = YEAR * NANOSECONDS / site.step
    found = {}
    for c, b in zip(site.components, group.baselines, strict=True):
        charts = [
            kind.carried(group, c) * kind.used(c, b, arl[c.name]) / arl[c.name]
            for kind, arl in zip(FAMILIES, budgets, strict=True)
        ]
        found[c.name] = year * sum(charts)
    return found, budgets


def gridded(b: Baseline) -> Baseline:
    """The readings repeat themselves, as on a coarse grid: half of them are as the last one."""
    still = {
        "readings": 2880, "runs": 1440, "longest": 9, "tail": 6, "exceed": 20, "excess": 20, "low": 15.0, "high": 25.0
    }  # fmt: skip
    return replace(b, diagnostics={**b.diagnostics, "flatline": dict.fromkeys(("T_room", "T_a"), still)})


def test_charts_that_cannot_ring_leave_their_share_to_those_of_their_component(known: dict[str, Baseline]) -> None:
    site = plan(false_alarms_per_year=60.0)
    found, budgets = promised(site, known)
    assert sum(found.values()) == pytest.approx(60.0)
    assert found["south"] == pytest.approx(found["north"])
    # Outside is a sine that no gateway rounds: no chart of frozen readings has anything to spend.
    assert [FLATLINE.used(c, known[c.name], 1e5) for c in site.components] == [0.0, 0.0]

    mixed, other = promised(site, {**known, "north": gridded(known["north"])})
    assert sum(mixed.values()) == pytest.approx(60.0)
    assert mixed["south"] == pytest.approx(mixed["north"])
    assert FLATLINE.used(site.components[1], gridded(known["north"]), 1e5) > 0
    for kind, before, after in zip(FAMILIES, budgets, other, strict=True):
        assert after["south"] == before["south"]
        # What north's frozen readings may spend now is taken from its other charts, and from nobody else's.
        assert after["north"] == before["north"] if kind.share else after["north"] > before["north"]


def test_model_that_is_not_judged_leaves_its_share_to_the_charts_of_the_plant(known: dict[str, Baseline]) -> None:
    def short(b: Baseline) -> Baseline:
        return replace(b, innovation={q: {**s, "windows": {}} for q, s in b.innovation.items()})

    site = plan()
    judged, budgets = promised(site, known)
    unjudged, others = promised(site, {n: short(b) for n, b in known.items()})
    assert sum(judged.values()) == pytest.approx(2.0)
    assert sum(unjudged.values()) == pytest.approx(2.0)
    ratio = np.array([a["south"] / b["south"] for a, b in zip(budgets, others, strict=True)])
    # Charts of days have what the others leave: gross faults 5 %, parameters 10 %, the models' health 10 %.
    np.testing.assert_allclose(ratio, [0.85 / 0.75, 1, 1, 1, 1])
