"""Synthetic chillers: the laboratory machine of the thesis, its two test designs, and years of operation with faults.

Used by the benchmarks, the tests and the studies; nothing here is measured. The 10.5 kW machine's parameters are the
measured ones of Ng et al. (1997), its errors those of their Table 1 ("1x", one sigma).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from fdd.chiller_eiv.model import GordonNg, power
from fdd.records import FloatArray

LAB_CHILLER = GordonNg(dS=5.518, Q_leak=2723.0, R=2.689e-3)
"""Ng et al. (1997), measured inside the machine [W/K, W, K/W]."""

LAB_SIGMA = np.array([0.05, 0.05, 200.0, 10.0])
"""One-sigma errors of (T_cdi [K], T_chi [K], Q [W], E [W]), "1x"."""

HOUR = 3600 * 10**9
"""[ns]"""


def capacity(T_cdi: FloatArray, T_chi: FloatArray) -> FloatArray:
    """Full load of the laboratory machine [W]: 10.5 kW, +3 % per K of T_chi, -1 % per K of T_cdi."""
    return np.asarray(10500.0 * (1 + 0.03 * (T_chi - 282.15) - 0.01 * (T_cdi - 293.15)))


def design(kind: Literal["wide", "narrow"], n: int) -> FloatArray:
    """Noise-free measurements (n, 4) of the laboratory machine on the 5 x 3 x 2 grid of the reference, repeated.

    ``wide`` has loads of 55 and 100 % of capacity, a range of 2.5 : 1 over the grid; ``narrow`` 95.5 and 104.5 %.
    """
    shares = (0.55, 1.0) if kind == "wide" else (0.955, 1.045)
    T, C, share = np.meshgrid(
        np.linspace(293.15, 306.15, 5), np.array([281.15, 284.15, 287.15]), np.array(shares), indexing="ij"
    )
    i = np.arange(n) % T.size
    T, C, share = T.ravel()[i], C.ravel()[i], share.ravel()[i]
    Q = share * capacity(T, C)
    return np.stack([T, C, Q, LAB_CHILLER.power(Q, T, C)], axis=1)


def autocorrelated(rng: np.random.Generator, n: int, correlation: float, sd: float) -> FloatArray:
    """A stationary AR(1) series of n values."""
    e = rng.standard_normal(n) * np.sqrt(1 - correlation**2)
    out, _ = lfilter([1.0], [1.0, -correlation], e, zi=[correlation * rng.standard_normal()])
    return np.asarray(out * sd)


@dataclass(frozen=True, slots=True)
class Operation:
    """Hourly operation of one machine.

    Attributes
    ----------
    time : shape (n,) [ns]
    x : shape (n, 4), measured (T_cdi [K], T_chi [K], Q [W], E [W]), with errors
    truth : the same without
    """

    time: FloatArray
    x: FloatArray
    truth: FloatArray


Fault = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""From time [days] to factors on dS and R and an addition to Q_leak [W], each (n,)."""


def healthy(day: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """No fault."""
    one = np.ones_like(day)
    return one, one, 0 * one


def operate(
    days: int,
    seed: int,
    *,
    noise: float = 2.0,
    model_error: float = 0.0,
    fault: Fault = healthy,
    step_hours: float = 1.0,
    first_day: int = 0,
) -> Operation:
    """Simulate the laboratory machine serving a building through the seasons.

    Condenser water follows the wet-bulb temperature (season, day, weather), the load follows outdoor temperature and
    occupancy between 40 and 100 % of capacity; the chilled water leaves near 7 degC and so returns warmer with load.

    Parameters
    ----------
    days, step_hours : length and sampling
    noise : multiple of ``LAB_SIGMA``
    model_error : standard deviation of a slow multiplicative error of power [1], correlation time 50 h
    fault : factors by day, counted from the start
    first_day : day of the year the simulation starts on
    """
    rng = np.random.default_rng(seed)
    per_day = round(24 / step_hours)
    n = days * per_day
    day = np.arange(n) / per_day
    hour = 24 * (day % 1)
    season = np.sin(2 * np.pi * ((day + first_day) / 365 - 0.3))
    decay = np.exp(-step_hours / 30)
    weather = autocorrelated(rng, n, decay, 1.0)
    T = 300.65 + 3.5 * season + 1.0 * np.sin(2 * np.pi * (hour - 9) / 24) + 1.2 * weather
    busy = np.where((hour > 7) & (hour < 19), 1.0, 0.0)
    share = 0.6 + 0.08 * season + (0.2 + 0.05 * season) * busy + 0.05 * weather + 0.05 * rng.standard_normal(n)
    share = np.clip(share, 0.4, 1.0)
    C = 280.65 + 5.0 * share + 0.8 * autocorrelated(rng, n, 0.8, 1.0)
    factor_dS, factor_R, more_leak = fault(day)
    Q = share * capacity(T, C)
    p = LAB_CHILLER
    E = power(Q, T, C, p.dS * factor_dS, p.Q_leak + more_leak, p.R * factor_R)
    if model_error:
        E = E * (1 + autocorrelated(rng, n, np.exp(-step_hours / 50), model_error))
    truth = np.stack([T, C, Q, E], axis=1)
    x = truth + noise * LAB_SIGMA * rng.standard_normal(truth.shape)
    return Operation((day * 24 * HOUR).astype(np.int64), x, truth)


def raw_week(
    operation: Operation, machine_seed: int, *, samples: int = 2016, noise: float = 1.0
) -> dict[str, FloatArray]:
    """Five-minute raw readings of a laboratory machine for the steady-state detector [degC, kg/s, W].

    Each hour of ``operation`` is held for twelve samples, so that the load steps and most of each hour is steady; flow
    is constant at 0.5 kg/s and the leaving water follows from the load.
    """
    rng = np.random.default_rng(machine_seed)
    hours = operation.truth[np.arange(samples) // 12]
    T, C, Q, E = hours.T
    flow = np.full(samples, 0.5)
    n = noise * rng.standard_normal((5, samples))
    return {
        "T_cdi": T - 273.15 + 0.05 * n[0],
        "T_chi": C - 273.15 + 0.05 * n[1],
        "T_cho": C - 273.15 - Q / (flow * 4190.0) + 0.05 * n[2],
        "flow_ch": flow * (1 + 0.005 * n[3]),
        "power": E * (1 + 0.002 * n[4]),
    }
