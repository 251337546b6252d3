"""The demonstration plant over many seeds: is the fault found, on the right component, and does nothing else ring?

    python -m benchmarks.demo [--quick] [--json]

Every seed has its own weather, occupants, process and sensor noise, its own onset, and baselines fitted to its own
first weeks. The engine runs in this process; that the daemon gives the same bytes is a test of its own
(tests/service/test_run.py).
"""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.common import arguments, context, figure, report
from fdd.plant.faults import DAY
from fdd.records import NANOSECONDS, AlarmState
from fdd.residual_monitors.budget import YEAR, realised
from fdd.service.baselines.versions import in_force
from fdd.service.engine.engine import Engine
from fdd.service.verbs.demo import FAULTS, prepare, scenario_of

WEEKS = 4


@dataclass(frozen=True)
class Outcome:
    """What one seed gave; the delay is NaN where the fault was not found."""

    fault: str
    seed: int
    delay_days: float
    false_alarms: int
    samples: int
    seconds: float


def one(fault: str, seed: int) -> Outcome:
    """Simulate, fit, watch."""
    scenario, planted = scenario_of(fault, seed, WEEKS)
    with TemporaryDirectory() as folder:
        prepared = prepare(scenario, Path(folder))
        store = prepared.context.store()
        plan = prepared.context.plan
        engine = Engine(plan, in_force(store, [c.name for c in plan.components]))
        store.close()
    began = time.perf_counter()
    alarms = {a.key: a for batch in prepared.batches for a in engine.step(batch).alarms}
    seconds = time.perf_counter() - began
    raised = [a for a in alarms.values() if a.state is not AlarmState.SUPPRESSED]
    onset = None if planted is None else scenario.first + round(planted.onset * NANOSECONDS)
    hits = [a.raised for a in raised if onset is not None and a.component == FAULTS[fault][1] and a.raised >= onset]
    delay = (min(hits) - onset) / NANOSECONDS / DAY if hits and onset is not None else float("nan")
    return Outcome(fault, seed, delay, len(raised) - len(hits), prepared.samples, seconds)


def main() -> None:
    """Print the figures."""
    options = arguments(__doc__ or "")
    seeds = range(1, 3) if options.quick else range(1, 21)
    tasks = [(fault, seed) for fault in (*FAULTS, "none") for seed in seeds]
    with ProcessPoolExecutor(2, mp_context=get_context("forkserver")) as pool:
        outcomes = list(pool.map(one, *zip(*tasks, strict=True)))
    figures = {}
    for fault in FAULTS:
        mine = [o for o in outcomes if o.fault == fault]
        found = sum(np.isfinite(o.delay_days) for o in mine)
        figures[f"{fault}_found"] = figure(
            int(found), f"of {len(mine)} seeds", ">= 19 of 20", found >= 0.95 * len(mine)
        )
        figures[f"{fault}_median_delay"] = figure(float(np.nanmedian([o.delay_days for o in mine])), "days", "", None)
    years = len(outcomes) * WEEKS * 7 / 365.25
    kept = realised(sum(o.false_alarms for o in outcomes), years * YEAR, 2.0)
    figures["false_alarms"] = figure(
        kept.count, f"in {years:.1f} plant-years", f"<= {kept.expected:.1f} promised, 95 % Poisson", kept.low <= 2.0
    )
    rate = sum(o.samples for o in outcomes) / sum(o.seconds for o in outcomes)
    figures["engine_samples_per_second"] = figure(rate, "1/s", "", None)
    report(figures, context(seeds=list(seeds), weeks=WEEKS, false_alarms_per_year=2.0), options.json)


if __name__ == "__main__":
    main()
