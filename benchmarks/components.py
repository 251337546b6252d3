"""Component models: what fits find again, balances, threshold, hysteresis, measured pipes, a measured air handler."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks import air_handler_days as ahu
from benchmarks import component_studies as studies
from benchmarks import measured_pipes
from benchmarks.common import arguments, context, figure, report
from benchmarks.component_balances import balances
from benchmarks.component_cases import CASES, experiment, recover
from benchmarks.fault_matrix import HOUSE, measured_house
from fdd.models.document import stale

QUICK_CASES = ("zone", "control_valve", "pipe_hydraulic", "radiator", "air_handler")
Figures = dict[str, dict[str, Any]]


def coverage(quick: bool, about: dict[str, Any]) -> Figures:
    """Share of true parameters inside 95 % intervals, and of innovations that pass for white."""
    names, seeds = (QUICK_CASES, 2) if quick else (tuple(CASES), 10)
    figures, table = {}, {}
    inside = of = white = outputs = 0
    for name in names:
        found = [recover(name, seed) for seed in range(seeds)]
        i, n, w, o = (sum(r[k] for r in found) for k in ("inside", "of", "white", "outputs"))
        table[name] = {"inside": i, "of": n, "white": w, "outputs": o}
        inside, of, white, outputs = inside + i, of + n, white + w, outputs + o
    about["coverage"] = table
    # A count this low would be seen once in a hundred times if intervals covered 95 %.
    fewest = int(binom.ppf(0.01, of, 0.95))
    figures["parameters in their 95 % intervals"] = figure(
        inside / of, "share", f">= {fewest / of:.3f}", inside >= fewest
    )
    least = int(binom.ppf(0.01, outputs, 0.99))
    figures["innovations white when the model is true"] = figure(
        white / outputs, "share", f">= {least / outputs:.3f}", white >= least
    )
    return figures


def physics(quick: bool, about: dict[str, Any]) -> Figures:
    """Balances, threshold and hysteresis."""
    closures = balances()
    about["energy balances"] = closures
    worst = max(closures.values())
    minutes = studies.time_constants()
    about["two-room house, time constants [min]"] = minutes.round(1).tolist()
    apart = float(np.abs(minutes / np.array(studies.PAPER_MINUTES) - 1.0).max())
    case = replace(CASES["pipe_hydraulic"], rows=3000)
    threshold = studies.threshold_profile(experiment(case, 3)[1], quick)
    about["threshold"] = threshold
    off = abs(threshold["centre"] - 2130.0)
    valves = {
        t: studies.hysteresis(t, rows=1500 if quick else 3000, starts=1 if quick else 3)
        for t in ("dahl", "bliman-sorine")
    }
    about["valve, prediction-error variances [m^2] by true friction and model"] = valves
    dahl, slow = valves["dahl"], valves["bliman-sorine"]
    ratio, sibling = dahl["play"] / dahl["dahl"], dahl["bliman-sorine"] / dahl["dahl"]
    needed = slow["dahl"] / slow["bliman-sorine"]
    return {
        "energy balance, worst": figure(worst, "of throughput", "<= 1e-9", worst <= 1e-9),
        "building, time constants against the paper's": figure(
            apart, "largest relative difference", "<= 0.02, as it is rounded", apart <= 0.02
        ),
        "pipe threshold, centre of the profile": figure(
            threshold["centre"], "Re", "2130 within 3 standard errors", off <= 3 * threshold["error"]
        ),
        "valve: play over Dahl, prediction-error variance": figure(ratio, "ratio", ">= 3 (paper: 3)", ratio >= 3.0),
        "valve: Bliman-Sorine over Dahl, the valve being Dahl's": figure(
            sibling, "ratio", "within 0.05 of 1", abs(sibling - 1.0) <= 0.05
        ),
        "valve: Dahl over Bliman-Sorine, the valve being theirs": figure(needed, "ratio", "> 1", needed > 1.0),
    }


def pipes(quick: bool, about: dict[str, Any]) -> Figures:
    """The measured pipe steps: every run simulated by a fit to others, in the quick size to the first run alone."""
    name = "measured pipe, simulation error on runs not seen"
    if not measured_pipes.load(False):
        return {name: figure("no data", "of the step", "<= 0.05", None)}
    runs = measured_pipes.first_alone() if quick else measured_pipes.cross_validated(False)
    about["measured pipe"] = {n: vars(j) for n, j in runs.items()}
    shares = [j.error / j.step for j in runs.values()]
    found = measured_pipes.fitted(False, tuple(measured_pipes.load(False))[:1] if quick else None)
    off = found.params["C"] / (measured_pipes.WATER + measured_pipes.STEEL) - 1.0
    return {
        name: figure(float(np.sqrt(np.mean(np.square(shares)))), "of the step", "<= 0.05", max(shares) <= 0.05),
        "measured pipe, heat capacity against water and steel": figure(off, "relative", "within 0.10", abs(off) <= 0.1),
    }


def plant(quick: bool, about: dict[str, Any]) -> Figures:
    """A large plant, and which parameter shows which fault."""
    begin = time.perf_counter()
    seconds, components = studies.large_plant_seconds(20.0 if quick else 365.0, plain=quick)
    about["large plant"] = {"components": components, "with compiling [s]": time.perf_counter() - begin}
    house = measured_house(dict(list(HOUSE.items())[:1]) if quick else HOUSE)
    about["faults of the house"] = house
    fouling = house["fouling of the heat exchanger, 5 %"]
    beside = max(abs(v) for c, v in fouling.items() if not c.startswith("hx."))
    return {
        "50 components, a year at 10 min": figure(seconds, "s", "< 60", seconds < 60.0),
        "5 % fouling, shift of hx.C": figure(fouling["hx.C"], "standard errors", "<= -10", fouling["hx.C"] <= -10),
        "5 % fouling, largest shift elsewhere": figure(beside, "standard errors", "< 4", beside < 4.0),
    }


def air_handler(quick: bool, about: dict[str, Any]) -> Figures:
    """Days of the measured test rig."""
    names = {"seen": "leaking days seen", "named": "leaking days whose valve is named", "false": "normal days alarmed"}
    targets = {"seen": "3 of 3", "named": "3 of 3", "false": "0 of 3" if quick else "0 of 10"}
    if not ahu.data_file().is_file():
        return {f"air handler, {n}": figure("no data", "days", targets[k], None) for k, n in names.items()}
    records = ahu.load(ahu.data_file())
    verdicts = ahu.quick_judge(records) if quick else ahu.judge(records, folds=10)
    score = ahu.score(verdicts)
    about["air handler"] = [
        {"day": v.day, "fan": v.fan_hours, "leak": v.gains["leak_heat"], "condition": v.condition, "says": v.words}
        for v in verdicts
    ]
    holds = {"seen": score["seen"] == 3, "named": score["named"] == 3, "false": score["false"] == 0}
    figures = {f"air handler, {n}": figure(score[k], "days", targets[k], holds[k]) for k, n in names.items()}
    if not quick:
        same = ahu.score(ahu.judge(records, folds=10, shorten=True))
        figures["air handler, same verdicts on the same hours of every day"] = figure(
            [same[k] for k in names],
            "seen, named, false",
            str([score[k] for k in names]),
            all(same[k] == score[k] for k in names),
        )
        about["day table"] = ahu.table(verdicts)
    return figures


def main() -> None:
    options = arguments(__doc__ or "")
    about: dict[str, Any] = {}
    figures = coverage(options.quick, about) | physics(options.quick, about) | pipes(options.quick, about)
    figures |= plant(options.quick, about) | air_handler(options.quick, about)
    figures["model pages that are stale"] = figure(len(stale()), "pages", "0", not stale())
    report(figures, context(seeds="fixed, by case", **about), options.json)


if __name__ == "__main__":
    main()
