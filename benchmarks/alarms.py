"""Do charts keep their promise? Solver against the oracle, realised false alarms, the two-state room, and peers.

    python -m benchmarks.alarms [--quick] [--json] [--years FILE ...]

Each section returns its figures and what the context should say; a new one is one more function in ``SECTIONS``. Of
fault-free operation the engine's own section is a sample. Figures named ``years_...`` are not measured by this run:
they add up the plant-years that ``python -m benchmarks.fault_free_years --to FILE`` has watched in an hour or two.
"""

from __future__ import annotations

import os

# Small systems of equations: more than one thread only spins, and costs a busy machine a factor of ten.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import csv
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from scipy.special import ndtri

from benchmarks import fault_free_years, peers, room
from benchmarks.chart_kinds import charts, make, warm_up
from benchmarks.common import context, figure, report
from benchmarks.detection_figures import detected
from fdd.records import FloatArray
from fdd.residual_monitors.budget import poisson_interval
from fdd.residual_monitors.chart import Chart, Feed, Phase
from fdd.residual_monitors.run_length import Rule, arl, limit_for

ROOT = Path(__file__).resolve().parents[1]
ORACLE = ROOT / "tests" / "oracle"
YEARS = ROOT / "docs" / "benchmarks" / "fault-free-years.jsonl"
Figures = dict[str, dict[str, Any]]
Section = Callable[[bool, Console], tuple[Figures, dict[str, Any]]]
SEED = 11
ENGINE_BUDGET = 60.0  # false alarms a year and plant, in the sample of the whole engine
RESTING = 0.9  # share of readings that do not change


def solver(quick: bool, console: Console) -> tuple[Figures, dict[str, Any]]:
    """Worst deviation from the R package spc, and the time of a solution."""
    worst: dict[str, float] = {}
    with (ORACLE / "arl_oracle.csv").open() as file:
        for row in csv.DictReader(file):
            kind = row["kind"].split()[0].removesuffix("370")
            own = _own_arl(row, kind)
            worst[kind] = max(worst.get(kind, 0.0), abs(own / float(row["ARL"]) - 1))
    figures = {
        f"solver_{kind}_error": figure(100 * error, "%", f"<= {most}", 100 * error <= most)
        for (kind, error), most in zip(sorted(worst.items()), (0.5, 0.5, 1.0), strict=True)
    }
    with (ORACLE / "cusum_design_h.csv").open() as file:
        gaps = [
            abs(float(limit_for("cusum", float(r["ARL0"]), k=float(r["k"]))) - float(r["h_two_sided"]))
            for r in csv.DictReader(file)
        ]
    figures["solver_limit_error"] = figure(max(gaps), "sd", "<= 0.001", max(gaps) <= 1e-3)
    for kind in ("cusum", "ewma", "mewma"):
        took = min(_solution_time(kind, wanted) for wanted in (1234.5, 98_765.4, 2_345_678.9))
        figures[f"solver_{kind}_limit_time"] = figure(took, "ms", "<= 50", took <= 50)
    return figures, {}


def _solution_time(kind: Any, wanted: float) -> float:
    """Time of a limit not solved before [ms]."""
    begun = time.perf_counter()
    limit_for(kind, wanted)
    return 1e3 * (time.perf_counter() - begun)


def _own_arl(row: dict[str, str], kind: str) -> float:
    constant, start = float(row["k_or_lambda"]), {"FIR h/2": 0.5, "steady": "steady"}.get(row["start"], "zero")
    if kind == "cusum":
        rule = Rule("cusum", k=constant, sided=2 if row["sided"] == "two" else 1)
    elif kind == "ewma":
        rule = Rule("ewma", lam=constant, exact="vacl" in row["start"])
    else:
        rule = Rule("mewma", lam=constant, dimension=int(row["kind"].split("p=")[1][0]))
    return arl(rule, float(row["h_or_L"]), float(row["shift"]), start)  # type: ignore[arg-type]


def rates(quick: bool, console: Console) -> tuple[Figures, dict[str, Any]]:
    """Realised over promised false alarms of every chart on white noise with 10 % missing, alarms cleared at once."""
    wanted, streams, steps = (5000.0, 500, 5000) if quick else (105_120.0, 500, 105_120)
    figures: Figures = {}
    for kind, cls in charts().items():
        width = 2 if cls.feed is Feed.SCORES else 1
        options: dict[str, Any] = {Feed.SCORES: {"parameters": width}, Feed.READINGS: {"repeat": RESTING}}.get(
            cls.feed, {}
        )
        chart = make(kind, np.full(streams * (width if cls.feed is Feed.SCORES else 1), wanted), **options)
        alarms, seen = _realise(chart, streams, width, steps)
        low, high = (x * wanted / seen for x in poisson_interval(alarms))
        ratio = alarms * wanted / seen
        holds = bool(1 / 1.5 <= ratio <= 1.5)
        figures[f"false_alarms_{kind}"] = figure(ratio, "of promised", "1/1.5 .. 1.5", holds)
        figures[f"false_alarms_{kind}"]["interval"] = [low, high]
        console.log(f"{kind}: {ratio:.3f} [{low:.3f}, {high:.3f}] of the promised rate, {alarms} alarms")
    for streams, most in ((10, 15.0), (5000, 100.0)):
        took = _update_time(streams)
        figures[f"update_cusum_{streams}_streams"] = figure(took, "us", f"<= {most:g}", took <= most)
    size = {"mean_samples_between": wanted, "streams": 500, "samples": steps, "missing": 0.1}
    return figures, {"rates": size}


def _realise(chart: Chart, units: int, width: int, steps: int) -> tuple[int, float]:
    """Alarms, each cleared at once, and stream updates that saw something."""
    rng = np.random.default_rng(SEED)
    alarms, seen = 0, 0.0
    information = np.tile(np.eye(width), (units, 1, 1))
    for _ in range(steps):
        x = rng.standard_normal((units, width))
        x[rng.random(units) < 0.1] = np.nan
        scores = chart.feed is Feed.SCORES
        said = chart.update_scores(x, information) if scores else chart.update(_fed(chart, x))  # type: ignore[attr-defined]
        rang = said.phase == Phase.ALARM
        seen += np.count_nonzero(np.isfinite(x[:, 0])) * (chart.n // units)
        if rang.any():
            alarms += int(rang.sum())
            chart.reset(rang)
    return alarms, seen


def _fed(chart: Chart, x: FloatArray) -> FloatArray:
    """Values (units, width) as the chart takes them; readings that rest at one number most of the time."""
    if chart.feed is Feed.READINGS:
        return np.where(x[:, 0] < ndtri(RESTING), 0.0, x[:, 0])
    return np.asarray(x[:, 0])


def _update_time(streams: int) -> float:
    """Least time of an update, of 20 times 20 [us]."""
    chart, z = make("cusum", np.full(streams, 1e5)), np.random.default_rng(SEED).standard_normal(streams)
    times = []
    for _ in range(20):
        begun = time.perf_counter()
        for _ in range(20):
            chart.update(z)
        times.append(1e6 * (time.perf_counter() - begun) / 20)
    return min(times)


def two_state_room(quick: bool, console: Console) -> tuple[Figures, dict[str, Any]]:
    """Score charts against innovation charts, every detector at the same chance of a false alarm."""
    runs, healthy, fits = (20, 40, 8) if quick else (100, 300, 100)
    figures: Figures = {}
    cases = [room.simulate(healthy, SEED), *(room.simulate(runs, SEED + 1, change) for change in room.FAULTS.values())]
    every, rows = room.together(cases)
    found = room.detect(every)
    for name, share in room.false_alarm_share(found.outcomes(rows[0])).items():
        figures[f"room_false_alarms_{_key(name)}"] = _false_alarms(share, healthy)
    table: dict[str, Any] = {}
    for (fault, (parameter, factor)), at in zip(room.FAULTS.items(), rows[1:], strict=True):
        outcomes = found.outcomes(at, parameter)
        table[fault] = {k: {"median_days": o.median, "found": o.found, "named": o.named} for k, o in outcomes.items()}
        score, plain = outcomes["score"], outcomes["innovations, k = 0.5"]
        # Where all 60 days cannot tell the change from none at three standard errors, no chart can; it is said so.
        error, change = (score.error or {}).get(parameter, np.inf), float(np.log(factor))
        hidden = abs(change) < 3 * error
        table[fault]["visible"] = {"standard_error": error, "change": change, "hidden": bool(hidden)}
        key = f"room_{_key(fault)}"
        figures[f"{key}_found"] = _figure(100 * score.found, "%", 95, hidden)
        figures[f"{key}_delay"] = figure(score.median, "d", "median", None)
        figures[f"{key}_named"] = _figure(None if score.named is None else 100 * score.named, "%", 80, hidden)
        figures[f"{key}_found_by_innovations"] = figure(100 * plain.found, "%", "compare", None)
        console.log(
            fault, {k: f"{o.median:.1f} d ({o.found:.0%})" for k, o in outcomes.items()}, f"named {score.named}"
        )
    figures.update(_fitted(fits))
    return figures, {"room": {"runs": runs, "healthy_runs": healthy, "fitted_runs": fits, "table": table}}


def _fitted(runs: int) -> Figures:
    """Baselines fitted on 14 days instead of known."""
    every, rows = room.together([room.simulate(runs, SEED + 2), room.simulate(runs, SEED + 4, ("gain", 0.9))])
    found = room.detect_fitted(every, SEED + 3)
    share = room.false_alarm_share(found.outcomes(rows[0]))["score"]
    faulty = found.outcomes(rows[1], "gain")["score"]
    return {
        "room_fitted_false_alarms": _false_alarms(share, runs),
        "room_fitted_heater_gain_minus_10_found": _figure(100 * faulty.found, "%", 95, False),
        "room_fitted_heater_gain_minus_10_delay": figure(faulty.median, "d", "median", None),
    }


def _false_alarms(share: float, runs: int) -> dict[str, Any]:
    """Share of runs with a false alarm against the nominal tenth and three standard errors of that many runs."""
    most = 0.1 + 3 * np.sqrt(0.09 / runs)
    return figure(100 * share, "% of 60 d", f"<= {100 * most:.0f}", bool(share <= most))


def against_peers(quick: bool, console: Console) -> tuple[Figures, dict[str, Any]]:
    """False alarms a year and median delays on the same white and slightly coloured series."""
    years, cases = peers.QUICK if quick else peers.WHOLE
    memories = (0.3,) if quick else (0.0, 0.3)
    table = peers.compare(memories, years, cases, SEED)
    for rho, scores in table.items():
        for name, score in scores.items():
            console.log(
                f"rho {rho}: {name}: {score.false_alarms:.2f}/a, delays {score.delay}, survives a NaN: {score.survives}"
            )
    about = {"years": years, "cases": cases, "promised": 1.0, "not installed": peers.detectors()[1]}
    return peers.figures_of(table, years), {"peers": about}


def engine_rates(quick: bool, console: Console) -> tuple[Figures, dict[str, Any]]:
    """Realised over promised false alarms of fault-free plants through the whole engine; alarms cleared at once."""
    # Houses differ, 38 to 74 alarms a year of 60 promised: many of them for a winter say more than a few for long.
    plants, days = (1, 7.0) if quick else (12, 90.0)
    sets = ("fitted",) if quick else fault_free_years.SETS
    record = fault_free_years.batch(SEED, plants, days, sets, ENGINE_BUDGET, np.inf)
    console.log(record)
    figures = fault_free_years.figures_of([record])
    # How many years there are is a matter for the records; a sample has what it has.
    return {f"engine_{k}": v for k, v in figures.items() if not k.endswith("plant_years")}, {"engine": record}


def _figure(value: float | None, unit: str, least: float, hidden: bool) -> dict[str, Any]:
    if hidden:
        return figure(value, unit, "not visible in these data", None)
    return figure(value, unit, f">= {least:g}", value is not None and value >= least)


def _key(name: str) -> str:
    for sign, word in ((" -", " minus "), (" +", " plus ")):
        name = name.replace(sign, word)
    return "_".join("".join(c if c.isalnum() else " " for c in name).lower().split())


def _plain(value: Any) -> Any:
    """JSON has no NaN and no infinity: null."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return bool(value) if isinstance(value, np.bool_) else value


SECTIONS: tuple[Section, ...] = (solver, rates, two_state_room, detected, against_peers, engine_rates)


def watched_years(paths: Sequence[Path]) -> tuple[Figures, dict[str, Any]]:
    """Plant-years of fault-free operation that were watched before, added up."""
    records = fault_free_years.read(paths)
    figures = {f"years_{name}": found for name, found in fault_free_years.figures_of(records).items()}
    about = {key: [r[key] for r in records] for key in ("seed", "plants", "years")}
    return figures, {"years": {"watched before": [path.name for path in paths]} | about}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the same figures on a smaller sample, under 50 s")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--years", type=Path, nargs="+", default=[YEARS], help="files with plant-years watched before")
    return parser.parse_args()


def main() -> None:
    given = arguments()
    console = Console(stderr=True, quiet=given.json)
    figures, about = watched_years(given.years)
    about |= {"seed": SEED, "quick": given.quick}
    warm_up()
    for section in SECTIONS:
        begun = time.perf_counter()
        found, more = section(given.quick, console)
        figures.update(found)
        about.update(more)
        about.setdefault("seconds", {})[section.__name__] = round(time.perf_counter() - begun, 1)
    report(_plain(figures), _plain(context(**about)), given.json)


if __name__ == "__main__":
    main()
