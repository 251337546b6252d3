"""A two-state room with PRBS heating: which detectors see which fault, all set to the same chance of a false alarm.

Air and envelope, 5-minute samples, 60 days of weather, a fault at day 15. Simulated with the exact discretisation by
numpy, apart from the filters under test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from fdd.greybox.filter_bank import FilterBank
from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data
from fdd.models.declare import ComponentModel, Parameter, Quantity, State
from fdd.plant.weather import weather
from fdd.records import NANOSECONDS, FloatArray
from fdd.residual_monitors.chart import Phase
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.run_length import Rule, alarm_probability, limit_for
from fdd.residual_monitors.score import Score

STEP = 300.0
DAY = int(86400 / STEP)
DAYS, ONSET = 60, 15
BLOCK = 72
START = 1_706_745_600 * NANOSECONDS  # 1 February 2024
PHYSICAL = ("R_ea", "R_ie", "C_i", "C_e", "gain", "A_w")
VALUES = {
    "R_ea": 4.6e-3, "R_ie": 8.6e-4, "C_i": 3.8e6, "C_e": 1.04e7, "gain": 1.0, "A_w": 1.0,
    "sigma_i": 5e-3, "sigma_e": 5e-3, "noise": 0.03,
}  # fmt: skip
FAULTS: dict[str, tuple[str, float]] = {
    "envelope resistance -20 %": ("R_ea", 0.8),
    "envelope resistance -10 %": ("R_ea", 0.9),
    "inner resistance -20 %": ("R_ie", 0.8),
    "air capacity +20 %": ("C_i", 1.2),
    "heater gain -10 %": ("gain", 0.9),
    "heater gain -5 %": ("gain", 0.95),
    "solar aperture +30 %": ("A_w", 1.3),
}


def model() -> ComponentModel:
    """The room as a component; every parameter on a log scale."""
    units = {"R_ea": "K/W", "R_ie": "K/W", "C_i": "J/K", "C_e": "J/K", "gain": "1", "A_w": "m^2"}

    def drift(x: Any, u: Any, p: Any) -> dict[str, Any]:
        inner = (x.T_e - x.T_i) / p.R_ie
        return {
            "T_i": (inner + p.gain * u.P + p.A_w * u.I) / p.C_i,
            "T_e": ((u.T_out - x.T_e) / p.R_ea - inner) / p.C_e,
        }

    return ComponentModel(
        name="benchmark-room",
        version="1",
        title="Two-state room",
        states=(State("T_i", "degC", "air", 0.2), State("T_e", "degC", "envelope", 1.0)),
        inputs=(Quantity("T_out", "degC", "outdoors"), Quantity("I", "W/m^2", "sun"), Quantity("P", "W", "heater")),
        outputs=(Quantity("T", "degC", "air"),),
        parameters=tuple(
            Parameter(
                s, units.get(s, "1"), s, v, v / 100, v * 100, "benchmark", kind="physical" if s in units else "noise"
            )
            for s, v in VALUES.items()
        ),
        drift=drift,
        diffusion=lambda x, u, p: {"T_i": p.sigma_i, "T_e": p.sigma_e},
        observe=lambda x, u, p: {"T": x.T_i},
        noise=lambda x, u, p: {"T": p.noise},
        start=lambda y, u, p: {"T_i": y.T, "T_e": (y.T * p.R_ea + u.T_out * p.R_ie) / (p.R_ea + p.R_ie)},
    )


@dataclass(frozen=True)
class Runs:
    """Inputs (steps, runs, 3) and measured temperature (steps, runs)."""

    u: FloatArray
    y: FloatArray


def _discrete(values: dict[str, float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Exact step: transition, input matrix for (T_out, I, P), Cholesky root of the process noise (Van Loan 1978)."""
    a = 1 / (values["R_ie"] * values["C_i"])
    b, c = 1 / (values["R_ie"] * values["C_e"]), 1 / (values["R_ea"] * values["C_e"])
    A = np.array([[-a, a], [b, -b - c]])
    B = np.array([[0, values["A_w"] / values["C_i"], values["gain"] / values["C_i"]], [c, 0, 0]])
    big = np.zeros((5, 5))
    big[:2, :2], big[:2, 2:] = A, B
    step = expm(big * STEP)
    noise = np.zeros((4, 4))
    noise[:2, :2], noise[:2, 2:], noise[2:, 2:] = -A, np.diag([values["sigma_i"] ** 2, values["sigma_e"] ** 2]), A.T
    van = expm(noise * STEP)
    Q = van[2:, 2:].T @ van[:2, 2:]
    return step[:2, :2], step[:2, 2:], np.linalg.cholesky((Q + Q.T) / 2)


def simulate(runs: int, seed: int, fault: tuple[str, float] | None = None, days: int = DAYS) -> Runs:
    """Independent runs, each with its own weather, heating and noise; the fault acts from day 15 on."""
    rng = np.random.default_rng(seed)
    steps = days * DAY
    time = START + np.arange(steps, dtype=np.int64) * int(STEP * NANOSECONDS)
    u = np.empty((steps, runs, 3))
    for r in range(runs):
        sky = weather(time, rng)
        u[:, r, 0], u[:, r, 1] = sky.T_out, sky.I_north
    # A PRBS that changes at most every hour and is on half of the time.
    u[:, :, 2] = 4500.0 * np.repeat(rng.integers(0, 2, (steps // 12 + 1, runs)), 12, axis=0)[:steps]
    healthy, broken = dict(VALUES), dict(VALUES)
    if fault:
        broken[fault[0]] *= fault[1]
    discrete = [_discrete(healthy), _discrete(broken)]
    x = np.stack([np.full(runs, 20.0), u[0, :, 0] * 0.16 + 20.0 * 0.84], axis=1)
    y = np.empty((steps, runs))
    noise = rng.standard_normal((steps, runs, 3))
    for t in range(steps):
        y[t] = x[:, 0] + VALUES["noise"] * noise[t, :, 2]
        transition, inputs, root = discrete[t >= ONSET * DAY and fault is not None]
        x = x @ transition.T + u[t] @ inputs.T + noise[t, :, :2] @ root.T
    return Runs(u, y)


class Means:
    """A CUSUM on standardised means of so many values."""

    def __init__(self, chart: Cusum, length: int) -> None:
        self.chart, self.length = chart, length
        self.total, self.count = np.zeros(chart.n), 0

    def update(self, z: FloatArray) -> np.ndarray:
        """Alarms after this value, (n,)."""
        self.total += np.nan_to_num(z)
        self.count += 1
        if self.count == self.length:
            self.chart.update(self.total / np.sqrt(self.length))
            self.total, self.count = np.zeros(self.chart.n), 0
        return self.chart.latched == 1


def limit_for_chance(k: float, updates: int, chance: float) -> float:
    """Limit of a CUSUM that alarms within ``updates`` with this probability."""
    rule = Rule("cusum", k=k)
    guess = float(limit_for("cusum", updates / -np.log1p(-chance), k=k))
    return float(brentq(lambda h: alarm_probability(rule, h, updates) - chance, 0.7 * guess, 1.3 * guess, xtol=1e-4))


@dataclass(frozen=True)
class Outcome:
    """Of one detector and one fault: delays [days], runs that alarmed before the onset, share rightly named.

    ``error``: median standard error of each parameter's change over the 60 days, log scale, it alone moving.
    """

    delay: FloatArray
    early: int
    runs: int
    named: float | None = None
    error: dict[str, float] | None = None

    @property
    def found(self) -> float:
        """Share of the runs without a false alarm that found the fault by the last day."""
        return len(self.delay) / max(1, self.runs - self.early)

    @property
    def median(self) -> float:
        """Median delay [days] where more than half are found, else NaN."""
        every = np.concatenate([self.delay, np.full(self.runs - self.early - len(self.delay), np.inf)])
        middle = float(np.median(every)) if len(every) else np.inf
        return middle if np.isfinite(middle) else float("nan")


@dataclass(frozen=True)
class Detection:
    """Of all runs: update of the first alarm by detector (NaN: none), parameter named, standard errors (runs, 6)."""

    first: dict[str, FloatArray]
    named: dict[int, str]
    error: FloatArray

    def outcomes(self, rows: slice, answer: str | None = None) -> dict[str, Outcome]:
        """What each detector made of these runs."""
        right = [self.named[i] == answer for i in range(rows.start, rows.stop) if i in self.named]
        out = {}
        for name, every in self.first.items():
            first = every[rows]
            late = first[first >= ONSET * DAY]
            out[name] = Outcome((late - ONSET * DAY + 1) / DAY, int(np.sum(first < ONSET * DAY)), len(first))
        median = np.median(self.error[rows], axis=0).tolist()
        score = out["score"]
        out["score"] = replace(
            score, named=float(np.mean(right)) if right else None, error=dict(zip(PHYSICAL, median, strict=True))
        )
        return out


def together(cases: Sequence[Runs]) -> tuple[Runs, list[slice]]:
    """Runs side by side, and where each case stands."""
    edges = np.cumsum([0, *(c.y.shape[1] for c in cases)])
    rows = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    return Runs(np.concatenate([c.u for c in cases], axis=1), np.concatenate([c.y for c in cases], axis=1)), rows


def detect(
    runs: Runs, chance: float = 0.1, parameters: FloatArray | None = None, covariance: FloatArray | None = None
) -> Detection:
    """Run the filter and all detectors over the runs.

    Parameters
    ----------
    chance : of a false alarm of each detector (of all six score charts together) in the 60 days
    parameters : shape (runs, n_p), what the filters believe; the true ones by default
    covariance : shape (runs, 6, 6), of the physical parameters the filters believe, on the log scale
    """
    steps, n = runs.y.shape
    bank = FilterBank(model(), np.tile(list(VALUES.values()), (n, 1)) if parameters is None else parameters)
    p = len(PHYSICAL)
    blocks = steps // BLOCK
    limit = limit_for_chance(0.5, blocks, -np.expm1(np.log1p(-chance) / p))
    score = Score(np.full((n, p), limit), block=BLOCK, history=blocks, covariance=covariance)
    charts = {
        "innovations, k = 0.5": Cusum(np.full(n, limit_for_chance(0.5, steps, chance))),
        "innovations, k = 0.1": Cusum(np.full(n, limit_for_chance(0.1, steps, chance)), k=0.1),
    }
    means = Means(Cusum(np.full(n, limit_for_chance(0.5, blocks, chance))), BLOCK)
    first = {name: np.full(n, np.nan) for name in (*charts, "6-h means", "score")}
    named: dict[int, str] = {}
    since = np.zeros(n, dtype=np.int64)
    for t in range(steps):
        step = bank.step(STEP, runs.u[t], runs.y[t][:, None])
        z = step.standardised[:, 0]
        for name, chart in charts.items():
            _note(first[name], chart.update(z).phase == Phase.ALARM, t)
        _note(first["6-h means"], means.update(z), t)
        said = score.update_scores(step.score[:, :p], step.information[:, :p, :p])
        _note(first["score"], (said.phase == Phase.ALARM).reshape(n, p).any(axis=1), t)
        new = first["score"] == t
        since += 1
        if new.any():
            since[new] = _since(said.onset_age, score)[new]
        for i in np.flatnonzero((first["score"] >= ONSET * DAY) & (t - first["score"] == 2 * DAY)):
            named[int(i)] = named_by(score, int(i), int(since[i]))
    return Detection(first, named, np.array([score.visibility(i) for i in range(n)]))


def detect_fitted(runs: Runs, seed: int, days: int = 14) -> Detection:
    """The same with filters fitted by maximum likelihood on other healthy days of the same season."""
    before = simulate(runs.y.shape[1], seed, days=days)
    seconds = STEP * np.arange(len(before.y))
    found = [
        fit(model(), Data(seconds, before.u[:, r], before.y[:, r : r + 1]), start=VALUES, errors="fisher")
        for r in range(before.y.shape[1])
    ]
    parameters = np.array([list(f.params.values()) for f in found])
    p = len(PHYSICAL)
    return detect(runs, parameters=parameters, covariance=np.array([f.cov_scale[:p, :p] for f in found]))


def named_by(score: Score, component: int, updates: int) -> str:
    """The parameter whose change alone explains most since the onset."""
    return PHYSICAL[int(np.argmax(score.estimate(component, updates).gain))]


def _since(age: np.ndarray, score: Score) -> np.ndarray:
    """Age of the onset of the strongest of each run's charts."""
    shape = score.components, score.parameters
    strongest = np.argmax((score.latched * np.maximum(score.upper, score.lower)).reshape(shape), axis=1)
    return np.asarray(age.reshape(shape)[np.arange(shape[0]), strongest])


def _note(first: FloatArray, alarm: np.ndarray, t: int) -> None:
    first[alarm & np.isnan(first)] = t


def false_alarm_share(outcomes: dict[str, Outcome]) -> dict[str, float]:
    """Share of healthy runs in which each detector alarmed at all."""
    return {name: (o.early + len(o.delay)) / o.runs for name, o in outcomes.items()}
