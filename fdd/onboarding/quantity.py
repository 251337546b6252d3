"""Which quantity a point holds and in which unit, from its name, its tags, its range and its behaviour.

Where a name or a tag says the unit, that is taken, if values allow it. Otherwise each unit that a quantity comes in is
weighed by how likely the values would be in it: temperatures by what is usual for their kind, and together, since one
export rarely mixes degC and degF; powers and irradiances by their orders of magnitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fdd.onboarding.guess import Sureness, graded
from fdd.onboarding.layout import unit_in
from fdd.onboarding.vocabulary import facets, words
from fdd.units import Conversion, UnitError, conversion

SENTINELS = (-9999.0, -999.9, -999.0, -99.0, -99.9, -127.0, -50.0, -40.0, 9999.0, 999.0, 999.9, 99999.0, 32767.0,
             -32768.0, 65535.0, 3276.7, 6553.5, 327.67, 655.35, 0.0, 850.0, 85.0)  # fmt: skip
"""Numbers that instruments and historians write for 'no value'; one counts where it is far from all other values."""

# What is usual in SI, (mean, standard deviation), by what a name says; the first that applies.
_TEMPERATURES: tuple[tuple[frozenset[str], float, float], ...] = (
    (frozenset({"chilled"}), 9.0, 4.0),
    (frozenset({"condenser"}), 26.0, 7.0),
    (frozenset({"outdoor"}), 11.0, 11.0),
    (frozenset({"room"}), 21.5, 4.0),
    (frozenset({"air"}), 20.0, 8.0),
    (frozenset({"heating"}), 45.0, 18.0),
    (frozenset({"hotside"}), 55.0, 20.0),
    (frozenset({"primary"}), 55.0, 20.0),
    (frozenset({"secondary"}), 40.0, 15.0),
    (frozenset({"coldside"}), 35.0, 15.0),
    (frozenset(), 28.0, 20.0),
)
# Order of magnitude of the largest usual values: log10 in SI, mean and standard deviation.
_LARGEST: Mapping[str, tuple[float, float]] = {
    "power": (4.0, 1.1),
    "chiller power": (5.1, 0.9),
    "irradiance": (2.85, 0.25),
    "water flow": (0.3, 1.0),
    "air flow": (-0.2, 0.9),
    "static pressure": (2.4, 0.5),
    "pressure": (4.9, 0.8),
    "energy": (10.5, 2.0),
}
# (unit, is it of the American system, prior weight)
_UNITS: Mapping[str, tuple[tuple[str, bool | None, float], ...]] = {
    "temperature": (("degC", False, 1.0), ("degF", True, 1.0), ("K", False, 0.3)),
    "power": (("kW", None, 1.0), ("W", None, 1.0), ("MW", None, 0.05), ("kBtu/h", True, 0.1)),
    "irradiance": (("W/m2", None, 1.0), ("kW/m2", None, 0.6)),
    "water flow": (("m3/h", False, 1.0), ("l/s", False, 0.6), ("l/h", False, 0.5), ("kg/s", False, 0.5),
                   ("gpm", True, 2.0)),
    "air flow": (("m3/h", False, 1.0), ("l/s", False, 0.3), ("m3/s", False, 0.3), ("cfm", True, 2.0)),
    "static pressure": (("Pa", False, 1.0), ("kPa", False, 0.3), ("inH2O", True, 2.0)),
    "pressure": (("kPa", False, 1.0), ("bar", False, 1.0), ("Pa", False, 0.4), ("psi", True, 1.5)),
    "energy": (("kWh", None, 1.0), ("MWh", None, 0.6), ("Wh", None, 0.1)),
    "humidity": (("%", None, 1.0), ("1", None, 0.4)),
    "position": (("%", None, 1.0), ("1", None, 1.0)),
    "speed": (("%", None, 1.0), ("1", None, 1.0), ("Hz", None, 0.4), ("rpm", None, 0.2)),
    "status": (("on/off", None, 1.0),),
    "load": (("tons", True, 3.0), ("kW", None, 1.0)),
    "co2": (("ppm", None, 1.0),),
    "wind": (("m/s", False, 1.0), ("mph", True, 1.0)),
    "illuminance": (("lux", None, 1.0),),
}  # fmt: skip
# Beyond these no such value is real, in SI.
POSSIBLE: Mapping[str, tuple[float, float]] = {
    "degC": (-60.0, 400.0), "W/m2": (-50.0, 1800.0), "kg/s": (-5e3, 5e3), "W": (-1e8, 1e9), "Pa": (-1e7, 1e7),
}  # fmt: skip


@dataclass(frozen=True)
class Series:
    """A column of an export, ``values`` (n,), with what tags or headers say of it."""

    name: str
    values: NDArray[np.float64]
    unit: str = ""
    facets: frozenset[str] = frozenset()
    group: str = ""
    title: str = ""


@dataclass(frozen=True)
class Found:
    """What a column was taken for; ``quantity`` is empty where nothing is known of it."""

    series: Series
    quantity: str
    unit: str
    sureness: Sureness
    why: str
    others: tuple[str, ...] = ()
    fluid: str = ""
    absolute: bool = False
    missing: tuple[float, ...] = ()
    bounds: tuple[float, float] | None = None
    facets: frozenset[str] = field(default_factory=frozenset)

    @property
    def conversion(self) -> Conversion:
        """From the plant's unit to SI, mass flow where a fluid is known."""
        return conversion(self.unit, quantity="temperature" if self.absolute else None, fluid=self.fluid or None)

    @property
    def si(self) -> str:
        """The unit in SI."""
        return self.conversion.si

    def in_si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values in SI, sentinels and what is out of bounds left out."""
        good = usable(values, self.missing, self.bounds)
        return np.where(good, self.conversion(values), np.nan)


def usable(
    values: NDArray[np.float64], missing: Sequence[float], bounds: tuple[float, float] | None
) -> NDArray[np.bool_]:
    """Which values are neither sentinels nor out of bounds, shape as ``values``."""
    good = np.isfinite(values) & ~np.isin(values, missing)
    return good & (values >= bounds[0]) & (values <= bounds[1]) if bounds else good


def kinds(said: frozenset[str]) -> str:
    """The quantity that a name's facets speak of; empty where they say none."""
    flow = "air flow" if "air" in said else "water flow"
    pressure = "static pressure" if said & {"static", "air", "fan"} else "pressure"
    order = (
        ("efficiency", "efficiency"), ("alarm", "alarm"), ("wetbulb", "temperature"), ("dewpoint", "temperature"),
        ("humidity", "humidity"), ("co2", "co2"), ("illuminance", "illuminance"), ("status", "status"),
        ("temperature", "temperature"), ("irradiance", "irradiance"), ("energy", "energy"), ("flow", flow),
        ("pressure", pressure), ("speed", "speed"), ("power", "power"), ("wind", "wind"), ("position", "position"),
        ("damper", "position"), ("valve", "position"), ("load", "load"), ("fan", "speed"), ("gain", "power"),
    )  # fmt: skip
    return next((quantity for facet, quantity in order if facet in said), "")


def identified(columns: Sequence[Series]) -> list[Found]:
    """What each column holds, all of one export together."""
    spoken = [_spoken(c) for c in columns]
    american = _american(spoken)
    own = [[] if f.unit else _weights(f, _seen(f), american) for f in spoken]
    pooled = [_pooled(i, spoken, own) for i in range(len(spoken))]
    return [_cleaned(f if f.unit else _weighed(f, weights)) for f, weights in zip(spoken, pooled, strict=True)]


def _seen(f: Found) -> NDArray[np.float64]:
    return f.series.values[usable(f.series.values, SENTINELS, None)]


def _pooled(i: int, spoken: Sequence[Found], own: Sequence[list[tuple[str, float]]]) -> list[tuple[str, float]]:
    """Weights of one column's units with those of the other columns of its quantity: an export rarely mixes units.

    What the others say counts as much as three columns at most, for they are alike and not independent.
    """
    kin = [w for j, w in enumerate(own) if j != i and w and spoken[j].quantity == spoken[i].quantity]
    if not kin or spoken[i].quantity not in ("power", "irradiance", "water flow", "air flow", "pressure"):
        return own[i]
    share = min(3.0, len(kin)) / len(kin)
    mean = {unit: share * sum(float(np.log(dict(w).get(unit, 0.0) / sum(x for _, x in w) + 1e-6)) for w in kin)
            for unit, _ in own[i]}  # fmt: skip
    return [(unit, w * float(np.exp(mean[unit]))) for unit, w in own[i]]


def _spoken(column: Series) -> Found:
    """What name and tags alone say; the unit is empty where they do not say it."""
    said = column.facets or facets(column.title or column.name)
    unit = column.unit or unit_in(column.name) or ""
    quantity = kinds(said)
    if unit:
        try:
            quantity = _of_unit(unit, said) or quantity
        except UnitError:
            unit = ""
    seen = column.values[np.isfinite(column.values)]
    if not unit and quantity == "power" and len(seen) and "efficiency" in said:
        quantity = "efficiency"
    if quantity in ("", "temperature") and not unit and len(seen) and set(np.unique(seen)) <= {0.0, 1.0} and len(
        seen) > 10:  # fmt: skip
        return Found(column, "status", "on/off", "likely", "only 0 and 1", facets=said)
    if quantity in ("", "efficiency", "alarm"):
        return Found(column, quantity, unit or "1", "unsure" if not quantity else "likely", "nothing names a quantity"
                     if not quantity else f"a {quantity}", facets=said)  # fmt: skip
    if not unit:
        return Found(column, quantity, "", "unsure", "", facets=said)
    absolute = quantity == "temperature" and conversion(unit).si == "K" and "difference" not in said
    found = Found(column, quantity, unit, "sure", "said by name or tag", absolute=absolute, facets=said)
    if quantity in ("temperature", "irradiance") and len(seen) and not _possible(found, seen):
        return replace(found, sureness="unsure", why=f"{unit} is said, but half of the values cannot be")
    return found


def _possible(found: Found, seen: NDArray[np.float64]) -> bool:
    low, high = POSSIBLE.get(found.si, (-np.inf, np.inf))
    return bool(low <= np.median(found.in_si(seen)) <= high)


def _of_unit(unit: str, said: frozenset[str]) -> str:
    si = conversion(unit).si
    if si == "W" and "load" in said:
        return "load"
    flow = "air flow" if "air" in said or "cfm" in unit.lower() else "water flow"
    pressure = "static pressure" if said & {"static", "air", "fan"} else "pressure"
    named = {"degC": "temperature", "K": "temperature", "W": "power", "J": "energy", "kg/s": flow, "m3/s": flow,
             "Pa": pressure, "W/m2": "irradiance", "lx": "illuminance", "m/s": "wind"}  # fmt: skip
    return named.get(si, "")


def _american(spoken: Sequence[Found]) -> float:
    """Probability that the export is in American units: what units say, and all temperatures together."""
    log_odds = 0.0
    for f in spoken:
        if f.unit:
            log_odds += sum(3.0 * (1 if us else -1) for unit, us, _ in _UNITS.get(f.quantity, ()) if us is not None and
                            unit.lower() == f.unit.lower().replace("°", "deg"))  # fmt: skip
        elif f.quantity == "temperature" and not f.facets & {"setpoint", "difference"}:
            weights = dict(_temperature_weights(f))
            if weights:
                log_odds += float(np.clip(np.log(weights["degF"] + 1e-9) - np.log(weights["degC"] + 1e-9), -4, 4))
    return float(1.0 / (1.0 + np.exp(-np.clip(log_odds - 0.3, -30, 30))))


def _temperature_weights(f: Found) -> list[tuple[str, float]]:
    """How likely the values are in each unit, by what is usual for such a temperature."""
    seen = f.series.values[usable(f.series.values, SENTINELS, None)]
    if not len(seen):
        return []
    mean, sd = next((m, s) for need, m, s in _TEMPERATURES if need <= f.facets)
    middle = float(np.median(seen))
    in_c = {"degC": middle, "degF": (middle - 32.0) / 1.8, "K": middle - 273.15}
    # Heavy tails: a value far from what is usual speaks against a unit, and not without end.
    return [(u, 1.0 / (sd * (1.0 + ((x - mean) / sd) ** 2 / 3.0) ** 2)) for u, x in in_c.items()]


def _weighed(f: Found, weights: list[tuple[str, float]]) -> Found:
    """The unit by how likely the values are in each that the quantity comes in."""
    seen = _seen(f)
    total = sum(w for _, w in weights)
    if not weights or total <= 0 or not len(seen):
        return replace(f, unit=_UNITS[f.quantity][0][0], sureness="unsure", why="there are no values to tell by")
    weights = sorted(weights, key=lambda w: -w[1])
    unit, best = weights[0]
    others = tuple(u for u, w in weights[1:] if w > 0.02 * total)
    why = f"values of {_span(seen)} are most usual in {unit}"
    fluid = ("air" if f.quantity == "air flow" else "water") if unit != "kg/s" and "flow" in f.quantity else ""
    absolute = f.quantity == "temperature" and unit == "K"
    return replace(f, unit=unit, sureness=graded(best / total), why=why, others=others, fluid=fluid, absolute=absolute)


def _span(seen: NDArray[np.float64]) -> str:
    low, high = np.percentile(seen, [2, 98])
    return f"{low:.4g} to {high:.4g}"


def _weights(f: Found, seen: NDArray[np.float64], american: float) -> list[tuple[str, float]]:
    prior = {
        unit: weight * (1.0 if us is None else american if us else 1.0 - american)
        for unit, us, weight in _UNITS[f.quantity]
    }
    if f.quantity == "temperature":
        return [(u, w * prior[u]) for u, w in _temperature_weights(f)]
    if not len(seen):
        return []
    high = float(np.percentile(np.abs(seen), 98))
    if f.quantity in ("position", "speed", "humidity"):
        return _share_weights(prior, float(np.max(np.abs(seen))))
    magnitude = _LARGEST.get("chiller power" if {"chiller"} & f.facets and f.quantity == "power" else f.quantity)
    if magnitude is None or high <= 0:
        return list(prior.items())
    said = set(words(f.series.name))
    if "flow" in f.quantity and "mass" in f.facets:
        prior = {u: w * (30.0 if u == "kg/s" else 0.1) for u, w in prior.items()}
    if "flow" in f.quantity and said & {"v", "qv", "vdot"}:
        prior = {u: w * (0.05 if u == "kg/s" else 1.0) for u, w in prior.items()}
    if f.quantity == "power" and np.mean(np.mod(seen, 1.0) != 0) < 0.02 and len(np.unique(seen)) > 5:
        prior = {u: w * (0.3 if u == "kW" else 1.0) for u, w in prior.items()}
    mean, sd = magnitude
    return [(u, w * float(np.exp(-0.5 * ((np.log10(high * _si_scale(u, f)) - mean) / sd) ** 2)))
            for u, w in prior.items()]  # fmt: skip


def _si_scale(unit: str, f: Found) -> float:
    fluid = ("air" if f.quantity == "air flow" else "water") if "flow" in f.quantity else None
    return conversion(unit, fluid=fluid if conversion(unit).si == "m3/s" else None).scale


def _share_weights(prior: Mapping[str, float], largest: float) -> list[tuple[str, float]]:
    """Shares by their largest value: up to 1 they are numbers, up to 100 per cent, speeds beyond are turns."""
    fits = {"1": largest <= 1.3, "%": 1.3 < largest <= 130.0, "Hz": 20.0 < largest <= 65.0, "rpm": largest > 130.0}
    return [(u, w * (1.0 if fits.get(u) else 0.01)) for u, w in prior.items()]


def _cleaned(f: Found) -> Found:
    """With a fluid for volume flows, the sentinels that occur, and bounds where impossible values do."""
    if f.unit and "flow" in f.quantity and not f.fluid and conversion(f.unit).si == "m3/s":
        f = replace(f, fluid="air" if f.quantity == "air flow" else "water")
    values = f.series.values[np.isfinite(f.series.values)]
    if not len(values) or not f.quantity:
        return f
    return _bounded(replace(f, missing=_sentinels_in(f, values)), values)


def _sentinels_in(f: Found, values: NDArray[np.float64]) -> tuple[float, ...]:
    """Sentinels among the values: repeated, and far from the bulk without them."""
    if f.quantity in ("status", "alarm"):
        return ()
    found = []
    for number in SENTINELS:
        at = values == number
        if not 1 <= at.sum() < 0.5 * len(values):
            continue
        rest = values[~at]
        low, high = np.percentile(rest, [0.5, 99.5])
        reach = max(high - low, 1e-6)
        far = number < low - 0.7 * reach or number > high + 0.7 * reach
        jump = number == 0.0 and f.quantity == "temperature" and f.unit == "degF" and low > 20.0
        if (far and number != 0.0) or jump:
            found.append(number)
    return tuple(found)


def _bounded(f: Found, values: NDArray[np.float64]) -> Found:
    """Bounds in the plant's unit, where some value cannot be real."""
    low, high = POSSIBLE.get(f.si, (-np.inf, np.inf))
    si = f.in_si(values)
    seen = si[np.isfinite(si)]
    if not len(seen) or (seen.min() >= low and seen.max() <= high):
        return f
    limits = f.conversion.back(np.array([low, high]))
    return replace(f, bounds=(float(np.round(limits[0], 6)), float(np.round(limits[1], 6))))
