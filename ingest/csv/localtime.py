"""Event time from the texts and numbers in a file, with a defined outcome for every local time that is odd."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.records import IntArray
from ingest.csv.options import TimeOptions
from ingest.source import Refused

ALL = ""  # key of the one series of a wide file
NOT_A_TIME = np.iinfo(np.int64).min
_UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9, "d": 86400 * 10**9}
_YEAR_FIRST = re.compile(r"\s*\d{4}[-/.]?\d{2}")
_NUMERIC = re.compile(
    r"(?P<a>\d{1,2})(?P<sign>[./-])(?P<b>\d{1,2})(?P=sign)(?P<year>\d{4}|\d{2})"
    r"(?:[ T,]+(?P<hour>\d{1,2})[:.](?P<minute>\d{2})(?:[:.](?P<second>\d{2}(?:[.,]\d+)?))?)?"
    r"\s*(?P<half>[AaPp])?(?:\.?[Mm]\.?)?\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?"
)
"""A date of day, month and year in numbers, with or without a time: 13/02/2026 14:05, 2.13.26 2:05:10 PM."""


@dataclass
class Clock:
    """Turns a file's time columns into nanoseconds UTC.

    ``counts`` tells what happened to the odd ones: ``time not understood``, ``local time does not exist`` (rejected
    unless shifted), ``local time ambiguous`` (resolved as configured).
    """

    options: TimeOptions
    zone: str
    counts: dict[str, int] = field(default_factory=dict)
    previous: dict[str, int] = field(default_factory=dict)

    def counted(self, value: pd.Series) -> IntArray:
        """Times of a column that counts units since the origin; NOT_A_TIME where it is no number."""
        number = pd.to_numeric(value, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        good = np.isfinite(number)
        scale = _UNITS[self.options.unit or "s"]
        time = np.full(len(number), NOT_A_TIME, dtype=np.int64)
        whole = np.floor(number[good])
        # Whole units in integers: 1.6e18 ns does not fit the 53 bits of a float.
        time[good] = self.origin() + whole.astype(np.int64) * scale
        # 140.8333333 h is meant to be a whole second: decimals are good to a millisecond (of seconds: a microsecond).
        grain = min(max(1, scale // 10**6), 10**6)
        time[good] += np.rint((number[good] - whole) * scale / grain).astype(np.int64) * grain
        self._count("time not understood", int((~good).sum()))
        return time

    def origin(self) -> int:
        """Time of a count of zero [ns]."""
        return self.moment(self.options.origin, "time.origin")

    def moment(self, text: str, key: str) -> int:
        """One time from the site file [ns]."""
        try:
            stamp = pd.Timestamp(text)
            local = stamp.tz_localize(self.zone) if stamp.tzinfo is None else stamp
        except Exception as error:  # pandas raises many kinds
            raise Refused(f"{key}: {text!r} is no time ({error}); write it like 2024-02-05 14:26") from None
        return int(local.tz_convert("UTC").as_unit("ns").value)

    def stepped(self, rows: IntArray) -> IntArray:
        """Times of rows without a time column, numbered from the first row of the first file."""
        start = self.moment(self.options.start or "", "time.start")
        return start + rows * round((self.options.step or 0.0) * 10**9)

    def written(self, text: pd.Series, series: NDArray[np.object_] | None = None) -> IntArray:
        """Times of a text column; NOT_A_TIME where rejected. ``series`` names the point of each row in long files."""
        parsed = self._parse(text)
        if isinstance(parsed.dtype, pd.DatetimeTZDtype):
            time = parsed.dt.tz_convert("UTC").dt.tz_localize(None)
            return self._nanoseconds(time)
        return self._localise(parsed, series)

    def _parse(self, text: pd.Series) -> pd.Series:
        if isinstance(text.dtype, pd.DatetimeTZDtype) or pd.api.types.is_datetime64_any_dtype(text.dtype):
            return text
        text = text.astype("str").str.strip()
        try:
            if self.options.format:
                zoned = "%z" in self.options.format
                return pd.to_datetime(text, format=self.options.format, errors="coerce", utc=zoned)
            if self.options.day_first is not None:
                text = self._year_first(text, self.options.day_first)
            else:
                self._require_year_first(text)
            zoned = bool(text.str.contains(r"(?:Z|[+-]\d{2}:?\d{2})$", regex=True).any())
            return pd.to_datetime(text, format="ISO8601", errors="coerce", utc=zoned)
        except ValueError as error:
            raise Refused(f"time {text.iloc[0]!r} is not understood ({error}); give time.format") from None

    def _year_first(self, text: pd.Series, day_first: bool) -> pd.Series:
        """Dates in numbers as ISO texts, in the declared order and no other; other texts as they are.

        Raises
        ------
        Refused : most dates that tell the two orders apart say the other one.
        """
        part = text.str.extract(f"^{_NUMERIC.pattern}$")
        numeric = part["a"].notna()
        if not numeric.any():
            return text
        part = part[numeric]
        day, month = (part["a"], part["b"]) if day_first else (part["b"], part["a"])
        self._refuse_other_order(text[numeric], day.astype(int), month.astype(int), day_first)
        year = part["year"].where(part["year"].str.len() == 4, "20" + part["year"])
        hour = part["hour"].fillna("0").astype(int)
        half = part["half"].str.lower()
        hour = hour.where(half.isna(), hour % 12 + 12 * (half == "p"))
        second = part["second"].fillna("00").str.replace(",", ".")
        clock = hour.astype(str).str.zfill(2) + ":" + part["minute"].fillna("00") + ":" + second
        iso = year + "-" + month.str.zfill(2) + "-" + day.str.zfill(2) + " " + clock + part["zone"].fillna("")
        return text.where(~numeric, iso.reindex(text.index))

    @staticmethod
    def _refuse_other_order(text: pd.Series, day: pd.Series, month: pd.Series, day_first: bool) -> None:
        other = (month > 12) & (day <= 12)
        if other.sum() > ((day > 12) & (month <= 12)).sum():
            declared, opposite = str(day_first).lower(), str(not day_first).lower()
            raise Refused(
                f"time {text[other].iloc[0]!r} has no month {month[other].iloc[0]} as day_first: {declared} reads it, "
                f"and {int(other.sum())} of {len(text)} rows are like it; "
                f"set time.day_first: {opposite}, or give time.format"
            )

    @staticmethod
    def _require_year_first(text: pd.Series) -> None:
        for value in text.head(20):
            if value and value[0].isdigit() and not _YEAR_FIRST.match(value):
                raise Refused(
                    f"time {value!r} may be read in more than one way; "
                    "say time.day_first: true or false, time.format, or time.unit if it is a count"
                )

    def _nanoseconds(self, time: pd.Series) -> IntArray:
        bad = time.isna().to_numpy()
        out = time.astype("datetime64[ns]").to_numpy().astype(np.int64)
        out[bad] = NOT_A_TIME
        self._count("time not understood", int(bad.sum()))
        return np.asarray(out)

    def _localise(self, local: pd.Series, series: NDArray[np.object_] | None) -> IntArray:
        """UTC of local times; each odd one has its configured outcome."""
        bad = local.isna().to_numpy()
        shift = "shift_forward" if self.options.nonexistent == "shift" else "NaT"
        known = local.where(~bad, pd.Timestamp("2000-01-01"))
        late = self._utc(known, shift, first=False)
        early = self._utc(known, shift, first=True)
        gone = (self._utc(known, "NaT", first=True) == NOT_A_TIME) & ~bad
        self._count("time not understood", int(bad.sum()))
        self._count("local time does not exist", int(gone.sum()))
        time = self._choose(early, late, bad, series)
        time[bad] = NOT_A_TIME
        return time

    def _utc(self, local: pd.Series, shift: str, *, first: bool) -> IntArray:
        which = np.full(len(local), first)
        zoned = local.dt.tz_localize(self.zone, ambiguous=which, nonexistent=shift)
        utc = zoned.dt.tz_convert("UTC").dt.tz_localize(None).astype("datetime64[ns]").to_numpy()
        return np.asarray(utc.astype(np.int64))

    def _choose(
        self, early: IntArray, late: IntArray, bad: NDArray[np.bool_], series: NDArray[np.object_] | None
    ) -> IntArray:
        twice = (early != late) & ~bad
        self._count("local time ambiguous", int(twice.sum()))
        way = self.options.ambiguous
        time = np.array(early)
        if way == "later":
            time[twice] = late[twice]
        elif way == "reject":
            time[twice] = NOT_A_TIME
        elif way == "by order":
            self._by_order(time, late, twice, series)
        self._remember(time, series)
        return time

    def _by_order(
        self, time: IntArray, late: IntArray, twice: NDArray[np.bool_], series: NDArray[np.object_] | None
    ) -> None:
        """The first pass is summer time, until time would no longer move on (for the point, in long files)."""
        if not twice.any():
            return
        last = dict(self.previous)
        start = int(np.argmax(twice))
        stop = len(twice) - int(np.argmax(twice[::-1]))
        if series is None and start:
            last[ALL] = int(time[start - 1])
        for i in range(0 if series is not None else start, stop):
            key = ALL if series is None else str(series[i])
            if twice[i] and time[i] <= last.get(key, NOT_A_TIME):
                time[i] = late[i]
            last[key] = max(last.get(key, NOT_A_TIME), int(time[i]))

    def _remember(self, time: IntArray, series: NDArray[np.object_] | None) -> None:
        if not len(time):
            return
        if series is None:
            self.previous[ALL] = int(time[-1])
        else:
            names, last = np.unique(series[::-1].astype(str), return_index=True)
            self.previous.update({str(n): int(time[::-1][i]) for n, i in zip(names, last, strict=True)})

    def _count(self, reason: str, number: int) -> None:
        if number:
            self.counts[reason] = self.counts.get(reason, 0) + number
