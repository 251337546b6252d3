"""Machines from manufacturers' curves, and forms against physics they approximate."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest

from fdd.chiller_eiv.eir_curves import EirCurves
from fdd.chiller_eiv.fit import FitOptions, fit_gordon_ng
from fdd.chiller_eiv.forms import VARIABLE_FLOW
from fdd.chiller_eiv.gate import Level, gate
from fdd.chiller_eiv.model import ChillerError, GordonNg
from fdd.chiller_eiv.simulate import LAB_CHILLER, LAB_SIGMA, design

ONE = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_nominal_point_gives_nominal_power() -> None:
    m = EirCurves(500e3, 5.0, 20.0, 25.0, ONE, ONE, (0.0, 1.0, 0.0), leaving=False)
    x = m.operate(np.array([1.0, 0.5]), np.array([7.0, 7.0]), np.array([30.0, 30.0]))
    np.testing.assert_allclose(x[:, 3], [100e3, 50e3])
    np.testing.assert_allclose(x[0], [303.15, 280.15 + 500e3 / 20 / 4190, 500e3, 100e3])


def test_reformulated_curves_settle_on_the_leaving_condenser_water() -> None:
    eir = (1.0, 0.0, 0.0, 0.01, 0.0, 0.0)
    m = EirCurves(500e3, 5.0, 20.0, 25.0, ONE, eir, (0.0, 0.0, 0.0, 1.0, *[0.0] * 6), leaving=True)
    E = m.operate(np.array([0.8]), np.array([7.0]), np.array([28.0]))[0, 3]
    leaving = 28.0 + (400e3 + E) / (25 * 4190)
    assert pytest.approx(500e3 / 5 * (1 + 0.01 * leaving) * 0.8, rel=1e-9) == E


def test_a_set_with_missing_coefficients_is_refused() -> None:
    with pytest.raises(ChillerError, match="3 coefficients"):
        EirCurves(1e5, 5.0, 1.0, 1.0, ONE, ONE, (1.0,), leaving=False)


def test_linear_flow_law_is_within_two_per_mille_of_the_effectiveness_form() -> None:
    V = np.linspace(0.7, 1.2, 200)
    capacity, UA = 4190 * 0.6, 2500.0  # nominal stream and conductance of the laboratory's condenser [W/K]
    evaporator = 0.6e-3  # does not see the condenser's flow [K/W]
    exact = evaporator + 1 / (capacity * V * (1 - np.exp(-UA / (capacity * V))))
    A = np.column_stack([np.ones_like(V), 1 / V])
    line = A @ np.linalg.lstsq(A / exact[:, None], np.ones_like(V), rcond=None)[0]
    assert np.max(np.abs(line / exact - 1)) < 2e-3


def test_variable_flow_is_corrected_for_the_flow_sensors_error() -> None:
    rng = np.random.default_rng(3)
    machine = GordonNg(LAB_CHILLER.dS, LAB_CHILLER.Q_leak, 1.9e-3, R_flow=0.8e-3)
    n, repeats = 2000, 40
    exact = np.column_stack([design("wide", n), rng.uniform(0.5, 1.2, n)])
    exact[:, 3] = machine.power(exact[:, 2], exact[:, 0], exact[:, 1], exact[:, 4])
    sigma = np.append(LAB_SIGMA, 0.05)
    truth = np.array([machine.dS, machine.Q_leak, machine.R, machine.R_flow])
    estimates = {"capped": [], "ols": []}  # type: ignore[var-annotated]
    for _ in range(repeats):
        x = exact + sigma * rng.standard_normal(exact.shape)
        for e in estimates:
            o = FitOptions(form=VARIABLE_FLOW, estimator=e)  # type: ignore[arg-type]
            estimates[e].append(fit_gordon_ng(x, np.diag(sigma**2), options=o).estimate)
    a = np.array(estimates["capped"])
    bias, error = a.mean(0) - truth, a.std(0) / np.sqrt(repeats)
    # Exact but for the third order of the 5 % flow error; that leaves a per cent of R_flow.
    assert np.all(np.abs(bias) < 3.5 * error + 0.01 * truth)
    assert abs(np.mean(estimates["ols"], axis=0)[3] / truth[3] - 1) > 0.02


def test_the_gate_gives_no_machine_all_parameters_whose_halves_disagree(shared_data: Path) -> None:
    with gzip.open(shared_data / "chiller_eir_curves.csv.gz", "rt") as f:
        rows = [r for r in csv.DictReader(f) if r["type"] == "ElectricEIR"][::8]
    rng = np.random.default_rng(0)
    levels = []
    for r in rows:
        c = {k: tuple(float(v) for v in r[k].split(",")) for k in ("capFunT", "EIRFunT", "EIRFunPLR")}
        machine = EirCurves(
            -float(r["QEva_nom_W"]),
            *(float(r[k]) for k in ("COP_nom", "mEva_kg_s", "mCon_kg_s")),
            *c.values(),  # type: ignore[arg-type]
            leaving=False,
        )
        n = 600
        warm = np.sin(np.pi * np.arange(n) / n - np.pi / 4)
        low, high = float(r["TConMin"]) - 273.15, float(r["TConMax"]) - 273.15
        T_cdi = np.clip(low + (high - low) * (0.45 + 0.3 * warm + 0.1 * rng.standard_normal(n)), low, high)
        share = np.clip(0.6 + 0.15 * warm + 0.15 * rng.standard_normal(n), 0.3, 1.0)
        x = machine.operate(share, np.full(n, float(r["TEvaLvg_nom_K"]) - 273.15), T_cdi)
        sigma = np.stack([np.full(n, 0.05), np.full(n, 0.05), 0.01 * x[:, 2], 0.005 * x[:, 3]], axis=1)
        cov = sigma[:, :, None] * np.eye(4) * sigma[:, None, :]
        decision = gate(x + sigma * rng.standard_normal(x.shape), cov, np.arange(n) // 6)
        levels.append(decision.level)
        prefix = "held: " if decision.level is Level.HELD else ""
        ratio = max(decision.measures[f"{prefix}the first and second half {p}"] for p in ("dS", "R"))
        if decision.level is not Level.RESIDUAL:
            assert ratio <= 1.5
        if decision.level is Level.FULL:
            assert decision.fit.values()["Q_leak"] > 0
    assert Level.RESIDUAL in levels
    assert len(set(levels)) > 1
