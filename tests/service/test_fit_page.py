"""The pages of ``fdd fit`` and the schedules of ``fdd experiment``."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console

from benchmarks.drifting_room import POINTS, START, Course, simulate
from fdd.service.baselines.fitting import fit_site
from fdd.service.verbs.experiments import propose
from tests.service.room_site import DAY_NS, SITE

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room's site file and its data as CSV."""
    folder = tmp_path_factory.mktemp("room")
    source = "source: {kind: csv, path: room.csv, time: {column: time}}\n"
    (folder / "site.yaml").write_text(SITE + source, encoding="utf-8")
    history = simulate(Course(days=30), seed=5)
    frame = pd.DataFrame(history.values, columns=list(POINTS))
    frame.insert(0, "time", pd.to_datetime(history.time, unit="ns", utc=True).strftime("%Y-%m-%dT%H:%M:%SZ"))
    frame.to_csv(folder / "room.csv", index=False)
    return folder / "site.yaml"


def page(room: Path, folder: Path, until: str | None) -> dict[tuple[str, str], list[str]]:
    """Rows of the verdict table by test and subject."""
    path = folder / "fit.html"
    fit_site(room, None, since=None, until=until, only=None, html=path, starts=1, console=QUIET)
    rows = re.findall(r"<tr class=\w+>(.*?)(?=<tr|</table>)", path.read_text(encoding="utf-8"), flags=re.S)
    cells = [re.split(r"<td>", row)[1:] for row in rows]
    return {(c[0], c[1]): c[2:] for c in cells}


def test_the_page_has_every_test_and_the_days_after(room: Path, tmp_path: Path) -> None:
    rows = page(room, tmp_path, str(pd.Timestamp(START + 21 * DAY_NS, unit="ns")))
    tests = {test for test, _ in rows}
    assert {"autocorrelation", "Ljung-Box", "cumulated periodogram", "lag dependence", "residual against", "normality",
            "variance", "cross-validation", "time constant"} <= tests  # fmt: skip
    for kind in ("one step", "simulation"):
        statistic, limit, *_ = rows["cross-validation", f"T_room {kind}"]
        assert 0 < float(statistic) <= float(limit)  # nothing changes in the room


def test_nothing_after_the_span_is_no_cross_validation(room: Path, tmp_path: Path) -> None:
    assert "cross-validation" not in {test for test, _ in page(room, tmp_path, None)}


def test_an_experiment_is_proposed_as_csv_and_plot(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "schedule.csv"
    found = propose(room, "room", ["P_heat=0:3:4 kW"], days=3, dwell="30 min", out=out, count=4, console=QUIET)
    rows = pd.read_csv(out)
    assert list(rows.columns) == ["t_s", "P_heat"]
    assert set(rows["P_heat"]) <= {0.0, 1000.0, 2000.0, 3000.0}
    assert rows["P_heat"].nunique() == 4
    assert (rows["t_s"].diff().dropna() >= 1800).all()
    assert rows["t_s"].iloc[-1] < 3 * 86400
    assert found.plot.read_text(encoding="utf-8").count("<path") > 10
    story = found.story()
    for symbol in ("C_i", "R_ia"):
        assert re.search(rf"{symbol}: standard error promised [\d.]+ %", story)
