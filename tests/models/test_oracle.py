"""The production models, in SI, against likelihoods and gradients that other programs found in hours, kJ and l/h.

Parameters are estimated on a log scale, so that a change of unit shifts them and leaves gradients as they are.
"""

import gzip
import json

import numpy as np
import pytest

from fdd.greybox.likelihood import Data, Likelihood
from fdd.models.registry import get_model

HOUR = 3600.0


def record(oracle, name):
    with gzip.open(oracle / f"kernel_{name}.csv.gz", "rt") as file:
        columns = file.readline().strip().split(",")
        table = dict(zip(columns, np.loadtxt(file, delimiter=",").T, strict=True))
    # Times are written with ten digits; the problems say what the steps are exactly.
    return table | {
        "t": np.arange(len(table["t"])) * {"radiator": 60.0, "building": 600.0, "heat_exchanger": 1.0}[name]
    }


def columns(table, *names):
    return np.column_stack([table[n] for n in names])


def compare(oracle, case, model, data, factors, substeps, method=None):
    """``factors``: our symbol to (oracle's symbol, factor from its unit to ours)."""
    reference = json.loads((oracle / "kernel_reference.json").read_text())[case]
    theirs = dict(zip(reference["parameters"], np.exp(reference["log_theta"]), strict=True))
    symbols = model.symbols["parameters"]
    values = np.array([theirs[factors[s][0]] * factors[s][1] for s in symbols])
    found = Likelihood(model, data, substeps=substeps, method=method).evaluate(values)
    assert found.value == pytest.approx(reference["negative_log_likelihood"], rel=1e-9)
    gradient = dict(zip(reference["parameters"], reference["gradient"], strict=True))
    # A logit scale differs from a log scale by the slope of one against the other.
    slopes = [
        1.0 if p.transform == "log" else (p.upper - v) * (v - p.lower) / (p.upper - p.lower) / v
        for p, v in zip(model.parameters, values, strict=True)
    ]
    ours = found.gradient / slopes
    expected = np.array([gradient[factors[s][0]] for s in symbols])
    assert np.abs(ours - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("case", ["radiator_true", "radiator_off"])
def test_printed_radiator_reproduces_the_reference(oracle, case):
    # k = 4.18 kJ/(l K); q in l/h, a per litre of water that weighs 1 kg.
    model = get_model("radiator", form="printed", heat_capacity=4180.0)
    table = record(oracle, "radiator")
    data = Data(
        table["t"],
        np.column_stack([table["Tf"], table["Ta"], table["q"] / HOUR]),
        columns(table, "Tr"),
        x0=np.array([45.0, 40.0, 26.0, 0.5]),
        P0=np.diag([1.0, 1.0, 1.0, 0.01]),
    )
    per_hour, per_root = 1e3 / HOUR, 1 / np.sqrt(HOUR)
    factors = {
        "C": ("Cr", 1e3), "H": ("Hr", per_hour), "C_air": ("Cl", 1e3), "B_air": ("Bl", per_hour),
        "a": ("a", 1.0), "b": ("b", 1 / HOUR), "sigma_T": ("sT", per_root), "sigma_air": ("sL", per_root),
        "sigma_A": ("sA", per_root), "noise_return": ("r", 1.0),
    }  # fmt: skip
    compare(oracle, case, model, data, factors, 4)


@pytest.mark.parametrize("case", ["building_true", "building_off"])
def test_two_room_building_reproduces_the_reference(oracle, case):
    model = get_model(
        "building",
        outside="each",
        boundary=True,
        solar_split=0.1,
        fixed={"A_north": 0.9},
        tied={"sigma_air_north": "sigma_air_south", "sigma_floor_north": "sigma_floor_south"},
    )
    table = record(oracle, "building")
    zero = np.zeros_like(table["t"])
    inputs = {
        "T_out_south": "Tus", "T_out_north": "Tun", "T_boundary": "Tb", "I_south": "Is", "I_north": "In",
        "P_heat_south": "Prs", "P_heat_north": "Prn", "P_gain_north": "Pec",
    }  # fmt: skip
    u = np.column_stack([table[inputs[s]] if s in inputs else zero for s in model.symbols["inputs"]])
    # The model's order is air and floor of the south, then of the north, as the reference's.
    data = Data(
        table["t"],
        u,
        columns(table, "Yis", "Yin"),
        x0=np.array([14.0, 13.5, 13.0, 12.5]),
        P0=np.diag([0.25, 1.0, 0.25, 1.0]),
    )
    factors = {
        "B_out_south": ("Bus", 1 / 3.6), "B_out_north": ("Bun", 1 / 3.6), "B_boundary": ("Bb", 1 / 3.6),
        "B_south_north": ("Bn", 1 / 3.6), "B_floor_south": ("Bas", 1 / 3.6), "B_floor_north": ("Ban", 1 / 3.6),
        "C_air_south": ("Cis", 1e3), "C_floor_south": ("Cas", 1e3), "C_air_north": ("Cin", 1e3),
        "C_floor_north": ("Can", 1e3), "A_south": ("Aes", 1.0), "sigma_air_south": ("s_air", 1 / np.sqrt(HOUR)),
        "sigma_floor_south": ("s_flo", 1 / np.sqrt(HOUR)), "noise_south": ("r_s", 1.0), "noise_north": ("r_n", 1.0),
    }  # fmt: skip
    compare(oracle, case, model, data, factors, None)


@pytest.mark.parametrize("case", ["heat_exchanger_true", "heat_exchanger_off"])
def test_heat_exchanger_reproduces_the_reference(oracle, case):
    model = get_model("heat_exchanger", transfer="flow")
    table = record(oracle, "heat_exchanger")
    data = Data(
        table["t"],
        columns(table, "mh", "mc", "Thin", "Tcin"),
        columns(table, "Tho", "Tco"),
        x0=np.array([66.0, 60.0, 55.0, 38.0, 43.0, 48.0]),
        P0=np.eye(6) * 4.0,
    )
    factors = {
        "M_hot": ("Mh", 1.0), "M_cold": ("Mc", 1.0), "C_hot": ("Ch", 1e3), "C_cold": ("Cc", 1e3), "y": ("y", 1.0),
        "sigma_hot": ("sh", 1.0), "sigma_cold": ("sc", 1.0), "noise_hot": ("rh", 1.0), "noise_cold": ("rc", 1.0),
    }  # fmt: skip
    reference = json.loads((oracle / "kernel_reference.json").read_text())[case]
    # The reference is Runge-Kutta with two substeps; the exact discretisation that the model gets by default is near.
    values = [
        np.exp(reference["log_theta"])[reference["parameters"].index(factors[s][0])] * factors[s][1]
        for s in model.symbols["parameters"]
    ]
    exact = Likelihood(model, data).value(np.array(values))
    assert exact == pytest.approx(reference["negative_log_likelihood"], rel=1e-4)
    compare(oracle, case, model, data, factors, 2, method="rk4")
