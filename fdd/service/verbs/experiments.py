"""``fdd experiment``: what to do with a plant for some days so that its parameters become visible."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from fdd.greybox.experiment import Design, Signal, candidates, d_optimal
from fdd.records import NANOSECONDS, FloatArray
from fdd.service.baselines.versions import in_force
from fdd.service.site.errors import UsageError
from fdd.service.site.plan import Component
from fdd.service.site.site_context import SiteContext, open_site
from fdd.units import UnitError, conversion, seconds


@dataclass(frozen=True)
class Proposal:
    """The best design found, and where it was written."""

    component: Component
    design: Design
    csv: Path
    plot: Path

    def story(self) -> str:
        """For people: what it promises."""
        lines = [f"{self.component.name}: largest cross-correlation of moved inputs {self.design.correlation():.2f}"]
        for symbol, error in sorted(self.design.errors.items(), key=lambda item: item[1]):
            promise = f"standard error promised {100 * error:.2g} %" if error < 1 else "not seen by this experiment"
            lines.append(f"  {symbol}: {promise}")
        return "\n".join([*lines, f"schedule: {self.csv}", f"plot: {self.plot}"])


def propose(
    site_file: Path,
    name: str,
    moves: list[str],
    *,
    days: float,
    dwell: str,
    out: Path,
    count: int,
    console: Console,
) -> Proposal:
    """The D-optimal one of ``count`` candidate designs, as CSV and plot.

    Parameters
    ----------
    moves : ``INPUT=LOW:HIGH[:LEVELS] UNIT`` for each input that may be moved
    days, dwell : length of the experiment, and the shortest time at a level

    Raises
    ------
    UsageError : no such equipment, or a move that cannot be read
    """
    context = open_site(site_file)
    component = _component(context, name)
    signals = [_signal(component, text, seconds(dwell)) for text in moves]
    step = context.plan.step / NANOSECONDS
    t = np.arange(0.0, days * 86400.0, step)
    store = context.store()
    baseline = in_force(store, [name]).get(name)
    store.close()
    component = component.following(baseline) if baseline else component
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("comparing designs", total=count)
        designs = candidates(component.model, signals, _usual(component, t), t, count=count)
        best, *_ = d_optimal(
            component.model,
            designs,
            parameters=baseline.parameters if baseline else None,
            progress=lambda done, total, _best: progress.update(task, completed=done, total=total),
        )
    out.parent.mkdir(parents=True, exist_ok=True)
    best.write_csv(out)
    plot = out.with_suffix(".svg")
    best.plot().savefig(plot)
    return Proposal(component, best, out, plot)


def _component(context: SiteContext, name: str) -> Component:
    found = {c.name: c for c in context.plan.components}
    if name not in found:
        raise UsageError(f"no equipment is named {name!r}; there are {', '.join(found)}")
    return found[name]


def _signal(component: Component, text: str, dwell: float) -> Signal:
    """Read ``P_heat=0:5 kW`` or ``P_heat=0:5:4 kW``; values become SI."""
    symbol, _, rest = text.partition("=")
    span, _, unit = rest.strip().partition(" ")
    units = {q.symbol: q.unit for q in component.model.inputs}
    if symbol not in units:
        raise UsageError(f"--move {text!r}: {component.name} has no input {symbol!r}; it has {', '.join(units)}")
    try:
        low, high, *levels = (float(v) for v in span.split(":"))
        ends = conversion(unit or units[symbol], units[symbol])(np.array([low, high]))
    except (ValueError, UnitError) as error:
        raise UsageError(f"--move {text!r} cannot be read ({error}); write it as {symbol}=0:5 kW") from None
    count = int(levels[0]) if levels else 2
    return Signal(symbol, tuple(np.linspace(ends[0], ends[1], count).tolist()), dwell)


def _usual(component: Component, t: FloatArray) -> FloatArray:
    """What inputs do that are not moved: a mild winter day's outdoor temperature and sun, nothing else."""
    day = 2 * np.pi * t / 86400.0
    columns = []
    for q in component.model.inputs:
        if q.unit == "degC":
            columns.append(5.0 - 4.0 * np.cos(day) if "out" in q.symbol else np.full_like(t, 20.0))
        elif q.unit in ("W/m^2", "W/m2"):
            columns.append(np.clip(-300.0 * np.cos(day), 0.0, None))
        else:
            columns.append(np.zeros_like(t))
    return np.column_stack(columns)
