"""How times are written: order of day and month, counts and their origin, and signs of the zone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from fdd.onboarding.guess import Guess, Sureness
from fdd.onboarding.vocabulary import words

_NUMERIC = re.compile(r"^\s*(\d{1,2})[./-](\d{1,2})[./-](\d{4}|\d{2})(?=$|[\sT,])(.*)$")
_YEAR_FIRST = re.compile(r"^\s*\d{4}[-/.]?\d{2}[-/.]?\d{2}(?:[ T,]|$)")
_CLOCK = re.compile(r"^\s*\d{1,2}[:.]\d{2}(?:[:.]\d{2}(?:[.,]\d+)?)?\s*(?:[AaPp]\.?[Mm]\.?)?\s*$")
_OFFSET = re.compile(r"(?:Z|[+-]\d{2}:?\d{2})\s*$")
_HALF = re.compile(r"[AaPp]\.?[Mm]\.?\s*$")
_NAMED = ("%d-%b-%Y %H:%M:%S", "%d-%b-%Y %H:%M", "%d %b %Y %H:%M", "%d %b %Y %H:%M:%S", "%d-%b-%y %H:%M",
          "%d-%b-%y %I:%M:%S %p", "%d-%b-%y %I:%M %p", "%d-%b-%Y %I:%M:%S %p", "%b %d, %Y %I:%M %p",
          "%b %d, %Y %H:%M:%S", "%b %d, %Y %I:%M:%S %p", "%b %d %Y %H:%M", "%a %b %d %H:%M:%S %Y",
          "%d-%b-%y %H:%M:%S", "%Y-%m-%d %I:%M:%S %p", "%Y/%m/%d %I:%M %p", "%Y%m%d%H%M", "%Y%m%d%H%M%S",
          "%Y%m%d %H%M", "%d.%m.%Y %H:%M:%S:%f")  # fmt: skip
_NAMES = ("time", "date", "datetime", "timestamp", "zeit", "datum", "zeitstempel", "uhrzeit", "heure", "horodatage",
          "fecha", "hora", "data", "ora", "tid", "dato", "tijd", "ts", "clock", "utc", "stamp", "timedate",
          "tidspunkt", "tijdstip", "moment", "when")  # fmt: skip
_COUNTS = {"s": "s", "sec": "s", "second": "s", "seconds": "s", "min": "min", "minute": "min", "minutes": "min",
           "h": "h", "hr": "h", "hour": "h", "hours": "h", "ms": "ms", "d": "d", "day": "d", "days": "d"}  # fmt: skip


def is_time_text(cells: Sequence[str]) -> bool:
    """Whether most of a column's texts are dates, with or without a time of the day."""
    seen = [c for c in cells if c.strip()][:200]
    return bool(seen) and sum(map(_is_date, seen)) >= 0.8 * len(seen)


def is_clock_text(cells: Sequence[str]) -> bool:
    """Whether a column holds times of the day alone."""
    seen = [c for c in cells if c.strip()][:200]
    return bool(seen) and sum(bool(_CLOCK.match(c)) and ":" in c for c in seen) >= 0.8 * len(seen)


def _is_date(text: str) -> bool:
    return bool(_NUMERIC.match(text) or _YEAR_FIRST.match(text)) or _named_format([text]) is not None


def _named_format(cells: Sequence[str]) -> str | None:
    """The first of the known formats with names of months, or without signs, that fits all."""
    text = pd.Series([c.strip() for c in cells if c.strip()][:200])
    for form in _NAMED:
        if len(text) and pd.to_datetime(text, format=form, errors="coerce").notna().mean() > 0.95:
            return form
    return None


def is_time_name(name: str) -> bool:
    """Whether a header is one of the words for time."""
    said = words(name)
    return bool(said) and (said[0] in _NAMES or said[-1] in _NAMES)


def written(cells: Sequence[str]) -> tuple[dict[str, Any], list[Guess]]:
    """Options of ``time`` for a column of texts, and what was guessed."""
    texts = [c for c in cells if c.strip()]
    if any(_YEAR_FIRST.match(c) for c in texts[:50]) and not any(_HALF.search(c) for c in texts[:50]):
        return {}, [Guess("time", "year first (ISO 8601)", "sure", f"such as {texts[0].strip()!r}")]
    parts = [m.groups() for c in texts if (m := _NUMERIC.match(c))]
    if parts:
        return _order(texts, parts)
    form = _named_format(texts)
    if form:
        return {"format": form}, [Guess("time.format", form, "sure", f"such as {texts[0].strip()!r}")]
    return {}, [Guess("time", "not understood", "unsure", f"such as {texts[0].strip()!r}; give time.format")]


def _order(texts: Sequence[str], parts: Sequence[tuple[str, ...]]) -> tuple[dict[str, Any], list[Guess]]:
    first, second = (np.array([int(p[i]) for p in parts]) for i in (0, 1))
    shown = f"such as {texts[0].strip()!r}"
    day, month = int((first > 12).sum()), int((second > 12).sum())
    if day != month:
        sureness: Sureness = "sure" if min(day, month) == 0 else "likely"
        why = f"{max(day, month)} dates can be read in no other way" + (f", {min(day, month)} contradict" if min(
            day, month) else "")  # fmt: skip
        return {"day_first": day > month}, [Guess("time.day_first", str(day > month).lower(), sureness, why)]
    smooth = [_steps(texts, order) for order in (True, False)]
    if max(smooth) > 2 * min(smooth):
        found = smooth[0] < smooth[1]
        return {"day_first": found}, [
            Guess("time.day_first", str(found).lower(), "likely", "the other order jumps to and fro")
        ]
    american = any(_HALF.search(t) for t in texts[:50]) or ("." not in texts[0].split()[0] and "/" in texts[0])
    return {"day_first": not american}, [
        Guess("time.day_first", str(not american).lower(), "unsure", f"{shown}: both orders fit", ("true", "false"))
    ]


def _steps(texts: Sequence[str], day_first: bool) -> float:
    """How far times run in all, there and back, against the span; 1 when they only go forward."""
    date = pd.to_datetime(pd.Series(texts), dayfirst=day_first, format="mixed", errors="coerce").dropna()
    path = date.diff().abs().sum().total_seconds()
    return float(path / max(1.0, (date.max() - date.min()).total_seconds()))


def counted(name: str, values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[dict[str, Any], list[Guess]] | None:
    """Options of ``time`` for a column of rising numbers; None where it is no count."""
    seen = values[np.isfinite(values)]
    if len(seen) < 3 or np.mean(np.diff(seen) > 0) < 0.95:
        return None
    low, high = float(seen[0]), float(seen[-1])
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if 3e8 * scale < low and high < 4e9 * scale:
            return {"unit": unit}, [Guess("time.unit", unit, "sure", "counts from 1970, UTC")]
    if low > 25_000 and high < 60_000:
        return {"unit": "d", "origin": "1899-12-30"}, [
            Guess("time.unit", "d", "likely", "a spreadsheet's days since 1899-12-30")
        ]
    said = [w for w in words(name) if w in _COUNTS]
    if not said and not is_time_name(name) and name.strip().lower() != "t":
        return None
    step = float(np.median(np.diff(seen)))
    unit = _COUNTS[said[-1]] if said else "s" if step >= 5 and step % 5 == 0 else "h"
    return {"unit": unit, "origin": "2000-01-01T00:00:00"}, [
        Guess("time.unit", unit, "likely" if said else "unsure", f"steps of {step:g}", ("s", "min", "h", "d")),
        Guess("time.origin", "2000-01-01T00:00:00", "unsure", "nothing says when the count begins"),
    ]


def carries_offset(cells: Sequence[str]) -> bool:
    """Whether texts say their own offset from UTC."""
    return any(_OFFSET.search(c) and ":" in c for c in cells[:50])


# Clocks change in Europe at 01:00 UTC, in North America at 02:00 local time.
def clock_changes(times: pd.DatetimeIndex) -> Guess | None:
    """What an hour left out on a Sunday in spring says of the zone of local times; None where none is."""
    step = pd.Series(times).diff().median()
    if not len(times) or step > pd.Timedelta("30min"):
        return None
    for zone, sundays in (("Europe/Berlin", _last_march), ("America/New_York", _second_march)):
        for year in sorted(set(times.year)):
            at = sundays(year) + pd.Timedelta("2h")
            if not times.min() + pd.Timedelta("1D") < at < times.max() - pd.Timedelta("1D"):
                continue
            inside = ((times >= at) & (times < at + pd.Timedelta("1h"))).sum()
            beside = ((times >= at - pd.Timedelta("1h")) & (times < at)).sum()
            if beside and not inside:
                return Guess("zone", zone, "unsure", f"the hour after {at:%Y-%m-%d %H:%M} is left out, as in {zone}")
    return None


def _last_march(year: int) -> pd.Timestamp:
    end = pd.Timestamp(year, 3, 31)
    return end - pd.Timedelta(days=(end.weekday() + 1) % 7)


def _second_march(year: int) -> pd.Timestamp:
    start = pd.Timestamp(year, 3, 1)
    return start + pd.Timedelta(days=(6 - start.weekday()) % 7 + 7)
