"""Remake the chiller studies: python docs/studies/chiller_studies.py figures|curves|variable-speed [folder].

``curves`` and ``variable-speed`` read data that are not shipped: set FDD_SHARED to the folder that holds ``data/``.
"""

from __future__ import annotations

import csv
import gzip
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from fdd.chiller_eiv.baseline import clusters_of
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.eir_curves import EirCurves
from fdd.chiller_eiv.errors import Instrumentation, SensorError
from fdd.chiller_eiv.estimators import Estimator, estimate
from fdd.chiller_eiv.fit import fit_gordon_ng
from fdd.chiller_eiv.forms import DIVISION_FREE, FRACTIONAL, Form
from fdd.chiller_eiv.gate import gate
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.moments import Method, regression_terms, sum_moments
from fdd.chiller_eiv.simulate import LAB_CHILLER, LAB_SIGMA, design
from fdd.chiller_eiv.steady_state import SteadyLimits
from fdd.chiller_eiv.study import ChillerData, StudyResult, study
from fdd.chiller_eiv.study_report import write_html
from fdd.chiller_eiv.vector import DAY, learn_vector
from fdd.chiller_eiv.watch import VectorMonitor

HERE = Path(__file__).resolve().parent
SHARED = Path(os.environ.get("FDD_SHARED", HERE.parents[2] / "shared")) / "data"
TRUTH = np.array([LAB_CHILLER.dS, LAB_CHILLER.Q_leak, LAB_CHILLER.R])
CASES: tuple[tuple[str, Form, Method, Estimator], ...] = (
    ("OLS", FRACTIONAL, "propagation", "ols"),
    ("CLS (Eq. 11, summed)", FRACTIONAL, "propagation", "cls"),
    ("capped, division-free", DIVISION_FREE, "exact", "capped"),
)


def figures(folder: Path) -> None:
    """Figures 2 to 4 of Paper G: estimates over noise level, 1000 repeats, for a wide and a narrow load range."""
    rng = np.random.default_rng(1)
    levels = np.arange(0.0, 2.01, 0.1)
    titles = ("entropy production dS [kW/K]", "heat leak Q_leak [kW]", "resistance R [K/kW]")
    shown = np.array([1e-3, 1e-3, 1e3])
    for number, parameter, title, factor in zip((2, 3, 4), range(3), titles, shown, strict=True):
        figure = Figure(figsize=(9, 5.4), layout="constrained")
        axes = figure.subplots(2, 3, sharex=True, sharey="row")
        for row, kind in enumerate(("wide", "narrow")):
            for column, (name, form, method, estimator) in enumerate(CASES):
                values = (
                    np.array([_repeat(rng, kind, s, form, method, estimator)[:, parameter] for s in levels]) * factor
                )
                ax = axes[row, column]
                low, high = np.percentile(values, [2.5, 97.5], axis=1)
                ax.fill_between(levels, low, high, alpha=0.25, lw=0)
                ax.plot(levels, np.median(values, axis=1), label="median")
                ax.plot(levels, values.mean(axis=1), lw=0.8, ls="--", label="mean")
                ax.axhline(TRUTH[parameter] * factor, color="k", lw=0.8)
                ax.set_title(f"{name}, {kind} load range", fontsize=9)
            spread = np.percentile(values, [1, 99])
            axes[row, 0].set_ylim(*(spread + np.array([-0.8, 0.8]) * (spread[1] - spread[0])))
        axes[0, 0].legend(fontsize=8)
        figure.supxlabel("noise, multiples of the laboratory's errors")
        figure.supylabel(title)
        figure.savefig(folder / f"chiller-figure-{number}.png", dpi=80)


def _repeat(
    rng: np.random.Generator, kind: str, level: float, form: Form, method: Method, estimator: Estimator
) -> np.ndarray:
    exact = design("wide" if kind == "wide" else "narrow", 30)
    x = exact + level * LAB_SIGMA * rng.standard_normal((1000, 30, 4))
    terms = regression_terms(form, x.reshape(-1, 4), np.diag((level * LAB_SIGMA) ** 2), method)
    return estimate(sum_moments(terms, np.repeat(np.arange(1000), 30)), estimator)


def machines() -> list[tuple[dict[str, str], EirCurves]]:
    """Every curve set of the data."""
    with gzip.open(SHARED / "chiller_eir_curves.csv.gz", "rt") as f:
        rows = list(csv.DictReader(f))
    return [(r, _curves(r)) for r in rows]


def _curves(r: dict[str, str]) -> EirCurves:
    c = {k: tuple(float(v) for v in r[k].split(",")) for k in ("capFunT", "EIRFunT", "EIRFunPLR")}
    return EirCurves(
        -float(r["QEva_nom_W"]), float(r["COP_nom"]), float(r["mEva_kg_s"]), float(r["mCon_kg_s"]),
        c["capFunT"], c["EIRFunT"], c["EIRFunPLR"], r["type"] == "ReformulatedEIR",
    )  # fmt: skip


def season(
    r: dict[str, str], machine: EirCurves, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half a year of operation inside the curves' range: measurements with errors, covariance, day."""
    days, per_day = 180, 6
    n = days * per_day
    day = np.repeat(np.arange(days), per_day)
    warm = np.sin(np.pi * day / days - np.pi / 4)  # spring to autumn, the halves differ in season
    weather = np.repeat(rng.standard_normal(days), per_day)
    low, high = float(r["TConMin"]) - 273.15, float(r["TConMax"]) - 273.15
    if machine.leaving:
        low, high = low, high - 5.0
    T_cdi = np.clip(low + (high - low) * (0.45 + 0.3 * warm + 0.1 * weather + 0.05 * rng.standard_normal(n)), low, high)
    least = max(float(r["PLRMin"]), 0.3)
    share = np.clip(0.6 + 0.15 * warm + 0.05 * weather + 0.15 * rng.standard_normal(n), least, 1.0)
    coldest, warmest = (float(r[k]) - 273.15 for k in ("TEvaLvgMin", "TEvaLvgMax"))
    T_cho = np.clip(float(r["TEvaLvg_nom_K"]) - 273.15 + 0.5 * rng.standard_normal(n), coldest, warmest)
    x = machine.operate(share, T_cho, T_cdi)
    sigma = np.stack([np.full(n, 0.05), np.full(n, 0.05), 0.01 * x[:, 2], 0.005 * x[:, 3]], axis=1)
    cov = sigma[:, :, None] * np.eye(4) * sigma[:, None, :]
    return x + sigma * rng.standard_normal(x.shape), cov, day


def curves(folder: Path) -> None:
    """Fit every machine: CV of predicted power, signs, the gate's decision."""
    rng = np.random.default_rng(2)
    with (folder / "chiller-curves.csv").open("w", newline="") as f:
        table = csv.writer(f, lineterminator="\n")
        head = ("type", "machine", "CV_percent", "dS_W_K", "Q_leak_W", "R_K_MW", "gate", *RATIOS)
        table.writerow((*head, "first_reason"))
        for r, machine in machines():
            table.writerow((r["type"], r["name"], *_one_machine(r, machine, rng)))


RATIOS = {
    "half_ratio_dS": "the first and second half dS",
    "half_ratio_R": "the first and second half R",
    "half_ratio_dS_leak_held": "held: the first and second half dS",
    "half_ratio_R_leak_held": "held: the first and second half R",
}
"""Columns of the table and the gate's measure behind each: larger over smaller value of the two half-years."""


def _one_machine(r: dict[str, str], machine: EirCurves, rng: np.random.Generator) -> tuple[object, ...]:
    x, cov, day = season(r, machine, rng)
    if not (np.isfinite(x).all() and (x[:, 2:] > 0).all()):
        return ("", "", "", "", "curves give no power", *[""] * 5)
    decision = gate(x, cov, day)
    free = fit_gordon_ng(x, cov, day)
    v, m = free.values(), decision.measures
    halves = [m.get(k, np.nan) for k in RATIOS.values()]
    values = (f"{v['dS']:.4g}", f"{v['Q_leak']:.4g}", f"{1e6 * v['R']:.4g}")
    first = decision.reasons[0] if decision.reasons else ""
    return (f"{100 * free.residual_sd:.2f}", *values, decision.level.value, *(f"{h:.3g}" for h in halves), first)


CLEAN = "as measured"


def variable_speed_data() -> ChillerData:
    """The real variable-speed chiller, in SI; condenser flow from the heat balance, which it lacks a meter for."""
    d = pd.read_csv(SHARED / "esb_chiller1_raw_5min.csv.gz")
    stamp = pd.to_datetime(d["Time"], utc=True, errors="coerce")
    d = d[stamp.notna()]
    time = stamp.dropna().astype("datetime64[ns, UTC]").astype("int64").to_numpy()

    def column(name: str) -> np.ndarray:
        return np.asarray(pd.to_numeric(d[name], errors="coerce").to_numpy(float))

    raw = {
        "T_cdi": (column("Cond Entering Water Temp") - 32) / 1.8,
        "T_cdo": (column("Cond Leaving Water Temp") - 32) / 1.8,
        "T_chi": (column("Evaporator Entering Water Temperature") - 32) / 1.8,
        "T_cho": (column("Evaporator Leaving Water Temperature") - 32) / 1.8,
        "flow_ch": column("Flexim M-3 (WCM-1) volumetric flow rate") * 0.0630902,
        "power": 1e3 * column("Starter Input Power Consumption (kW)"),
    }
    load = 4190 * raw["flow_ch"] * (raw["T_chi"] - raw["T_cho"])
    rise = raw["T_cdo"] - raw["T_cdi"]
    raw["flow_cd"] = np.where(rise > 0.5, (load + raw["power"]) / 4190 / np.where(rise > 0.5, rise, 1.0), np.nan)
    return ChillerData(time, raw)


VSD = ChillerConfig(
    name="variable-speed chiller",
    rated_load=2.46e6,
    instruments=Instrumentation(
        {
            "T_cdi": SensorError(0.1),
            "T_cdo": SensorError(0.1),
            "T_chi": SensorError(0.05),
            "T_cho": SensorError(0.05),
            "flow_ch": SensorError(relative=0.01),
            "power": SensorError(relative=0.01),
        },
        nominal_flow_cd=100.0,
    ),
    condenser_flow="measured",
    speed="by load",
    # Five-minute trends and a cycling tower: steady states are compared in looser windows than parameters are fitted.
    steady=SteadyLimits(window=1800, least_temperature_sd=0.15, least_relative_sd=0.02, temperature_slope=2.0),
    baseline_days=45.0,
)


def variable_speed(folder: Path) -> None:
    """The gate, and the chart of steady states in four splits of the record, healthy and with synthetic faults."""
    data = variable_speed_data()
    three = study(data, ChillerConfig("three parameters", VSD.rated_load, VSD.instruments, baseline_days=45.0))
    print("default windows, three parameters:", three.report.counts())
    print(three.decision.sentence(), "\n", three.decision.fit.values(), "\n", dict(three.decision.measures))
    print(three.calibration)
    result = study(data, VSD)
    write_html(result, folder / "chiller-variable-speed.html")
    print("looser windows:", result.report.counts(), f"power within {100 * result.baseline.vector.power_cv:.1f} %")
    print(result.decision.sentence())
    print(result.verdict)
    _splits(result)


FAULTS = {CLEAN: {}, "power +5 %": {"power": 1.05}, "power +10 %": {"power": 1.10}, "flow -10 %": {"flow_ch": 0.9}}
"""Readings that are multiplied in the half that is watched."""


def _splits(result: StudyResult) -> None:
    """Learn one half of the running days, watch the other; alarms are cleared at once, so that none hides another."""
    clusters = clusters_of(result.points, result.config, round(result.baseline.steady.window * 1e9))
    day = clusters.start // DAY
    days = np.unique(day)
    half, odd = day < days[len(days) // 2], np.searchsorted(days, day) % 2 == 1
    for split, learned in {"first half": half, "second half": ~half, "even days": ~odd, "odd days": odd}.items():
        vector = learn_vector(clusters.select(np.flatnonzero(learned)), result.config.instruments, VSD.rated_load)
        print(
            f"learned on the {split}: {', '.join(vector.layout.features)}; {'; '.join(vector.notes) or 'all watched'}"
        )
        for fault, factors in FAULTS.items():
            monitor, found = VectorMonitor(vector, VSD.residual_false_alarms), []
            for i in np.flatnonzero(~learned):
                one = clusters.select(np.array([i]))
                raw = {k: v * factors.get(k, 1.0) for k, v in one.raw.items()}
                verdict = monitor.update(replace(one, raw=raw))
                if verdict.finding is not None:
                    found.append(f"{verdict.finding.named.cause or 'no name'} after {monitor.judged} judged")
                    monitor.reset()
            running = len(np.unique(day[~learned]))
            share = f"{monitor.judged} of {monitor.seen} states judged, {running} days"
            print(f"  {fault}: {share}; {len(found)} alarms: {found[:1]}")


def main() -> None:
    """Run the study asked for."""
    actions = {"figures": figures, "curves": curves, "variable-speed": variable_speed}
    if len(sys.argv) < 2 or sys.argv[1] not in actions:
        raise SystemExit(f"usage: python {sys.argv[0]} {'|'.join(actions)} [folder]")
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else HERE
    try:
        actions[sys.argv[1]](folder)
    except (ChillerError, FileNotFoundError) as e:
        raise SystemExit(str(e)) from e


if __name__ == "__main__":
    main()
