"""The service: load through Zenoh into each store, and re-identification over simulated plant-years.

``python -m benchmarks.service [--quick] [--json]``. Figures without a suffix are those of InfluxDB where its server is
at hand (``deploy/influxd/build.sh``), else of SQLite.
"""

from __future__ import annotations

import logging
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import structlog

from benchmarks.common import arguments, context, figure, report
from benchmarks.drifting_room import Course
from benchmarks.load import UNPACED, measure
from benchmarks.plant_years import Case, live
from fdd.service.pool import Failure, side_by_side
from fdd.store.store import Store, StoreConfig, open_store

COMPONENTS, POINTS_A_SECOND = 2_000, 10_000


@contextmanager
def stores(folder: Path) -> Iterator[dict[str, Any]]:
    """A maker of each store that this machine has."""
    makers: dict[str, Any] = {"sqlite": lambda i: open_store(StoreConfig("sqlite", path=folder / f"{i}.sqlite"))}
    from tests.store.influxd import ORG, Influxd, find_influxd

    binary = find_influxd()
    if binary is None:
        yield makers
        return
    from influxdb_client import InfluxDBClient, OnboardingRequest, SetupService

    server = Influxd(binary, folder / "influxd")
    server.start()
    try:
        with InfluxDBClient(server.url, token=server.admin_token) as client:
            request = OnboardingRequest("admin", "test-password", ORG, "first", token=server.admin_token)
            SetupService(client.api_client).post_setup(onboarding_request=request)
        os.environ["FDD_LOAD_TOKEN"] = server.admin_token

        def influx(i: int) -> Store:
            bucket = server.new_bucket()
            config = StoreConfig(
                "influx", "load", folder / f"spool{i}", server.url, ORG, bucket, None, "FDD_LOAD_TOKEN"
            )
            return open_store(config)

        yield makers | {"influx": influx}
    finally:
        server.kill()


def load(seconds: int) -> dict[str, Any]:
    """Each store at the wanted rate, then as fast as it goes."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with stores(folder) as makers:
            for name, make in makers.items():
                for i, pace in enumerate((1.0, UNPACED)):
                    own = folder / f"{name}-{i}"
                    own.mkdir()
                    store = make(i)
                    began = time.monotonic()
                    result = measure(store, own, COMPONENTS, seconds if pace else max(5, seconds // 4), pace)
                    store.close()
                    result["seconds_with_spool"] = time.monotonic() - began
                    found[f"{name}{'' if pace else ' unpaced'}"] = result
    return found


def load_figures(found: dict[str, Any]) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for name in [n for n in found if "unpaced" not in n]:
        paced, most = found[name], found[f"{name} unpaced"]
        suffix = f"_{name}"
        figures |= {
            f"points_per_second_held{suffix}": figure(most["rate"], "1/s", ">= 10000", most["rate"] >= POINTS_A_SECOND),
            f"latency_p99_ms{suffix}": figure(paced["p99_ms"], "ms", "< 250", paced["p99_ms"] < 250),
            f"lost{suffix}": figure(paced["lost"] + most["lost"], "points", "0", paced["lost"] + most["lost"] == 0),
            f"rss_growth_mb{suffix}": figure(paced["growth_mb"], "MB", "< 50", paced["growth_mb"] < 50),
        }
    main = "influx" if "influx" in found else "sqlite"
    keys = ("points_per_second_held", "latency_p99_ms", "lost", "rss_growth_mb")
    return {k: figures[f"{k}_{main}"] for k in keys} | figures


def plant_years(quick: bool) -> dict[str, list[dict[str, Any]]]:
    """Seasons, growing faults and steps, each run with its own weather."""
    if quick:
        kinds = {
            "season": [Case(Course(70, season=0.03), 0)],
            "growth": [Case(Course(90, growth=0.10, onset=40), 100 + s) for s in range(2)],
            "step": [Case(Course(60, step=0.15, onset=40), 200)],
        }
    else:
        kinds = {
            "season": [Case(Course(365, season=0.03), s) for s in range(8)],
            "growth": [Case(Course(240, growth=0.10, onset=70), 100 + s) for s in range(40)],
            "step": [Case(Course(120, step=0.15, onset=60), 200 + s) for s in range(40)],
        }
    cases = [(kind, case) for kind, many in kinds.items() for case in many]
    found: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}

    def done(i: int, result: dict[str, Any] | Failure) -> None:
        if isinstance(result, Failure):
            raise RuntimeError(f"{cases[i]}: {result.reason}")
        found[cases[i][0]].append(result)

    side_by_side(live, [case for _, case in cases], done)
    return found


def year_figures(found: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    season, growth, step = found["season"], found["growth"], found["step"]
    years = sum(r["days"] for many in found.values() for r in many) / 365
    false = sum(r["false_alarms"] for r in season) / (sum(r["days"] for r in season) / 365)
    followed = sum(r["accepted"] > 0 for r in season) / len(season)
    worst = max(abs(r["error"]) for r in season)
    figures = {
        "plant_years": figure(years, "years", "50 (full run)", None),
        "season_false_alarms_per_year": figure(false, "1/year", "<= 1 (budget)", false <= 1),
        "season_followed": figure(followed, "share", "1", followed == 1),
        "season_worst_error": figure(worst, "share", "< 0.02", worst < 0.02),
    }
    for name, runs, wanted in (("growing_fault", growth, 0.95), ("step_fault", step, 1.0)):
        kept = sum(not r["learned"] for r in runs) / len(runs)
        alarmed = sum(r["alarmed"] for r in runs) / len(runs)
        figures[f"{name}_not_learned"] = figure(kept, "share", f">= {wanted:g}", kept >= wanted)
        figures[f"{name}_alarmed"] = figure(alarmed, "share", "1", alarmed == 1)
    return figures


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__ or "")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    loaded = load(5 if given.quick else 180)
    lived = plant_years(given.quick)
    figures = load_figures(loaded) | year_figures(lived)
    report(figures, context(components=COMPONENTS, load=loaded, runs=lived), given.json)


if __name__ == "__main__":
    main()
