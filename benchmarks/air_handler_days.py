"""The air handler model on a measured test rig (LBNL fault data sets, MZVAV-2-1): which days leak, and what leaks?

Baselines come from fault-free days; a fault-free day is judged by a baseline that has not seen it. A day gets two
statistics: the gain in log-likelihood, over sliding windows, of each single fault against none (a bank of hypotheses),
and the lowest hourly mean of the cooling coil's condition while it cools. Limits are predictive, from the days a
baseline knows: one false alarm a year from each. An alarm of the condition alone is either a leak or a lack of cold
water; the stop of the fan tells which, when the heat of a warm coil behind a closed valve reaches still air.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.models.air_handler import air_handler
from fdd.models.restrict import restrict

LEAK = {"2007-08-28": "0.4 gpm", "2007-08-29": "1.0 gpm", "2007-08-30": "2.0 gpm"}
APART = ("2009-05-30", "2009-05-31")  # labelled normal, not in the set's inventory
# What fault-free operation does not tell: faults themselves, water temperatures, sensors' resolution (0.06 K), and how
# long the coil's condition lasts.
HELD = {
    "leak_heat": 1e-4, "leak_cool": 1e-4, "bias_mixed": 0.0, "bias_supply": 0.0, "T_cold": 6.5, "T_hot": 80.0,
    "noise_mixed": 0.03, "noise_supply": 0.03, "sigma_h": 2e-3, "r": 0.03, "k_0": 7e-4, "k_h": 5e-4, "n_air": 30.0,
    "gamma_cool": 1.0, "gamma_heat": 1.0, "s_off": 0.15, "tau_c": 14400.0, "sigma_c": 3e-3, "f_fan": 2.2,
    "e_heat": 0.4,
}  # fmt: skip
START = {"n_cool": 3.0, "g": 0.01, "tau_s": 300.0, "tau_m": 300.0, "d_mid": 0.46, "d_width": 0.09}
WINDOWS = ((30, 15), (90, 30), (240, 80))  # length and stride [min]
STOP = 600.0  # s after the fan's stop in which a warm coil gives off what it holds
RATE = 1.0 / 365.0  # false alarms a day from each statistic
MODEL = air_handler()
FITTED = restrict(MODEL, fixed=HELD)  # fewer parameters, smaller kernel
SYMBOLS = MODEL.symbols["parameters"]


@dataclass(frozen=True)
class Verdict:
    """One day: gain of each hypothesis (log-likelihood), lowest condition of the cooling coil, and what they say."""

    day: str
    fan_hours: float
    gains: dict[str, float]
    condition: float
    limits: tuple[float, float]
    stop: dict[str, float] = field(default_factory=dict)

    @property
    def named(self) -> bool:
        """An alarm, and the leak explains it better than any other fault: in a window, or when the fan stops.

        A likelihood ratio beyond the number of values tried over ``RATE`` is chance no oftener than that (Ville).
        """
        tried = sum(map(len, hypotheses(START).values()))
        at_stop = self.stop.get("leak_heat", 0.0)
        warm = at_stop > np.log(tried / RATE) and at_stop == max(self.stop.values())
        return self.leaks or (self.short and warm)

    @property
    def leaks(self) -> bool:
        """The leak explains a window better than any other fault, and by more than on healthy days."""
        return self.gains["leak_heat"] > self.limits[0] and self.gains["leak_heat"] == max(self.gains.values())

    @property
    def short(self) -> bool:
        """The cooling coil does less than on any healthy day: it works against a leak, or is short of cold water."""
        return self.condition < self.limits[1]

    @property
    def words(self) -> str:
        """What a technician would be told."""
        if self.named:
            return "heating valve leaks" + (", cooling works against it" if self.short else "")
        return "cooling short: heating valve leaks or cold water lacks" if self.short else "quiet"


def data_file() -> Path:
    """The measured set, outside the project."""
    root = Path(os.environ.get("FDD_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    return root / "data" / "lbnl_mzvav_2_1.csv.gz"


def load(path: Path) -> dict[str, Data]:
    """One record a day; deg F to degC, zeros in deg F are dropouts."""
    table = pd.read_csv(path)
    table.columns = pd.Index([c.strip().removeprefix("AHU: ") for c in table.columns])
    time = pd.to_datetime(table["Datetime"])
    celsius = {
        c: ((table[c].where(table[c] != 0) - 32) / 1.8).where(lambda v: (v > -30) & (v < 60))
        for c in (
            "Supply Air Temperature",
            "Outdoor Air Temperature",
            "Mixed Air Temperature",
            "Return Air Temperature",
        )
    }
    fan = table["Supply Air Fan Speed Control Signal"] * table["Supply Air Fan Status"]
    inputs = pd.DataFrame(
        {
            "T_out": celsius["Outdoor Air Temperature"].ffill(),
            "T_return": celsius["Return Air Temperature"].ffill(),
            "damper": table["Outdoor Air Damper Control Signal"],
            "fan": fan,
            "cool": table["Cooling Coil Valve Control Signal"],
            "heat": table["Heating Coil Valve Control Signal"],
        }
    )
    outputs = pd.DataFrame({"m": celsius["Mixed Air Temperature"], "s": celsius["Supply Air Temperature"]})
    days = time.dt.strftime("%Y-%m-%d")
    return {
        str(day): Data(
            (time[rows] - time[rows].iloc[0]).dt.total_seconds().to_numpy(),
            inputs[rows].to_numpy(),
            outputs[rows].to_numpy(),
            name=str(day),
        )
        for day, rows in ((d, days == d) for d in days.unique())
    }


def baseline(records: Sequence[Data], start: dict[str, float] | None = None) -> dict[str, float]:
    """Parameters from fault-free days."""
    return HELD | dict(fit(FITTED, list(records), start=start or START, errors="fisher").params)


def hypotheses(p: dict[str, float]) -> dict[str, list[float]]:
    """Values of one parameter at a time that a fault would give it."""
    return {
        "leak_heat": [0.01, 0.04, 0.1, 0.25, 0.6],
        "leak_cool": [0.03, 0.1, 0.3],
        "n_cool": [p["n_cool"] * f for f in (0.1, 0.25, 0.5)],
        "g": [p["g"] * 0.3],
        "d_mid": [p["d_mid"] + d for d in (-0.3, -0.15, 0.15, 0.3)],
        "bias_mixed": [-3.0, -1.0, 1.0, 3.0],
        "bias_supply": [-3.0, -1.0, 1.0, 3.0],
    }


def gains(record: Data, p: dict[str, float]) -> dict[str, float]:
    """Largest gain in log-likelihood of every hypothesis over all windows of a day."""
    values = np.array([p[s] for s in SYMBOLS])
    path = Likelihood(MODEL, record).paths(values)[0]
    best = dict.fromkeys(hypotheses(p), 0.0)
    for length, stride in WINDOWS:
        for a in range(30, len(record) - length, stride):
            part = slice(a, a + length)
            piece = Data(record.t[part], record.u[part], record.y[part], x0=path.x[a], P0=path.P[a])
            if not np.isfinite(piece.y).any(axis=0).all():
                continue
            raise_gains(best, piece, p)
    return best


def raise_gains(best: dict[str, float], piece: Data, p: dict[str, float]) -> None:
    """Raise each hypothesis' gain to what it has over no fault in one piece of a record."""
    likelihood = Likelihood(MODEL, piece)
    values = np.array([p[s] for s in SYMBOLS])
    none = likelihood.value(values)
    for symbol, tries in hypotheses(p).items():
        for value in tries:
            changed = values.copy()
            changed[SYMBOLS.index(symbol)] = value
            best[symbol] = max(best[symbol], none - likelihood.value(changed))


def gains_at_stop(record: Data, p: dict[str, float]) -> dict[str, float]:
    """Gain in log-likelihood of every hypothesis over the minutes after the fan's last stop; none without a stop."""
    running = np.nonzero(record.u[:, 3] > 0)[0]
    if len(running) == 0 or running[-1] + 3 >= len(record) or running[-1] < 2:
        return {}
    first = int(running[-1]) - 1
    part = slice(first, int(np.searchsorted(record.t, record.t[running[-1] + 1] + STOP)))
    values = np.array([p[s] for s in SYMBOLS])
    path = Likelihood(MODEL, record).paths(values)[0]
    piece = Data(record.t[part], record.u[part], record.y[part], x0=path.x[first], P0=path.P[first])
    best = dict.fromkeys(hypotheses(p), 0.0)
    raise_gains(best, piece, p)
    return best


def condition(record: Data, p: dict[str, float]) -> float:
    """Lowest hourly mean of the coil's condition while it cools, an hour after the fan's start and later."""
    path = Likelihood(MODEL, record).paths(np.array([p[s] for s in SYMBOLS]))[0]
    running = pd.Series(record.u[:, 3] > 0).rolling(60, min_periods=60).min() == 1
    cooling = running.to_numpy() & (record.u[:, 4] > 0.15)
    c = pd.Series(np.where(cooling, path.xf[:, 3], np.nan)).rolling(60, min_periods=50).mean()
    return float(c.min()) if c.notna().any() else 0.0


def cut(record: Data, first: float = 6.5, last: float = 20.5) -> Data:
    """The same hours of every day, so that how long a fan ran cannot count."""
    rows = (record.t >= first * 3600) & (record.t < last * 3600)
    return Data(record.t[rows], record.u[rows], record.y[rows], name=record.name)


def limits_of(records: Sequence[Data], p: dict[str, float]) -> tuple[float, float]:
    """Limits of leak gain and coil condition from the days a baseline knows.

    Predictive limits for one more day like those known. The gain has an exponential tail (Wilks) whose scale, blown up
    by the model's error, comes from the days: P(next > g) = (1 + g / sum)^-n. The condition is normal, by Student's t
    over the days that cooled.
    """
    known = np.array([gains(r, p)["leak_heat"] for r in records])
    cooled = np.array([c for c in (condition(r, p) for r in records) if c != 0.0])
    spread = cooled.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(cooled))
    lowest = cooled.mean() + student.ppf(RATE, len(cooled) - 1) * spread
    return float(known.sum() * (RATE ** (-1.0 / len(known)) - 1.0)), float(lowest)


def verdict(record: Data, p: dict[str, float], limits: tuple[float, float], shorten: bool = False) -> Verdict:
    """One day under a baseline."""
    used = cut(record) if shorten else record
    hours = float((record.u[:, 3] > 0).sum()) / 60
    return Verdict(record.name, hours, gains(used, p), condition(used, p), limits, gains_at_stop(used, p))


def judge(records: dict[str, Data], folds: int, shorten: bool = False) -> list[Verdict]:
    """Every day's verdict; fault-free days by baselines that have not seen them."""
    normal = [d for d in records if d not in LEAK and d not in APART]
    verdicts: list[Verdict] = []
    start: dict[str, float] | None = None
    for k in range(folds + 1):
        held_out = normal[k::folds] if k < folds else []
        known = [records[d] for d in normal if d not in held_out]
        p = baseline(known, start)
        start = start or {s: v for s, v in p.items() if s not in HELD}
        limits = limits_of([cut(r) if shorten else r for r in known], p)
        verdicts += [verdict(records[d], p, limits, shorten) for d in (held_out if k < folds else [*LEAK, *APART])]
    return sorted(verdicts, key=lambda v: v.day)


def quick_judge(records: dict[str, Data]) -> list[Verdict]:
    """Three normal days by a baseline that has not seen them, the others by one that knows all normal days."""
    normal = [d for d in records if d not in LEAK and d not in APART]
    held_out = normal[1::4]
    verdicts: list[Verdict] = []
    start: dict[str, float] | None = None
    for days, judged in (([d for d in normal if d not in held_out], held_out), (normal, [*LEAK, *APART])):
        known = [records[d] for d in days]
        p = baseline(known, start)
        start = {s: v for s, v in p.items() if s not in HELD}
        limits = limits_of(known, p)
        verdicts += [verdict(records[d], p, limits) for d in judged]
    return sorted(verdicts, key=lambda v: v.day)


def table(verdicts: Sequence[Verdict]) -> str:
    """The day table as Markdown."""
    head = (
        "| day | truth | fan ran [h] | leak: gain (limit) | best other | cooling condition (limit) | "
        "fan stop: leak, best other | verdict |"
    )
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for v in verdicts:
        truth = f"leak {LEAK[v.day]}" if v.day in LEAK else "doubtful" if v.day in APART else "normal"
        other, gain = max(((s, g) for s, g in v.gains.items() if s != "leak_heat"), key=lambda item: item[1])
        stop = max(((g, s) for s, g in v.stop.items() if s != "leak_heat"), default=(0.0, "none"))
        lines.append(
            f"| {v.day} | {truth} | {v.fan_hours:.1f} | {v.gains['leak_heat']:.0f} ({v.limits[0]:.0f}) | "
            f"{other} {gain:.0f} | {v.condition:.2f} ({v.limits[1]:.2f}) | "
            f"{v.stop.get('leak_heat', 0.0):.0f}, {stop[1]} {stop[0]:.0f} | {v.words} |"
        )
    return "\n".join(lines)


def score(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Faulty days seen, faulty days whose valve is named, false alarms on normal days."""
    faulty = [v for v in verdicts if v.day in LEAK]
    normal = [v for v in verdicts if v.day not in LEAK and v.day not in APART]
    return {
        "seen": sum(v.leaks or v.short for v in faulty),
        "named": sum(v.named for v in faulty),
        "false": sum(v.leaks or v.short for v in normal),
        "faulty": len(faulty),
        "normal": len(normal),
    }


if __name__ == "__main__":
    days = load(data_file())
    for shorten in (False, True):
        found = judge(days, folds=10, shorten=shorten)
        print("Same hours of every day, 06:30 to 20:30:" if shorten else "Whole days:", score(found))
        print(table(found))
