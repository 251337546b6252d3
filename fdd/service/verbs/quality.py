"""What is wrong with a record before anything is learned from it: gaps, flat stretches, jumps, clocks, columns.

All is looked at in SI and in event time, on the frames that the engine would see and on the counts of what did not
reach them. Limits are those of instruments and plant, not of one record; each fault says where, how much, since when.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal

import numpy as np
import pandas as pd

from fdd.records import NANOSECONDS, FloatArray, IntArray, JsonObject
from fdd.service.baselines.history import History
from fdd.service.site.site_context import SiteContext

HOUR = 3600 * NANOSECONDS
DAY = 24 * HOUR
Kind = Literal["loss", "gap", "flat", "jump", "implausible", "same", "swapped", "clock", "sampling"]

# Beyond these a value is not one of a building's plant, in SI.
PLAUSIBLE: Mapping[str, tuple[float, float]] = {
    "degC": (-60.0, 300.0), "K": (-200.0, 200.0), "W/m^2": (-50.0, 1700.0), "W/m2": (-50.0, 1700.0),
    "kg/s": (-2e3, 2e3), "m3/s": (-2e3, 2e3), "W": (-5e7, 5e7), "Pa": (-1e7, 1e7), "1/s": (-1e3, 1e3),
    "lx": (-10.0, 2e5), "m/s": (-1.0, 100.0),
}  # fmt: skip
# A quantity that moves by nature does not stand still so long; zero is a machine that stands.
FLAT_HOURS: Mapping[str, float] = {"degC": 24.0, "W/m^2": 30.0, "W/m2": 30.0, "kg/s": 48.0, "W": 48.0, "Pa": 72.0}
# A change within one frame below this is no jump, whatever its scale.
SMALLEST_JUMP: Mapping[str, float] = {"degC": 5.0, "K": 5.0}
# Warm and cold end of a stream while the machine runs, by model.
STREAMS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "heat_exchanger": (("T_hot_in", "T_hot_out"), ("T_cold_out", "T_cold_in")),
    "gordon_ng": (("T_chi", "T_cho"), ("T_cdo", "T_cdi")),
    "radiator": (("T_supply", "T_return"),),
}
MOSTLY_LOST = 0.5
"""Less than this share of samples or of the span: nothing should be learned from the record."""
ANOTHER_RECORD = 7 * DAY
"""A longer silence parts two records; it is told as a gap, and not taken for a loss."""
SHOWN = 5


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong with a record, of ``points``, in words, with the time where it begins [ns]."""

    kind: Kind
    points: tuple[str, ...]
    words: str
    since: int | None = None


@dataclass(frozen=True, slots=True)
class PointQuality:
    """One point: share of frames with a value, usual time between values [s], and its range in SI."""

    name: str
    unit: str
    seen: float
    sampling: float
    lowest: float
    mean: float
    highest: float
    unchanged: float


@dataclass
class RecordQuality:
    """A record: how much of it is used, each point, and what is wrong; ``present`` (days, points) is the share seen."""

    used: float
    span_used: float
    first: int
    last: int
    points: list[PointQuality] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    days: list[str] = field(default_factory=list)
    present: FloatArray = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def mostly_lost(self) -> bool:
        """Whether most samples, or most of the span, cannot be used."""
        return min(self.used, self.span_used) < MOSTLY_LOST

    def document(self, local: Callable[[int], str]) -> JsonObject:
        """For machines."""
        return {
            "samples_used": self.used,
            "span_used": self.span_used,
            "mostly_lost": self.mostly_lost,
            "from": local(self.first),
            "until": local(self.last),
            "faults": [
                {"kind": f.kind, "points": list(f.points), "words": f.words,
                 "since": None if f.since is None else local(f.since)}
                for f in self.faults
            ],
        }  # fmt: skip


def record_quality(context: SiteContext, history: History, counts: Mapping[str, int]) -> RecordQuality:
    """Look at a record.

    Parameters
    ----------
    history : its frames
    counts : what became of its samples, by reason, of framing and of the sources together
    """
    time, step = history.time, context.plan.step
    names = tuple(context.plan.points)
    values = history.of(names)
    units = context.site.units
    seen = np.isfinite(values)
    frames = (int(time[-1]) - int(time[0])) // step + 1
    there = time[seen.any(axis=1)]
    # Days chosen from two years are many records, and lose nothing between them.
    apart = sum(stop - start for start, stop in _silences(there, ANOTHER_RECORD)) // step
    span_used = min(1.0, len(there) / max(1, frames - apart))
    quality = RecordQuality(_used(counts), span_used, int(time[0]), int(time[-1]))
    quality.points = [_point(n, units.get(n, "1"), values[:, i], time, frames) for i, n in enumerate(names)]
    quality.days, quality.present = _by_day(context, time, seen, step)
    quality.faults = [
        *_losses(counts),
        *_gaps(names, time, seen, context),
        *_each(names, units, values, time, context),
        *_same(names, values),
        *_swapped(context, history),
        *_clocks(context, history, counts),
    ]
    return quality


def _used(counts: Mapping[str, int]) -> float:
    """Share of what was read that reached a frame; what had no value is a gap and counted there."""
    lost = sum(n for reason, n in counts.items() if reason in _LOST)
    accepted = counts.get("accepted", 0)
    return accepted / max(1, accepted + lost)


_LOST = ("late", "clock_jump", "time not understood", "local time does not exist", "value is no number",
         "line has the wrong number of fields", "out of range", "bad quality", "row cannot be read")  # fmt: skip
_REMEDIES = {
    "late": "rows that run back in time; files in another order, a clock set back, or `sorted: false`",
    "time not understood": "check time.format or time.day_first",
    "clock_jump": "times far ahead of all others",
    "value is no number": "texts among numbers; name them in `missing`, or set decimal",
    "local time does not exist": "set time.zone, or `nonexistent: shift`",
    "line has the wrong number of fields": "a delimiter within a field, or lines cut short",
}


def _losses(counts: Mapping[str, int]) -> Iterator[Fault]:
    total = max(1, counts.get("accepted", 0) + sum(counts.get(r, 0) for r in _LOST))
    for reason in _LOST:
        n = counts.get(reason, 0)
        if n > 0.001 * total:
            remedy = f" ({_REMEDIES[reason]})" if reason in _REMEDIES else ""
            yield Fault("loss", (), f"{n} samples or rows are lost: {reason.replace('_', ' ')}{remedy}")


def _point(name: str, unit: str, values: FloatArray, time: IntArray, frames: int) -> PointQuality:
    good = np.isfinite(values)
    seen = values[good]
    steps = np.diff(time[good]) / NANOSECONDS
    nan = float("nan")
    return PointQuality(
        name,
        unit,
        len(seen) / max(1, frames),
        float(np.median(steps)) if len(steps) else nan,
        float(seen.min()) if len(seen) else nan,
        float(seen.mean()) if len(seen) else nan,
        float(seen.max()) if len(seen) else nan,
        float(np.mean(np.diff(seen) == 0)) if len(seen) > 1 else nan,
    )


def _by_day(
    context: SiteContext, time: IntArray, seen: np.ndarray[tuple[int, int], np.dtype[np.bool_]], step: int
) -> tuple[list[str], FloatArray]:
    """Share of each day's frames in which each point has a value, days of the site's zone."""
    local = pd.to_datetime(time, utc=True).tz_convert(context.site.zone)
    day = local.strftime("%Y-%m-%d").to_numpy()
    names, at = np.unique(day, return_inverse=True)
    every = pd.date_range(names[0], names[-1]).strftime("%Y-%m-%d").tolist()
    place = {d: i for i, d in enumerate(every)}
    present = np.zeros((len(every), seen.shape[1]))
    for i, name in enumerate(names):
        present[place[name]] = seen[at == i].sum(axis=0) * step / DAY
    return every, np.minimum(present, 1.0)


def _runs(mask: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> IntArray:
    """First and last index of each run of true values, shape (n, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return np.stack([edges[::2], edges[1::2] - 1], axis=1).astype(np.int64)


def _gaps(
    names: Sequence[str], time: IntArray, seen: np.ndarray[tuple[int, int], np.dtype[np.bool_]], context: SiteContext
) -> Iterator[Fault]:
    """Silences longer than ``max_gap``: of all points together first, then of each beyond these."""
    limit = context.plan.max_gap
    whole = _silences(time[seen.any(axis=1)], limit)
    yield from _told_gaps((), whole, context)
    common = {start for start, _ in whole}
    for i, name in enumerate(names):
        own = [g for g in _silences(time[seen[:, i]], limit) if g[0] not in common]
        yield from _told_gaps((name,), own, context)


def _silences(at: IntArray, limit: int) -> list[tuple[int, int]]:
    long = np.flatnonzero(np.diff(at) > limit)
    return [(int(at[i]), int(at[i + 1])) for i in long]


def _told_gaps(points: tuple[str, ...], gaps: Sequence[tuple[int, int]], context: SiteContext) -> Iterator[Fault]:
    if not gaps:
        return
    longest = sorted(gaps, key=lambda g: g[0] - g[1])[:SHOWN]
    total = sum(stop - start for start, stop in gaps) / HOUR
    shown = ", ".join(f"{context.local(a)} to {context.local(b)}" for a, b in sorted(longest))
    more = f", and {len(gaps) - SHOWN} shorter ones" if len(gaps) > SHOWN else ""
    who = "nothing at all" if not points else f"nothing of {points[0]}"
    yield Fault("gap", points, f"{who} for {total:.0f} h in {len(gaps)} gap(s): {shown}{more}", gaps[0][0])


def _each(
    names: Sequence[str], units: Mapping[str, str], values: FloatArray, time: IntArray, context: SiteContext
) -> Iterator[Fault]:
    for i, name in enumerate(names):
        good = np.isfinite(values[:, i])
        seen, at, unit = values[good, i], time[good], units.get(name, "1")
        if len(seen) < 10:
            yield Fault("loss", (name,), f"{name} has {len(seen)} values in all")
            continue
        for check in (_implausible, _flat, _jumps):
            fault = check(name, unit, seen, at, context)
            if fault is not None:
                yield fault


def _implausible(name: str, unit: str, seen: FloatArray, at: IntArray, context: SiteContext) -> Fault | None:
    low, high = PLAUSIBLE.get(unit, (-np.inf, np.inf))
    bad = (seen < low) | (seen > high)
    if not bad.any():
        return None
    first, worst = int(np.argmax(bad)), float(seen[bad][np.argmax(np.abs(seen[bad]))])
    words = (
        f"{name} has {int(bad.sum())} of {len(seen)} values beyond {low:g} to {high:g} {unit}, such as {worst:.4g} on "
        f"{context.local(int(at[first]))}: check its unit, or set range or missing"
    )
    return Fault("implausible", (name,), words, int(at[first]))


def _flat(name: str, unit: str, seen: FloatArray, at: IntArray, context: SiteContext) -> Fault | None:
    """The longest stretches without any change in what moves by nature."""
    hours = FLAT_HOURS.get(unit)
    if hours is None or len(np.unique(seen)) < 5:
        return None
    still = np.concatenate([[False], (np.diff(seen) == 0) & (np.diff(at) <= context.plan.max_gap)])
    long = [(int(at[max(a - 1, 0)]), int(at[b])) for a, b in _runs(still) if seen[b] != 0]
    long = [g for g in long if g[1] - g[0] > hours * HOUR]
    if not long:
        return None
    longest = max(long, key=lambda g: g[1] - g[0])
    words = (
        f"{name} does not move at all in {len(long)} stretch(es) of more than {hours:g} h, the longest from "
        f"{context.local(longest[0])} to {context.local(longest[1])}"
    )
    return Fault("flat", (name,), words, long[0][0])


def _jumps(name: str, unit: str, seen: FloatArray, at: IntArray, context: SiteContext) -> Fault | None:
    """Single values far from both neighbours, which agree: spikes of the instrument, not of the plant."""
    step = np.diff(seen)
    scale = float(np.percentile(np.abs(step), 95)) or float(np.std(seen)) / 100.0
    limit = max(10.0 * scale, SMALLEST_JUMP.get(unit, 0.0), 0.5 * float(np.ptp(np.percentile(seen, [1, 99]))))
    there, back = step[:-1], step[1:]
    spike = (np.abs(there) > limit) & (np.abs(back) > limit) & (there * back < 0)
    spike &= np.abs(there + back) < 0.3 * np.abs(there)
    if not spike.any() or spike.mean() > 0.02:
        return None
    first = int(at[int(np.argmax(spike)) + 1])
    words = f"{name} leaps and comes back {int(spike.sum())} time(s), the first on {context.local(first)}"
    return Fault("jump", (name,), words, first)


def _same(names: Sequence[str], values: FloatArray) -> Iterator[Fault]:
    """Columns that hold the same: one was exported twice."""
    for i, j in combinations(range(len(names)), 2):
        both = np.isfinite(values[:, i]) & np.isfinite(values[:, j])
        if both.sum() < 50:
            continue
        a, b = values[both, i], values[both, j]
        if len(np.unique(a[:: max(1, len(a) // 2000)])) > 20 and np.mean(a == b) > 0.99:
            yield Fault("same", (names[i], names[j]), f"{names[i]} and {names[j]} hold the same values")


def _swapped(context: SiteContext, history: History) -> Iterator[Fault]:
    """Ends of a stream that say the wrong one is the warm one, whenever they differ."""
    for name, equipment in context.site.equipment.items():
        mapped = {**equipment.inputs, **equipment.outputs}
        for warm, cold in STREAMS.get(equipment.model, ()):
            if warm not in mapped or cold not in mapped:
                continue
            pair = history.of((mapped[warm], mapped[cold]))
            difference = pair[:, 0] - pair[:, 1]
            apart = difference[np.isfinite(difference) & (np.abs(difference) > 1.0)]
            if len(apart) > 50 and np.mean(apart < 0) > 0.8:
                words = (
                    f"{name}: {mapped[cold]} is warmer than {mapped[warm]} in {np.mean(apart < 0):.0%} of frames; are "
                    f"{warm} and {cold} swapped?"
                )
                yield Fault("swapped", (mapped[warm], mapped[cold]), words)


def _clocks(context: SiteContext, history: History, counts: Mapping[str, int]) -> Iterator[Fault]:
    """Clocks that run back, lack an hour, or disagree with the sun."""
    backwards = counts.get("row's time runs backwards", 0)
    if backwards:
        yield Fault("clock", (), f"times run backwards {backwards} time(s): a clock set back, or files out of order")
    for name, unit in context.site.units.items():
        if unit in ("W/m2", "W/m^2") and name in history.columns:
            yield from _sun(name, history, context)


def _sun(name: str, history: History, context: SiteContext) -> Iterator[Fault]:
    """The middle of the day by the sun against the clock of the zone; an hour's step says that clocks were changed."""
    value = history.of((name,))[:, 0]
    good = np.isfinite(value)
    if good.sum() < 200 or np.nanmax(value) < 50.0:
        return
    local = pd.to_datetime(history.time[good], utc=True).tz_convert(context.site.zone)
    utc = local.tz_convert("UTC").tz_localize(None)
    shift = ((local.tz_localize(None) - utc) / pd.Timedelta("1h")).to_numpy()
    # Standard time all year: what the sun keeps.
    hour = (local.hour + local.minute / 60.0).to_numpy() - (shift - shift.min())
    table = pd.DataFrame({"day": local.strftime("%Y-%m-%d"), "hour": hour, "sun": np.clip(value[good], 0, None)})
    daily = table.groupby("day")[["hour", "sun"]].apply(_middle).dropna()
    if len(daily) < 5:
        return
    middle = float(daily.median())
    if abs(middle - 12.5) > 2.5:
        words = (
            f"the sun on {name} stands highest around {_clock(middle)} by standard time of {context.site.zone}: the "
            "zone or the clock is wrong"
        )
        yield Fault("clock", (name,), words)
    yield from _changed(name, daily, context)


def _middle(day: pd.DataFrame) -> float:
    """Hour about which a day's sun is centred; missing where little was seen of it."""
    total = float(day["sun"].sum())
    if total <= 0 or day["sun"].max() < 50.0 or len(day) < 12:
        return float("nan")
    return float((day["hour"] * day["sun"]).sum() / total)


def _changed(name: str, daily: pd.Series, context: SiteContext) -> Iterator[Fault]:
    """A step of about an hour in the middle of the day: clocks were changed, and the zone says otherwise."""
    if len(daily) < 20:
        return
    values = daily.to_numpy()
    gaps = [(abs(np.median(values[i - 10 : i]) - np.median(values[i : i + 10])), i) for i in range(10, len(values) - 9)]
    size, at = max(gaps)
    if 0.75 < size < 1.25:
        words = (
            f"the sun on {name} moves by {size:.1f} h about {daily.index[at]}: its clock was changed then, and zone "
            f"{context.site.zone} does not say so; set time.zone of the source to the one its times are written in"
        )
        yield Fault("clock", (name,), words)


def _clock(hour: float) -> str:
    return f"{int(hour) % 24:02d}:{int(hour % 1 * 60):02d}"
