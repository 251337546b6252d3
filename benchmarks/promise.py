"""The promise of false alarms, and what is found, on plant that no model of the project has drawn.

    python -m benchmarks.promise [--quick] [--json] [--to FOLDER] [--sets house-dev real ...] [--plants N]

Foreign houses and substations (:mod:`benchmarks.foreign_plants`), real records and the project's own houses, each by
``fdd fit`` on its first eight weeks and ``fdd audit`` on the rest; then the audit of twins with a fault. Answers are
kept in FOLDER, and a second run goes on where the first stood. Sets named ``dev`` may be developed on, sets named
``report`` not. An alarm that comes within 30 days of a fault's beginning counts as its finding; how many healthy plants
ring in the same days says what that is worth.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pandas as pd
from rich.progress import track

from benchmarks.common import context, figure, report
from benchmarks.foreign_plants import HOUSE, ONSET, SETS, START, SUBSTATION
from benchmarks.promise_runs import Json, Plant, plants, run
from fdd.diagnosis.score import wilson
from fdd.residual_monitors.budget import poisson_interval

BEGUN = pd.Timestamp(START, tz="UTC") + pd.Timedelta(days=ONSET)
WITHIN = (7, 20, 30)  # days
WINTER = ("11", "12", "01", "02")
# Component's suffix and the causes that are right; "model" is "none of the known", right where there is no hypothesis.
RIGHT = {
    "heater-20": ("", {"heater"}),
    "heater-10": ("", {"heater"}),
    # "open-window" is told as "more heat leaves than the envelope explains", which is what worn insulation does.
    "insulation-20": ("", {"insulation", "open-window", "model"}),
    "bias": ("", {"bias"}),
    "window": ("", {"open-window"}),
    "fouling-20": ("-hx", {"fouling"}),
    "mixing-leak": ("-rad", {"model"}),
}
# What is asked: days, and share of plants in which the fault is found by then (fouling grows for ten days first).
WANTED = {"heater-20": (7, 0.95), "heater-10": (20, 0.8), "insulation-20": (30, 0.8), "fouling-20": (24, 0.8)}
# The row of what a fit foretells that speaks of a fault, by its first words, and the fault's size in that row's unit.
FORETOLD = {
    "heater-20": ("power P_heat", 0.2),
    "heater-10": ("power P_heat", 0.1),
    "bias": ("sensor T_room", 0.5),
    "insulation-20": ("open-window (R_ea", 1 - 1 / 1.2),
    "fouling-20": ("fouling", 0.2),
}
MOST = {"house": 1.5, "substation": 1.5, "real": 3.0, "own": 1.5}
MOST_RINGING, LEAST_RIGHT, LEAST_KEPT = 0.15, 0.7, 0.85
TOLD = 0.5  # a healthy alarm that names a cause with more than this accuses
QUICK = 5


def pooled(audits: Sequence[Json], table: str, names: Iterable[str] | None = None) -> tuple[int, float]:
    """Alarms and promised ones, over rows of a table of the audits."""
    rows = [row for a in audits for key, row in a[table].items() if names is None or key in names]
    return sum(r["alarms"] for r in rows), sum(r["promised"] for r in rows)


def kept(alarms: int, promised: float, most: float | None = None) -> Json:
    """Realised over promised with its exact interval, against the most that is asked."""
    if promised <= 0:
        return figure(None, "of promised", "", None) | {"alarms": alarms, "promised": promised}
    low, high = (x / promised for x in poisson_interval(alarms))
    holds = None if most is None else alarms / promised <= most
    target = "" if most is None else f"<= {most:g}"
    about = {"interval": [low, high], "alarms": alarms, "promised": promised}
    return figure(alarms / promised, "of promised", target, holds) | about


def audited(answers: Sequence[Json], which: str) -> Iterator[tuple[Json, Json]]:
    """Every site that has an audit of this name, with it."""
    for a in answers:
        if "error" not in a.get(which, {"error": "not run"}):
            yield a, a[which]


def lanes(answers: Sequence[Json], which: str) -> list[tuple[str, list[Json]]]:
    """Every plant in such audits, with its alarms of the plant, not of its model, since the fault's beginning."""
    return [
        (
            plant,
            [x for x in audit["alarms"] if _of(plant, x["component"], a) and _since(x) >= 0 and x["kind"] == "plant"],
        )
        for a, audit in audited(answers, which)
        for plant in a["plants"]
    ]


def _of(plant: str, component: str, site: Json) -> bool:
    return len(site["plants"]) == 1 or component == plant or component.startswith(f"{plant}-")


def _since(alarm: Json) -> float:
    """Days since the fault's beginning."""
    return float((pd.Timestamp(alarm["raised"]) - BEGUN) / pd.Timedelta(days=1))


def promise_figures(group: str, answers: Sequence[Json], budget: float) -> Json:
    """All charts, each kind, each season, and what was not judged."""
    pairs = list(audited(answers, f"audit-{budget:g}"))
    audits = [audit for _, audit in pairs]
    if not audits:
        return {}
    head = f"{group}_{budget:g}"
    most = MOST[group.split("-")[0]]
    watched = [r for a in audits for r in a["charts"].values()]
    due = sum(r["promised"] / r["share_judged"] if r["share_judged"] else 0.0 for r in watched)
    found = {f"{head}_all": kept(*pooled(audits, "charts"), most)}
    for chart in sorted({c for a in audits for c in a["charts"]}):
        found[f"{head}_{chart}"] = kept(*pooled(audits, "charts", [chart]))
    months = {m for a in audits for m in a["months"]}
    for season, own in (
        ("winter", {m for m in months if m[5:] in WINTER}),
        ("spring", {m for m in months if m[5:] not in WINTER}),
    ):
        found[f"{head}_{season}"] = kept(*pooled(audits, "months", own))
    judged = sum(r["promised"] for r in watched) / due if due else 0.0
    found[f"{head}_judged"] = figure(judged, "of time with data", "", None)
    ringing = sum(
        any(_of(plant, x["component"], a) for x in audit["alarms"]) for a, audit in pairs for plant in a["plants"]
    )
    found[f"{head}_plants_ringing"] = figure(ringing, f"of {sum(len(a['plants']) for a, _ in pairs)} plants", "", None)
    accusing = [x for a in audits for x in a["alarms"] if _likelihood(x) > TOLD]
    found[f"{head}_accusing"] = figure(len(accusing), "alarms", "0", not accusing)
    return found


def _likelihood(alarm: Json) -> float:
    causes = [c for c in (alarm.get("cleared_as") or alarm["rang_as"]) if c["name"] != "model"]
    return max((c["likelihood"] or 0.0 for c in causes), default=0.0) if alarm["kind"] == "plant" else 0.0


def detection_figures(group: str, answers: Sequence[Json], faults: Sequence[str], budget: float) -> Json:
    """Found within days, rightly placed and named, beside the healthy plants that ring in the same days."""
    found: Json = {}
    healthy = lanes(answers, f"audit-{budget:g}")
    if healthy and any(f in a for a in answers for f in faults):
        for days in WITHIN:
            n = sum(_rang(alarms, days) for _, alarms in healthy)
            holds = n <= MOST_RINGING * len(healthy) if days == WITHIN[-1] else None
            found[f"{group}_healthy_ringing_{days}"] = share(n, len(healthy), f"<= {MOST_RINGING:.0%}", holds)
    for fault in faults:
        twins = lanes(answers, fault)
        if twins:
            found |= _found(f"{group}_{fault}", twins, *WANTED.get(fault, (0, 0.0))) | _named(group, fault, twins)
    return found


def _found(head: str, twins: Sequence[tuple[str, list[Json]]], days: float, least: float) -> Json:
    table: Json = {}
    for within in sorted({*WITHIN, *([days] if days else [])}):
        n = sum(_rang(alarms, within) for _, alarms in twins)
        asked = within == days
        holds = n >= least * len(twins) if asked else None
        table[f"{head}_found_{within}"] = share(n, len(twins), f">= {least:.0%}" if asked else "", holds)
    return table


def foretold_figures(group: str, answers: Sequence[Json], faults: Sequence[str]) -> Json:
    """Faults that the fit said would be found within a month, and those that it declined: how many were found."""
    found: Json = {}
    for fault in (f for f in faults if f in FORETOLD):
        words, size = FORETOLD[fault]
        told = {p: _told(p, a, words) for a, _ in audited(answers, fault) for p in a["plants"]}
        twins = [(plant, _rang(alarms, WITHIN[-1])) for plant, alarms in lanes(answers, fault)]
        for says, mine in (
            ("foretold", [rang for plant, rang in twins if (least := told[plant]) is not None and least <= size]),
            ("declined", [rang for plant, rang in twins if (least := told[plant]) is not None and least > size]),
        ):
            target = f">= {LEAST_KEPT:.0%}" if says == "foretold" else ""
            holds = sum(mine) >= LEAST_KEPT * len(mine) if mine and says == "foretold" else None
            if any(v is not None for v in told.values()):
                found[f"{group}_{fault}_{says}_found"] = share(sum(mine), len(mine), target, holds)
    return found


def _told(plant: str, site: Json, words: str) -> float | None:
    """The smallest size that is foretold to be found on a plant: infinite where it is declined, None where not told."""
    sizes = [
        float("inf") if row["size"] is None else float(row["size"])
        for b in site["fit"]["baselines"]
        if _of(plant, b["component"], site)
        for row in b["diagnostics"].get("probation", {}).get("foretold", ())
        if row["fault"].startswith(words)
    ]
    return min(sizes, default=None)


def _named(group: str, fault: str, twins: Sequence[tuple[str, list[Json]]]) -> Json:
    """Of plants in which something rang within a month: where the first alarm was, and what it held likeliest."""
    suffix, causes = ("-hx", {"bias"}) if (group[:3], fault) == ("sub", "bias") else RIGHT[fault]
    firsts = [(plant, alarms[0]) for plant, alarms in twins if _rang(alarms, WITHIN[-1])]
    right = sum(a["component"] == plant + suffix and _first(a) in causes for plant, a in firsts)
    named = Counter(f"{a['component'].removeprefix(plant)} {_first(a)}".strip() for plant, a in firsts)
    holds = right >= LEAST_RIGHT * len(firsts) if firsts else None
    told = share(right, len(firsts), f">= {LEAST_RIGHT:.0%}", holds) | {"named": dict(named.most_common())}
    return {f"{group}_{fault}_right": told}


def _rang(alarms: Sequence[Json], days: float) -> bool:
    return any(_since(a) < days for a in alarms)


def _first(alarm: Json) -> str:
    """The cause held likeliest a day after the alarm, or when it rang where it was never cleared."""
    causes = alarm.get("cleared_as") or alarm["rang_as"]
    return str(causes[0]["name"]) if causes else "none"


def share(count: int, of: int, target: str, holds: bool | None) -> Json:
    """A share of plants with its Wilson interval."""
    return figure(count, f"of {of}", target, holds) | {"interval": list(wilson(count, of))}


def figures_of(answers: Sequence[Json], given: argparse.Namespace) -> Json:
    """Every figure of every set."""
    found: Json = {}
    for group in dict.fromkeys(a["group"] for a in answers):
        mine = [a for a in answers if a["group"] == group]
        refused = {a["name"]: a["fit"]["error"] for a in mine if "error" in a["fit"]}
        watched = sum(len(a["plants"]) for a in mine if a["name"] not in refused)
        found[f"{group}_plants"] = figure(watched, "plants watched", "", None) | {"refused": refused}
        for budget in given.budgets:
            found |= promise_figures(group, mine, budget)
        found |= detection_figures(group, mine, given.faults, given.budgets[0])
        found |= foretold_figures(group, mine, given.faults)
    return found


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="five houses, one fault, one budget")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--foreign", type=Path, default=Path("../shared/foreign"), help="scripts that make plants")
    parser.add_argument("--real", type=Path, default=Path("../shared/data/real2"), help="real records, with sites/")
    parser.add_argument("--to", type=Path, default=Path("var/promise"), help="keeps every command's answer")
    parser.add_argument("--made", type=Path, help="folder of made plants; default TO/made")
    parser.add_argument("--sets", nargs="+", default=[*SETS, "real", "own"], choices=[*SETS, "real", "own"])
    parser.add_argument("--plants", type=int, help="so many plants of each foreign set")
    parser.add_argument("--budgets", type=float, nargs="+", default=[2.0, 12.0], help="false alarms a year and plant")
    parser.add_argument("--faults", nargs="*", help="of the twins; default: all")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no further plant is begun after these")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    given.made = given.made or given.to / "made"
    if given.faults is None:
        given.faults = list(dict.fromkeys(c.name for k in (HOUSE, SUBSTATION) for c in k.cases if c.fault != "none"))
    if given.quick:
        given.sets, given.plants, given.budgets, given.faults = ["house-dev"], QUICK, [2.0], ["heater-20"]
    return given


def main() -> None:
    given = arguments()
    end = time.monotonic() + 60 * given.minutes
    every = list(plants(given))

    with ProcessPoolExecutor(given.processes) as pool:
        waiting = [pool.submit(_one, p, given, end) for p in every]
        done = [w.result() for w in track(waiting, "plants", disable=given.json)]
    answers = [a for a in done if a is not None]
    about = context(plants={g: sum(a["group"] == g for a in answers) for g in given.sets}, budgets=given.budgets)
    report(figures_of(answers, given), about, given.json)


def _one(plant: Plant, given: argparse.Namespace, end: float) -> Json | None:
    return None if time.monotonic() > end else run(plant, given.to, given.budgets, given.faults)


if __name__ == "__main__":
    main()
