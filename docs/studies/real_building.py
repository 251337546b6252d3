"""Remake the study of a real building: python docs/studies/real_building.py

Reads data that are not shipped: set FDD_SHARED to the folder that holds ``data/``. Writes the plots beside this file
and the tables of ``real-building.md`` between their markers. Faults are made in copies in a temporary folder.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from rich.console import Console
from scipy.stats import kurtosis

from fdd.evidence import ChartEvidence
from fdd.greybox.likelihood import Data
from fdd.greybox.validate import autocorrelation, cumulated_periodogram, kolmogorov_band
from fdd.records import NANOSECONDS, Alarm, FloatArray
from fdd.service.baselines.fitting import Fitted, fit_site, read_span
from fdd.service.baselines.identify import healthy_steps
from fdd.service.site.site_context import open_site
from fdd.service.verbs.replay import ReplayResult, replay_site

HERE = Path(__file__).resolve().parent
PAGE, SITE = HERE / "real-building.md", HERE / "real-building.yaml"
MEASURED = Path(os.environ.get("FDD_SHARED", HERE.parents[2] / "shared")) / "data" / "flexhouse_prbs_5min.csv"
SPLIT = "2009-02-09"
START_UP = pd.Timedelta("12h")
# After the alarm of the first monitored morning, and with a day of data left to see the fault in.
ONSETS = pd.date_range("2009-02-09 12:00", "2009-02-10 09:00", freq="3h")
SHOWN = pd.Timestamp("2009-02-09 18:00")
WATCH = pd.Timedelta("24h")
BLUE, ORANGE, RED, GREY = "#1f6fb4", "#e08214", "#c0392b", "#8a8a8a"
# Two independent programs over the whole record, in the page's units (C in kWh/K, R in K/kW).
OTHERS = {"C_i": 1.0687, "C_e": 2.8959, "R_ie": 0.85629, "R_ea": 4.6131, "A_w": 6.1041}
KWH = {"J/K": (1 / 3.6e6, "kWh/K"), "K/W": (1e3, "K/kW")}
QUIET = Console(file=io.StringIO())

Change = Callable[[pd.DataFrame, "pd.Series[bool]", "pd.Series[float]"], None]


def _stuck(data: pd.DataFrame, on: pd.Series[bool], days: pd.Series[float]) -> None:
    data.loc[on, "yTi"] = data.loc[on, "yTi"].iloc[0]


def _bias(kelvin: float) -> Change:
    def change(data: pd.DataFrame, on: pd.Series[bool], days: pd.Series[float]) -> None:
        data.loc[on, "yTi"] += kelvin

    return change


def _drift(kelvin_a_day: float) -> Change:
    def change(data: pd.DataFrame, on: pd.Series[bool], days: pd.Series[float]) -> None:
        data.loc[on, "yTi"] += kelvin_a_day * days[on]

    return change


def _heater(share: float) -> Change:
    def change(data: pd.DataFrame, on: pd.Series[bool], days: pd.Series[float]) -> None:
        data.loc[on, "Ph"] /= share

    return change


def _nothing(data: pd.DataFrame, on: pd.Series[bool], days: pd.Series[float]) -> None:
    pass


FAULTS: dict[str, Change] = {
    "none": _nothing,
    "indoor sensor stuck": _stuck,
    "bias +0.1 K": _bias(0.1),
    "bias +0.5 K": _bias(0.5),
    "bias -0.5 K": _bias(-0.5),
    "bias +1 K": _bias(1.0),
    "drift +1 K a day": _drift(1.0),
    "drift +3 K a day": _drift(3.0),
    "heater gives 20 % less than metered": _heater(0.8),
}


@dataclass(frozen=True)
class Study:
    """The measured data, and a folder for site files, stores and faulty copies."""

    data: pd.DataFrame
    folder: Path

    def site(self, nodes: str, start: dict[str, float]) -> Path:
        """The site file with these nodes and start values, its store in the folder."""
        table = yaml.safe_load(SITE.read_text(encoding="utf-8"))
        table["equipment"]["house"]["options"]["nodes"] = nodes
        table["equipment"]["house"]["parameters"] = start
        table["store"]["path"] = f"{nodes}.sqlite"
        path = self.folder / f"{nodes}.yaml"
        path.write_text(yaml.safe_dump(table), encoding="utf-8")
        return path

    def fit(self, nodes: str, **start: float) -> Fitted:
        """``fdd fit`` on the first part."""
        return fit_site(
            self.site(nodes, start), MEASURED, since=None, until=SPLIT, only=None, html=None, starts=3, console=QUIET
        )[0]

    def faulty(self, fault: str, onset: pd.Timestamp) -> pd.DataFrame:
        """A copy of the data with a fault from ``onset`` on."""
        data = self.data.copy()
        days = (data["TimeDate"] - onset) / pd.Timedelta("1D")
        FAULTS[fault](data, days >= 0, days)
        return data

    def replay(
        self, data: pd.DataFrame, since: pd.Timestamp | None = None, until: pd.Timestamp | None = None
    ) -> tuple[ReplayResult, pd.DataFrame]:
        """``fdd replay``: what it found, and every chart's statistic over its limit, a column each."""
        path, verdicts = self.folder / "replayed.csv", self.folder / "verdicts.jsonl"
        data.to_csv(path, index=False)
        found = replay_site(
            self.folder / "TiTeTh.yaml",
            path,
            since=None if since is None else since.isoformat(),
            until=None if until is None else until.isoformat(),
            verdicts=verdicts,
            console=QUIET,
        )
        rows = [json.loads(line) for line in verdicts.read_text(encoding="utf-8").splitlines()]
        table = pd.DataFrame([r for r in rows if "chart" in r and r["phase"] != "no_data"])
        table["ratio"] = table["statistic"] / table["limit"]
        table["time"] = _local(pd.to_datetime(table["time"]))
        return found, table.pivot(index="time", columns="chart", values="ratio")


def _local(times: Any) -> Any:
    series = pd.Series(times)
    return series.dt.tz_convert("Europe/Copenhagen").dt.tz_localize(None).to_numpy()


def _moment(nanoseconds: int) -> pd.Timestamp:
    return pd.Timestamp(nanoseconds, unit="ns", tz="UTC").tz_convert("Europe/Copenhagen").tz_localize(None)


def _rms_mk(x: Any) -> float:
    return float(1e3 * np.sqrt(np.mean(np.square(np.asarray(x)))))


def _departure(z: FloatArray) -> float:
    """Largest distance of the cumulated periodogram from that of white noise."""
    frequency, power = cumulated_periodogram(z)
    return float(np.abs(power - 2 * frequency).max())


# Tables
def model_table(fits: dict[str, Fitted]) -> str:
    """One line a model."""
    rows = [
        "| nodes | parameters | log-likelihood | AIC | one-step error, rms | lag-one autocorrelation | "
        f"periodogram off the diagonal by (95 %: {kolmogorov_band(fits['Ti'].result.nobs, 0.05):.3f}) | warnings |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for nodes, f in fits.items():
        r, s = f.result, f.baseline.innovation["T_room"]
        error = _rms_mk(r.paths()[0].innovation[1:, 0])
        left = [f"{', '.join(r.at_bound)} at its bound"] if r.at_bound else []
        left += [f"{', '.join(r.unidentifiable)} not identified"] if r.unidentifiable else []
        left += ["innovations not white"] if any("not white" in w for w in f.warnings) else []
        left += ["scores vary more than the model says"] if any("scores vary" in w for w in f.warnings) else []
        rows.append(
            f"| {nodes} | {len(r.free)} | {r.llf:.1f} | {r.aic:.1f} | {error:.1f} mK | {s['lag1']:+.3f} | "
            f"{_departure(r.paths()[0].standardised[1:, 0]):.3f} | "
            f"{'; '.join(left) or '-'} |"
        )
    return "\n".join(rows)


def estimate_table(fitted: Fitted) -> str:
    """Estimates with standard errors, beside those of other programs."""
    result = fitted.result
    rows = ["| parameter | estimate | standard error | others, whole record |", "|---|---|---|---|"]
    for q in result._model().parameters:
        factor, unit = KWH.get(q.unit, (1.0, q.unit.replace("^0.5", "^½").replace("^2", "²")))
        value, error = factor * result.params[q.symbol], factor * result.bse[q.symbol]
        note = f"{error:.2g}"
        if q.symbol in result.at_bound:
            note = "at its bound"
        elif q.symbol in result.unidentifiable:
            note = "not identified"
        rows.append(f"| {q.symbol}, {q.meaning} | {value:.4g} {unit} | {note} | {OTHERS.get(q.symbol, '')} |")
    z = result.paths()[0].standardised[1:, 0]
    rho = autocorrelation(z, 48)[1:]
    bound = 1.96 / np.sqrt(len(z))
    worst = int(np.abs(rho).argmax())
    lag = result.params["C_h"] * result.params["R_ih"]
    outside = int((np.abs(rho) > bound).sum())
    rows += [
        "",
        f"C_h R_ih, the heater's time constant, is {lag / 60:.1f} min. {outside} of 48 autocorrelations lie outside "
        f"±{bound:.3f} (2 or 3 expected), the largest {rho[worst]:+.2f} at {5 * (worst + 1)} min.",
    ]
    return "\n".join(rows)


def _alarm_line(alarm: Alarm) -> str:
    charts = ", ".join(f"{c.symbol} {'up' if c.direction > 0 else 'down'}" for c in _charts(alarm))
    return f"since {_moment(alarm.since):%d %b %H:%M}, raised {_moment(alarm.raised):%H:%M} ({charts}), {alarm.state}"


def _charts(alarm: Alarm) -> list[ChartEvidence]:
    return list(alarm.evidence.charts.values())


def healthy_text(study: Study, everything: ReplayResult, frames: pd.DataFrame) -> str:
    """Alarms and innovations on the data as measured."""
    monitored, _ = study.replay(study.data, pd.Timestamp(SPLIT) - START_UP)
    lines = [
        "| replay of the data as measured | alarms |",
        "|---|---|",
        f"| everything, {everything.frames} frames | {_alarms(everything)} |",
        f"| charts judge from the first minute not fitted | {_alarms(monitored)} |",
        "",
        "| standardised innovations (1 promised) | frames | sd | beyond 3 | kurtosis above normal |",
        "|---|---|---|---|---|",
    ]
    z = frames["z"].dropna()
    sun = frames["solar"].reindex(z.index) > 100.0
    later = z.index >= pd.Timestamp(SPLIT)
    groups = {
        "fitted part": z[~later],
        "monitored part": z[later],
        "all, sun up to 100 W/m²": z[~sun],
        "all, sun above 100 W/m²": z[sun],
    }
    for name, part in groups.items():
        beyond = 100.0 * float((part.abs() > 3).mean())
        lines.append(
            f"| {name} | {len(part)} | {float(np.std(part)):.2f} | {beyond:.1f} % | {float(kurtosis(part)):.1f} |"
        )
    error = (frames["free"] - frames["indoor"])[frames.index >= pd.Timestamp(SPLIT)]
    lines += [
        "",
        f"Without looking at the sensor from {SPLIT} on, the model is off by {error.std():.2f} K rms around a mean of "
        f"{error.mean():+.2f} K over {len(error) / 12:.0f} h.",
    ]
    return "\n".join(lines)


def _alarms(found: ReplayResult) -> str:
    return "; ".join(_alarm_line(a) for a in found.alarms.values()) or "none"


def fault_table(study: Study) -> str:
    """Every fault at every onset: what was alarmed, by which chart, after how long."""
    rows = [
        f"| fault | alarmed within {WATCH / pd.Timedelta('1h'):.0f} h | delay: median (range) | first chart | "
        "parameter charts that follow | gone again | first cause named |",
        "|---|---|---|---|---|---|---|",
    ]
    for fault in FAULTS:
        found = []
        for onset in ONSETS:
            result, _ = study.replay(study.faulty(fault, onset), onset - START_UP, onset + WATCH)
            found += [(onset, a) for a in list(result.alarms.values())[:1]]
            print(f"{fault}, {onset:%d %b %H:%M}: {_alarms(result)}", file=sys.stderr)
        rows.append(f"| {fault} | {len(found)} of {len(ONSETS)} | " + " | ".join(_summary(found)) + " |")
    rows += ["", "Watched to the end of the record, from the first onset on:"]
    for fault in ("none", "drift +1 K a day", "drift +3 K a day"):
        result, _ = study.replay(study.faulty(fault, ONSETS[0]), ONSETS[0] - START_UP)
        rows.append(f"* {fault}: {_late(result)}")
    return "\n".join(rows)


def _late(result: ReplayResult) -> str:
    if not result.alarms:
        return "no alarm"
    alarm = next(iter(result.alarms.values()))
    after = (_moment(alarm.raised) - ONSETS[0]) / pd.Timedelta("1h")
    charts = ", ".join(f"{c.symbol} {'up' if c.direction > 0 else 'down'}" for c in _charts(alarm))
    return f"alarmed after {after:.0f} h by {charts}"


def _summary(found: list[tuple[pd.Timestamp, Alarm]]) -> list[str]:
    if not found:
        return ["-"] * 5
    delays = np.array([(_moment(a.raised) - onset) / pd.Timedelta("1h") for onset, a in found])
    first, later = Counter[str](), Counter[str]()
    for _, alarm in found:
        charts = sorted(_charts(alarm), key=lambda c: c.raised)
        for c in charts:
            name = f"{c.symbol} {'up' if c.direction > 0 else 'down'}"
            (first if c.raised == charts[0].raised else later)[name] += 1
    causes = Counter(str(a.causes[0].name) for _, a in found)
    gone = sum(str(a.state) == "returned to normal" for _, a in found)
    return [
        f"{_hours(np.median(delays))} ({_hours(delays.min())} to {_hours(delays.max())})",
        _counted(first),
        _counted(later) or "-",
        f"{gone} of {len(found)}",
        _counted(causes),
    ]


def _hours(value: float) -> str:
    return f"{60 * value:.0f} min" if value < 2 else f"{value:.1f} h"


def _counted(names: Counter[str]) -> str:
    return ", ".join(f"{name} ({n})" for name, n in names.most_common())


# Plots
def fit_figure(fits: dict[str, Fitted]) -> None:
    """Whiteness of the smallest and the largest model's innovations."""
    figure = Figure(figsize=(9.5, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for nodes, color in (("Ti", GREY), ("TiTe", ORANGE), ("TiTeTh", BLUE)):
        z = fits[nodes].result.paths()[0].standardised[1:, 0]
        lags = np.arange(1, 49)
        rho = autocorrelation(z, 48)[1:]
        left.plot(lags / 12, rho, color=color, marker=".", ms=4, lw=1, label=nodes)
        frequency, power = cumulated_periodogram(z)
        right.plot(12 * frequency, power, color=color, lw=1.5, label=nodes)
    bound = 1.96 / np.sqrt(len(z))
    left.axhspan(-bound, bound, color=BLUE, alpha=0.12, lw=0)
    left.set(xlabel="lag [h]", ylabel="autocorrelation", ylim=(-0.45, 1), xlim=(0, 4))
    band = kolmogorov_band(len(z), 0.05)
    line = np.array([0.0, 6.0])
    right.fill_between(line, line / 6 - band, line / 6 + band, color=BLUE, alpha=0.12, lw=0, label="95 % band, white")
    right.set(xlabel="frequency [1/h]", ylabel="cumulated periodogram", ylim=(0, 1), xlim=(0, 6))
    right.legend(frameon=False, loc="lower right")
    _save(figure, "fit")


def healthy_figure(frames: pd.DataFrame, charts: pd.DataFrame, found: ReplayResult) -> None:
    """Measured and predicted, inputs, innovations and charts over the whole record."""
    figure = Figure(figsize=(9.5, 8.2), layout="constrained")
    top, inputs, middle, bottom = figure.subplots(4, 1, sharex=True, height_ratios=(2.2, 1, 1.2, 1.5))
    split, x = pd.Timestamp(SPLIT), frames.index.to_numpy()
    top.plot(x, frames["indoor"], color="k", lw=1.8, label="measured")
    top.plot(x, frames["predicted"], color=BLUE, lw=0.9, label="predicted one step (5 min) ahead")
    free = frames["free"].where(frames.index >= split)
    top.plot(x, free, color=ORANGE, lw=1.2, label="simulated from 9 February on, sensor unseen")
    top.set_ylabel("indoor [°C]")
    top.legend(frameon=False, fontsize=8, loc="lower left")
    inputs.fill_between(x, frames["heater"] / 1e3, step="post", color=RED, alpha=0.35, lw=0)
    inputs.set_ylabel("heater [kW]", color=RED)
    sun = inputs.twinx()
    sun.plot(x, frames["solar"], color=ORANGE, lw=1.2)
    sun.set_ylabel("sun [W/m²]", color=ORANGE)
    sun.set_ylim(0, 400)
    sun.spines[["top"]].set_visible(False)
    middle.plot(x, frames["z"], ".", color=BLUE, ms=2.5)
    middle.axhspan(-3, 3, color=BLUE, alpha=0.1, lw=0)
    middle.set_ylabel("innovation\n[standard deviations]")
    _chart_axes(bottom, charts)
    for alarm in found.alarms.values():
        bottom.axvline(_moment(alarm.raised).to_numpy(), color=RED, lw=0.8)
    bottom.legend(frameon=False, fontsize=8, loc="upper left")
    for axes in (top, inputs, middle, bottom):
        axes.axvline(split.to_numpy(), color="k", lw=0.8, ls=":")
    top.set_title("fitted up to the dotted line, monitored after it", fontsize=9)
    _dates(bottom)
    _save(figure, "healthy")


def fault_figure(study: Study) -> None:
    """Four faults from one onset: what the sensor says, and the charts."""
    shown = ("indoor sensor stuck", "bias +1 K", "drift +1 K a day", "heater gives 20 % less than metered")
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    grid = figure.subplots(2, len(shown), sharex=True, sharey="row")
    start, end = SHOWN - pd.Timedelta("3h"), SHOWN + WATCH
    for column, fault in enumerate(shown):
        data = study.faulty(fault, SHOWN)
        found, charts = study.replay(data, SHOWN - START_UP, end)
        upper, lower = grid[:, column]
        for table, color, label in ((study.data, "k", "measured"), (data, RED, "as reported")):
            part = table[(table["TimeDate"] >= start) & (table["TimeDate"] < end)]
            upper.plot(part["TimeDate"].to_numpy(), part["yTi"], color=color, lw=1.3, label=label)
        upper.set_title(fault, fontsize=9)
        _chart_axes(lower, charts)
        for alarm in found.alarms.values():
            lower.axvline(_moment(alarm.raised).to_numpy(), color=RED, lw=0.8)
        for axes in (upper, lower):
            axes.axvline(SHOWN.to_numpy(), color="k", lw=0.8, ls=":")
        _dates(lower)
    grid[0, 0].set_ylabel("indoor [°C]")
    grid[0, 0].legend(frameon=False, fontsize=8)
    grid[1, 2].legend(frameon=False, fontsize=8, loc="upper left")
    for axes in grid[1, 1:]:
        axes.set_ylabel("")
    _save(figure, "faults")


def _chart_axes(axes: Axes, charts: pd.DataFrame) -> None:
    innovation = [c for c in charts.columns if c.endswith(":cusum")]
    scores = [c for c in charts.columns if c.endswith(":score")]
    axes.plot(charts.index.to_numpy(), charts[innovation].max(axis=1), color=BLUE, lw=1.2, label="innovation chart")
    axes.plot(
        charts.index.to_numpy(), charts[scores].max(axis=1), color=ORANGE, lw=1.2, label="parameter charts, largest"
    )
    axes.axhline(1.0, color=RED, lw=0.9, ls="--")
    axes.set_ylabel("statistic / limit")
    axes.set_ylim(0, 2.1)


def _dates(axes: Axes) -> None:
    axes.xaxis.set_major_locator(AutoDateLocator(minticks=3, maxticks=7))  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_formatter(ConciseDateFormatter(axes.xaxis.get_major_locator()))  # type: ignore[no-untyped-call]


def _save(figure: Figure, name: str) -> None:
    for axes in figure.axes:
        axes.spines["top"].set_visible(False)
    figure.savefig(HERE / f"real-building-{name}.png", dpi=90)


# The page
def frames_of(study: Study, fitted: Fitted) -> pd.DataFrame:
    """Every frame: measured, predicted, standardised innovation, and a simulation that never sees the second part."""
    context = open_site(study.folder / "TiTeTh.yaml", MEASURED)
    history = read_span(context, None, None)
    steps = healthy_steps(context.plan, context.plan.components[0], fitted.baseline, history)
    frames = pd.DataFrame(history.values, columns=list(history.columns))
    frames.index = pd.DatetimeIndex(_local(pd.to_datetime(history.time, utc=True)))
    frames["predicted"] = [s.predicted[0, 0] for s in steps]
    frames["z"] = [s.standardised[0, 0] for s in steps]
    y = frames["indoor"].where(frames.index < pd.Timestamp(SPLIT)).to_numpy()[:, None]
    blind = Data(
        t=(history.time - history.time[0]) / NANOSECONDS, u=frames[["outdoor", "solar", "heater"]].to_numpy(), y=y
    )
    frames["free"] = fitted.result.paths(blind)[0].predicted[:, 0]
    return frames


def write(tables: dict[str, str]) -> None:
    """Put every table between its markers.

    Raises
    ------
    ValueError : a marker is missing from the page
    """
    page = PAGE.read_text(encoding="utf-8")
    for name, text in tables.items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        pattern = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
        if not pattern.search(page):
            raise ValueError(f"{PAGE.name}: markers {start} and {end} are missing; put them back")
        before, after = pattern.split(page)
        page = f"{before}{start}\n{text}\n{end}{after}"
    PAGE.write_text(page, encoding="utf-8")


def main() -> None:
    """Fit, replay, plot, write."""
    if not MEASURED.is_file():
        sys.exit(f"{MEASURED.name} is not in {MEASURED.parent}; set FDD_SHARED to the folder that holds data/")
    with tempfile.TemporaryDirectory() as name:
        study = Study(pd.read_csv(MEASURED, parse_dates=["TimeDate"]), Path(name))
        fits = {nodes: study.fit(nodes) for nodes in ("Ti", "TiTe", "TiTh")}
        fits["TiTh, sigma_h from 0.1 on"] = study.fit("TiTh", sigma_h=0.1)
        fits["TiTeTh"] = study.fit("TiTeTh")
        frames = frames_of(study, fits["TiTeTh"])
        everything, charts = study.replay(study.data)
        fit_figure(fits)
        healthy_figure(frames, charts, everything)
        fault_figure(study)
        write(
            {
                "models": model_table(fits),
                "estimates": estimate_table(fits["TiTeTh"]),
                "healthy": healthy_text(study, everything, frames),
                "faults": fault_table(study),
            }
        )


if __name__ == "__main__":
    main()
