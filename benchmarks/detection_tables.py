"""What was found of the simulated house's faults, how soon, and how that compares with the theory of run lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.detection import COURSE, DAY, DAYS, HEALTHY, ONSET, STEP, WINDOW, Watched
from benchmarks.detection_theory import (
    Compared,
    compare,
    dispersion_delays,
    median,
    noise_delays,
    noisier,
    parameter_delays,
    shift_delays,
)
from fdd.greybox.scale import to_scale
from fdd.plant.district import TRUTH, models
from fdd.records import FloatArray
from fdd.service.monitoring.health_charts import KINDS

SURE = 3.0
"""A change of fewer standard errors over the whole watch is one that no chart can see."""
WATCHED = DAYS - ONSET


@dataclass(frozen=True)
class Row:
    """One fault at one size: of the runs without an earlier false alarm, found by each kind of chart, and named.

    ``named``: share of those found in which the parameter, refitted alone, explains most; ``scored``: by the sums of
    scores. Delays are medians [days], inf where fewer than half were found. ``errors``: the change in standard errors
    over the whole watch. ``own``: the faulty parameter's own chart on known parameters against theory.
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
    scored: float | None
    errors: float
    own: Compared

    @property
    def hidden(self) -> bool:
        """Whether no chart can see it."""
        return self.errors < SURE


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
    own = [
        r.streams.get(f"{key[1]}:score", np.inf) * STEP / DAY if "score" not in r.early else float("nan") for r in known
    ]
    theory = [parameter_delays(change, i, known[0].z.shape[1]) for i in information]
    return Row(
        *key,
        runs=int(np.isfinite(score).sum() + np.isinf(score).sum()),
        score_found=_found(score),
        score_delay=median(score),
        innovation_found=_found(plain),
        innovation_delay=median(plain),
        named=float(np.mean([r.named == key[1] for r in rang])) if rang else None,
        scored=float(np.mean([r.scored == key[1] for r in rang])) if rang else None,
        errors=abs(change) * float(np.sqrt(np.mean([i.sum() for i in information]))),
        own=compare(own, theory, WATCHED),
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


def _found(delay: FloatArray) -> float:
    kept = delay[~np.isnan(delay)]
    return float(np.isfinite(kept).mean()) if len(kept) else float("nan")


@dataclass(frozen=True)
class KindRow:
    """A fault of the plant at one severity, on known parameters: found by the charts of plant and model, how soon.

    ``chart``: the innovation chart that rang first, or the ``dispersion`` of the output whose noise has grown.
    ``shift`` and ``variance`` are those of the innovations, 0 and 1 without the fault; ``errors``: the difference of
    all innovations of a week from those without the fault, root of the sum of squares; ``own``: the chart's delay
    against theory.
    """

    component: str
    kind: str
    target: str
    size: float
    runs: int
    found: float
    delay: float
    model_found: float
    model_delay: float
    chart: str
    shift: float
    variance: float
    errors: float
    own: Compared

    @property
    def hidden(self) -> bool:
        """Whether no chart can see it."""
        return self.errors < SURE


def kind_rows(runs: Sequence[Watched]) -> list[KindRow]:
    """A row for each fault of the plant and severity, two for noise: what is meant for shifts, and for noise."""

    def key(r: Watched) -> tuple[str, str, str, float]:
        assert r.fault.plant is not None
        return r.fault.component, r.fault.name, r.fault.plant.target, r.fault.size

    known = [r for r in runs if r.fault.plant and r.baseline == "known"]
    healthy = {(r.fault.component, r.seed, r.life): r for r in known if r.fault.name == HEALTHY}
    order = sorted((r for r in known if r.fault.name != HEALTHY), key=key)
    table = []
    for k, group in groupby(order, key):
        same = list(group)
        twins = [healthy[k[0], r.seed, r.life] for r in same]
        table += [_kind_row(k, same, twins, chart) for chart in _charts(k, same)]
    return table


def _charts(key: tuple[str, str, str, float], runs: Sequence[Watched]) -> list[str]:
    """Whose delays are held against theory."""
    outputs = [q.symbol for q in models()[key[0]].outputs]
    first = [min((f"{q}:cusum" for q in outputs), key=lambda s: r.streams.get(s, np.inf)) for r in runs]
    chart = max(set(first), key=first.count)
    return [chart, f"{key[2].rpartition('.')[2]}:dispersion"] if key[1] == "noise" else [chart]


def _kind_row(key: tuple[str, str, str, float], runs: list[Watched], twins: list[Watched], chart: str) -> KindRow:
    outputs = [q.symbol for q in models()[key[0]].outputs]
    output, _, kind = chart.partition(":")
    at = outputs.index(output)
    courses = [r.course[:, at] - h.course[:, at] for r, h in zip(runs, twins, strict=True)]
    own = [r.streams.get(chart, np.inf) * STEP / DAY if kind not in r.early else float("nan") for r in runs]
    plant, model = (np.array([r.delay(*kinds) for r in runs]) for kinds in (("score", "cusum"), KINDS))
    apart = [np.nansum(np.square(r.course - h.course)) for r, h in zip(runs, twins, strict=True)]
    return KindRow(
        *key,
        runs=len(runs),
        found=_found(plant),
        delay=median(plant),
        model_found=_found(model),
        model_delay=median(model),
        chart=chart,
        shift=float(np.nanmean(np.concatenate(courses))),
        variance=_variance(key, courses),
        errors=float(np.sqrt(np.mean(apart))),
        own=_against_theory(key, kind, own, courses, [r.spread[:, at] for r in runs], len(outputs)),
    )


def _variance(key: tuple[str, str, str, float], courses: Sequence[FloatArray]) -> float:
    return noisier(np.concatenate(courses), key[3]) if key[1] == "noise" else 1.0


def _against_theory(
    key: tuple[str, str, str, float],
    kind: str,
    own: Sequence[float],
    courses: Sequence[FloatArray],
    spreads: Sequence[FloatArray],
    outputs: int,
) -> Compared:
    """Noise by its variance, over the whole watch; all else by its course, as far as that is kept."""
    if key[1] != "noise":
        return compare(own, [shift_delays(c, outputs) for c in courses], COURSE * STEP / DAY)
    variance = _variance(key, courses)
    if kind == "dispersion":
        theory = [dispersion_delays(variance, s[0], s[1], WINDOW) for s in spreads]
    else:
        theory = [noise_delays(variance, round(WATCHED * DAY / STEP), outputs)] * len(own)
    return compare(own, theory, WATCHED)


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
        at.plot(x, [r.own.theory for r in own], color="#555", lw=1.2, label="theory, own chart")
        at.plot(x, [r.own.measured for r in own], "o", ms=4, color="#1d6b4f", label="measured, own chart")
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
