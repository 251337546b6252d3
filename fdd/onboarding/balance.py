"""Units by the heat balance: what a stream gives off is what the other takes up, and what a heat meter says.

A flow's unit that its values leave open is settled where the same heat is measured twice: flow times temperature
difference against a meter, in one pair of units out of all that both may have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fdd.onboarding.quantity import Found
from fdd.onboarding.roles import Part
from fdd.units import conversion

_STREAMS = {
    "heat_exchanger": (("m_flow_hot", "T_hot_in", "T_hot_out"), ("m_flow_cold", "T_cold_out", "T_cold_in")),
    "gordon_ng": (("flow_ch", "T_chi", "T_cho"),),
    "radiator": (("m_flow", "T_supply", "T_return"),),
}
HEAT_CAPACITY = 4186.0
"""Of water [J/(kg K)]; a glycol's is 10 to 15 % less, units are apart by far more."""
AGREES = (0.75, 1.33)


def balanced(found: Sequence[Found], parts: Sequence[Part]) -> list[Found]:
    """The columns with units of flows and meters settled where the balance decides."""
    by_name = {f.series.name: f for f in found}
    meters = [f for f in found if f.quantity in ("power", "load") and not f.facets & {"pump", "fan", "chiller", "gain"}]
    for part in parts:
        for flow, warm, cold in _STREAMS.get(part.model, ()):
            stream = [by_name[part.roles[r]] for r in (flow, warm, cold) if r in part.roles]
            if len(stream) < 3 or len({len(f.series.values) for f in stream}) > 1:
                continue
            for meter in meters:
                settled = _settled(stream[0], stream[1], stream[2], meter)
                by_name |= {f.series.name: f for f in settled}
        _same_unit([by_name[part.roles[s[0]]] for s in _STREAMS.get(part.model, ()) if s[0] in part.roles], by_name)
    return [by_name[f.series.name] for f in found]


def _settled(flow: Found, warm: Found, cold: Found, meter: Found) -> list[Found]:
    """Flow and meter with the one pair of units in which both say the same heat; empty where none or several do."""
    if len(meter.series.values) != len(flow.series.values) or (flow.sureness == meter.sureness == "sure"):
        return []
    difference = warm.in_si(warm.series.values) - cold.in_si(cold.series.values)
    fits = []
    for one, other in product(_choices(flow), _choices(meter)):
        ratio = _ratio(HEAT_CAPACITY * one.in_si(flow.series.values) * difference, other.in_si(meter.series.values))
        if ratio is not None and AGREES[0] < ratio < AGREES[1]:
            fits.append((one, other, ratio))
    if len(fits) == 1:
        one, other, ratio = fits[0]
        why = f"the heat balance closes to {ratio:.2f} in this unit alone"
        return [replace(f, sureness="likely", why=why, others=()) for f in (one, other)]
    # Litres and watts close it as well as cubic metres and kilowatts: the meter follows what the flow is taken for.
    own = [(other, ratio) for one, other, ratio in fits if one.unit == flow.unit]
    if len(own) == 1 and meter.sureness != "sure":
        other, ratio = own[0]
        return [
            replace(other, sureness="unsure", why=f"with {flow.series.name} in {flow.unit} the heat balance closes")
        ]
    return []


def _choices(f: Found) -> list[Found]:
    return [f] if f.sureness == "sure" else [_in(f, unit) for unit in (f.unit, *f.others)]


def _in(f: Found, unit: str) -> Found:
    volume = conversion(unit).si == "m3/s"
    return replace(f, unit=unit, fluid=(f.fluid or "water") if volume else "")


def _ratio(heat: NDArray[np.float64], metered: NDArray[np.float64]) -> float | None:
    """Metered over computed heat while the plant runs; None where they do not move together."""
    seen = np.isfinite(heat) & np.isfinite(metered)
    if seen.sum() < 50:
        return None
    run = seen & (np.abs(heat) > 0.2 * np.percentile(np.abs(heat[seen]), 95))
    if run.sum() < 20 or np.ptp(heat[run]) == 0 or np.ptp(metered[run]) == 0:
        return None
    if np.corrcoef(heat[run], metered[run])[0, 1] < 0.8:
        return None
    return float(np.median(metered[run] / heat[run]))


def _same_unit(flows: Sequence[Found], by_name: dict[str, Found]) -> None:
    """Two flows of one machine are written in one unit: what settles the one settles the other."""
    settled = [f for f in flows if f.sureness != "unsure"]
    for f in flows:
        if f.sureness == "unsure" and settled and settled[0].unit in (f.unit, *f.others):
            unit = settled[0].unit
            by_name[f.series.name] = replace(
                _in(f, unit), sureness="likely", why=f"as the other flow, {settled[0].series.name}", others=()
            )
