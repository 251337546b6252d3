"""Remake the pictures of docs/promise.md: PYTHONPATH=. python docs/studies/promise.py [ANSWERS]

The first is of a real record that is not shipped: set FDD_SHARED to the folder that holds ``data/real2``. The others
are of what ``python -m benchmarks.promise --to ANSWERS`` has kept.
"""

from __future__ import annotations

import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from rich.console import Console

from benchmarks.promise import BEGUN, lanes, pooled
from fdd.residual_monitors.budget import poisson_interval
from fdd.service.baselines.fitting import fit_site, read_span
from fdd.service.baselines.identify import healthy_steps
from fdd.service.baselines.versions import in_force
from fdd.service.site.site_context import open_site

HERE = Path(__file__).resolve().parent
IMAGES = HERE.parent / "images"
SHARED = Path(os.environ.get("FDD_SHARED", HERE.parents[2] / "shared"))
RECORD, COMPONENT, DAYS = "college", "B140", 56
BLUE, ORANGE, RED, GREY, GREEN = "#1f6fb4", "#e08214", "#c0392b", "#8a8a8a", "#1d6b4f"
PARTS = ("the weeks of the fit", "probation", "watched")
BOUND = 3.0
FAULTS = {
    "heater-20": ("heater 20 % down", RED),
    "heater-10": ("heater 10 % down", ORANGE),
    "insulation-20": ("insulation 20 % worse", BLUE),
    "window": ("window open a day a week", GREEN),
    "bias": ("room sensor 0.5 K off", "#7b4ea3"),
}
SETS = {
    "house": "houses by another author",
    "substation": "substations by another author",
    "real": "real records",
    "own": "own simulated houses",
}
QUIET = Console(file=io.StringIO())


def days_of_a_record(path: Path) -> None:
    """The day's sum of a real room's prediction errors: in the weeks of the fit, and afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        site = Path(folder) / "site.yaml"
        source = SHARED / "data" / "real2" / "sites" / f"{RECORD}.yaml"
        table = yaml.safe_load(source.read_text())
        table["source"]["path"] = str((source.parent / table["source"]["path"]).resolve())
        site.write_text(yaml.safe_dump(table))
        opened = open_site(site)
        first = read_span(opened, None, None)
        until = str(pd.Timestamp(int(first.time[0]), tz="UTC").date() + pd.Timedelta(days=DAYS))
        fit_site(site, None, since=None, until=until, only=[COMPONENT], html=None, starts=3, console=QUIET)
        store = opened.store(read_only=True)
        baseline = in_force(store, [COMPONENT])[COMPONENT]
        store.close()
    component = next(c for c in opened.plan.components if c.name == COMPONENT)
    steps = healthy_steps(opened.plan, component, baseline, first)
    z = pd.Series([float(s.standardised[0, 0]) for s in steps], pd.to_datetime(first.time, utc=True)).clip(
        -BOUND, BOUND
    )
    count = z.resample("D").count()
    sums = (z.resample("D").sum() / np.sqrt(count.clip(lower=1)))[count > 0.5 * count.max()]
    ends = [int(baseline.diagnostics.get("probation", {}).get("end", baseline.end)), 2**63 - 1]
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(-2, 2, color=GREY, alpha=0.15, lw=0, label="where 95 % would lie if the model were right")
    start = 0
    for end, title, colour in zip((baseline.end, *ends), PARTS, (GREY, ORANGE, BLUE), strict=True):
        own = sums[(sums.index > pd.Timestamp(start, tz="UTC")) & (sums.index <= pd.Timestamp(end, tz="UTC"))]
        axes.bar(own.index, own, color=colour, label=f"{title}: mean {own.mean():+.1f}, spread {own.std():.1f}")
        start = end
    axes.xaxis.set_major_formatter(ConciseDateFormatter(AutoDateLocator()))
    axes.set_ylabel("a day's sum of errors\n(1 = chance)")
    axes.set_title("A class room: the weeks of the fit cannot tell how wrong its model is", fontsize=9)
    axes.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)


def answers_of(folder: Path) -> list[dict[str, Any]]:
    """What the benchmark kept of every site, as it would count it."""
    found = []
    for fit in sorted(folder.glob("*/fit.json")):
        answers = {f.stem: json.loads(f.read_text()) for f in fit.parent.glob("*.json")}
        answers |= {"name": fit.parent.name, "plants": _plants(fit.parent.name, answers["fit"])}
        found.append(answers)
    return found


def _plants(name: str, fit: dict[str, Any]) -> list[str]:
    if name[:1] not in "hs" or not name[1:2].isdigit():
        return [name]
    return list(dict.fromkeys(b["component"].partition("-")[0] for b in fit.get("baselines", ())))


def found_by_day(answers: list[dict[str, Any]], path: Path) -> None:
    """Share of houses in which a fault has rung, by days since it began, beside that of healthy houses."""
    houses = [a for a in answers if a["name"].startswith("h") and a["name"][1].isdigit()]
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots()
    days = np.arange(0, 31)
    for fault, (title, colour) in {"audit-2": ("healthy", GREY), **FAULTS}.items():
        found = [min((_day(a) for a in alarms), default=np.inf) for _, alarms in lanes(houses, fault)]
        if found:
            share = [np.mean(np.array(found) <= d) for d in days]
            axes.step(days, share, where="post", color=colour, lw=2, label=f"{title} ({len(found)})")
    axes.set(xlabel="days since the fault began", ylabel="share of houses that have rung", xlim=(0, 30), ylim=(0, 1.02))
    axes.set_title("Houses that no model of the project has drawn, 2 false alarms a year", fontsize=9)
    axes.legend(fontsize=8, frameon=False, loc="center right")
    figure.savefig(path, dpi=130)


def _day(alarm: dict[str, Any]) -> float:
    return float((pd.Timestamp(alarm["raised"]) - BEGUN) / pd.Timedelta(days=1))


def kept_by_plant(answers: list[dict[str, Any]], path: Path) -> None:
    """Alarms that came, of those promised, by kind of plant."""
    figure = Figure(figsize=(7.2, 2.6), layout="constrained")
    axes = figure.subplots()
    rows = []
    for kind, title in SETS.items():
        audits = [a["audit-2"] for a in answers if "audit-2" in a and _kind(a["name"]) == kind]
        count, promised = pooled([a for a in audits if "error" not in a], "charts")
        if promised > 0:
            rows.append((f"{title}\n{count} alarms, {promised:.1f} promised", count / promised,
                         [x / promised for x in poisson_interval(count)]))  # fmt: skip
    for y, (_, ratio, (low, high)) in enumerate(rows):
        axes.plot([max(low, 0.05), high], [y, y], color=BLUE, lw=3)
        axes.plot([max(ratio, 0.05)], [y], "o", color=BLUE)
    axes.axvline(1.0, color=GREY, lw=1)
    axes.set_xscale("log")
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50], ["0.1", "0.2", "0.5", "1", "2", "5", "10", "20", "50"])
    axes.set_yticks(range(len(rows)), [r[0] for r in rows], fontsize=8)
    axes.set_ylim(-0.5, len(rows) - 0.5)
    axes.invert_yaxis()
    axes.set_xlabel("alarms that came, of those promised (95 % interval)")
    figure.savefig(path, dpi=130)


def _kind(name: str) -> str:
    kinds = {"h": "house", "s": "substation", "o": "own"}
    return kinds.get(name[0], "real") if name[1:2].isdigit() or name.startswith("own") else "real"


def main() -> None:
    """Make what the data allow."""
    if (SHARED / "data" / "real2").is_dir():
        days_of_a_record(IMAGES / "promise-days.png")
        print("docs/images/promise-days.png")
    else:
        print(f"docs/images/promise-days.png: skipped, {SHARED / 'data' / 'real2'} is not there")
    if len(sys.argv) > 1:
        answers = answers_of(Path(sys.argv[1]))
        found_by_day(answers, IMAGES / "promise-found.png")
        kept_by_plant(answers, IMAGES / "promise-kept.png")


if __name__ == "__main__":
    main()
