"""What could explain a chiller's vector: faults with their signatures, each sensor's bias, or none of these.

Every explanation is a density of the vector's change, so that one likelihood raises the alarm and names the cause. A
fault's signature comes from simulated machines (``signatures.json``, made by ``fdd.plant.chiller_signatures``; kinds of
fault after Comstock and Braun, ASHRAE RP-1043, 1999) and stays a mixture over them; a sensor's bias goes through the
same Jacobian as its slow error; "none of these" is a change of any feature by any amount.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fdd.chiller_eiv.vector import FEATURES, Layout, VectorBaseline
from fdd.records import FloatArray, IntArray

NAMED = 0.8
"""Probability from which one cause is named."""
GROUPED = 0.3
"""Probability below which no cause is named at all."""

SEVERITIES = (0.7, 2.0, 5.0)
"""Middles of the sizes a fault may have, in units of its signature; each spreads by half of itself."""
UNLIKE = 0.2
"""Relative difference between a real machine's signature and a simulated one's, feature by feature."""
UNLIKE_MORE: Mapping[str, float] = {"low charge": 0.5, "high charge": 0.5, "oil excess": 0.5}
"""... where machines disagree: where the charge stands, and what oil does to which exchanger."""
UNLIKE_LEAST = 0.1
"""... and at least this share of the signature's largest part, each in the size of ``FEATURES``."""

SENSORS: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("T_cdi", "T_cdo", "T_chi", "T_cho"), (1.0, 0.0)),
    **dict.fromkeys(("T_sat_cd", "T_sat_ev", "T_liquid"), (1.5, 0.0)),
    "T_discharge": (4.0, 0.0),
    "T_oil": (5.0, 0.0),
    "subcooling": (1.5, 0.0),
    "superheat": (4.0, 0.0),
    "flow_ch": (0.0, 0.12),
    "flow_cd": (0.0, 0.12),
    "load": (0.0, 0.12),
    "power": (0.0, 0.12),
}
"""Usual size of a sensor's bias, one sigma: in its unit, and as a share of the reading."""

BETTER = "purged condenser", "cleaner condenser", "cleaner evaporator", "better compressor"
FAULTS: Mapping[str, tuple[str, float]] = {
    **{
        k: (k, 1.0)
        for k in (
            "non-condensable gas",
            "condenser fouling",
            "evaporator fouling",
            "low condenser flow",
            "high condenser flow",
            "low chilled-water flow",
            "high chilled-water flow",
            "low charge",
            "high charge",
            "oil excess",
            "compressor efficiency loss",
        )
    },
    BETTER[0]: ("non-condensable gas", -1.0),
    BETTER[1]: ("condenser fouling", -1.0),
    BETTER[2]: ("evaporator fouling", -1.0),
    BETTER[3]: ("compressor efficiency loss", -1.0),
}
"""What may have happened to the machine: whose signature it has, and in which direction."""
NONE = "none of these"
WEIGHTS = {"fault": 0.5, "sensor": 0.4, "none": 0.1}
"""Prior probability of each kind, shared equally among its members."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    "condenser side": ("non-condensable gas", "condenser fouling", "high charge", "low condenser flow"),
    "evaporator side": ("evaporator fouling", "low charge", "oil excess", "low chilled-water flow"),
    "refrigerant or compressor": ("low charge", "high charge", "oil excess", "compressor efficiency loss"),
    "condenser water flow or its meter": ("low condenser flow", "high condenser flow", "flow_cd sensor"),
    "chilled-water flow or its meter": ("low chilled-water flow", "high chilled-water flow", "flow_ch sensor"),
    "water flow": ("low condenser flow", "high condenser flow", "low chilled-water flow", "high chilled-water flow"),
    "better than when it was learned": BETTER,
}
"""What causes that cannot be told apart have in common; all sensors are a group of their own."""


@dataclass(frozen=True)
class Library:
    """Signatures: ``change`` has shape (machines, loads, changes) by name of the fault."""

    changes: tuple[str, ...]
    loads: FloatArray
    change: Mapping[str, FloatArray]

    def at(self, name: str, load: float) -> FloatArray:
        """Signatures at a share of the rated load, shape (machines, changes)."""
        table, x = self.change[name], float(np.clip(load, self.loads[0], self.loads[-1]))
        i = int(np.clip(np.searchsorted(self.loads, x) - 1, 0, len(self.loads) - 2))
        w = (x - self.loads[i]) / (self.loads[i + 1] - self.loads[i])
        return np.asarray((1 - w) * table[:, i] + w * table[:, i + 1])


@cache
def library() -> Library:
    """The signatures that come with the package."""
    d = json.loads((Path(__file__).parent / "signatures.json").read_text())
    names = d["machines"][0]
    return Library(
        tuple(d["changes"]),
        np.array(d["loads"]),
        {name: np.array([m[name] for m in d["machines"]]) for name in names},
    )


def changed_readings(layout: Layout, raw: Mapping[str, float], change: FloatArray) -> FloatArray:
    """What signatures do to the readings at one state and the same true load.

    Energy balances make the water temperatures of the machine's own flows and power.

    Parameters
    ----------
    change : shape (..., changes), in the library's measure

    Returns
    -------
    shape (..., r), in the units of the readings
    """
    load = float(layout.load({k: np.array([v]) for k, v in raw.items()})[0])
    s = dict(zip(library().changes, np.moveaxis(change, -1, 0), strict=True))
    known = {k: raw.get(k, float("nan")) for k in ("T_sat_cd", "T_sat_ev", "T_cdi", "T_chi", "T_cho", "T_cdo")}
    power = raw["power"] * s["power"]
    range_cd = _or(known["T_cdo"] - known["T_cdi"], 5.0)
    range_ch = _or(known["T_chi"] - known["T_cho"], 5.5)
    cd = _or(known["T_sat_cd"] - known["T_cdi"], range_cd + 1.5)
    ev = _or(known["T_chi"] - known["T_sat_ev"], range_ch + 1.5)
    lift = _or(known["T_sat_cd"] - known["T_sat_ev"], 28.0)
    leaving = range_cd * (power / (load + raw["power"]) - s["flow_cd"])
    sat_cd = leaving + cd * s["approach_cd"]
    table = {
        "T_cdo": leaving,
        "T_chi": -range_ch * s["flow_ch"],
        "flow_ch": raw.get("flow_ch", 0.0) * s["flow_ch"],
        "flow_cd": raw.get("flow_cd", 0.0) * s["flow_cd"],
        "power": power,
        "T_sat_cd": sat_cd,
        "T_sat_ev": ev * s["T_sat_ev"],
        "T_liquid": sat_cd - cd * s["subcooling"],
        "T_discharge": sat_cd + lift * s["superheat"],
        "T_oil": s["T_oil"],
        "subcooling": cd * s["subcooling"],
        "superheat": lift * s["superheat"],
    }
    none = np.zeros_like(power)
    return np.stack([table.get(k, none) for k in layout.readings], axis=-1)


def _or(value: float, usual: float) -> float:
    return value if np.isfinite(value) and value > 0.2 else usual


@dataclass(frozen=True)
class Explanations:
    """Densities of a vector's change by explanation, as a mixture of Gaussians.

    Attributes
    ----------
    names : of the explanations
    owner : shape (m,), explanation of each part
    weight : shape (m,), log of its share of all
    mean : shape (m, p); spread : shape (m, p, p), beside the healthy covariance
    """

    names: tuple[str, ...]
    owner: FloatArray
    weight: FloatArray
    mean: FloatArray
    spread: FloatArray

    def evidence(self, change: FloatArray, covariance: FloatArray) -> tuple[float, FloatArray]:
        """How much better than "healthy" a change (p,) with its healthy covariance is explained.

        Returns
        -------
        log of the likelihood ratio, and the probability of each explanation, shape (names,)
        """
        away = change - self.mean
        total = covariance + self.spread
        factor = np.linalg.cholesky(total)
        z = np.linalg.solve(factor, away[..., None])[..., 0]
        logs = self.weight - 0.5 * (z**2).sum(1) - np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(1)
        healthy = np.linalg.cholesky(covariance)
        zero = np.linalg.solve(healthy, change)
        base = -0.5 * float(zero @ zero) - float(np.log(np.diagonal(healthy)).sum())
        most = float(logs.max())
        # Far below the largest, a sum of nothing: kept finite.
        each = most + np.log(np.bincount(self.owner, np.exp(logs - most), len(self.names)) + 1e-300)
        whole = float(np.logaddexp.reduce(each))
        return whole - base, np.exp(each - whole)


def explanations(baseline: VectorBaseline, raw: Mapping[str, float], shown: IntArray) -> Explanations:
    """What could explain a change of the vector at one state.

    Parameters
    ----------
    raw : readings of the state, one number each
    shown : indices of the features that are there, shape (q,); the others are left out
    """
    layout, jacobian = baseline.layout, baseline.jacobian(raw)
    sizes = np.array([FEATURES[k][1] for k in layout.features])
    load = float(layout.load({k: np.array([v]) for k, v in raw.items()})[0]) / layout.rated_load
    parts = [_fault_parts(layout, raw, jacobian, sizes, load), _sensor_parts(layout, raw, jacobian), _none_parts(sizes)]
    names: list[str] = []
    owner, weight = [], []
    for (found, share), mean in zip((p[:2] for p in parts), (p[2] for p in parts), strict=True):
        owner.append(np.repeat(np.arange(len(found)), len(mean) // len(found)) + len(names))
        weight.append(np.full(len(mean), np.log(share / len(mean))))
        names += found
    return Explanations(
        tuple(names),
        np.concatenate(owner),
        np.concatenate(weight),
        np.concatenate([p[2] for p in parts])[:, shown],
        np.concatenate([p[3] for p in parts])[:, shown[:, None], shown],
    )


Parts = tuple[list[str], float, FloatArray, FloatArray]
"""Names of a kind's explanations, the kind's prior, means (m, p) and spreads (m, p, p) in the order of the names."""


def _fault_parts(
    layout: Layout, raw: Mapping[str, float], jacobian: FloatArray, sizes: FloatArray, load: float
) -> Parts:
    table = np.stack([sign * library().at(kind, load) for kind, sign in FAULTS.values()])
    s = (changed_readings(layout, raw, table) @ jacobian.T).reshape(-1, 1, len(sizes))
    share = np.repeat([UNLIKE_MORE.get(kind, UNLIKE) for kind, _ in FAULTS.values()], table.shape[1])[:, None, None]
    unlike = np.hypot(share * np.abs(s), UNLIKE_LEAST * np.nanmax(np.abs(s) / sizes, axis=-1, keepdims=True) * sizes)
    size = np.array(SEVERITIES)[None, :, None]
    along, beside = size / 2 * s, size * unlike
    spread = along[..., :, None] * along[..., None, :] + beside[..., None] ** 2 * np.eye(len(sizes))
    p = len(sizes)
    return list(FAULTS), WEIGHTS["fault"], (size * s).reshape(-1, p), spread.reshape(-1, p, p)


def _sensor_parts(layout: Layout, raw: Mapping[str, float], jacobian: FloatArray) -> Parts:
    usual = np.array([np.hypot(SENSORS[k][0], SENSORS[k][1] * raw.get(k, 0.0)) for k in layout.readings])
    direction = (jacobian * usual).T[:, None, :] * np.array([0.4, 1.0, 2.5])[None, :, None]
    p = len(jacobian)
    spread = (direction[..., :, None] * direction[..., None, :]).reshape(-1, p, p)
    return [f"{k} sensor" for k in layout.readings], WEIGHTS["sensor"], np.zeros((len(spread), p)), spread


def _none_parts(sizes: FloatArray) -> Parts:
    spread = np.stack([np.diag((f * sizes) ** 2) for f in (0.5, 1.5)])
    return [NONE], WEIGHTS["none"], np.zeros((2, len(sizes))), spread


@dataclass(frozen=True)
class Named:
    """What the explanations come to.

    Attributes
    ----------
    cause : one name, a group's name, or empty
    probability : of it
    ranked : the explanations worth a word, with their probabilities
    sensor : whether the cause is a sensor or the sensors
    """

    cause: str
    probability: float
    ranked: tuple[tuple[str, float], ...]
    sensor: bool


def name_cause(names: tuple[str, ...], probability: FloatArray) -> Named:
    """One name from ``NAMED``, the smallest group below, no cause where neither reaches ``GROUPED``."""
    p = dict(zip(names, probability.tolist(), strict=True))
    ranked = tuple(sorted(((k, v) for k, v in p.items() if v >= 0.02), key=lambda kv: -kv[1]))
    best, most = max(p.items(), key=lambda kv: kv[1])
    if most >= NAMED:
        return Named("" if best == NONE else best, most, ranked, best.endswith(" sensor"))
    sensors = tuple(k for k in names if k.endswith(" sensor"))
    groups = {**GROUPS, "a sensor": sensors}
    total = {g: sum(p.get(k, 0.0) for k in members) for g, members in groups.items()}
    group, together = max(total.items(), key=lambda kv: kv[1])
    if together >= max(GROUPED, most):
        return Named(group, together, ranked, group == "a sensor")
    return Named("", most, ranked, False)
