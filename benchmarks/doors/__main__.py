"""What arrives from outside, measured: mutants at every door, and a daemon that is killed.

``python -m benchmarks.doors [--quick] [--json]``: a million mutants and a hundred kills; quick: 4 500 and four.
"""

from __future__ import annotations

import logging
import warnings
from typing import Any

import structlog

from benchmarks.common import arguments, context, figure, report
from benchmarks.doors.fuzz import HANG_SECONDS, Outcome, run, targets
from benchmarks.doors.kills import measure

MUTANTS, KILLS = 1_000_000, 100
QUICK_MUTANTS, QUICK_KILLS = 4_500, 4
# A file is written and read for each of its cases: they have fewer.
SHARES = {"csv": 0.02, "csv.gz": 0.02, "parquet": 0.02, "xlsx": 0.02, "site file": 0.03}
GROWTH_MB = 300.0
SEED = 1


def mutants(total: int) -> dict[str, Outcome]:
    """Each door's share of so many mutants."""
    doors = targets()
    others = (1.0 - sum(SHARES.values())) / (len(doors) - len(SHARES))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {d.name: run(d, round(total * SHARES.get(d.name, others)), SEED) for d in doors}


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    killed = measure(QUICK_KILLS if options.quick else KILLS, SEED)
    found = mutants(QUICK_MUTANTS if options.quick else MUTANTS)
    figures: dict[str, dict[str, Any]] = {}
    for name, o in found.items():
        figures[f"{name}: crashes"] = figure(o.crashed, f"of {o.cases}", "0", o.crashed == 0)
        figures[f"{name}: slowest"] = figure(o.slowest, "s", f"<= {HANG_SECONDS:g}", o.hangs == 0)
        grown = o.grown_bytes / 1e6
        figures[f"{name}: memory"] = figure(grown, "MB more", f"<= {GROWTH_MB:g}", grown <= GROWTH_MB)
    for name, n in killed.items():
        if name.startswith("wrong "):
            figures[f"killed: {name}"] = figure(n, "lost, doubled", "0", n == 0)
    about = {name: n for name, n in killed.items() if not name.startswith("wrong ")}
    report(figures, context(seed=SEED, mutants=sum(o.cases for o in found.values()), **about), options.json)


if __name__ == "__main__":
    main()
