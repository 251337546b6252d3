"""The section of :mod:`benchmarks.alarms` on faults of the simulated house: figures, and every row for the tables.

    python -m benchmarks.detection_figures alarms.json [--plot delay.svg]

prints the tables of a run of ``python -m benchmarks.alarms --json`` in Markdown and draws delay against severity.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import detection, detection_tables
from benchmarks.common import figure
from benchmarks.detection import Fault, Watched
from benchmarks.detection_tables import KindRow, Row
from benchmarks.detection_theory import Compared
from fdd.plant.district import EQUIPMENT

Figures = dict[str, dict[str, Any]]
SEEDS, LIVES, MORE, ROUNDS = (2, 3, 4, 5, 6, 7), 2, 4, 3
"""Baselines are fitted once a seed; each of its lives has a weather and a noise of its own. Faults whose ratio to
theory may be off by chance live more lives, in so many rounds at most."""
ERROR = 0.2
"""Half a 95 % interval of the ratio, by theory's own scatter, from which on it is known well enough."""
BOUND = 1.5
NAMED = ("named", "scored")


def detected(quick: bool, console: Console) -> tuple[Figures, dict[str, Any]]:
    """Score charts against innovation charts on the simulated house, every parameter fault; delays against theory."""
    runs = _few() if quick else _many(console)
    table = detection_tables.rows([r for r in runs if r.fault.symbol])
    faults = detection_tables.kind_rows([r for r in runs if not r.fault.symbol])
    figures: Figures = {}
    for row in table:
        figures.update(_parameter(row))
        console.log(row)
    for fault in faults:
        figures.update(_kind(fault))
        console.log(fault)
    figures.update(_counted([*(r.own.ratio for r in table), *(f.own.ratio for f in faults)]))
    about = {
        "seeds": sorted({r.seed for r in runs}),
        "lives_a_seed": [1, 1] if quick else [LIVES, 1 + max(r.life for r in runs)],
        "false_alarms_a_year_of_each_family": detection.RATE,
        "parameters": [asdict(r) | {"hidden": r.hidden} for r in table],
        "faults": [asdict(f) | {"hidden": f.hidden} for f in faults],
        "no_chart_can_see": [
            *(f"{r.component} {r.name} -{100 * r.size:.0f} %" for r in table if r.hidden),
            *(f"{f.kind} {f.target} {f.size:g}" for f in faults if f.hidden),
        ],
    }
    return figures, {"detection": about}


def _few() -> list[Watched]:
    houses = [tuple(f for f in h if f.component == "radiator-south") for h in detection.parameter_faults((0.3,))[:2]]
    return detection.watch(houses, SEEDS[0])


def _many(console: Console) -> list[Watched]:
    """All houses on all processors; of the faults that theory says to vary most, more lives."""
    parameters, plant = detection.parameter_faults(), detection.plant_faults()
    runs: list[Watched] = []
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        for more in range(ROUNDS + 1):
            lives = range(LIVES) if more == 0 else range(LIVES + (more - 1) * MORE, LIVES + more * MORE)
            tasks = [(h, seed, lives, more == 0) for h in (parameters, plant) if h for seed in SEEDS]
            for part in pool.map(_watched, tasks):
                runs += part
            unsure = _unsure(runs)
            console.log(f"{len(runs)} runs; not yet sure of {len(unsure)} faults")
            parameters = [house for h in parameters if (house := tuple(f for f in h if f in unsure))]
            plant = [h for h in plant if unsure.intersection(h) or h[0].name == detection.HEALTHY]
            plant = plant if len(plant) > 1 else []
            if not unsure:
                break
    return runs


def _watched(task: tuple[list[tuple[Fault, ...]], int, range, bool]) -> list[Watched]:
    """Baselines that were fitted say how much is found and named; those known, how that compares with theory."""
    houses, seed, lives, first = task
    sets = detection.SETS if first and houses[0][0].symbol else ("known",)
    return detection.watch(houses, seed, sets, lives, tuple(EQUIPMENT))


def _unsure(runs: Sequence[Watched]) -> set[Fault]:
    """Faults whose ratio to theory may be off by more than ERROR by chance."""
    of: dict[Fault, list[Watched]] = {}
    for r in runs:
        of.setdefault(r.fault, []).append(r)
    healthy = [r for r in runs if r.fault.name == detection.HEALTHY]

    def ratios(fault: Fault) -> list[Compared]:
        if fault.symbol:
            return [r.own for r in detection_tables.rows(of[fault])]
        return [r.own for r in detection_tables.kind_rows([*of[fault], *healthy])]

    return {f for f in of if f.name != detection.HEALTHY and any(own.error > ERROR for own in ratios(f))}


def _parameter(row: Row) -> Figures:
    key = f"detection_{_key(row.component)}_{_key(row.name)}_minus_{100 * row.size:.0f}"
    return {
        f"{key}_found": figure(100 * row.score_found, "%", _seen(row), None),
        f"{key}_delay": figure(row.score_delay, "d", "median", None),
        f"{key}_found_by_innovations": figure(100 * row.innovation_found, "%", "compare", None),
        f"{key}_delay_of_innovations": figure(row.innovation_delay, "d", "median", None),
        f"{key}_named": figure(_percent(row.named), "%", "compare", None),
        f"{key}_named_by_scores": figure(_percent(row.scored), "%", "compare", None),
        f"{key}_delay_over_theory": _over_theory(row.own),
    }


def _kind(row: KindRow) -> Figures:
    key = f"detection_{_key(row.kind)}_{_key(row.target)}_{row.size:g}"
    return {
        f"{key}_found": figure(100 * row.found, "%", _seen(row), None),
        f"{key}_delay": figure(row.delay, "d", "median", None),
        f"{key}_{_key(row.chart)}_delay_over_theory": _over_theory(row.own),
    }


def _seen(row: Row | KindRow) -> str:
    return "no chart can see it" if row.hidden else "compare"


def _over_theory(own: Compared) -> dict[str, Any]:
    """None where neither finds half within the watch: there is nothing to compare."""
    holds = _within(own.ratio) if np.isfinite(own.ratio) else None
    about = {"interval": [own.low, own.high], "medians": [own.measured, own.theory], "runs": own.runs}
    return figure(own.ratio, "", "1/1.5 .. 1.5", holds) | about


def _within(ratio: float) -> bool:
    return bool(1 / BOUND <= ratio <= BOUND)


def _counted(ratios: Sequence[float]) -> Figures:
    """All comparisons together."""
    made = [_within(r) for r in ratios if np.isfinite(r)]
    return {
        "detection_compared_with_theory": figure(len(made), "cases", "compare", None),
        "detection_within_bound_of_theory": figure(sum(made), "cases", f"= {len(made)}", all(made)),
    }


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _key(name: str) -> str:
    return "_".join("".join(c if c.isalnum() else " " for c in name).lower().split())


def parameter_table(rows: Sequence[Row]) -> list[str]:
    """Markdown, a line a row."""
    head = (
        "| component | parameter | lower by | score charts: found, median delay | innovation charts "
        "| rightly named 2 d later (by scores) | own chart: median | theory | run lengths, measured over theory |"
    )
    lines = [head, "|---" * 9 + "|"]
    for r in rows:
        score = f"{100 * r.score_found:.0f}%, {_time(r.score_delay)}"
        if r.hidden:
            score = f"**no chart can see it** ({r.errors:.1f} standard errors)"
        named = "" if r.named is None or r.hidden else f"{_percent(r.named):.0f}% ({_percent(r.scored):.0f}%)"
        plain = f"{100 * r.innovation_found:.0f}%, {_time(r.innovation_delay)}"
        own = f"{_time(r.own.measured)} | {_time(r.own.theory)} | {_ratio(r.own)}"
        lines.append(f"| {r.component} | `{r.name}` | {100 * r.size:.0f}% | {score} | {plain} | {named} | {own} |")
    return lines


def kind_table(rows: Sequence[KindRow]) -> list[str]:
    """Markdown, a line a row."""
    head = (
        "| fault | where | severity | plant's charts: found, median delay | model's charts | chart "
        "| its mean, variance | median | theory | run lengths, measured over theory |"
    )
    lines = [head, "|---" * 10 + "|"]
    for r in rows:
        plant = f"{100 * r.found:.0f}%, {_time(r.delay)}"
        if r.hidden:
            plant = f"**no chart can see it** ({r.errors:.1f} standard errors)"
        found = f"{plant} | {100 * r.model_found:.0f}%, {_time(r.model_delay)}"
        own = f"{_time(r.own.measured)} | {_time(r.own.theory)} | {_ratio(r.own)}"
        where, fed = r.target.replace(" | ", " and "), f"{r.shift:.2f}, {r.variance:.2f}"
        lines.append(f"| {r.kind} | {where} | {r.size:g} | {found} | {r.chart.replace(':', ' ')} | {fed} | {own} |")
    return lines


def _time(days: float) -> str:
    if not np.isfinite(days):
        return "-"
    minutes = round(days * 1440)
    if minutes < 120:
        return f"{minutes} min"
    return f"{days * 24:.0f} h" if days < 2 else f"{days:.1f} d"


def _ratio(own: Compared) -> str:
    return f"{own.ratio:.2f} ({own.low:.2f} - {own.high:.2f})" if np.isfinite(own.ratio) else ""


def _restored(row: dict[str, Any]) -> dict[str, Any]:
    """JSON's null was an infinite delay, or nothing to compare; both read as "-"."""
    own = Compared(**_floats(row["own"]))
    kept = {k: v for k, v in row.items() if k not in ("own", "hidden")}
    return {k: v if k in NAMED else _number(v) for k, v in kept.items()} | {"own": own}


def _floats(row: dict[str, Any]) -> dict[str, Any]:
    return {k: _number(v) for k, v in row.items()}


def _number(value: Any) -> Any:
    return float("inf") if value is None else value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="what python -m benchmarks.alarms --json printed")
    parser.add_argument("--plot", type=Path, help="picture to draw, .png or .svg")
    given = parser.parse_args()
    about = json.loads(given.run.read_text())["context"]["detection"]
    rows = [Row(**_restored(r)) for r in about["parameters"]]
    faults = [KindRow(**_restored(f)) for f in about["faults"]]
    print("\n".join([*parameter_table(rows), "", *kind_table(faults)]))
    if given.plot:
        detection_tables.plot(rows, given.plot)


if __name__ == "__main__":
    main()
