"""The vector of a chiller's steady state, what it is at given drivers while healthy, and how it may scatter.

A cluster of steady points gives one vector: flows where metered, approaches, subcooling, discharge superheat, oil
temperature, power and the heat balance. Each is regressed on the load, the entering temperatures and a declared drive
for every flow that varies, with a ridge whose strength left-out clusters choose. What remains scatters for three
reasons that are kept apart: from cluster to cluster (averages out), from week to week, and by slow errors of the
sensors, carried through one Jacobian; the last two never average out. Outside the trained box nothing is judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from fdd.chiller_eiv.clusters import Clusters
from fdd.chiller_eiv.errors import Instrumentation
from fdd.chiller_eiv.model import ChillerError
from fdd.records import FloatArray, IntArray, JsonObject

DAY = 86_400 * 10**9
"""[ns]"""

READINGS = (
    "T_cdi",
    "T_cdo",
    "T_chi",
    "T_cho",
    "flow_ch",
    "flow_cd",
    "load",
    "power",
    "T_sat_cd",
    "T_sat_ev",
    "T_liquid",
    "T_discharge",
    "T_oil",
    "subcooling",
    "superheat",
)
"""Sensors whose errors and changes the vector shows."""

FEATURES: Mapping[str, tuple[str, float]] = {
    "chilled-water flow": ("share", 0.15),
    "condenser flow": ("share", 0.15),
    "heat balance": ("share", 0.10),
    "power": ("share", 0.12),
    "condenser approach": ("K", 2.0),
    "evaporator approach": ("K", 2.0),
    "subcooling": ("K", 2.0),
    "discharge superheat": ("K", 4.0),
    "oil temperature": ("K", 5.0),
}
"""What the vector may hold: its unit, and the size of a change that is no longer small."""

SLOW: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("T_cdi", "T_cdo", "T_chi", "T_cho"), (0.05, 0.0)),
    **dict.fromkeys(("T_sat_cd", "T_sat_ev", "T_liquid"), (0.15, 0.0)),
    "T_discharge": (0.6, 0.0),
    "T_oil": (0.8, 0.0),
    "subcooling": (0.2, 0.0),
    "superheat": (0.6, 0.0),
    "flow_ch": (0.0, 0.01),
    "flow_cd": (0.0, 0.01),
    "load": (0.0, 0.015),
    "power": (0.0, 0.01),
}
"""Slow errors (from week to week, one sigma) where none are declared: in the reading's unit, and as its share.
Tests of one healthy laboratory machine a week apart differ by 0.1 to 0.35 K in approach."""

STEADY_FLOW = 0.03
"""A flow that scatters by more than this at given drives has no driver that explains it [1]."""

LEAST = 8
"""Clusters without which nothing can be learned."""

MARGIN: Mapping[str, float] = {"load": 0.05, "T_cdi": 0.75, "T_cho": 0.5, "T_chi": 0.75}
"""How far beyond the trained range is still judged: load as a share of the rated one [1], temperatures [K]."""
MARGIN_SHARE = 0.05
"""The same for drives and flows, as a share of their mean [1]."""

BLOCKS = 10
PENALTIES = tuple((a, b) for a in (1e-3, 0.1, 1.0) for b in (1e-2, 0.3, 3.0, 30.0, 1e4))
"""Ridge penalties on linear and on quadratic terms that left-out clusters choose from."""


@dataclass(frozen=True)
class Layout:
    """Which readings, features and drivers one chiller has.

    Attributes
    ----------
    readings, features, drivers : names
    rated_load : [W]
    heat_capacity : of the water [J/(kg K)]
    metered : whether the load is a heat meter's
    auxiliary : taken off the power [W]
    """

    readings: tuple[str, ...]
    features: tuple[str, ...]
    drivers: tuple[str, ...]
    rated_load: float
    heat_capacity: float
    metered: bool
    auxiliary: float = 0.0

    def load(self, raw: Mapping[str, FloatArray]) -> FloatArray:
        """Cooling load [W]."""
        if self.metered:
            return np.asarray(raw["load"])
        return np.asarray(self.heat_capacity * raw["flow_ch"] * (raw["T_chi"] - raw["T_cho"]))

    def vector(self, raw: Mapping[str, FloatArray]) -> FloatArray:
        """The features at these readings, shape (n, p)."""
        return np.stack([self._feature(k, raw) for k in self.features], axis=-1)

    def drive(self, raw: Mapping[str, FloatArray]) -> FloatArray:
        """The drivers at these readings, shape (n, d); the load as a share of the rated one."""
        table = {**raw, "load": self.load(raw) / self.rated_load}
        return np.stack([np.asarray(table[k], dtype=float) for k in self.drivers], axis=-1)

    def _feature(self, name: str, raw: Mapping[str, FloatArray]) -> FloatArray:
        load, power, c = self.load(raw), raw["power"] - self.auxiliary, self.heat_capacity
        if name == "chilled-water flow":
            return _log(raw["flow_ch"] if "flow_ch" in self.readings else load / (c * (raw["T_chi"] - raw["T_cho"])))
        if name == "condenser flow":
            range_cd = raw["T_cdo"] - raw["T_cdi"] if "T_cdo" in raw else np.nan
            return _log(raw["flow_cd"] if "flow_cd" in self.readings else (load + power) / (c * range_cd))
        if name == "heat balance":
            return _log(c * raw["flow_cd"] * (raw["T_cdo"] - raw["T_cdi"])) - _log(load + power)
        if name == "power":
            return _log(power)
        direct = DIRECT.get(name)
        if direct in self.readings:
            return np.asarray(raw[direct])
        warm, cold = DIFFERENCES[name]
        return np.asarray(raw[warm] - raw[cold] if cold else raw[warm])

    def slow_sd(self, instruments: Instrumentation, raw: Mapping[str, FloatArray]) -> FloatArray:
        """Slow error of every reading, one sigma, shape (r,), at the mean of these readings."""
        found = []
        for k in self.readings:
            declared = instruments.errors.get(k)
            absolute, share = SLOW[k]
            usual = float(np.hypot(absolute, share * float(np.nanmean(raw[k]))))
            found.append(declared.slow if declared is not None and declared.slow > 0 else usual)
        return np.array(found)


DIFFERENCES: Mapping[str, tuple[str, str]] = {
    "condenser approach": ("T_sat_cd", "T_cdo"),
    "evaporator approach": ("T_cho", "T_sat_ev"),
    "subcooling": ("T_sat_cd", "T_liquid"),
    "discharge superheat": ("T_discharge", "T_sat_cd"),
    "oil temperature": ("T_oil", ""),
}

DIRECT: Mapping[str, str] = {"subcooling": "subcooling", "discharge superheat": "superheat"}
"""Differences that some plants read as such."""


def _log(value: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(value > 0, np.log(np.where(value > 0, value, 1.0)), np.nan))


@dataclass(frozen=True)
class VectorBaseline:
    """A healthy chiller's vectors.

    Attributes
    ----------
    layout : what it has
    centre, scale : of the drivers, shape (d,)
    low, high : the trained box, margins included, shape (d,)
    coefficients : shape (terms, p)
    inverse : shape (terms, terms), for the leverage of a new cluster
    most : largest leverage that is judged
    scatter : covariance from cluster to cluster, shape (p, p)
    slow : covariance from week to week that the clusters showed, shape (p, p)
    sensors : slow error of each reading, shape (r,)
    clusters : it was learned from
    rate : clusters a year [1/a]
    typical : mean readings
    notes : what is not watched, and what to add
    """

    layout: Layout
    centre: FloatArray
    scale: FloatArray
    low: FloatArray
    high: FloatArray
    coefficients: FloatArray
    inverse: FloatArray
    most: float
    scatter: FloatArray
    slow: FloatArray
    sensors: FloatArray
    clusters: int
    rate: float
    typical: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def residual(self, raw: Mapping[str, FloatArray]) -> FloatArray:
        """Vectors less what is expected at their drivers, shape (n, p)."""
        terms = _terms((self.layout.drive(raw) - self.centre) / self.scale)
        return np.asarray(self.layout.vector(raw) - terms @ self.coefficients)

    @property
    def power_cv(self) -> float:
        """Spread of power about its expectation in clusters left out, as a share: CV(RMSE) of ASHRAE Guideline 14."""
        i = self.layout.features.index("power")
        return float(np.sqrt(self.scatter[i, i] + self.slow[i, i]))

    def part_load(self) -> dict[float, float]:
        """Expected power per load [1] at 100, 75, 50 and 25 % of the rated load, at the mean of the other drivers.

        Loads outside what was learned are left out.
        """
        i, at = self.layout.drivers.index("load"), self.layout.features.index("power")
        found = {}
        for share in (1.0, 0.75, 0.5, 0.25):
            if self.low[i] <= share <= self.high[i]:
                drivers = self.centre.copy()
                drivers[i] = share
                expected = _terms(((drivers - self.centre) / self.scale)[None]) @ self.coefficients
                found[share] = float(np.exp(expected[0, at])) / (share * self.layout.rated_load)
        return found

    def judged(self, raw: Mapping[str, FloatArray]) -> FloatArray:
        """Which clusters lie in the trained box and show anything, shape (n,) of bool."""
        drivers = self.layout.drive(raw)
        inside = np.all((drivers >= self.low) & (drivers <= self.high), axis=1)
        terms = _terms((drivers - self.centre) / self.scale)
        leverage = np.einsum("ni,ij,nj->n", terms, self.inverse, terms)
        return np.asarray(inside & (leverage <= self.most) & np.isfinite(self.layout.vector(raw)).any(axis=1))

    def jacobian(self, raw: Mapping[str, float]) -> FloatArray:
        """Change of the residual with each reading at one state, shape (p, r), by central differences.

        A feature whose reading is missing has a row of NaN.
        """
        readings = self.layout.readings
        step = np.array([1e-4 * np.fmax(abs(raw.get(k, np.nan)), 1.0) for k in readings])
        moved = np.concatenate([np.diag(step), -np.diag(step)])
        needed = {*readings, *raw}
        rows = {k: np.full(len(moved), raw.get(k, np.nan)) for k in needed}
        for i, k in enumerate(readings):
            rows[k] = rows[k] + moved[:, i]
        up, down = np.split(self.residual(rows), 2)
        return np.asarray((up - down).T / (2 * step))

    def common(self, jacobian: FloatArray) -> FloatArray:
        """Covariance that never averages out, shape (p, p): week to week, and slow errors through the Jacobian."""
        through = jacobian * self.sensors
        return np.asarray(self.slow + through @ through.T)

    @property
    def looks(self) -> float:
        """Clusters a year as far as they are independent [1/a].

        What never averages out holds for a week; clusters of one week share it and only differ by the rest.
        """
        weeks = 365.25 / 7
        shared = np.diagonal(self.common(self.jacobian(self.typical)))
        own = 1 - float(np.min(shared / (shared + np.diagonal(self.scatter))))
        return float(min(self.rate, weeks + max(self.rate - weeks, 0.0) * own))

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {**{k: getattr(self, k) for k in self.__dataclass_fields__}, "layout": asdict(self.layout)}

    @classmethod
    def of_state(cls, state: JsonObject) -> VectorBaseline:
        """From what :meth:`export_state` gave."""
        layout: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in state["layout"].items()}
        arrays = ("centre", "scale", "low", "high", "coefficients", "inverse", "scatter", "slow", "sensors")
        return cls(
            layout=Layout(**layout),
            **{k: np.asarray(state[k], dtype=float) for k in arrays},
            most=float(state["most"]),
            clusters=int(state["clusters"]),
            rate=float(state["rate"]),
            typical={k: float(v) for k, v in state["typical"].items()},
            notes=tuple(state["notes"]),
        )


def _terms(u: FloatArray) -> FloatArray:
    """Constant, linear and quadratic terms of standardised drivers (n, d), shape (n, terms)."""
    pairs = combinations_with_replacement(range(u.shape[1]), 2)
    return np.column_stack([np.ones(len(u)), u, *(u[:, i] * u[:, j] for i, j in pairs)])


def learn_vector(clusters: Clusters, instruments: Instrumentation, rated_load: float) -> VectorBaseline:
    """Learn what a healthy chiller's vectors are from clusters of a healthy period.

    Raises
    ------
    ChillerError : fewer than ``LEAST`` clusters have every reading that most have
    """
    layout, notes = layout_of(clusters, instruments, rated_load)
    whole = np.isfinite(layout.vector(clusters.raw)).all(1) & np.isfinite(layout.drive(clusters.raw)).all(1)
    c = clusters.select(np.flatnonzero(whole))
    if len(c) < LEAST:
        raise ChillerError(
            f"{len(c)} clusters of steady points have every reading ({len(clusters)} in all); {LEAST} are needed: "
            "give a longer healthy period, or loosen 'steady' under options"
        )
    layout, more = _explained(layout, c)
    drivers = layout.drive(c.raw)
    centre = drivers.mean(0)
    least = np.array([_margin(k, m) for k, m in zip(layout.drivers, np.abs(centre), strict=True)])
    scale = np.maximum(drivers.std(0), least)
    terms, y = _terms((drivers - centre) / scale), layout.vector(c.raw)
    block = _blocks(len(c))
    coefficients, left_out, inverse = _regress(terms, y, block)
    scatter, slow = _scatter(left_out, block)
    leverage = np.einsum("ni,ij,nj->n", terms, inverse, terms)
    years = max(int(c.end[-1] - c.start[0]) / DAY, 1.0) / 365.25
    baseline = VectorBaseline(
        layout=layout,
        centre=centre,
        scale=scale,
        low=drivers.min(0) - least,
        high=drivers.max(0) + least,
        coefficients=coefficients,
        inverse=inverse,
        most=float(1.5 * leverage.max() + 0.1),
        scatter=scatter,
        slow=slow,
        sensors=layout.slow_sd(instruments, c.raw),
        clusters=len(c),
        rate=len(c) / years,
        typical={k: float(np.mean(v[np.isfinite(v)])) for k, v in c.raw.items() if np.isfinite(v).any()},
        notes=(*notes, *more),
    )
    return replace(baseline, slow=_beyond(slow, baseline))


def _beyond(seen: FloatArray, baseline: VectorBaseline) -> FloatArray:
    """What clusters differed by from week to week beyond slow errors of sensors, which count by themselves, (p, p)."""
    through = baseline.jacobian(baseline.typical) * baseline.sensors
    value, vector = np.linalg.eigh(seen - through @ through.T)
    return np.asarray(vector @ np.diag(np.maximum(value, 0.0)) @ vector.T)


def layout_of(clusters: Clusters, instruments: Instrumentation, rated_load: float) -> tuple[Layout, tuple[str, ...]]:
    """What a chiller's clusters allow to be watched; a reading that never moves is a name plate's value, no sensor."""
    raw = clusters.raw
    seen = [k for k in READINGS if k in raw and np.isfinite(raw[k]).mean() > 0.8]
    metered = instruments.load_from == "meter"
    moving = tuple(k for k in seen if np.nanstd(raw[k]) > 1e-9 * max(1.0, abs(float(np.nanmean(raw[k])))))
    readings = tuple(k for k in moving if k != "load" or metered)
    features = []
    if "flow_ch" in readings or (metered and {"T_chi", "T_cho"} <= set(readings)):
        features.append("chilled-water flow")
    if "flow_cd" in readings or "T_cdo" in readings:
        features.append("condenser flow")
    if {"flow_cd", "T_cdo"} <= set(readings):
        features.append("heat balance")
    features.append("power")
    for k, (warm, cold) in DIFFERENCES.items():
        if DIRECT.get(k) in readings or (warm in readings and (not cold or cold in readings)):
            features.append(k)
    chilled = "T_cho" if "T_cho" in readings else "T_chi"
    drivers = ["load", "T_cdi", *([chilled] if chilled in seen else [])]
    drivers += [k for k in ("drive_ch", "drive_cd") if k in raw and np.isfinite(raw[k]).mean() > 0.8]
    notes = () if len(features) > 1 else ("only power is watched: map more of the roles in docs/chiller.md",)
    layout = Layout(
        readings,
        tuple(features),
        tuple(drivers),
        rated_load,
        instruments.heat_capacity,
        metered,
        instruments.auxiliary,
    )
    return layout, notes


def _explained(layout: Layout, c: Clusters) -> tuple[Layout, tuple[str, ...]]:
    """Take out the flows that vary with nothing declared; a metered one becomes a driver of the rest."""
    notes = []
    for flow, reading, drive, pump in (
        ("chilled-water flow", "flow_ch", "drive_ch", "chilled-water pump"),
        ("condenser flow", "flow_cd", "drive_cd", "condenser water pump"),
    ):
        if flow not in layout.features:
            continue
        drivers = layout.drive(c.raw)
        centre = drivers.mean(0)
        least = np.array([_margin(k, m) for k, m in zip(layout.drivers, np.abs(centre), strict=True)])
        terms = _terms((drivers - centre) / np.maximum(drivers.std(0), least))
        y = layout.vector(c.raw)[:, [layout.features.index(flow)]]
        spread = float(np.std(_regress(terms, y, _blocks(len(c)))[1]))
        if spread <= STEADY_FLOW:
            continue
        declared = drive in layout.drivers
        notes.append(
            f"the {flow} varies by {100 * spread:.0f} % "
            + (f"at the same {drive}, so that it" if declared else "and nothing that drives it is declared: it")
            + f" is not watched; map the {pump}'s speed, power or command as {drive!r}"
            + (" (another one)" if declared else "")
        )
        layout = Layout(
            **{
                **{k: getattr(layout, k) for k in layout.__dataclass_fields__},
                "features": tuple(k for k in layout.features if k != flow),
                "drivers": (*layout.drivers, *([reading] if reading in layout.readings else [])),
            }
        )
    return layout, tuple(notes)


def _margin(driver: str, mean: float) -> float:
    return MARGIN.get(driver, MARGIN_SHARE * mean)


def _blocks(n: int) -> IntArray:
    """Left out together: every cluster by itself where there are few, otherwise neighbours in time."""
    return np.arange(n) if n <= 4 * BLOCKS else np.arange(n) * BLOCKS // n


def _regress(terms: FloatArray, y: FloatArray, block: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ridge coefficients (terms, p), residuals of left-out blocks (n, p), and (X'X + P)^-1 of the middle penalty."""
    d = round((np.sqrt(8 * terms.shape[1] + 1) - 3) / 2)
    quadratic = np.arange(terms.shape[1]) > d
    mean = y.mean(0)
    best: list[tuple[float, FloatArray, FloatArray, FloatArray] | None] = [None] * y.shape[1]
    for linear, square in PENALTIES:
        penalty = np.diag(np.where(quadratic, square, linear))
        penalty[0, 0] = 1e-9
        left_out = np.empty_like(y)
        for b in np.unique(block):
            keep = block != b
            beta = np.linalg.solve(terms[keep].T @ terms[keep] + penalty, terms[keep].T @ (y[keep] - mean))
            left_out[~keep] = y[~keep] - mean - terms[~keep] @ beta
        inverse = np.linalg.inv(terms.T @ terms + penalty)
        beta = inverse @ terms.T @ (y - mean)
        beta[0] += mean
        for j in range(y.shape[1]):
            error = float(np.mean(left_out[:, j] ** 2))
            current = best[j]
            if current is None or error < 0.98 * current[0]:
                best[j] = (error, beta[:, j], left_out[:, j], inverse)
    chosen = [b for b in best if b is not None]
    # The loosest fit's leverage tells extrapolation best.
    inverse = max((b[3] for b in chosen), key=lambda m: float(np.trace(m)))
    return np.stack([b[1] for b in chosen], axis=1), np.stack([b[2] for b in chosen], axis=1), inverse


def _scatter(left_out: FloatArray, block: IntArray) -> tuple[FloatArray, FloatArray]:
    """Covariance from cluster to cluster, and from block to block beyond it, each (p, p)."""
    n, p = left_out.shape
    blocks = np.unique(block)
    if len(blocks) == n:
        return _shrunk(left_out.T @ left_out / n, n), np.zeros((p, p))
    means = np.array([left_out[block == b].mean(0) for b in blocks])
    within = left_out - means[block]
    scatter = within.T @ within / (n - len(blocks))
    between = means.T @ means / len(blocks) - scatter * len(blocks) / n
    value, vector = np.linalg.eigh((between + between.T) / 2)
    slow = vector @ np.diag(np.maximum(value, 0.0)) @ vector.T
    return _shrunk(scatter, n - len(blocks)), np.asarray(slow * len(blocks) / (len(blocks) - 2))


def _shrunk(covariance: FloatArray, freedom: int) -> FloatArray:
    """Shrunk towards its diagonal and widened for the few clusters that it comes from."""
    p = len(covariance)
    share = min(1.0, p / max(freedom, 1))
    diagonal = np.diag(np.maximum(np.diagonal(covariance), 1e-10))
    wide = freedom / max(freedom - 2.0, 1.0)
    return np.asarray(wide * ((1 - share) * covariance + share * diagonal))
