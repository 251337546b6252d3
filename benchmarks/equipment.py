"""Equipment watched by rows of expectations: what is found, named, and promised.

    python -m benchmarks.equipment [--quick] [--json]

*Days*: shared air-handler records, day by day through ``fdd replay``, with nothing learned and with normal days learned
(never the one that is judged); MZVAV-2-1 was developed on and MZVAV-2-2 is the report. *Years*: fault-free simulated
air handlers with what the rows leave out, findings against those promised, before and after thirty days were learned.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.common import arguments, context, figure, report
from benchmarks.equipment_days import RAN, SETS, Judged, folder, judged_days
from benchmarks.equipment_plants import AirHandler
from fdd.diagnosis.equipment import Knowledge, examine, judge_day, teach
from fdd.diagnosis.score import wilson
from fdd.models.equipment.air_handler import AIR_HANDLER
from fdd.residual_monitors.budget import poisson_interval

BUDGET = 2.0
LEARNED = 30
SEED = 17


def days_figures(name: str, trained: bool, quick: bool) -> dict[str, Any]:
    """Rates of one set."""
    found = judged_days(name, trained, quick)
    faulty, normal = [j for j in found if j.fault != "normal"], [j for j in found if j.fault == "normal"]
    hits = [j for j in faulty if j.rang]
    sure = [j for j in hits if j.probability >= 0.8]
    label = f"{name}, {'normal days learned' if trained else 'nothing learned'}"
    return {
        f"{label}: faulty days found": _share(sum(j.rang for j in faulty), len(faulty), 0.9 if trained else 0.75, 1),
        f"{label}: normal days alarmed": _share(sum(j.rang for j in normal), len(normal), 0.04, -1),
        f"{label}: place right, of hits": _share(sum(j.right for j in hits), len(hits), 0.85, 1),
        f"{label}: right, said with .8 and more": _share(sum(j.right for j in sure), len(sure), 0.85, 1),
        f"{label}: fan ran over {RAN:g} h: found": _share(sum(j.fan_hours > RAN for j in faulty), len(faulty), None, 1),
        f"{label}: fan ran over {RAN:g} h: alarmed": _share(
            sum(j.fan_hours > RAN for j in normal), len(normal), None, 1
        ),
    } | {f"{label}: days": figure(_told(found), "", "-", None)}


def _told(found: Sequence[Judged]) -> str:
    return "; ".join(
        f"{j.day} {j.fault}: {j.cause or 'quiet'} {j.probability:.2f}" for j in found if j.rang or j.fault != "normal"
    )


def _share(count: int, of: int, target: float | None, side: int) -> dict[str, Any]:
    low, high = wilson(count, of)
    holds = None if target is None or not of else side * (count / of - target) >= 0
    wanted = "-" if target is None else f"{'at least' if side > 0 else 'at most'} {target:.0%}"
    return figure(f"{count} of {of}", f"({low:.0%} to {high:.0%})", wanted, holds)


@dataclass
class Years:
    """Findings of fault-free plant-years: how many began, by row, and how many days could be judged."""

    days: int = 0
    findings: int = 0
    by_row: Counter[str] = field(default_factory=Counter)


def years_figures(plants: int, days: int) -> dict[str, Any]:
    """Findings a year against those promised; one that goes on is the same finding."""
    before, after = Years(), Years()
    for plant in range(plants):
        rng = np.random.default_rng([SEED, plant])
        handler = AirHandler.drawn(rng)
        examined = [examine(AIR_HANDLER, handler.day(d, rng)) for d in range(days + LEARNED)]
        # The month before the year is learned; both watch the same year.
        knowledge = teach(AIR_HANDLER, examined[:LEARNED])
        for years, known in ((before, Knowledge()), (after, knowledge)):
            _watch(years, examined[LEARNED:], known)
    told = {}
    for label, years in (("nothing learned", before), ("a month learned", after)):
        promised = BUDGET * years.days / 365.25
        low, high = (b / promised for b in poisson_interval(years.findings))
        realised = years.findings / promised
        told[f"fault-free years, {label}: findings of promised"] = figure(
            f"{realised:.2f}", f"({low:.2f} to {high:.2f})", "0.5 to 1.5", 0.5 <= realised <= 1.5
        )
        told[f"fault-free years, {label}: by row"] = figure(dict(years.by_row.most_common()), "", "-", None)
    return told


def _watch(years: Years, examined: Sequence[Any], knowledge: Knowledge) -> None:
    ringing: set[str] = set()
    for day in examined:
        verdict = judge_day(AIR_HANDLER, day, knowledge, BUDGET)
        years.days += 1
        now = {t.statistic.key for t in verdict.ringing} | (
            {"steady readings"} if (verdict.bank_ratio or 0) >= 1 else set()
        )
        if now and not ringing:
            years.findings += 1
            years.by_row[min(now)] += 1
        # Days on which a row does not apply say nothing of it.
        ringing = now or (ringing if not verdict.judged else set())


def main() -> None:
    """Measure and print."""
    options = arguments(__doc__ or "")
    figures: dict[str, Any] = {}
    if folder().is_dir():
        for name in SETS:
            for trained in (False, True):
                figures |= days_figures(name, trained, options.quick)
    plants, days = (4, 60) if options.quick else (40, 365)
    figures |= years_figures(plants, days)
    report(figures, context(seed=SEED, plants=plants, days=days, budget=BUDGET), options.json)


if __name__ == "__main__":
    main()
