"""A month of a small heated building in a store, simulated: what the service would have written."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from fdd.evidence import Message
from fdd.records import NANOSECONDS, Baseline, Rows
from fdd.report.content import ComponentInfo, SiteInfo
from fdd.store.store import Store

STEP = 300 * NANOSECONDS
DAY = 86400 * NANOSECONDS
END = 1_763_373_600 * NANOSECONDS  # 2025-11-17 10:00 UTC
LIMIT = 9.0
WATER = ("degC", "water temperature at the outlet")


def said(code: str, **arguments: str) -> dict[str, Any]:
    """A message as documents hold it."""
    return Message.of(code, **arguments).document()


def radiator_info(i: int) -> ComponentInfo:
    return ComponentInfo(
        title=f"Radiator, room {100 + i}",
        model="Water radiator",
        outputs={"T_return": (f"rad{i}.T_return", *WATER)},
        parameters={"C": ("J/K", "heat capacity of water and metal"), "H": ("W/K^n", "heat transfer to the air")},
        location=f"second floor, room {100 + i}",
    )


def exchanger_info() -> ComponentInfo:
    return ComponentInfo(
        title="Heat exchanger, substation",
        model="Plate heat exchanger",
        outputs={
            "T_hot_out": ("hx.T_hot_out", "degC", "outlet temperature of the hot side"),
            "T_cold_out": ("hx.T_cold_out", "degC", "outlet temperature of the cold side"),
        },
        parameters={
            "C_hot": ("W/K (kg/s)^-y", "film coefficient of the hot side at 1 kg/s"),
            "C_cold": ("W/K (kg/s)^-y", "film coefficient of the cold side at 1 kg/s"),
        },
        location="basement, plant room",
    )


def site(radiators: int = 6, **changes: Any) -> SiteInfo:
    components = {"substation-hx": exchanger_info()} | {f"radiator-{i}": radiator_info(i) for i in range(radiators)}
    values: dict[str, Any] = {
        "name": "Harbour Street 12",
        "zone": "Europe/Copenhagen",
        "false_alarms_per_year": 2.0,
        "components": components,
        "tariffs": {"currency": "EUR", "heat": 0.11},
    }
    return SiteInfo(**{**values, **changes})


def fill(store: Store, info: SiteInfo, days: int = 28, faults: dict[str, dict[str, float]] | None = None) -> None:
    """Rows of every component: predictions and charts; ``faults`` maps component to the shift of each output [sd]
    that grows from eight days before the end."""
    rng = np.random.default_rng(7)
    time = END - DAY * days + STEP * np.arange(1, days * 288 + 1)
    for name, component in info.components.items():
        shifts = (faults or {}).get(name, {})
        for symbol in component.outputs:
            write_output(store, name, symbol, time, rng, shifts.get(symbol, 0.0))


def write_output(
    store: Store, name: str, symbol: str, time: np.ndarray, rng: np.random.Generator, shift: float
) -> None:
    n = len(time)
    grown = np.clip((time - (END - 8 * DAY)) / (6 * DAY), 0, 1) * shift
    z = rng.standard_normal(n) + grown
    hours = time / (3600 * NANOSECONDS)
    predicted = 38 + 4 * np.sin(2 * np.pi * hours / 24) + 2.5 * np.sin(2 * np.pi * hours / (24 * 9))
    sd = np.full(n, 0.12)
    fields = {"measured": predicted + z * sd, "predicted": predicted, "sd": sd, "innovation": z}
    store.write(rows("predictions", f"{name}/{symbol}", time, fields))
    statistic = cusum(z)
    alarmed = np.maximum.accumulate(statistic > LIMIT)
    phase = np.where(alarmed, 3.0, 2.0)
    fields = {"statistic": statistic, "limit": np.full(n, LIMIT), "phase": phase}
    store.write(rows("charts", f"{name}/{symbol}:cusum", time, fields))


def cusum(z: np.ndarray) -> np.ndarray:
    """Two-sided, k = 0.5, held below twice the limit as the service's chart is."""
    up = down = 0.0
    out = np.empty(len(z))
    for i, value in enumerate(z.tolist()):
        up = min(max(0.0, up + value - 0.5), 2 * LIMIT)
        down = min(max(0.0, down - value - 0.5), 2 * LIMIT)
        out[i] = max(up, down)
    return out


def rows(measurement: str, series: str, time: np.ndarray, fields: dict[str, np.ndarray]) -> Rows:
    return Rows(measurement, (series,), np.zeros(len(time), dtype=np.int32), np.asarray(time, dtype=np.int64), fields)


def baseline(
    name: str, version: int, parameters: dict[str, float], days_before: int = 60, length: int = 14
) -> Baseline:
    start = END - days_before * DAY
    return Baseline(
        component=name,
        version=version,
        model="model",
        model_version="1",
        options={},
        parameters=parameters,
        standard_errors={k: 0.02 * v for k, v in parameters.items()},
        covariance=[],
        start=start,
        end=start + length * DAY,
        samples=length * 288,
        log_likelihood=1234.5,
        innovation={},
        reason="fitted",
    )


def keep_baseline(store: Store, b: Baseline) -> None:
    store.put("baseline", f"{b.component}/{b.version:06d}", asdict(b))
    store.put("state", f"baseline/{b.component}", {"component": b.component, "version": b.version})


def alarm(name: str, charts: dict[str, int], state: str = "raised", **changes: Any) -> dict[str, Any]:
    """An alarm as the service keeps it; ``charts`` maps output symbol to direction."""
    since, raised = END - 8 * DAY + 7 * STEP, END - 6 * DAY - 3 * STEP
    evidence = {
        f"{name}/{s}:cusum": {
            "symbol": s, "statistic": 9.4, "limit": LIMIT, "direction": d, "since": since, "raised": raised,
        }
        for s, d in charts.items()
    }  # fmt: skip
    document = {
        "key": f"{name}@2025-11-11T09:45:00Z",
        "component": name,
        "state": state,
        "since": since,
        "raised": raised,
        "updated": raised,
        "charts": list(evidence),
        "summary": f"{name}: it behaves differently",
        "severity": "medium",
        "causes": [],
        "checks": [],
        "evidence": {"charts": evidence, "points": []},
        "history": [
            {"time": raised, "state": "raised", "actor": "service", "comment": Message.of("rang", chart=c).document()}
            for c in list(evidence)[:1]
        ],
    }
    return {**document, **changes}


def fouling(**changes: Any) -> dict[str, Any]:
    """The heat exchanger's alarm with its diagnosis, as the ranking words it."""
    checks = [
        "compare the primary return temperature with the secondary return: the gap grows with fouling",
        "measure the pressure drop on both sides",
        "clean the plates; check the strainer and the water treatment",
    ]
    document = alarm(
        "substation-hx",
        {"T_hot_out": 1, "T_cold_out": -1},
        summary="substation-hx: outlet temperature of the hot side higher than the model expects and outlet "
        "temperature of the cold side lower than the model expects; most likely deposits on the plates: less "
        "heat passes at the same flows",
        severity="high",
        causes=[
            {
                "name": "fouling", "meaning": "deposits on the plates: less heat passes at the same flows",
                "likelihood": 0.871, "checks": checks, "against": [],
                "for": [said("output_above", symbol="T_hot_out"), said("output_below", symbol="T_cold_out")],
            },
            {
                "name": "scaling", "meaning": "a flow meter reads a wrong share of the flow", "likelihood": 0.097,
                "for": [said("output_above", symbol="T_hot_out")],
                "against": [said("output_below", symbol="T_cold_out")],
                "checks": ["check the meter's pulse value"],
            },
            {
                "name": "bias", "meaning": "an outlet sensor reads wrong by a constant", "likelihood": 0.032,
                "for": [said("output_above", symbol="T_hot_out")],
                "against": [said("unexplained_symbol", symbol="T_cold_out")],
                "checks": ["compare the sensor with a hand-held one in the same pocket"],
            },
        ],
        checks=[*checks, "check the meter's pulse value", "compare the sensor with a hand-held one in the same pocket"],
    )  # fmt: skip
    document["evidence"]["cost_per_day"] = {"value": 14.2, "lower": 9.8, "upper": 18.9}
    return {**document, **changes}


def air(name: str = "radiator-2", **changes: Any) -> dict[str, Any]:
    """A radiator's alarm."""
    checks = ["feel the top of the radiator: cold means air", "bleed it, then check the system pressure"]
    document = alarm(
        name,
        {"T_return": 1},
        summary=f"{name}: water temperature at the outlet higher than the model expects; most likely air in the "
        "upper part",
        causes=[
            {
                "name": "air", "meaning": "air in the upper part: less surface gives off heat", "likelihood": 0.4,
                "for": [said("output_above", symbol="T_return")], "against": [], "checks": checks,
            },
            {
                "name": "sludge", "meaning": "deposits in the lower part", "likelihood": 0.35,
                "for": [said("output_above", symbol="T_return")],
                "against": [said("unexplained_symbol", symbol="H")], "checks": [],
            },
        ],
        checks=checks,
    )  # fmt: skip
    return {**document, **changes}


def full(store: Store, radiators: int = 6, days: int = 28) -> SiteInfo:
    """Two findings, a consequence, a closed alarm, one component without a baseline, parameter history and counts."""
    info = site(radiators)
    shifts = {"substation-hx": {"T_hot_out": 1.1, "T_cold_out": -0.9}, "radiator-2": {"T_return": 0.8}}
    watched = {n: c for n, c in info.components.items() if n != "radiator-5"}
    with store.transaction():
        fill(store, SiteInfo(info.name, info.zone, 2.0, watched), days, shifts)
        _baselines(store, watched)
        _alarms(store)
        for what, value in {"accepted": 241_920, "late": 12, "no_value": 340, "duplicate": 0}.items():
            store.write(rows("counts", f"engine/{what}", np.array([END - STEP]), {"value": np.array([float(value)])}))
    return info


def _baselines(store: Store, watched: dict[str, ComponentInfo]) -> None:
    for name in watched:
        if name == "substation-hx":
            keep_baseline(store, baseline(name, 1, {"C_hot": 8300.0, "C_cold": 7900.0}, 90))
            keep_baseline(store, baseline(name, 2, {"C_hot": 8150.0, "C_cold": 7850.0}, 50))
        else:
            keep_baseline(store, baseline(name, 1, {"C": 5.1e4, "H": 10.2}))
    rng = np.random.default_rng(3)
    time = END - 35 * DAY + np.arange(6) * 7 * DAY
    for symbol, level in (("C_hot", 8150.0), ("C_cold", 7850.0)):
        value = level * (1 - np.clip(np.arange(6) - 4, 0, 1) * 0.12) + rng.normal(0, 70, 6)
        fields = {"value": value, "lower": value - 190, "upper": value + 190, "version": np.full(6, 2.0)}
        store.write(rows("parameters", f"substation-hx/{symbol}", time, fields))


def _alarms(store: Store) -> None:
    hx = fouling()
    documents = [hx, air(history=[*air()["history"], _seen()], state="acknowledged"), *_others(hx["key"])]
    for document in documents:
        store.put("alarm", document["key"], document)


def _seen() -> dict[str, Any]:
    return {"time": END - 5 * DAY, "state": "acknowledged", "actor": "M. Jensen", "comment": "will look on Thursday"}


def _others(source: str) -> list[dict[str, Any]]:
    held = alarm("radiator-0", {"T_return": -1}, "suppressed by design", updated=END - 4 * DAY)
    held["evidence"]["caused_by"] = source
    why = Message.of("reads_suspect", points=("hx.T_cold_out",), alarm=source).document()
    held["history"].append({"time": END - 4 * DAY, "state": "suppressed by design", "actor": "service", "comment": why})
    closed = alarm("radiator-1", {"T_return": 1}, "cleared", updated=END - 2 * DAY)
    entry = {"time": END - 2 * DAY, "state": "cleared", "actor": "M. Jensen", "comment": "false alarm, window was open"}
    closed["history"].append(entry)
    return [held, closed]
