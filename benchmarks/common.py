"""What every benchmark shares: its arguments, the machine it ran on, and one way to print figures."""

from __future__ import annotations

import argparse
import json
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any


def arguments(description: str) -> argparse.Namespace:
    """``--quick`` for a smaller sample of the same figures, ``--json`` for one object on standard output."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="the same figures on a smaller sample, under 50 s")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser.parse_args()


def figure(value: Any, unit: str, target: str, holds: bool | None) -> dict[str, Any]:
    """One measured figure; ``holds`` is None where the machine lacks what the comparison needs."""
    return {"value": value, "unit": unit, "target": target, "holds": holds}


def context(**more: Any) -> dict[str, Any]:
    """The machine, the versions, and what the benchmark adds (seeds, sizes)."""
    versions = {}
    for package in ("numpy", "scipy", "numba", "statsmodels", "filterpy", "eclipse-zenoh", "influxdb-client"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "machine": platform.machine(),
        "processors": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "versions": versions,
        **more,
    }


def report(figures: dict[str, dict[str, Any]], about: dict[str, Any], as_json: bool) -> None:
    """Print the figures, as one JSON object or as a table."""
    if as_json:
        print(json.dumps({"figures": figures, "context": about}, default=float))
        return
    width = max(len(name) for name in figures)
    for name, f in figures.items():
        mark = {True: "holds", False: "FALLS SHORT", None: "not measured"}[f["holds"]]
        value = f"{f['value']:.4g}" if isinstance(f["value"], float) else f["value"]
        print(f"{name:<{width}}  {value!s:>12} {f['unit']:<14} target {f['target']:<16} {mark}")
    print(json.dumps(about, default=float))
