"""What was found of the simulated house's faults, how soon, and how that compares with the theory of run lengths.

Theory takes the shift that the filter's own information predicts for a parameter's change, block by block, and runs the
designed CUSUM on independent normal values with that mean: nothing of the filter's innovations enters. For faults that
are no change of one parameter the shift is the difference of the innovations from those of the same house without the
fault, under the same weather and noise, sample by sample; the CUSUM runs on independent normal values with that mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.detection import BLOCK, COURSE, DAY, DAYS, HEALTHY, ONSET, RATE, STEP, Watched
from fdd.greybox.likelihood import to_scale
from fdd.plant.district import TRUTH, models
from fdd.records import FloatArray
from fdd.residual_monitors.budget import YEAR
from fdd.residual_monitors.run_length import limit_for

K = 0.5
REPEATS = 400
SETTLED = 40
"""Blocks of a healthy chart before the fault, in theory."""
SURE = 3.0
"""A change of fewer standard errors over the whole watch is one that no chart can see."""
BLOCK_DAYS = BLOCK * STEP / DAY
WATCHED = DAYS - ONSET


@dataclass(frozen=True)
class Row:
    """One fault at one size: of the runs without an earlier false alarm, found by each kind of chart, and named.

    Delays are medians [days], inf where fewer than half were found. ``errors``: the change in standard errors over the
    whole watch. ``theory``: median delay of the faulty parameter's own chart, ``own`` as it was on known parameters.
    """

    component: str
    name: str
    size: float
    runs: int
    score_found: float
    score_delay: float
    innovation_found: float
    innovation_delay: float
    named: float | None
    errors: float
    own: float
    theory: float

    @property
    def hidden(self) -> bool:
        """Whether no chart can see it."""
        return self.errors < SURE

    @property
    def ratio(self) -> float:
        """Measured over theoretical delay."""
        return self.own / self.theory if np.isfinite(self.theory) else float("nan")


def rows(runs: Sequence[Watched]) -> list[Row]:
    """A row for each parameter fault and size."""

    def key(r: Watched) -> tuple[str, str, float]:
        return r.fault.component, r.fault.name, r.fault.size

    order = [r for r in runs if r.fault.symbol]
    return [_row(k, list(group)) for k, group in groupby(sorted(order, key=key), key)]


def _row(key: tuple[str, str, float], runs: list[Watched]) -> Row:
    fitted, known = ([r for r in runs if r.baseline == b] for b in ("fitted", "known"))
    score, plain = (np.array([r.delay(kind) for r in fitted]) for kind in ("score", "cusum"))
    rang = [r for r, d in zip(fitted, score, strict=True) if np.isfinite(d)]
    change = _change(*key)
    information = [_information(r) for r in known]
    own = np.array([r.streams.get(f"{key[1]}:score", np.inf) * STEP / DAY for r in known if "score" not in r.early])
    return Row(
        *key,
        runs=int(np.isfinite(score).sum() + np.isinf(score).sum()),
        score_found=_found(score),
        score_delay=_median(score),
        innovation_found=_found(plain),
        innovation_delay=_median(plain),
        named=float(np.mean([r.named == key[1] for r in rang])) if rang else None,
        errors=abs(change) * float(np.sqrt(np.mean([i.sum() for i in information]))),
        own=_median(own),
        theory=theoretical(change, information, known[0].z.shape[1]),
    )


def _change(component: str, symbol: str, size: float) -> float:
    """A parameter's change on the scale it is estimated on."""
    q = next(p for p in models()[component].parameters if p.symbol == symbol)
    true = TRUTH[component][symbol]
    return to_scale(q, true * (1 - size)) - to_scale(q, true)


def _information(run: Watched) -> FloatArray:
    """Of the faulty parameter, block by block after the onset."""
    component = models()[run.fault.component]
    symbols = [p.symbol for p in component.parameters if p.kind == "physical"]
    return np.asarray(run.information[:, symbols.index(run.fault.symbol)])


def theoretical(change: float, information: Sequence[FloatArray], charts: int) -> float:
    """Median delay of a parameter's CUSUM over blocks after a change [days]; inf beyond the watch."""
    h = float(limit_for("cusum", YEAR / STEP / RATE * charts / BLOCK, k=K))
    delays = [_first_alarms(change * np.sqrt(own), h, SETTLED) for own in information]
    return _median(np.concatenate(delays) * BLOCK_DAYS)


def _first_alarms(shift: FloatArray, h: float, settled: int) -> FloatArray:
    """Updates after the onset to the alarm of a CUSUM on normal values with these means; those before it left out."""
    rng = np.random.default_rng(17)
    whole = np.concatenate([np.zeros(settled), shift])
    upper, lower, first = np.zeros(REPEATS), np.zeros(REPEATS), np.full(REPEATS, np.inf)
    for t, mean in enumerate(whole):
        values = rng.standard_normal(REPEATS) + mean
        upper, lower = np.maximum(0.0, upper + values - K), np.maximum(0.0, lower - values - K)
        first[np.isinf(first) & (np.maximum(upper, lower) > h)] = t - settled + 1
    return first[first > 0]


def _found(delay: FloatArray) -> float:
    kept = delay[~np.isnan(delay)]
    return float(np.isfinite(kept).mean()) if len(kept) else float("nan")


def _median(delay: FloatArray) -> float:
    """Not interpolated, since infinity is among the values; ``inf`` where fewer than half were found."""
    kept = np.sort(delay[~np.isnan(delay)])
    return float(kept[(len(kept) - 1) // 2]) if len(kept) else float("nan")


@dataclass(frozen=True)
class KindRow:
    """A fault of the plant at one severity: the innovation chart that rang first, its mean shift, delay and theory."""

    component: str
    kind: str
    target: str
    size: float
    runs: int
    found: float
    delay: float
    chart: str
    shift: float
    own: float
    theory: float

    @property
    def ratio(self) -> float:
        """Measured over theoretical delay."""
        return self.own / self.theory if np.isfinite(self.theory) else float("nan")


def kind_rows(runs: Sequence[Watched]) -> list[KindRow]:
    """A row for each fault of the plant and severity, on known parameters."""

    def key(r: Watched) -> tuple[str, str, str, float]:
        assert r.fault.plant is not None
        return r.fault.component, r.fault.name, r.fault.plant.target, r.fault.size

    known = [r for r in runs if r.fault.plant and r.baseline == "known"]
    healthy = {(r.fault.component, r.seed): r for r in known if r.fault.name == HEALTHY}
    order = sorted((r for r in known if r.fault.name != HEALTHY), key=key)
    return [_kind_row(k, list(group), healthy) for k, group in groupby(order, key)]


def _kind_row(
    key: tuple[str, str, str, float], runs: list[Watched], healthy: Mapping[tuple[str, int], Watched]
) -> KindRow:
    delay = np.array([min(r.delay("score"), r.delay("cusum")) for r in runs])
    outputs = [q.symbol for q in models()[key[0]].outputs]
    first = [min((f"{q}:cusum" for q in outputs), key=lambda s: r.streams.get(s, np.inf)) for r in runs]
    chart = max(set(first), key=first.count)
    at = outputs.index(chart.partition(":")[0])
    # Within the first week, which is as far as the course of the shift is kept.
    own = np.array([r.streams.get(chart, np.inf) for r in runs if not r.early])
    own = np.where(own <= COURSE, own, np.inf) * STEP / DAY
    courses = [r.course[:, at] - healthy[key[0], r.seed].course[:, at] for r in runs]
    shift = float(np.nanmean(np.concatenate(courses)))
    theory = shifted(courses, len(outputs))
    return KindRow(*key, len(runs), _found(delay), _median(delay), chart, shift, _median(own), theory)


def shifted(courses: Sequence[FloatArray], charts: int) -> float:
    """Median delay of an innovation CUSUM to shifts that take these courses [days]; inf beyond them."""
    h = float(limit_for("cusum", YEAR / STEP / RATE * charts, k=K))
    return _median(np.concatenate([_first_alarms(np.nan_to_num(c), h, SETTLED) for c in courses]) * STEP / DAY)


def plot(table: Sequence[Row], path: Path) -> None:
    """Delay against severity for every parameter: measured (points), theory (line)."""
    from matplotlib.figure import Figure

    names = sorted({(r.component, r.name) for r in table})
    across = 4
    figure = Figure(figsize=(11, 2.3 * -(-len(names) // across)), layout="constrained")
    axes = figure.subplots(-(-len(names) // across), across, sharex=True, sharey=True).ravel()
    for at, (component, name) in zip(axes, names, strict=False):
        own = [r for r in table if (r.component, r.name) == (component, name)]
        x = [100 * r.size for r in own]
        at.plot(x, [r.theory for r in own], color="#555", lw=1.2, label="theory, own chart")
        at.plot(x, [r.own for r in own], "o", ms=4, color="#1d6b4f", label="measured, own chart")
        at.plot(x, [r.score_delay for r in own], "-", lw=0.8, color="#1f77b4", label="first score chart, fitted")
        at.plot(x, [r.innovation_delay for r in own], "--", lw=0.8, color="#d2691e", label="innovation charts, fitted")
        hidden = [100 * r.size for r in own if r.hidden]
        at.plot(hidden, [WATCHED] * len(hidden), "x", ms=4, color="#b22222", label="no chart can see it")
        at.set_yscale("log")
        at.set_yticks([1 / 24, 0.25, 1, 4, 16], ["1 h", "6 h", "1 d", "4 d", "16 d"])
        at.minorticks_off()
        at.set_title(f"{component}: {name}", fontsize=9)
        at.grid(alpha=0.3)
    for at in axes[len(names) :]:
        at.set_axis_off()
    handles: dict[str, Any] = {}
    for at in axes[: len(names)]:
        handles |= dict(zip(*reversed(at.get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles.keys(), loc="lower right", fontsize=9)
    figure.supxlabel("parameter lower by [%]", fontsize=9)
    figure.supylabel("median delay", fontsize=9)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
