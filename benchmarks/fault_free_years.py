"""Plant-years of fault-free operation through the whole engine: alarms of every kind of chart against the promise.

    python -m benchmarks.fault_free_years [--quick] [--json] [--seed N] [--minutes M] [--to FILE] [--pool FILE ...]

Batches of simulated houses (:mod:`benchmarks.whole_engine`) learn for four weeks of October and are watched from
November on for a year, by filters of several sets of baselines side by side, until the minutes are used up. Each batch
adds a line to FILE; ``--pool`` adds up what several runs have written, each with a seed of its own, and runs nothing.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import whole_engine
from benchmarks.common import context, figure, report
from benchmarks.whole_engine import Fleet
from fdd.records import NANOSECONDS, Baseline
from fdd.residual_monitors.budget import YEAR, poisson_interval
from fdd.service.engine.engine import Engine

Record = dict[str, Any]
DAYS = 364.0
SETS = ("fitted", "known", "model_off", "default")
DEFAULT_BUDGET = 2.0  # of a default site
# A year of houses is a batch; more of them make a step cheaper, and a run longer than its minutes.
PLANTS = 20
# Plant-years a set that a promise is judged by.
WANTED = 200.0
# Where so few are promised, chance decides; only what it does not explain is held against the engine.
FEW = 10.0


def baselines_of(fleet: Fleet, sets: Sequence[str], seed: int) -> dict[str, list[dict[str, Baseline]]]:
    """Baselines of every plant for these sets; see :mod:`benchmarks.whole_engine`."""
    fitted = whole_engine.fit_all(fleet)
    found = {"fitted": fitted, "default": fitted}
    if {"known", "model_off"} & set(sets):
        found["known"] = whole_engine.settled(fleet, [whole_engine.known(b) for b in fitted])
        rng = np.random.default_rng(seed)
        wrong = [whole_engine.disturbed(b, rng) for b in found["known"]]
        found["model_off"] = whole_engine.settled(fleet, wrong)
    return {which: found[which] for which in sets}


def batch(seed: int, plants: int, days: float, sets: Sequence[str], budget: float, until: float) -> Record:
    """One batch, cut short at ``until`` (processor time does not stand still for others) [s of the monotonic clock]."""
    fleet = whole_engine.simulated(plants, whole_engine.LEARNING + days, seed)
    tables = baselines_of(fleet, sets, seed)
    budgets = dict.fromkeys(sets, budget)
    if "default" in budgets:
        budgets["default"] = DEFAULT_BUDGET
    engine = whole_engine.engine_of(fleet, tables, budgets)
    rang: dict[str, Counter[str]] = {which: Counter() for which in sets}
    begun, frames = time.process_time(), 0
    charts: Counter[str] = Counter()
    for done, alarms in whole_engine.watching(fleet, engine):
        frames = done
        for a in alarms:
            which, _, component = a.component.split("/")
            rang[which][whole_engine.kind_of_chart(a)] += 1
            charts[f"{which} {component} {a.charts[0].rpartition('/')[2]}"] += 1
        if time.monotonic() > until:
            break
    years = plants * frames * fleet.plan.step / NANOSECONDS / YEAR
    return {
        "seed": seed,
        "plants": plants,
        "years": years,
        "lost": whole_engine.LOST,
        "budget": budgets,
        "promised": {
            which: {k: v * due * years for k, v in whole_engine.promises(fleet, tables[which], due).items()}
            for which, due in budgets.items()
        },
        "rang": {which: dict(count) for which, count in rang.items()},
        "charts": dict(charts.most_common()),
        "processor_seconds": time.process_time() - begun,
        "restarts": _restarts(engine),
    }


def _restarts(engine: Engine) -> dict[str, int]:
    return {k: v for k, v in engine.counts.items() if k.startswith("restart") and v}


def read(paths: Sequence[Path]) -> list[Record]:
    """Records that earlier runs have written."""
    return [json.loads(line) for path in paths for line in path.read_text().splitlines()]


def figures_of(records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """Realised over promised of every set and kind of chart, with exact Poisson intervals, over all records."""
    found: dict[str, dict[str, Any]] = {}
    for which in dict.fromkeys(w for r in records for w in r["rang"]):
        own = [r for r in records if which in r["rang"]]
        promised: Counter[str] = Counter()
        rang: Counter[str] = Counter()
        for r in own:
            promised.update(r["promised"][which])
            rang.update(r["rang"][which])
        years = sum(r["years"] for r in own)
        found[f"{which}_plant_years"] = figure(years, "a", f">= {WANTED:g}", years >= WANTED or None)
        for kind in ("all", *promised):
            n, due = (sum(rang.values()), sum(promised.values())) if kind == "all" else (rang[kind], promised[kind])
            if not n and not due:  # charts that these data give nothing to do, such as frozen readings of noisy sensors
                continue
            found[f"{which}_{kind}"] = kept(kind, n, due)
    return found


def kept(kind: str, rang: int, promised: float) -> dict[str, Any]:
    """Realised over promised alarms of all charts (``all``), or of a kind of chart, against what is asked of it."""
    least, most, target = (1 / 1.5, 1.5, "1/1.5 .. 1.5") if kind == "all" else (0.0, 2.0, "<= 2")
    if not promised:
        return figure(None, "of promised", "none", rang == 0) | {"alarms": rang, "promised": promised}
    low, high = (x / promised for x in poisson_interval(rang))
    fits = least <= rang / promised <= most
    holds = fits if promised >= FEW else (None if low <= most and high >= least else False)
    about = {"interval": [low, high], "alarms": rang, "promised": promised}
    return figure(rang / promised, "of promised", target, holds) | about


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the same figures on a smaller sample, under 50 s")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--seed", type=int, default=11, help="of the first batch; the next take the numbers after it")
    parser.add_argument("--minutes", type=float, default=30.0, help="wall time to use; the last batch is cut short")
    parser.add_argument("--plants", type=int, default=PLANTS, help="houses a batch")
    parser.add_argument("--budget", type=float, default=12.0, help="false alarms a year and plant, but for 'default'")
    parser.add_argument("--sets", default=",".join(SETS), help="baselines to watch by")
    parser.add_argument("--lost", type=float, default=whole_engine.LOST, help="share of single samples that are lost")
    parser.add_argument("--to", type=Path, help="file that each batch adds a line to")
    parser.add_argument("--pool", type=Path, nargs="+", help="add up these files instead of running")
    return parser.parse_args()


def run(given: argparse.Namespace, console: Console) -> list[Record]:
    """Batches until the time is used up."""
    plants, days, minutes = (1, 14.0, np.inf) if given.quick else (given.plants, DAYS, given.minutes)
    until, seed = time.monotonic() + 60 * minutes, given.seed
    records: list[Record] = []
    whole_engine.LOST = given.lost
    while not records or (time.monotonic() < until and not given.quick):
        records.append(batch(seed, plants, days, given.sets.split(","), given.budget, until))
        console.log(records[-1])
        if given.to:
            with given.to.open("a") as file:
                file.write(json.dumps(records[-1]) + "\n")
        seed += 1
    return records


def main() -> None:
    given = arguments()
    console = Console(stderr=True, quiet=given.json)
    records = read(given.pool) if given.pool else run(given, console)
    charts: Counter[str] = Counter()
    for r in records:
        charts.update(r["charts"])
    seconds = sum(r["processor_seconds"] for r in records)
    set_years = sum(r["years"] * len(r["rang"]) for r in records)
    about = context(
        seeds=[r["seed"] for r in records],
        plants=[r["plants"] for r in records],
        plant_years_a_processor_minute=60 * set_years / seconds,
        charts=dict(charts.most_common(30)),
    )
    report(figures_of(records), about, given.json)


if __name__ == "__main__":
    main()
