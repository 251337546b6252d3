"""Steady states of chillers: simulated machines that no signature was made from, real ones, and honest intervals.

Imported by :mod:`benchmarks.chiller_eiv`, which prints the figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import poisson

from benchmarks.common import figure
from fdd.chiller_eiv.baseline import clusters_of, learn_from_samples
from fdd.chiller_eiv.clusters import HOUR, Clusters, join_clusters
from fdd.chiller_eiv.errors import Instrumentation
from fdd.chiller_eiv.fit import FitOptions, fit_gordon_ng
from fdd.chiller_eiv.gate import with_scale
from fdd.chiller_eiv.simulate import LAB_CHILLER, LAB_SIGMA, autocorrelated, operate
from fdd.chiller_eiv.vector import DAY, VectorBaseline, learn_vector
from fdd.chiller_eiv.watch import VectorFinding, VectorMonitor
from fdd.plant.chiller_cycle import Fault, Machine
from fdd.plant.chiller_operation import conditions, readings, running_machine, sensors
from fdd.service.baselines.chiller_fit import chiller_data
from fdd.service.baselines.fitting import read_span
from fdd.service.site.site_context import open_site

Figures = dict[str, dict[str, Any]]
FALSE_ALARMS = 0.25
RATED = 1e6
A_DAY = 8
"""Clusters a day."""
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"

STRONG = {
    "non-condensable gas": Fault(gas=0.03),
    "low condenser flow": Fault(flow_cd=-0.1),
    "low chilled-water flow": Fault(flow_ch=-0.1),
    "oil excess": Fault(oil=1.0),
}
WEAK = {
    "low charge": Fault(charge=-0.15),
    "high charge": Fault(charge=0.15),
    "condenser fouling": Fault(fouling_cd=0.15),
    "evaporator fouling": Fault(fouling_ev=0.15),
}
BIASES: Mapping[str, dict[str, Mapping[str, float]]] = {
    **{k: {"share": {k: -0.1}} for k in ("flow_ch", "flow_cd")},
    "power": {"share": {"power": 0.1}},
    **{k: {"added": {k: 1.0}} for k in ("T_cdi", "T_cdo", "T_chi", "T_cho")},
    **{k: {"added": {k: 2.0}} for k in ("T_sat_cd", "T_sat_ev", "T_liquid")},
    "T_discharge": {"added": {"T_discharge": 5.0}},
}


class Watched:
    """A machine drawn wider than the library's, learned from four weeks with sensors of their own week by week."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.machine: Machine = running_machine(self.rng, wide=1.3)
        self.baseline: VectorBaseline = learn_vector(self.weeks(4), Instrumentation({}), RATED)

    def weeks(self, count: int, fault: Fault | None = None, bias: Mapping[str, Any] | None = None) -> Clusters:
        """Clusters of so many weeks; slow errors are drawn anew each week."""
        parts = []
        for week in range(count):
            own = sensors(self.rng).biased(**(bias or {}))
            raw = readings(self.machine, conditions(self.rng, 7 * A_DAY), own, self.rng, fault)
            load = 4190.0 * raw["flow_ch"] * (raw["T_chi"] - raw["T_cho"])
            n = len(load)
            start = np.arange(n, dtype=np.int64) * (24 // A_DAY) * HOUR + week * 7 * DAY
            parts.append(Clusters(start, start + HOUR, np.ones(n, dtype=np.int64), {**raw, "load": load}))
        return join_clusters(parts)

    def alarms(self, clusters: Clusters) -> tuple[int, VectorMonitor]:
        """Alarms, each cleared at once."""
        monitor, found = VectorMonitor(self.baseline, FALSE_ALARMS), 0
        for i in range(len(clusters)):
            if monitor.update(clusters.select(np.array([i]))).alarm:
                found += 1
                monitor.reset()
        return found, monitor

    def finding(self, fault: Fault | None = None, bias: Mapping[str, Any] | None = None) -> VectorFinding | None:
        """What stands after a week."""
        clusters, monitor = self.weeks(1, fault, bias), VectorMonitor(self.baseline, FALSE_ALARMS)
        for i in range(len(clusters)):
            monitor.update(clusters.select(np.array([i])))
        return monitor.finding


def simulated(quick: bool) -> Figures:
    """False alarms, names of strong and weak faults and of biased sensors."""
    machines, weeks = (8, 4) if quick else (20, 17)
    alarms = judged = seen = wrong = weak_found = 0
    strong: dict[str, list[bool]] = {k: [] for k in STRONG}
    side = dict.fromkeys(STRONG, 0)
    named: dict[str, list[bool]] = {k: [] for k in BIASES}
    for seed in range(machines):
        w = Watched(1000 + seed)
        found, monitor = w.alarms(w.weeks(weeks))
        alarms, judged, seen = alarms + found, judged + monitor.judged, seen + monitor.seen
        for k, fault in STRONG.items():
            f = w.finding(fault)
            strong[k].append(f is not None and f.named.cause == k)
            side[k] += f is not None and f.named.ranked[0][0] == k
        for k, bias in BIASES.items():
            f = w.finding(bias=bias)
            named[k].append(f is not None and f.named.sensor and f.named.probability >= 0.8)
        for k, fault in WEAK.items():
            f = w.finding(fault)
            weak_found += f is not None
            single = f is not None and f.named.probability >= 0.8 and f.named.cause in (*STRONG, *WEAK, *_sensors())
            wrong += f is not None and single and f.named.cause != k
    expected = FALSE_ALARMS * machines * weeks * 7 / 365.25
    most = int(poisson.ppf(0.975, expected))
    weak = machines * len(WEAK)
    out = {
        "states_false_alarms": figure(alarms, f"in {machines * weeks * 7} days", f"<= {most}", alarms <= most),
        "states_judged": figure(100 * judged / seen, "%", "-", None),
        "states_weak_found": figure(100 * weak_found / weak, "%", "-", None),
        "states_weak_wrongly_named": figure(100 * wrong / weak, "%", "<= 5 %", wrong / weak <= 0.05),
    }
    for k, hits in strong.items():
        share = 100 * float(np.mean(hits))
        out[f"states_named_{k}"] = figure(share, "%", ">= 90 %", share >= 90)
        out[f"states_likeliest_{k}"] = figure(100 * side[k] / machines, "%", "-", None)
    sure = sum(np.mean(v) >= 0.9 for v in named.values())
    out["states_sensors_named"] = figure(int(sure), f"of {len(named)} sensors, in 90 %", ">= 9", bool(sure >= 9))
    for k, v in named.items():
        out[f"states_sensor_{k}"] = figure(100 * float(np.mean(v)), "%", "-", None)
    return out


def _sensors() -> tuple[str, ...]:
    return tuple(f"{k} sensor" for k in (*BIASES, "T_oil"))


def covered(seed: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Whether the intervals of 60 days hold the truth, and their half-widths as a share, for dS, Q_leak and R."""
    rng = np.random.default_rng(10**6 + seed)
    o = operate(60, seed, noise=0.0, model_error=0.01 if kind == "model error" else 0.0, first_day=seed % 365)
    n, sigma = len(o.x), 2 * LAB_SIGMA
    if kind == "coloured":
        noise = np.stack([autocorrelated(rng, n, np.exp(-1 / 6), 1.0) for _ in range(4)], axis=1)
    else:
        noise = rng.standard_normal(o.x.shape)
    x = o.x + sigma * noise
    scale = {"Q": 0.02, "E": 0.01} if kind == "scale" else {}
    for i, k in enumerate(("Q", "E")):
        x[:, 2 + i] *= 1 + scale.get(k, 0.0) * rng.standard_normal()
    cov, day = np.diag(sigma**2), np.arange(n) // 24
    interval = with_scale(fit_gordon_ng(x, cov, day), x, cov, day, FitOptions(), scale).interval()
    truth = np.array([LAB_CHILLER.dS, LAB_CHILLER.Q_leak, LAB_CHILLER.R])
    inside = (interval[:, 0] <= truth) & (truth <= interval[:, 1])
    return inside, (interval[:, 1] - interval[:, 0]) / 2 / truth


def intervals(quick: bool) -> Figures:
    """Cover of 95 % intervals where errors are independent, coloured, a model's of days, and of scale."""
    repeats = 40 if quick else 300
    out: Figures = {}
    for kind in ("independent", "coloured", "model error", "scale"):
        found = [covered(s, kind) for s in range(repeats)]
        hits, width = np.mean([f[0] for f in found], axis=0), np.median([f[1] for f in found], axis=0)
        for k, h, w in zip(("dS", "Q_leak", "R"), 100 * hits, 100 * width, strict=True):
            label = f"interval_{kind.replace(' ', '_')}_{k}"
            out[label] = figure(float(h), f"% covered, +-{w:.1f} % wide", ">= 90 %", bool(h >= 90))
    return out


STUDIES = Path(__file__).resolve().parents[1] / "docs" / "studies"
FIELD = {
    "esb_chiller1": (STUDIES / "real-chiller.yaml", "esb_chiller1_raw_5min.csv.gz"),
    "datacentre_chiller": (
        SHARED / "real2" / "sites" / "datacentre_chiller.yaml",
        "real2/datacentre_chiller_1h.csv.gz",
    ),
}


def field(_: bool) -> Figures:
    """Alarms of real machines, presumed healthy, in chronological and interleaved splits; cleared at once."""
    out: Figures = {}
    for name, (site, data) in FIELD.items():
        if not (SHARED / data).exists():
            out[f"field_{name}"] = figure(float("nan"), "not run: the shared records are not here", "-", None)
            continue
        context = open_site(site, SHARED / data)
        chiller = context.plan.chillers[0]
        d = chiller_data(context.plan, chiller, read_span(context, None, None))
        baseline, _decision, points, _report = learn_from_samples(d.time, d.raw, chiller.config)
        clusters = clusters_of(points, chiller.config, round(baseline.steady.window * 1e9))
        day = clusters.start // DAY
        days = np.unique(day)
        first, odd = day < days[len(days) // 2], np.searchsorted(days, day) % 2 == 1
        for split, learned in {"first": first, "second": ~first, "even": ~odd, "odd": odd}.items():
            vector = learn_vector(
                clusters.select(np.flatnonzero(learned)), chiller.config.instruments, chiller.config.rated_load
            )
            monitor, found = VectorMonitor(vector, chiller.config.residual_false_alarms), 0
            for i in np.flatnonzero(~learned):
                if monitor.update(clusters.select(np.array([i]))).alarm:
                    found += 1
                    monitor.reset()
            running = len(np.unique(day[~learned]))
            rate, share = 30 * found / running, 100 * monitor.judged / monitor.seen
            label = f"field_{name}_learned_{split}"
            out[label] = figure(rate, f"alarms in 30 running days, {share:.0f} % judged", "<= 1", rate <= 1)
    return out
