"""``fdd score`` from files to figures, on a short life of the demonstration plant; and ``fdd charts design``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fdd.cli import app
from fdd.plant.faults import DAY, PlantFault
from fdd.plant.scenario import Scenario, simulate
from fdd.plant.site import demo_site
from fdd.service.baselines.history import read_history
from fdd.service.baselines.identify import identify
from fdd.service.baselines.versions import accept
from fdd.service.site.errors import UsageError
from fdd.service.site.feed import Feed
from fdd.service.site.site_context import open_site
from fdd.service.verbs.scoring import read_labels

LEARNING = 6.0
HEAD = "component,fault,start,end,severity\n"
RUNNER = CliRunner()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Site file, data and labels; the exchanger is watched alone, fouled from the 9th to the 12th day of 14."""
    folder = tmp_path_factory.mktemp("score")
    fault = PlantFault("fouling", "hx", 8 * DAY, 0.3, "intermittent", 3 * DAY)
    scenario = Scenario(days=14, seed=5, faults=(fault,))
    data = folder / "history.csv"
    simulate(scenario).to_csv(data, date_format="%Y-%m-%dT%H:%M:%SZ")
    site_file = demo_site(folder, sources=[{"kind": "csv", "path": data.name}], scenario=scenario)
    context = open_site(site_file)
    feed = Feed(context.site)
    feed.open()
    history, _ = read_history(context.plan, list(feed.batches()))
    feed.close()
    end = scenario.first + round(LEARNING * DAY) * 10**9
    store = context.store()
    accept(store, identify(context.plan, context.plan.components[0], history.between(None, end))[0])
    store.close()
    labels = folder / "labels.csv"
    labels.write_text(HEAD + "hx,fouling,2024-10-15T00:00Z,2024-10-18T00:00Z,0.3\n")
    return site_file, data, labels


def test_a_planted_fault_is_found_and_rightly_named(site: tuple[Path, Path, Path], tmp_path: Path) -> None:
    page = tmp_path / "score.html"
    said = RUNNER.invoke(app, ["score", *map(str, site), "--html", str(page), "--json", "--settle", "7 d"])
    assert said.exit_code == 0, said.output
    found = json.loads(said.stdout)
    case = found["cases"]["each"][0]
    assert (case["outcome"], case["diagnosis"]) == ("found", "correct")
    assert 0 < case["delay_seconds"] < 2 * DAY
    assert found["cases"]["found"]["of"] == found["cases"]["by_severity"][0]["found"]["count"] == 1
    assert found["watched"] == ["hx"]
    days = found["days"]
    assert days["true_positive"] + days["false_negative"] in (3, 4)  # 3 days of UTC touch 4 of a zone east of it
    assert "<img" in page.read_text()


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("pump,wear,2024-10-15,2024-10-16,0.1", "no component 'pump'"),
        ("hx,fouling,2024-10-16,2024-10-15,0.1", "is not after start"),
        ("hx,fouling,2024-10-15,2024-10-16,much", "is no number"),
        ("hx,fouling,,2024-10-16,0.1", "empty"),
    ],
)
def test_labels_that_make_no_sense_are_refused_with_their_line(
    site: tuple[Path, Path, Path], tmp_path: Path, row: str, says: str
) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text(HEAD + "hx,fouling,2024-10-15,2024-10-16,\n" + row + "\n")
    with pytest.raises(UsageError, match=says) as refused:
        read_labels(labels, open_site(site[0]))
    assert "line 3" in str(refused.value)


def test_labels_without_a_column_are_refused(site: tuple[Path, Path, Path], tmp_path: Path) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text("component,start,end\n")
    with pytest.raises(UsageError, match="no column fault, severity"):
        read_labels(labels, open_site(site[0]))


def test_charts_design_prints_the_known_limit_and_writes_its_files(tmp_path: Path) -> None:
    plot, page = tmp_path / "delay.svg", tmp_path / "design.html"
    arguments = ["charts", "design", "--interval", "1 d", "--plot", str(plot), "--html", str(page), "--json"]
    said = RUNNER.invoke(app, arguments)
    assert said.exit_code == 0, said.output
    design = json.loads(said.stdout)["designs"][0]
    assert design["limit"] == pytest.approx(4.7604, abs=0.002)  # R package spc: 365 updates
    assert plot.stat().st_size > 0
    assert "data:image/svg" in page.read_text()


def test_charts_design_refuses_a_kind_without_run_lengths() -> None:
    said = RUNNER.invoke(app, ["charts", "design", "--kind", "glr"])
    assert isinstance(said.exception, UsageError)
    assert "cusum, ewma, mewma, shewhart" in str(said.exception)
