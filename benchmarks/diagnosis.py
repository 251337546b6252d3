"""Which fault shows through what, and how often it is rightly named: measured, and judged on other seeds.

    python -m benchmarks.diagnosis [--quick] [--json]
    python -m benchmarks.diagnosis --write      # measure fdd/diagnosis/signatures.yaml anew

Signatures are measured on seeds 1 and 2, the naming is judged on seeds 11 and 12 (``--quick``: 11) with baselines
fitted to another life of the house, at two thirds of the faults' size. Single zones: benchmarks/diagnosis_room.py.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from benchmarks.common import arguments, context, figure, report
from benchmarks.diagnosis_runs import Case, Seen, cases, smaller, watch, where
from benchmarks.signatures import Signature, numbered, signature, write
from fdd.diagnosis.departure import Departure
from fdd.diagnosis.ranking import diagnose
from fdd.evidence import AlarmKind
from fdd.plant.district import EQUIPMENT, models

FILE = "signatures.yaml"
TRAINING, FITTED = (1, 2), 900
JUDGED, OTHER_FITTED = (11, 12), 901
SHARE = 2 / 3


def role(case: Case, component: str) -> tuple[str, str, str] | None:
    """(kind, cause to be named, symbol) of a case as one component sees it; None where it sees nothing of it."""
    if not case.point:
        return ("component", case.name, "") if case.component == component else None
    symbol = where(component, case.point)
    model = models()[component]
    if not symbol:
        return None
    if symbol not in model.symbols["outputs"]:
        return "upstream", f"upstream-{symbol}", symbol
    names = {f.name for f in model.faults}
    room = f"{case.name}-{symbol.partition('_')[2]}"
    return "sensor", room if room in names else case.name, symbol


def measure(runs: Sequence[tuple[Case, Seen]]) -> dict[str, list[Signature]]:
    """Signatures by model from the evidence of many runs."""
    gathered: dict[tuple[str, str, str, str], list[tuple[Case, Departure]]] = {}
    for case, seen in runs:
        for component, departure in seen.departures.items():
            found = role(case, component)
            if found is not None:
                kind, name, symbol = (numbered(part) for part in found)
                model = EQUIPMENT[component][0]
                gathered.setdefault((model, kind, name, symbol), []).append((case, departure))
    tables: dict[str, list[Signature]] = {}
    for (model, kind, name, symbol), group in sorted(gathered.items()):
        runs_of_it = [(c.size, d) for c, d in group]
        entry = signature(name, symbol, kind, group[0][0].unit, runs_of_it, signed=kind == "component")
        tables.setdefault(model, []).append(entry)
    return tables


def _job(task: tuple[int, int, int, float]) -> Seen:
    seed, index, fitted, share = task
    return watch(seed, smaller(cases()[index], share), fitted)


def watched(seeds: Sequence[int], fitted: int, share: float, every: int = 1) -> list[tuple[Case, Seen]]:
    """All cases on these seeds, two at a time."""
    tasks = [(s, i, fitted, share) for s in seeds for i in range(0, len(cases()), every)]
    with ProcessPoolExecutor(2, mp_context=get_context("forkserver")) as pool:
        seen = list(pool.map(_job, tasks, chunksize=-(-len(tasks) // 2)))
    return [(smaller(cases()[i], share), s) for (_, i, _, _), s in zip(tasks, seen, strict=True)]


def named(runs: Sequence[tuple[Case, Seen]]) -> dict[str, tuple[int, int, int, int]]:
    """Alarms on the faulty component, and how many of them name the cause first, first by signs alone, among three."""
    table: dict[str, tuple[int, int, int, int]] = {}
    for case, seen in runs:
        # An instrument that belongs to no equipment is suspected by what reads it.
        component = case.component if case.component in EQUIPMENT else "building"
        found = role(case, component)
        mine = [a for a in seen.alarms.values() if a.component == component and a.raised >= seen.onset]
        mine = [a for a in mine if a.evidence.kind is AlarmKind.PLANT]
        if found is None or not mine:
            continue
        kind, name, symbol = found
        model, alarm = models()[component], mine[0]
        causes = diagnose(model, alarm, seen.departures[component]).causes[:3]
        fits = [c.name == name and c.where == symbol for c in causes]
        signs = diagnose(model, alarm).causes[0]
        group = f"{EQUIPMENT[component][0]}, {kind}"
        n, a, b, c = table.get(group, (0, 0, 0, 0))
        table[group] = (n + 1, a + fits[0], b + (signs.name == name), c + any(fits))
    return table


def main() -> None:
    """Measure the signatures, or judge them."""
    if "--write" in sys.argv:
        write(FILE, "diagnosis", measure(watched(TRAINING, FITTED, 1.0)))
        return
    options = arguments(__doc__ or "")
    seeds = JUDGED[:1] if options.quick else JUDGED
    runs = watched(seeds, OTHER_FITTED, SHARE, every=6 if options.quick else 1)
    table = named(runs)
    total = np.array(list(table.values())).sum(axis=0)
    figures = {
        "alarmed": figure(int(total[0]), f"of {len(runs)} faults", "", None),
        "rightly_named": figure(float(total[1] / total[0]), "of alarms", ">= 0.8", bool(total[1] >= 0.8 * total[0])),
        "rightly_named_by_signs": figure(float(total[2] / total[0]), "of alarms", "the ranking before", None),
    }
    figures["among_first_three"] = figure(float(total[3] / total[0]), "of alarms", "", None)
    for group, (n, right, signs, _) in table.items():
        figures[f"named: {group}"] = figure(f"{right} of {n}", f"by signs {signs}", "", None)
    report(figures, context(seeds=list(seeds), size=f"{SHARE:.2f} of the measured"), options.json)


if __name__ == "__main__":
    main()
