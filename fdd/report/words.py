"""Symbols, codes, times and numbers in a technician's words."""

from __future__ import annotations

import math
import re
from datetime import datetime
from zoneinfo import ZoneInfo

from fdd.records import NANOSECONDS, AlarmState
from fdd.report.site import ComponentInfo

DAY = 86400 * NANOSECONDS
HOUR = 3600 * NANOSECONDS

STATES = {
    AlarmState.RAISED: "open, nobody has confirmed it yet",
    AlarmState.ACKNOWLEDGED: "open, somebody has seen it",
    AlarmState.SHELVED: "set aside for a time",
    AlarmState.SUPPRESSED: "follows from another finding",
    AlarmState.RETURNED: "the signs are gone, waiting to be closed",
    AlarmState.CLEARED: "closed",
}

COUNTS = {
    "accepted": "samples used",
    "late": "samples that came too late",
    "duplicate": "samples that came twice",
    "no_value": "samples without a usable value",
    "unknown_point": "samples of points that the site file does not name",
    "clock_jump": "samples with an impossible time stamp",
    "received": "samples received",
    "rejected": "samples rejected",
}

_UNITS = {"degC": "°C", "1": ""}
_RAISED = str.maketrans("-0123456789ny.", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹ⁿʸ·")
# SI unit to (from which magnitude on, factor, unit shown); the first that fits is taken.
_SCALES: dict[str, tuple[tuple[float, float, str], ...]] = {
    "W": ((1e6, 1e-6, "MW"), (1e3, 1e-3, "kW")),
    "J/K": ((1e6, 1e-6, "MJ/K"), (1e3, 1e-3, "kJ/K")),
    "W/K": ((1e6, 1e-6, "MW/K"), (1e3, 1e-3, "kW/K")),
    "Pa": ((1e5, 1e-5, "bar"), (1e2, 1e-3, "kPa")),
    "J": ((1e6, 1.0 / 3.6e6, "kWh"),),
}


def scale(unit: str, magnitude: float, *, difference: bool = False) -> tuple[float, str]:
    """Factor and unit in which people read a quantity of about ``magnitude`` [SI]."""
    if difference and unit == "degC":
        return 1.0, "K"
    for least, factor, shown in _SCALES.get(unit, ()):
        if abs(magnitude) >= least:
            return factor, shown
    return 1.0, _UNITS.get(unit) or re.sub(r"\^(-?[0-9ny.]+)", lambda m: m[1].translate(_RAISED), unit).strip("1")


def quantity(value: float | None, unit: str, *, difference: bool = False, sign: bool = False) -> str:
    """A value with its unit, to the digits that matter; an en dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    factor, shown = scale(unit, value, difference=difference)
    x = value * factor
    return f"{_number(x, shown, sign)} {shown}".rstrip()


def interval(low: float, high: float, unit: str) -> str:
    """Two values with their unit."""
    factor, shown = scale(unit, max(abs(low), abs(high)))
    return f"{_number(low * factor, shown)} to {_number(high * factor, shown)} {shown}".rstrip()


def _number(x: float, shown: str, sign: bool = False) -> str:
    if shown == "°C":
        text = f"{x:.1f}"
    elif shown == "K":
        text = f"{x:{'+' if sign else ''}.{2 if abs(x) >= 0.05 else 3}f}"
    else:
        text = _digits(x, sign)
    if x < 0 and not text.strip("-0."):  # rounded to nothing: no side is claimed
        return text.lstrip("-")
    return text.replace("-", "−", 1) if x < 0 else text


def _digits(x: float, sign: bool) -> str:
    lead = "+" if sign else ""
    if x == 0:
        return "0"
    if not 1e-3 <= abs(x) < 1e6:
        return f"{x:{lead}.2e}"
    decimals = max(0, 2 - math.floor(math.log10(abs(x))))
    return f"{x:{lead}.{min(decimals, 5)}f}"


def likely(share: float) -> str:
    """A likelihood as people read it: nothing that was weighed is impossible or certain."""
    return "under 1 %" if share < 0.01 else "over 99 %" if share > 0.99 else percent(share)


def percent(share: float) -> str:
    """A share as people read it."""
    return f"{100 * share:.0f} %"


def local(time: int, tz: ZoneInfo) -> str:
    """Event time as a technician writes it, in the site's zone."""
    return f"{_at(time, tz):%a %-d %b %Y, %H:%M}"


def local_day(time: int, tz: ZoneInfo) -> str:
    """The local day of an event time."""
    return f"{_at(time, tz):%-d %b %Y}"


def _at(time: int, tz: ZoneInfo) -> datetime:
    return datetime.fromtimestamp(time / NANOSECONDS, tz)


def duration(nanoseconds: int) -> str:
    """A span of time, in the two units that matter."""
    minutes = round(nanoseconds / NANOSECONDS / 60)
    days, rest = divmod(minutes, 1440)
    hours, minutes = divmod(rest, 60)
    if days >= 7:
        return f"{days} days"
    if days:
        return f"{days} day{'s' * (days > 1)}" + (f" {hours} h" if hours else "")
    return f"{hours} h {minutes} min" if hours and minutes else f"{hours} h" if hours else f"{minutes} min"


def in_words(text: str, info: ComponentInfo) -> str:
    """A sentence of the service with symbols replaced by what they mean."""
    known = {s for s in (*info.outputs, *info.parameters) if info.meaning(s) != s}
    if not known:
        return text
    patterns = (_symbol_pattern(s) for s in sorted(known, key=len, reverse=True))
    return re.sub("|".join(patterns), lambda m: f"the {info.meaning(m[0])}", text)


def _symbol_pattern(symbol: str) -> str:
    bare = re.escape(symbol)
    if re.fullmatch(r"[a-z]|A|I", symbol):  # also words of English: only where nothing but a symbol can stand
        return rf"^{bare}(?= is )|(?<=explain ){bare}$"
    return rf"(?<![\w/@.-]){bare}(?![\w/@-])"


def inside(text: str) -> str:
    """A sentence as it stands inside another: its capital goes, unless it begins an abbreviation."""
    return text[:1].lower() + text[1:] if text[1:2].islower() or text[1:2] == " " else text


def sentence(text: str) -> str:
    """With a capital at the start and a full stop at the end."""
    text = text.strip()
    if not text:
        return ""
    return text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")
