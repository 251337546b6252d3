"""Steady-state points from raw building data, and an account of what was rejected and why.

A moving window is accepted where every signal's standard deviation stays within a few sensor errors, its slope within a
limit an hour, the machine has run for half an hour, its load is high enough, and one machine
is staged; it becomes one point (the averages) and the next window starts after it. Every raw sample ends up in a point
or under exactly one reason.

References: T.M. Rossi and J.E. Braun, HVAC&R Research 3 (1997); M. Kim et al., Int. J. Refrigeration 31 (2008);
S. Cao and R.R. Rhinehart, J. Process Control 5 (1995).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fdd.chiller_eiv.errors import RAW_UNITS, Instrumentation, heat_balance, regressors
from fdd.chiller_eiv.forms import BASE
from fdd.chiller_eiv.model import ChillerError
from fdd.records import NANOSECONDS, FloatArray, IntArray, JsonObject

REASONS = (
    "kept",
    "machine off",
    "starting or staging",
    "missing value or gap",
    "temperature not steady",
    "flow, load or power not steady",
    "temperature drifts",
    "flow, load or power drifts",
    "load too low",
    "several machines staged",
    "no complete window left",
)
(
    KEPT,
    OFF,
    STARTING,
    MISSING,
    NOISY_TEMPERATURE,
    NOISY_FLOW,
    DRIFTING_TEMPERATURE,
    DRIFTING_FLOW,
    LOW_LOAD,
    STAGED,
    INCOMPLETE,
) = range(len(REASONS))

WINDOWS = (2700.0, 1800.0, 1200.0, 900.0, 600.0, 300.0)
"""Lengths of a window that are tried, the longest first [s]."""
LEAST_SAMPLES = 6
"""Of a window that is shorter than the usual one."""
ENOUGH = 0.25
"""Share of the running samples in steady points from which a longer window is preferred to more points."""
QUIET = 25.0
"""Percentile of the windows' spreads that is taken for a quiet window's."""
LARGEST_NOISE = (0.2, 0.02)
"""The largest spread of a quiet window that is believed: of a temperature [K], and as a share of the reading."""

_TEMPERATURES = ("T_cdi", "T_chi", "T_cho", "T_cdo")
_FLOWS = ("flow_ch", "load", "power", "flow_cd")


@dataclass(frozen=True, slots=True)
class SteadyLimits:
    """What counts as steady.

    Attributes
    ----------
    window : length of a window [s]
    spread : largest standard deviation, in one-sample sensor errors
    least_temperature_sd : sensor error assumed at least, for the resolution of the building's trend [K]
    least_relative_sd : the same for flow, load and power, as a share of the reading
    temperature_slope : [K/h]
    relative_slope : of flow, load and power [1/h]
    settling : time after a start or a change of stage [s]
    least_load : part-load ratio below which points are dropped [1]; needs the rated load
    balance : largest relative error of Q_cd = Q + E, where measured, of points that parameters are estimated from
    gap : longest time between two samples, in sampling periods
    noise : spread of a quiet window that the data themselves show, by quantity [K, or a share of the reading]
    """

    window: float = 2700.0
    spread: float = 3.0
    least_temperature_sd: float = 0.05
    least_relative_sd: float = 0.01
    temperature_slope: float = 1.0
    relative_slope: float = 0.03
    settling: float = 1800.0
    least_load: float = 0.3
    balance: float = 0.08
    gap: float = 2.5
    noise: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SteadyPoints:
    """Steady points of one chiller.

    Attributes
    ----------
    time : shape (n,), end of each window [ns]
    samples : shape (n,), readings averaged in each
    raw : averaged readings, shape (n,) each, in the units of ``errors.RAW_UNITS``
    standard_error : empirical standard error of those averages, shape (n,) each
    balance : shape (n,), relative error of Q_cd = Q + E; NaN where not measured
    """

    time: IntArray
    samples: IntArray
    raw: Mapping[str, FloatArray]
    standard_error: Mapping[str, FloatArray] = field(default_factory=dict)
    balance: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.time)

    def regressors(
        self, instruments: Instrumentation, measured: tuple[str, ...] = BASE
    ) -> tuple[FloatArray, FloatArray]:
        """Measurements (n, m) and covariances (n, m, m) for a regression form, see :func:`errors.regressors`."""
        return regressors(self.raw, self.samples, instruments, measured)

    def select(self, which: NDArray[np.bool_] | IntArray | slice) -> SteadyPoints:
        """Some of the points."""
        return SteadyPoints(
            self.time[which],
            self.samples[which],
            {k: v[which] for k, v in self.raw.items()},
            {k: v[which] for k, v in self.standard_error.items()},
            self.balance[which],
        )

    def closing(self, limit: float) -> NDArray[np.bool_]:
        """Whose heat balance closes within ``limit``, or is not measured, shape (n,)."""
        return np.asarray(~(np.abs(self.balance) > limit))

    def days(self) -> IntArray:
        """Index of each point's day (UTC), 0 for the first day: the groups of the jackknife."""
        day = self.time // (86_400 * NANOSECONDS)
        return np.asarray(np.unique(day, return_inverse=True)[1], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class SteadyReport:
    """What became of every raw sample.

    Attributes
    ----------
    reason : shape (N,), index into ``REASONS``
    period : sampling period found [s]
    points : number of steady points made
    """

    reason: NDArray[np.int8]
    period: float
    points: int

    def counts(self) -> dict[str, int]:
        """Samples by reason, those without samples left out; they add up to the number of samples."""
        found = np.bincount(self.reason, minlength=len(REASONS))
        return {r: int(c) for r, c in zip(REASONS, found, strict=True) if c}


def steady_points(
    time: IntArray,
    raw: Mapping[str, FloatArray],
    instruments: Instrumentation,
    *,
    rated_load: float,
    limits: SteadyLimits | None = None,
    running: NDArray[np.bool_] | None = None,
    others_running: NDArray[np.bool_] | None = None,
    settled: bool = False,
) -> tuple[SteadyPoints, SteadyReport]:
    """Find the steady points of one chiller in raw data.

    Parameters
    ----------
    time : shape (N,), increasing [ns]
    raw : readings, shape (N,) each, in the units of ``errors.RAW_UNITS``; NaN is missing
    instruments : what is measured and how well
    rated_load : rated capacity [W], for the part-load test
    limits : what counts as steady
    running : shape (N,), whether the compressor runs; taken from power above 1 % of the rated load if not given
    others_running : shape (N,), whether another machine shares the water; taken from ``others`` if not given
    settled : whether the machine had been running for long enough before the first sample

    Raises
    ------
    ChillerError : unknown or missing quantities, or times that do not increase
    """
    limits = limits or SteadyLimits()
    _check(time, raw, instruments)
    points, reason, period, _ = _pass(
        time, raw, instruments, rated_load, limits, running, others_running, (settled, -1, False), None, None
    )
    return points, SteadyReport(reason, period, len(points))


Carried = tuple[bool, int, bool]
"""What a scan needs of what was before: whether the machine had run for long, since when it runs or staging changed
[ns] (-1: not known), and whether others ran at the last sample."""


def _pass(
    time: IntArray,
    raw: Mapping[str, FloatArray],
    instruments: Instrumentation,
    rated_load: float,
    limits: SteadyLimits,
    running: NDArray[np.bool_] | None,
    others_running: NDArray[np.bool_] | None,
    before: Carried,
    period: float | None,
    tested: tuple[str, ...] | None,
) -> tuple[SteadyPoints, NDArray[np.int8], float, tuple[int, int]]:
    """Points, the fate of every sample, the sampling period [s], and where the scan stands: the first sample that may
    still serve, and since when the machine runs [ns]."""
    if period is None:
        period = float(np.median(np.diff(time))) / NANOSECONDS if len(time) > 1 else limits.window / 3
    names = tuple(k for k in RAW_UNITS if k in raw)
    tested = tested or steady_quantities(raw, instruments)
    on = running if running is not None else ~(raw["power"] <= 0.01 * rated_load)
    others = others_running
    if others is None:
        others = raw["others"] > 0.5 if "others" in raw else np.zeros(len(time), dtype=bool)
    sd_limit, slope_limit = _limits(raw, tested, instruments, limits)
    window = max(3, round(limits.window / period))
    settled, began, staged = before
    reason, ends, start, began = _scan(
        np.ascontiguousarray(time, dtype=np.int64),
        np.stack([np.asarray(raw[k], dtype=float) for k in tested], axis=1),
        np.array([k in _TEMPERATURES for k in tested]),
        on,
        others,
        window,
        sd_limit,
        slope_limit,
        round(limits.settling * NANOSECONDS),
        round(limits.gap * period * NANOSECONDS),
        settled,
        began,
        staged,
    )
    points = _average(time, raw, names, ends, window)
    keep, why = _accept(points, instruments, rated_load, limits)
    for end, code in zip(ends[~keep], why[~keep], strict=True):
        reason[end - window + 1 : end + 1] = code
    return points.select(keep), reason, period, (start, began)


def steady_quantities(raw: Mapping[str, FloatArray], instruments: Instrumentation) -> tuple[str, ...]:
    """What must be steady: what is needed, and the condenser side where it is measured throughout.

    A dead extra sensor must not cost every point.
    """
    needed = instruments.needed()
    extra = [k for k in ("flow_cd", "T_cdo") if k in raw and np.isfinite(raw[k]).mean() > 0.9]
    return tuple(k for k in (*_TEMPERATURES, *_FLOWS) if k in raw and k in (*needed, *extra))


class SteadyStream:
    """Steady points of samples that come in parts: the same as of the whole, wherever it is cut.

    Parameters
    ----------
    instruments, rated_load, limits : as for :func:`steady_points`
    period : sampling period [s]
    tested : quantities that must be steady
    """

    def __init__(
        self,
        instruments: Instrumentation,
        rated_load: float,
        limits: SteadyLimits,
        period: float,
        tested: Sequence[str],
    ) -> None:
        self._instruments, self._rated, self._limits, self._period = instruments, rated_load, limits, period
        self._tested = tuple(tested)
        self._time: IntArray = np.zeros(0, dtype=np.int64)
        self._table = np.zeros((0, len(RAW_UNITS)))
        self._began, self._staged = -1, False

    @property
    def length(self) -> int:
        """Of a point's window [ns]."""
        return round(max(3, round(self._limits.window / self._period)) * self._period * NANOSECONDS)

    def take(self, time: IntArray, table: FloatArray) -> tuple[SteadyPoints, dict[str, int]]:
        """Take samples.

        Parameters
        ----------
        time : shape (N,) [ns]; table : shape (N, quantities), in the order of ``errors.RAW_UNITS``

        Returns
        -------
        The points that they complete, and the samples whose fate is settled by reason
        """
        self._time, self._table = np.concatenate([self._time, time]), np.vstack([self._table, table])
        kept = [(i, k) for i, k in enumerate(RAW_UNITS) if k in self._tested or np.isfinite(self._table[:, i]).any()]
        raw = {k: self._table[:, i] for i, k in kept}
        others = raw["others"] > 0.5 if "others" in raw else None
        points, reason, _, (start, began) = _pass(
            self._time,
            raw,
            self._instruments,
            self._rated,
            self._limits,
            None,
            others,
            (False, self._began, self._staged),
            self._period,
            self._tested,
        )
        self._began = began
        self._staged = bool(others[-1]) if others is not None else False
        window = max(3, round(self._limits.window / self._period))
        first = len(self._time) if start < 0 else max(start, len(self._time) - window + 1)
        self._time, self._table = self._time[first:], self._table[first:]
        found = np.bincount(reason[:first], minlength=len(REASONS))
        return points, {r: int(c) for r, c in zip(REASONS, found, strict=True) if c}

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {
            "time": self._time.copy(),
            "table": self._table.copy(),
            "began": self._began,
            "staged": self._staged,
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._time = np.asarray(state["time"], dtype=np.int64)
        self._table = np.asarray(state["table"], dtype=float).reshape(-1, len(RAW_UNITS))
        self._began, self._staged = int(state["began"]), bool(state["staged"])


def propose_limits(
    time: IntArray,
    raw: Mapping[str, FloatArray],
    instruments: Instrumentation,
    *,
    rated_load: float,
    limits: SteadyLimits,
    given: Collection[str] = (),
) -> SteadyLimits:
    """Limits that fit the sampling and the quietness of the data; what the site gives stays.

    The longest window is taken that leaves ``ENOUGH`` of the running samples in points, or else the one that leaves
    most; a shorter window may drift faster, and needs less time after a start.
    """
    if len(time) < 2:
        return limits
    period = float(np.median(np.diff(time))) / NANOSECONDS
    running = ~(raw["power"] <= 0.01 * rated_load)
    best, most = limits, -1.0
    for window in (limits.window,) if "window" in given else WINDOWS:
        if window < limits.window and window / period < LEAST_SAMPLES:
            continue
        candidate = _for_window(window, time, raw, instruments, running, limits, given, period)
        points, _ = steady_points(time, raw, instruments, rated_load=rated_load, limits=candidate)
        share = float(points.samples.sum()) / max(float(running.sum()), 1.0)
        # A shorter window has to earn its noise.
        if share > 1.2 * most:
            best, most = candidate, share
        if share >= ENOUGH:
            break
    return best


def _for_window(
    window: float,
    time: IntArray,
    raw: Mapping[str, FloatArray],
    instruments: Instrumentation,
    running: NDArray[np.bool_],
    limits: SteadyLimits,
    given: Collection[str],
    period: float,
) -> SteadyLimits:
    size, shorter = max(3, round(window / period)), np.sqrt(limits.window / window)
    table: dict[str, object] = {
        "window": window,
        "temperature_slope": limits.temperature_slope * float(shorter),
        "relative_slope": limits.relative_slope * float(shorter),
        "settling": min(limits.settling, 2 * window),
        "noise": {k: _quiet(raw[k][running], size, k in _TEMPERATURES) for k in steady_quantities(raw, instruments)},
    }
    return replace(limits, **{k: v for k, v in table.items() if k not in given})  # type: ignore[arg-type]


def _quiet(values: FloatArray, size: int, temperature: bool) -> float:
    """Spread within a quiet window of this many samples."""
    n = len(values) // size
    blocks = values[: n * size].reshape(n, size)
    blocks = blocks[np.isfinite(blocks).all(1)]
    if not len(blocks):
        return 0.0
    spread = blocks.std(1, ddof=1)
    if not temperature:
        spread = spread / np.maximum(np.abs(blocks.mean(1)), 1e-9)
    return float(min(np.percentile(spread, QUIET) / 2, LARGEST_NOISE[0 if temperature else 1]))


def _check(time: IntArray, raw: Mapping[str, FloatArray], instruments: Instrumentation) -> None:
    unknown = [k for k in raw if k not in RAW_UNITS]
    if unknown:
        raise ChillerError(f"unknown chiller quantities {', '.join(unknown)}; known: {', '.join(RAW_UNITS)}")
    missing = [k for k in instruments.needed() if k not in raw]
    if missing:
        raise ChillerError(
            f"the data lack {', '.join(missing)}, needed with load_from={instruments.load_from!r} and "
            f"chilled_water={instruments.chilled_water!r}"
        )
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        raise ChillerError(f"times must increase; sample {back[0] + 1} does not: sort the data and drop duplicates")


def _limits(
    raw: Mapping[str, FloatArray], tested: tuple[str, ...], instruments: Instrumentation, limits: SteadyLimits
) -> tuple[FloatArray, FloatArray]:
    """Absolute limits for temperatures, relative ones for the rest."""
    sd, slope = np.empty(len(tested)), np.empty(len(tested))
    for i, k in enumerate(tested):
        if k in _TEMPERATURES:
            own = max(limits.least_temperature_sd, limits.noise.get(k, 0.0))
            sd[i] = limits.spread * max(instruments.sd_of(k, 0.0), own)
            slope[i] = limits.temperature_slope
        else:
            values = np.abs(raw[k][np.isfinite(raw[k])])
            typical = float(np.percentile(values, 75)) if len(values) else 1.0
            share = instruments.sd_of(k, typical) / typical if typical > 0 else 0.0
            sd[i] = limits.spread * max(share, limits.least_relative_sd, limits.noise.get(k, 0.0))
            slope[i] = limits.relative_slope
    return sd, slope


@njit(cache=True)
def _window_test(
    time: IntArray, values: FloatArray, temperature: NDArray[np.bool_], sd_limit: FloatArray, slope_limit: FloatArray
) -> int:
    """Reason why one window of values (w, s) is not steady, or KEPT."""
    w, s = values.shape
    centre = 0.0
    for i in range(w):
        centre += (time[i] - time[0]) / 3.6e12
    centre /= w
    spread = 0.0
    for i in range(w):
        spread += ((time[i] - time[0]) / 3.6e12 - centre) ** 2
    worst: int = 0
    for j in range(s):
        mean = 0.0
        for i in range(w):
            mean += values[i, j]
        mean /= w
        if not np.isfinite(mean):
            return 3
        square = 0.0
        cross = 0.0
        for i in range(w):
            d = values[i, j] - mean
            square += d * d
            cross += d * ((time[i] - time[0]) / 3.6e12 - centre)
        sd = np.sqrt(square / (w - 1))
        slope = abs(cross / spread)
        # A slope is only called a drift where it stands out of the noise it is computed from.
        noise = sd / np.sqrt(spread)
        size = 1.0 if temperature[j] else max(abs(mean), 1e-9)
        code = 0
        if sd > sd_limit[j] * size:
            code = 4 if temperature[j] else 5
        elif slope > slope_limit[j] * size and slope > 2.0 * noise:
            code = 6 if temperature[j] else 7
        if code and (worst == 0 or code < worst):
            worst = code
    return worst


@njit(cache=True)
def _scan(
    time: IntArray,
    values: FloatArray,
    temperature: NDArray[np.bool_],
    on: NDArray[np.bool_],
    others: NDArray[np.bool_],
    window: int,
    sd_limit: FloatArray,
    slope_limit: FloatArray,
    settling: int,
    gap: int,
    settled: bool,
    before: int,
    staged: bool,
) -> tuple[NDArray[np.int8], IntArray, int, int]:
    n = len(time)
    reason = np.full(n, 10, dtype=np.int8)
    ends = np.empty(n // window + 1, dtype=np.int64)
    found = 0
    start = -1  # first sample of the current uninterrupted run that may serve
    began = before  # when the machine last started or changed stage
    for i in range(n):
        broken = i > 0 and time[i] - time[i - 1] > gap
        if not on[i]:
            reason[i] = 1
            start = -1
            began = -1
            continue
        if began < 0 or (others[i] != others[i - 1] if i > 0 else before >= 0 and others[0] != staged):
            began = time[i] - settling if settled and i == 0 else time[i]
            start = -1
        if others[i]:
            reason[i] = 9
            start = -1
            continue
        if time[i] - began < settling:
            reason[i] = 2
            start = -1
            continue
        missing = False
        for j in range(values.shape[1]):
            if not np.isfinite(values[i, j]):
                missing = True
        if missing:
            reason[i] = 3
            start = -1
            continue
        if start < 0 or broken:
            start = i
        if i - start + 1 < window:
            continue
        first = i - window + 1
        code = _window_test(time[first : i + 1], values[first : i + 1], temperature, sd_limit, slope_limit)
        if code == 0:
            reason[first : i + 1] = 0
            ends[found] = i
            found += 1
            start = i + 1
        else:
            # The oldest sample leaves the window unused; this is why.
            reason[first] = code
    return reason, ends[:found], start, began


def _average(
    time: IntArray, raw: Mapping[str, FloatArray], names: tuple[str, ...], ends: IntArray, window: int
) -> SteadyPoints:
    index = ends[:, None] + np.arange(1 - window, 1)[None]
    mean: dict[str, FloatArray] = {}
    error: dict[str, FloatArray] = {}
    for k in names:
        block = np.asarray(raw[k], dtype=float)[index]
        mean[k] = block.mean(axis=1)
        error[k] = block.std(axis=1, ddof=1) / np.sqrt(window)
    return SteadyPoints(time[ends], np.full(len(ends), window), mean, error, np.full(len(ends), np.nan))


def _accept(
    points: SteadyPoints, instruments: Instrumentation, rated_load: float, limits: SteadyLimits
) -> tuple[NDArray[np.bool_], IntArray]:
    """The test that needs the averages, of part load; fills in the heat balance."""
    x, _ = points.regressors(instruments)
    load, electric = x[:, 2], x[:, 3]
    points.balance[:] = heat_balance(points.raw, load, electric, instruments.heat_capacity)
    why = np.zeros(len(points), dtype=np.int64)
    why[(load < limits.least_load * rated_load) | (electric <= 0)] = LOW_LOAD
    return why == KEPT, why
