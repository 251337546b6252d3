"""Plots of fits: one page of residual diagnostics, profile likelihoods; HTML that needs nothing but a browser."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from fdd.greybox.validate import GROUPS, Validation, signals

if TYPE_CHECKING:
    from fdd.greybox.inference import Profile

FloatArray = NDArray[np.float64]


def diagnostics(v: Validation) -> Figure:
    """One page of each output: prediction, residuals, autocorrelation, periodogram, lag dependence, quantiles.

    Below them the residuals against every input and predicted output.
    """
    outputs = v.result._model().outputs
    held_against = signals(v.result, v.data, v.path)
    across = 4 if len(held_against) <= 4 else 6  # plots in a row
    more = math.ceil(len(held_against) / across)
    heights = [1.4, 1.4, *[1.1] * more] * len(outputs)
    figure = Figure(figsize=(16, 1.9 * sum(heights)), layout="constrained")
    grid = figure.add_gridspec(len(heights), 12, height_ratios=heights)
    wide, narrow = 4, 12 // across
    for j, q in enumerate(outputs):
        top = j * (2 + more)
        main = [figure.add_subplot(grid[top + i // 3, wide * (i % 3) : wide * (i % 3 + 1)]) for i in range(6)]
        _output(main, v, j, q.symbol, q.unit)
        for i, (name, unit, signal) in enumerate(held_against):
            left = narrow * (i % across)
            a = figure.add_subplot(grid[top + 2 + i // across, left : left + narrow])
            _against(a, v.path.standardised[1:, j], f"{name} [{unit}]", signal)
            a.set_ylabel("residual" if i % across == 0 else "", fontsize=8)
    return figure


def _against(a: Axes, z: FloatArray, name: str, signal: FloatArray) -> None:
    """Residuals over a signal, with the means of the groups that the test compares."""
    ok = np.isfinite(z) & np.isfinite(signal)
    order = np.argsort(signal[ok], kind="stable")
    a.plot(signal[ok], z[ok], ".", ms=1.5, color="0.6")
    groups = [(signal[ok][g].mean(), z[ok][g].mean()) for g in np.array_split(order, GROUPS) if len(g)]
    a.plot(*zip(*groups, strict=True), "o-", ms=3, lw=0.8, color="C1")
    a.axhline(0.0, color="C3", lw=0.7, ls="--")
    a.set_ylim(-4, 4)
    a.set_xlabel(name, fontsize=8)
    a.tick_params(labelsize=7)


def _output(axes: Sequence[Axes], v: Validation, j: int, symbol: str, unit: str) -> None:
    hours = np.ptp(v.data.t) > 7200
    t = (v.data.t - v.data.t[0]) / 3600 if hours else v.data.t
    z, curve = v.path.standardised[:, j], v.curves[symbol]
    title = [f"{symbol}: one-step prediction", "standardised residual", "autocorrelation", "cumulated periodogram"]
    title += ["lag dependent function", "normal quantiles"]
    for a, text in zip(axes, title, strict=True):
        a.set_title(text, fontsize=10)
    simulated = v.result.simulate(v.data)[:, j]
    for a in axes[:2]:
        a.set_xlabel("time from the first sample [h]" if hours else "time [s]")
    axes[0].plot(t, v.data.y[:, j], ".", ms=2, color="0.4", label="measured")
    axes[0].plot(t, v.path.predicted[:, j], lw=0.8, label="one step")
    axes[0].plot(t, simulated, lw=0.8, label="simulated")
    axes[0].set_ylabel(f"{symbol} [{unit}]")
    axes[0].legend(fontsize=8)
    axes[1].plot(t, z, ".", ms=2)
    for level in (-1.96, 1.96):
        axes[1].axhline(level, color="C3", lw=0.7, ls="--")
    _stems(axes[2], curve["acf"][1:], curve["band"])
    axes[3].plot(curve["frequency"], curve["cumulated"])
    line = curve["frequency"] / curve["frequency"][-1]
    for shift in (-curve["ks"], curve["ks"]):
        axes[3].plot(curve["frequency"], line + shift, color="C3", lw=0.7, ls="--")
    axes[3].set_ylim(0, 1)
    axes[3].set_xlabel("cycles a sample")
    _stems(axes[4], curve["ldf"], curve["ldf_limit"])
    ordered = np.sort(z[np.isfinite(z)])
    axes[5].plot(stats.norm.ppf((np.arange(len(ordered)) + 0.5) / len(ordered)), ordered, ".", ms=2)
    axes[5].set_xlabel("normal distribution")
    axes[5].plot([-3, 3], [-3, 3], color="C3", lw=0.7)


def _stems(a: Axes, values: FloatArray, band: float) -> None:
    a.bar(np.arange(1, len(values) + 1), values, width=0.3)
    for level in (-band, band):
        a.axhline(level, color="C3", lw=0.7, ls="--")
    a.set_xlabel("lag [samples]")


def profile(p: Profile) -> Figure:
    """The profile likelihood of one parameter with its interval."""
    figure = Figure(figsize=(5, 3.5), layout="constrained")
    a = figure.subplots()
    a.plot(p.values, p.drop, "o-", ms=3)
    a.axhline(p.threshold, color="C3", lw=0.7, ls="--")
    for edge in p.interval:
        if np.isfinite(edge):
            a.axvline(edge, color="C3", lw=0.7, ls=":")
    a.set_xlabel(f"{p.parameter} [{p.unit}]")
    a.set_ylabel("twice the loss of log-likelihood")
    return figure


def png(figure: Figure) -> str:
    """A figure as a data address for HTML."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=90)
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()


def html(v: Validation) -> str:
    """The whole validation as one HTML page: summary, verdict table, plots."""
    rows = "".join(
        f"<tr class={'ok' if w.passed else 'bad'}><td>{escape(w.test)}<td>{escape(w.about)}<td>{_number(w.statistic)}"
        f"<td>{_number(w.limit)}<td>{_number(w.p)}<td>{'pass' if w.passed else 'FAIL'}<td>{escape(w.remark)}"
        for w in v.verdicts
    )
    failed = sum(not w.passed for w in v.verdicts)
    verdict = "every test passed" if not failed else f"{failed} of {len(v.verdicts)} tests failed"
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        f"<title>{escape(v.result.model_name)}: validation</title><style>body{{font:14px sans-serif;margin:2em;"
        "max-width:75em}table{border-collapse:collapse}td,th{padding:.2em .7em;text-align:left;"
        "border-bottom:1px solid #ddd}.bad{background:#fde7e7}img{max-width:100%}</style>"
        f"<h1>{escape(v.result.model_name)}: {verdict}</h1><pre>{escape(v.result.summary())}</pre>"
        "<table><tr><th>test<th>of<th>statistic<th>limit<th>p<th>verdict<th>remark" + rows + "</table>"
        f'<img alt="residual diagnostics" src="{png(diagnostics(v))}"></html>'
    )


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""


def write_html(v: Validation, path: Path) -> None:
    """Write the validation page."""
    path.write_text(html(v), encoding="utf-8")
