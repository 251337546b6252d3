"""What a component's charts will find: the smallest fault of each kind that rings within a month, foretold.

Every fault is planted in the fit's own weeks, or in the model that they are run through, and what it moves the day's
sum of innovations by is kept with the baseline. With the scale that later days show, and the limit of the chart of
days, this foretells the size that is found within 30 days in nine cases of ten.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from fdd.greybox.likelihood import Data, Likelihood
from fdd.models.declare import ComponentModel
from fdd.records import Baseline, FloatArray, JsonObject
from fdd.residual_monitors.daily import BOUND, bounded_power

DAYS, CHANCE = 30, 0.9
SHARE, KELVIN = 0.1, 0.5
"""Sizes at which faults are planted: what they move grows in proportion."""
MOST_SHARE, MOST_KELVIN = 0.5, 3.0
"""Beyond these a fault is not foretold to be found: what moves a chart so little is lost in what nobody modelled."""
TEMPERATURE, POWER, FLOW, CAPACITY = "degC", "W", "kg/s", "J/K"


@dataclass(frozen=True, slots=True)
class Foretold:
    """The smallest fault of a kind that is found within ``DAYS`` days with ``CHANCE``; ``size`` None: declined."""

    fault: str
    unit: str
    size: float | None
    reason: str

    def words(self) -> str:
        """For people."""
        if self.size is None:
            most = f"{MOST_KELVIN:g} K" if self.unit == "K" else f"{100 * MOST_SHARE:g} %"
            return f"{self.fault}: not even {most} can be seen, because {self.reason}"
        size = f"{self.size:.2g} K" if self.unit == "K" else f"{100 * self.size:.2g} %"
        return f"{self.fault}: found from {size} on"

    def document(self) -> JsonObject:
        """For machines."""
        return {"fault": self.fault, "unit": self.unit, "size": self.size, "reason": self.reason}


def sensitivities(model: ComponentModel, records: Sequence[Data], baseline: Baseline) -> list[JsonObject]:
    """By how much faults move the day's sum of each output's innovations, in standard deviations a share or a kelvin.

    Parameters
    ----------
    records : the fit's own
    """
    values = np.array([baseline.parameters[p.symbol] for p in model.parameters])
    healthy = _sums(model, records, values, baseline)
    found: list[JsonObject] = []
    for fault, unit, size, data, parameters in _planted(model, records, values):
        try:
            moved = _sums(model, data, parameters, baseline) - healthy
        except ValueError:  # the planted fault leads the filter out of its numbers: nothing can be foretold of it
            continue
        shift = {q.symbol: float(m / size) for q, m in zip(model.outputs, moved, strict=True)}
        found.append({"fault": fault, "unit": unit, "shift": shift})
    return found


def foretell(baseline: Baseline, scales: Mapping[str, float], limit: float, k: float = 0.5) -> list[Foretold]:
    """What the charts of days find with these scales by output, and this limit."""
    needed = _needed(round(limit, 3), k)
    said = []
    for row in baseline.diagnostics.get("sensitivity", ()):
        seen = {s: abs(v) / scales[s] for s, v in row["shift"].items() if s in scales}
        best = max(seen, key=lambda s: seen[s], default=None)
        most = MOST_KELVIN if row["unit"] == "K" else MOST_SHARE
        size = needed / seen[best] if best is not None and seen[best] > 0 else np.inf
        reason = ""
        if size > most:
            reason = _reason(max(scales.values(), default=1.0))
        said.append(Foretold(row["fault"], row["unit"], None if reason else float(size), reason))
    return said


def _reason(scale: float) -> str:
    if scale > 1.5:
        return (
            f"the model's daily errors are {scale:.1f} times what its noise explains; measure what it lacks "
            "(heat given off, sun on the facade, use of the room, a flow), or choose a model with more detail"
        )
    return "it hardly moves what is measured; a sensor nearer to it changes that"


@lru_cache
def _needed(limit: float, k: float) -> float:
    """The shift of a day, in its standard deviations, that is found in time."""
    return float(brentq(lambda shift: bounded_power(limit, k, shift, DAYS) - CHANCE, 0.05, 8.0, xtol=1e-3))


def _planted(
    model: ComponentModel, records: Sequence[Data], values: FloatArray
) -> Iterator[tuple[str, str, float, Sequence[Data], FloatArray]]:
    """Faults by name and unit, their size, and the records and parameters that show them."""
    for j, q in enumerate(model.inputs):
        if q.unit in (POWER, FLOW):
            what = "power" if q.unit == POWER else "flow"
            yield (
                f"{what} {q.symbol} less than its meter says",
                "1",
                SHARE,
                _input(records, j, 1 / (1 - SHARE), 0.0),
                values,
            )
        elif q.unit == TEMPERATURE:
            yield f"sensor {q.symbol} off", "K", KELVIN, _input(records, j, 1.0, KELVIN), values
    for j, q in enumerate(model.outputs):
        if q.unit == TEMPERATURE:
            data = [replace(r, y=r.y + KELVIN * (np.arange(r.y.shape[1]) == j)) for r in records]
            yield f"sensor {q.symbol} off", "K", KELVIN, data, values
    unit_of = {p.symbol: p.unit for p in model.parameters}
    for fault in model.faults:
        moved = {s: sign for s, sign in fault.shows.items() if sign and not s.startswith("innovation:")}
        # Where capacities seem to change, it is a meter or a sensor that is wrong: those are planted as such.
        if moved and all(unit_of[s] != CAPACITY for s in moved):
            # The plant has moved away from the model by so much: the same as a model that is off the other way.
            factor = [1.0 - SHARE * moved.get(p.symbol, 0) for p in model.parameters]
            yield f"{fault.name} ({', '.join(moved)})", "1", SHARE, records, values * np.array(factor)


def _input(records: Sequence[Data], column: int, factor: float, added: float) -> list[Data]:
    at = np.arange(records[0].u.shape[1]) == column
    return [replace(r, u=r.u * np.where(at, factor, 1.0) + np.where(at, added, 0.0)) for r in records]


def _sums(model: ComponentModel, records: Sequence[Data], values: FloatArray, baseline: Baseline) -> FloatArray:
    """Mean of a day's sum of the charted innovations, bounded, over the root of their number, (n_y,)."""
    paths = Likelihood(model, list(records)).paths(values)
    z = np.vstack([p.standardised[1:] for p in paths])
    step = float(np.median(np.concatenate([np.diff(r.t) for r in records])))
    found = np.zeros(z.shape[1])
    for j, q in enumerate(model.outputs):
        s = baseline.innovation.get(q.symbol, {})
        gain = (1.0 - sum(s.get("ar", ()))) / s.get("sd", 1.0)
        seen = z[np.isfinite(z[:, j]), j]
        found[j] = np.clip((seen - s.get("mean", 0.0)) * gain, -BOUND, BOUND).mean() * np.sqrt(86400.0 / step)
    return found
