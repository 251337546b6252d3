"""``fdd init`` on exports whose units and roles are known; none was drawn by the guesses themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from benchmarks.newcomer_exports import ALL
from fdd.cli import app
from fdd.config import load_site
from fdd.onboarding.guess import ExportError
from fdd.onboarding.init import Started, start
from fdd.onboarding.layout import unit_in
from fdd.onboarding.quantity import Series, identified
from fdd.onboarding.tags import read_tags
from fdd.onboarding.vocabulary import facets
from fdd.units import conversion

HOUSE = "Time,Outside Temp,Solar Radiation,Heater Power,Room Temp\n"


def started(folder: Path, text: str, *, name: str = "export.csv", **more: Any) -> Started:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return start([path], folder / "site.yaml", **more)


def house(form: str, days: int = 10, *, start_day: str = "2026-01-10", step: str = "30min") -> str:
    time = pd.date_range(start_day, periods=int(pd.Timedelta(days=days) / pd.Timedelta(step)), freq=step)
    hour = time.hour + time.minute / 60
    sun = np.clip(700 * np.sin((hour - 6) / 12 * np.pi), 0, None)
    rows = zip(time.strftime(form), 3 + 4 * np.sin(hour / 24 * 6.28), sun, 2.5 + np.cos(hour / 4), 21 + sun / 700,
               strict=True)  # fmt: skip
    return HOUSE + "".join(f"{t},{a:.2f},{s:.1f},{p:.3f},{r:.2f}\n" for t, a, s, p, r in rows)


def right(made: Started, units: dict[str, str], roles: dict[tuple[str, str], str]) -> tuple[int, int]:
    """How many units and roles are as they are known to be."""
    found = {f.series.name: f for f in made.draft.found}
    played = {(p.model, r, c) for p in made.draft.parts for r, c in p.roles.items()}
    same = sum(c in found and conversion(found[c].unit) == _renamed(found[c].unit, u) for c, u in units.items())
    return same, sum((m, r, c) in played for (m, r), c in roles.items())


def _renamed(spelt: str, unit: str) -> Any:
    from dataclasses import replace

    return replace(conversion(unit), unit=spelt)


QUICK = ("sentinels", "two_clocks", "brick_air_handler")


@pytest.mark.parametrize(
    "make",
    [pytest.param(m, id=m.__name__, marks=() if m.__name__ in QUICK else pytest.mark.slow) for m in ALL],
)
def test_labelled_exports_find_their_units_and_roles(make: Any, tmp_path: Path) -> None:
    export = make(tmp_path)
    if export is None:
        pytest.skip("the measured record is not beside the project")
    made = start(export.paths, tmp_path / "site.yaml", zone=export.zone)
    units, roles = right(made, dict(export.units), dict(export.roles))
    assert units >= 0.9 * len(export.units)
    assert roles >= 0.8 * len(export.roles)
    assert not made.errors
    load_site(made.path)


@pytest.mark.parametrize(
    ("form", "key", "sureness"),
    [
        ("%Y-%m-%d %H:%M", None, "sure"),
        ("%d.%m.%Y %H:%M", True, "sure"),
        ("%m/%d/%Y %H:%M", False, "sure"),
        ("%d-%b-%Y %H:%M", None, "sure"),
    ],
)
def test_dates_are_read_as_they_are_written(form: str, key: bool | None, sureness: str, tmp_path: Path) -> None:
    made = started(tmp_path, house(form))
    source = made.draft.sources[0]
    assert source.keys["time"].get("day_first") is key
    assert pd.Timestamp(source.time[0]) == pd.Timestamp("2026-01-10")
    assert {str(g.sureness) for g in made.guesses if g.key.startswith("time")} == {sureness}


def test_dates_that_can_be_read_in_two_ways_are_flagged_and_asked_for(tmp_path: Path) -> None:
    text = house("%d/%m/%Y %H:%M", 1, start_day="2026-01-02")
    made = started(tmp_path, text)
    (guess,) = [g for g in made.guesses if g.key == "time.day_first"]
    assert guess.sureness == "unsure"
    asked: list[str] = []

    def ask(question: str, guessed: str, others: Any) -> str:
        asked.append(question)
        return "true" if "day_first" in question else guessed

    again = started(tmp_path, text, ask=ask)
    assert any("day_first" in q for q in asked)
    assert pd.Timestamp(again.draft.sources[0].time[0]) == pd.Timestamp("2026-01-02")


def test_a_house_is_found_with_all_its_roles(tmp_path: Path) -> None:
    made = started(tmp_path, house("%Y-%m-%d %H:%M"), zone="Europe/Copenhagen")
    (part,) = made.draft.parts
    assert part.model == "zone"
    assert part.roles == {"T_room": "Room Temp", "T_out": "Outside Temp", "I_solar": "Solar Radiation",
                          "P_heat": "Heater Power"}  # fmt: skip
    site = load_site(made.path)
    assert site.step == 1800.0
    assert {p.unit for p in site.points.values()} == {"degC", "W/m2", "kW"}


@pytest.mark.parametrize(("sentinel", "count"), [("-9999", 9), ("9999", 9)])
def test_numbers_that_mean_no_value_are_found(sentinel: str, count: int, tmp_path: Path) -> None:
    lines = house("%Y-%m-%d %H:%M").splitlines()
    for i in range(5, 5 + 7 * count, 7):
        cells = lines[i].split(",")
        lines[i] = ",".join([*cells[:4], sentinel])
    made = started(tmp_path, "\n".join(lines) + "\n")
    assert load_site(made.path).points["Room_Temp"].missing == (float(sentinel),)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Außentemperatur", {"outdoor", "temperature"}),
        ("Vorlauftemperatur HK1", {"supply", "temperature"}),
        ("Temp. extérieure", {"outdoor", "temperature"}),
        ("Temperatura impulsión", {"supply", "temperature"}),
        ("Fremløbstemperatur", {"supply", "temperature"}),
        ("AHU-1.MAT", {"mixed", "temperature", "air"}),
        ("CHWST", {"chilled", "supply", "temperature"}),
        ("ZN-T", {"room", "temperature"}),
        ("OaDmprCmd", {"damper", "outdoor"}),
        ("Wärmeleistung", {"heating", "power"}),
    ],
)
def test_names_say_what_they_mean_in_the_field(name: str, said: set[str]) -> None:
    assert said <= facets(name)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("Supply [°C]", "°C"), ("Flow (gpm)", "gpm"), ("T_room_degF", "degF"), ("Output ()", None), ("Row 12", None)],
)
def test_units_in_names(name: str, unit: str | None) -> None:
    assert unit_in(name) == unit


def test_temperatures_of_one_export_share_their_unit() -> None:
    rng = np.random.default_rng(3)
    in_f = {"Room Temp": 72.0, "Outside Air Temp": 51.0, "Supply Air Temp": 57.0, "Return Air Temp": 73.0}
    found = identified([Series(n, v + rng.normal(0, 2, 500)) for n, v in in_f.items()])
    assert {f.unit for f in found} == {"degF"}
    found = identified([Series(n, (v - 32) / 1.8 + rng.normal(0, 1, 500)) for n, v in in_f.items()])
    assert {f.unit for f in found} == {"degC"}


def test_a_flow_that_may_be_in_many_units_is_never_called_sure() -> None:
    rng = np.random.default_rng(4)
    (found,) = identified([Series("Flow", rng.uniform(1, 9, 500))])
    assert found.sureness == "unsure"
    assert len(found.others) >= 2


ZINC = """ver:"3.0"
id,dis,point,kind,unit,equipRef,supply,air,temp
@p1 "AHU 1 SAT","AHU 1, SAT",M,"Number","°F",@a1 "AHU 1",M,M,M
@p2,"Fan run",M,"Bool",N,@a1 "AHU 1",N,N,N
@p3,"Mode",M,"Str",N,@a1,N,N,N
"""


def test_zinc_grids_are_read(tmp_path: Path) -> None:
    path = tmp_path / "grid.zinc"
    path.write_text(ZINC)
    first, second = read_tags(path)
    assert (first.title, first.unit, first.keys[0]) == ("AHU 1, SAT", "°F", "p1")
    assert {"supply", "air", "temperature"} <= first.facets
    assert "status" in second.facets


def test_a_grid_without_points_or_a_broken_file_is_told(tmp_path: Path) -> None:
    for name, text, words in (
        ("a.json", "{}", "no Haystack grid"),
        ("b.zinc", "x", "no Zinc grid"),
        ("c.ttl", "no turtle", "no Turtle"),
        ("d.json", '{"rows": []}', "holds no point"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(ExportError, match=words):
            start([tmp_path / name], tmp_path / "site.yaml")


def test_an_export_without_a_time_says_so(tmp_path: Path) -> None:
    body = "\n".join(f"{20 + (i * 7) % 5},{(i * 3) % 11}" for i in range(200))
    made = started(tmp_path, "Room Temp,Outside Temp\n" + body + "\n")
    (guess,) = [g for g in made.guesses if g.key == "time.start"]
    assert guess.sureness == "unsure"


def test_the_verb_writes_a_site_and_refuses_to_write_over_it(tmp_path: Path) -> None:
    path = tmp_path / "house.csv"
    path.write_text(house("%Y-%m-%d %H:%M"))
    site = tmp_path / "site.yaml"
    arguments = ["init", str(path), "--out", str(site), "--zone", "Europe/Copenhagen", "--json"]
    first = CliRunner().invoke(app, arguments)
    assert first.exit_code == 0
    told = json.loads(first.stdout)
    assert told["equipment"][0]["model"] == "zone"
    assert {c["sureness"] for c in told["columns"]} <= {"sure", "likely", "unsure"}
    assert CliRunner().invoke(app, arguments).exception is not None
