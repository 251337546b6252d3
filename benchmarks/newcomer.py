"""A newcomer's walk over ten unlike exports: ``fdd init``, ``fdd study``, and what came of it.

Every command runs as a process of its own, as it would be typed; nothing is written by hand. Units and roles are held
against what is known of each export; a guess that is wrong and was called sure or likely counts apart.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import arguments, context, figure, report
from benchmarks.newcomer_exports import Export, exports
from fdd.units import conversion

ROOT = Path(__file__).resolve().parents[1]
QUICK = ("American dates", "two clocks", "sentinels", "Haystack and Parquet")
PATIENCE = 1800.0


def main() -> None:
    """Walk, and print the figures."""
    chosen = arguments(__doc__ or "")
    with tempfile.TemporaryDirectory() as folder:
        walked = [_walk(e, Path(folder)) for e in exports(Path(folder)) if not chosen.quick or e.name in QUICK]
    units, roles = (_share(walked, key) for key in ("units", "roles"))
    flagged = [w for walk in walked for w in walk["wrong"]]
    figures = {
        "exports": figure(len(walked), "exports", "10", None if chosen.quick else len(walked) >= 10),
        "commands": figure(max(len(w["commands"]) for w in walked), "from export to report", "<= 3",
                           all(len(w["commands"]) <= 3 for w in walked)),
        "keys by hand": figure(sum(w["keys_by_hand"] for w in walked), "keys", "0", True),
        "units": figure(units, "share found", ">= 0.9", units >= 0.9),
        "roles": figure(roles, "share found", ">= 0.8", roles >= 0.8),
        "wrong and called sure": figure(sum(w["sureness"] != "unsure" for w in flagged), f"of {len(flagged)} wrong",
                                        "0", all(w["sureness"] == "unsure" for w in flagged)),
        "reports": figure(sum(w["report"] for w in walked), f"of {len(walked)}", "all",
                          all(w["report"] for w in walked)),
        "tracebacks": figure(sum(w["traceback"] for w in walked), "", "0", not any(w["traceback"] for w in walked)),
        "longest": figure(max(w["seconds"] for w in walked) / 60.0, "min of machine", "<= 10",
                          max(w["seconds"] for w in walked) <= 600.0),
    }  # fmt: skip
    report(figures, context(walks=walked), chosen.json)


def _share(walked: Sequence[dict[str, Any]], key: str) -> float:
    found, known = (sum(w[key][i] for w in walked) for i in (0, 1))
    return found / known if known else float("nan")


def _walk(export: Export, folder: Path) -> dict[str, Any]:
    """The commands on one export, and what each said."""
    own = folder / "walks" / export.name.replace(" ", "-")
    own.mkdir(parents=True)
    site = own / "site.yaml"
    zone = ["--zone", export.zone] if export.zone else []
    until = ["--until", export.until] if export.until else []
    first = ["init", *map(str, export.paths), "--out", str(site), *zone, "--json"]
    second = ["study", str(site), *until, "--starts", "1", "--out", str(site.with_name("report.html")), "--json"]
    began = time.monotonic()
    drafted = _run(first)
    studied = _run(second) if site.exists() else None
    seconds = time.monotonic() - began
    told = json.loads(drafted.stdout) if drafted.stdout.strip().startswith("{") else {"columns": [], "equipment": []}
    verdict = json.loads(studied.stdout) if studied and studied.stdout.strip().startswith("{") else {}
    runs = [r for r in (drafted, studied) if r is not None]
    units, roles, wrong = _held_against(export, told)
    return {
        "export": export.name,
        "commands": [" ".join(["fdd", c[0]]) for c in (first, second)],
        "keys_by_hand": 0,
        "seconds": round(seconds, 1),
        "units": units,
        "roles": roles,
        "wrong": wrong,
        "unsure": sum(c["sureness"] == "unsure" for c in told["columns"]),
        "data": verdict.get("data", []),
        "verdicts": [f"{v['equipment']}: {v['outcome']}" for v in verdict.get("verdicts", [])],
        "said": "" if verdict else (runs[-1].stderr.strip().splitlines() or [""])[-1],
        "report": site.with_name("report.html").exists(),
        "traceback": any("Traceback" in r.stderr for r in runs),
    }


def _run(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "fdd", *words], capture_output=True, text=True, check=False, timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def _held_against(export: Export, told: dict[str, Any]) -> tuple[list[int], list[int], list[dict[str, str]]]:
    """[found, known] of units and of roles, and each that is wrong with how sure the draft was of it."""
    columns = {c["column"]: c for c in told["columns"]}
    wrong: list[dict[str, str]] = []
    found = 0
    for column, unit in export.units.items():
        if column in columns and _alike(columns[column]["unit"], unit):
            found += 1
        else:
            guessed = columns.get(column, {"unit": "", "sureness": "unsure"})
            wrong.append({"what": column, "guessed": guessed["unit"], "is": unit, "sureness": guessed["sureness"]})
    played: dict[tuple[str, str], dict[str, str]] = {}
    for part in told["equipment"]:
        for role, point in part["roles"].items():
            played.setdefault((part["model"], role), {})[point["column"]] = point["sureness"]
    right = 0
    for (model, role), column in export.roles.items():
        own = played.get((model, role), {})
        if column in own:
            right += 1
        else:
            sureness = next(iter(own.values()), "unsure")
            wrong.append({"what": f"{model}.{role}", "guessed": ", ".join(own), "is": column, "sureness": sureness})
    return [found, len(export.units)], [right, len(export.roles)], wrong


def _alike(spelt: str, unit: str) -> bool:
    a, b = conversion(spelt), conversion(unit)
    return (a.si, a.scale, a.offset) == (b.si, b.scale, b.offset)


if __name__ == "__main__":
    main()
