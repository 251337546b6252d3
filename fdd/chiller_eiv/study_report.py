"""A study as one self-contained HTML page: tables and SVG plots, no scripts, nothing loaded from elsewhere."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from fdd.chiller_eiv.fit import ChillerFit
from fdd.chiller_eiv.forms import BASE
from fdd.chiller_eiv.study import StudyResult, date_of

SHOWN = {
    "dS": (1e-3, "kW/K"),
    "Q_leak": (1e-3, "kW"),
    "R": (1e3, "K/kW"),
    "R_flow": (1e3, "K/kW"),
    "dS_speed": (1e-3, "kW/K"),
}
"""How a parameter is shown: factor from SI, and unit."""


def write_html(result: StudyResult, path: Path) -> Path:
    """Write the page and return its path."""
    path.write_text(render(result), encoding="utf-8")
    return path


def render(result: StudyResult) -> str:
    """The page as text."""
    environment = Environment(
        loader=PackageLoader("fdd.chiller_eiv", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("study.html.j2").render(
        r=result,
        rejected=result.report.counts(),
        estimates=[_row(name, f) for name, f in result.fits.items()],
        parameters=[f"{p} [{SHOWN[p][1]}]" for p in result.decision.fit.form.parameters],
        measures=sorted(result.decision.measures.items()),
        weekly=[_week(v) for v in result.weekly],
        alarms=_alarms(result),
        plots={k: Markup(v) for k, v in plots(result).items()},
        span=(date_of(result.baseline.start), date_of(result.baseline.end), date_of(int(result.points.time[-1]))),
    )


def _row(name: str, fit: ChillerFit) -> dict[str, Any]:
    interval = fit.interval()
    cells = []
    for p in fit.form.parameters:
        factor, _ = SHOWN[p]
        if p in fit.held:
            cells.append(f"{fit.held[p] * factor:.4g} (held)")
            continue
        i = fit.parameters.index(p)
        cells.append(f"{fit.estimate[i] * factor:.4g} ({interval[i, 0] * factor:.4g} to {interval[i, 1] * factor:.4g})")
    note = "" if fit.positive_definite else "broke down: not positive definite"
    return {
        "name": name,
        "cells": cells,
        "residual": 100 * fit.residual_sd,
        "method": fit.interval_method,
        "note": note,
    }


def _week(v: Any) -> dict[str, Any]:
    return {
        "date": date_of(v.time),
        "points": v.week.points,
        "z": ", ".join("-" if not np.isfinite(z) else f"{z:+.1f}" for z in v.z),
        "statistic": ", ".join(f"{s:.1f}" for s in v.statistic),
        "limit": f"{v.limit[0]:.1f}",
        "alarm": v.alarm,
    }


def _alarms(result: StudyResult) -> list[str]:
    out = []
    first = next((v for v in result.states if v.alarm), None)
    if first is not None:
        out.append(f"steady states: {date_of(first.time - 1)}")
    first_week = next((v for v in result.weekly if v.alarm), None)
    if first_week is not None:
        out.append(f"parameters: week ending {date_of(first_week.time)}")
    return out


def plots(result: StudyResult) -> dict[str, str]:
    """SVG plots by title."""
    out = {"Steady points: power over load": _svg(_points_figure(result))}
    out["Power residual, and the chart of steady states"] = _svg(_residual_figure(result))
    if result.weekly:
        out["Weekly parameters"] = _svg(_weekly_figure(result))
    return out


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "fdd", "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _points_figure(result: StudyResult) -> Figure:
    x, _ = result.points.regressors(result.config.instruments, BASE)
    figure = Figure(figsize=(7.5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    shown = axes.scatter(x[:, 2] / 1e3, x[:, 3] / 1e3, c=x[:, 0] - x[:, 1], s=9, cmap="viridis")
    axes.set(xlabel="load [kW]", ylabel="power [kW]")
    figure.colorbar(shown, label="T_cdi - T_chi [K]")
    return figure


def _dates(times: Any) -> Any:
    return np.asarray(times, dtype="int64").astype("datetime64[ns]")


def _residual_figure(result: StudyResult) -> Figure:
    figure = Figure(figsize=(7.5, 4.4), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    power = result.points.raw["power"] - result.baseline.vector.layout.auxiliary
    top.plot(_dates(result.points.time), 100 * (power / result.expected - 1), ".", ms=3)
    top.axvline(_dates(result.baseline.end), color="k", lw=0.8, ls=":")
    top.set(ylabel="power residual [%]")
    if result.states:
        times = _dates([v.time for v in result.states])
        bottom.plot(times, [v.statistic for v in result.states], ".-", ms=3)
        bottom.axhline(result.states[0].limit, color="tab:red", lw=1)
    bottom.set(ylabel="log evidence")
    bottom.tick_params(axis="x", rotation=30)
    return figure


def _weekly_figure(result: StudyResult) -> Figure:
    names = result.baseline.drift.parameters if result.baseline.drift is not None else ()
    figure = Figure(figsize=(7.5, 2.2 * len(names)), layout="constrained")
    for i, p in enumerate(names):
        axes = figure.add_subplot(len(names), 1, i + 1)
        factor, unit = SHOWN[p]
        value = np.array([v.week.estimate[i] for v in result.weekly]) * factor
        error = 1.96 * np.array([v.week.se[i] for v in result.weekly]) * factor
        axes.errorbar(_dates([v.time for v in result.weekly]), value, error, fmt="o", ms=3, lw=1)
        assert result.baseline.drift is not None
        axes.axhline(result.baseline.drift.estimate[i] * factor, color="k", lw=0.8)
        axes.set(ylabel=f"{p} [{unit}]")
        axes.tick_params(axis="x", rotation=30)
    return figure
