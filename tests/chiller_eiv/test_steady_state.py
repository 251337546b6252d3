"""The steady-state detector keeps what is steady and accounts for every sample."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.chiller_eiv.errors import RAW_UNITS, Instrumentation, SensorError
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.steady_state import (
    REASONS,
    SteadyLimits,
    SteadyStream,
    propose_limits,
    steady_points,
    steady_quantities,
)

SECOND = 10**9
INSTRUMENTS = Instrumentation(
    {
        "T_cdi": SensorError(0.05),
        "T_chi": SensorError(0.05),
        "T_cho": SensorError(0.05),
        "flow_ch": SensorError(relative=0.005),
        "power": SensorError(relative=0.003),
    }
)


def steady(n: int = 240, period: int = 60, seed: int = 0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """n quiet samples of a running machine."""
    rng = np.random.default_rng(seed)
    e = rng.standard_normal((5, n))
    raw = {
        "T_cdi": 28.0 + 0.05 * e[0],
        "T_chi": 12.0 + 0.05 * e[1],
        "T_cho": 7.0 + 0.05 * e[2],
        "flow_ch": 20.0 * (1 + 0.005 * e[3]),
        "power": 80e3 * (1 + 0.003 * e[4]),
    }
    return np.arange(n, dtype=np.int64) * period * SECOND, raw


def run(time: np.ndarray, raw: dict[str, np.ndarray], **changes):  # type: ignore[no-untyped-def]
    limits = changes.pop("limits", SteadyLimits())
    instruments = changes.pop("instruments", INSTRUMENTS)
    return steady_points(time, raw, instruments, rated_load=500e3, limits=limits, **changes)


def test_quiet_operation_becomes_points_after_the_start_up_time() -> None:
    time, raw = steady()
    points, report = run(time, raw)
    assert len(points) == (240 - 30) // 45
    assert report.counts()["starting or staging"] == 30
    assert points.samples[0] == 45
    np.testing.assert_allclose(points.raw["T_chi"], 12.0, atol=4 * 0.05 / np.sqrt(45))
    x, cov = points.regressors(INSTRUMENTS)
    assert x[0, 2] == pytest.approx(20 * 4190 * 5, rel=0.01)
    assert cov[0, 0, 0] == pytest.approx(0.05**2 / 45)


@pytest.mark.parametrize("period", [60, 300, 900])
def test_every_sample_has_one_fate(period: int) -> None:
    time, raw = steady(300, period)
    raw["power"][100:120] = 0.0
    raw["T_chi"][200] = np.nan
    points, report = run(time, raw)
    assert sum(report.counts().values()) == 300
    assert report.counts()["kept"] == points.samples.sum()
    assert report.counts()["machine off"] == 20
    assert report.counts()["missing value or gap"] == 1
    assert report.period == period


@pytest.mark.parametrize(
    ("disturb", "reason"),
    [
        (
            lambda raw, k: raw["T_cdi"].__iadd__(np.where(np.arange(len(k)) % 8 < 4, 0.5, -0.5)),
            "temperature not steady",
        ),
        (lambda raw, k: raw["power"].__imul__(np.where(k % 8 < 4, 1.1, 0.9)), "flow, load or power not steady"),
        (lambda raw, k: raw["power"].__imul__(1 + 0.001 * k), "flow, load or power drifts"),
        (lambda raw, k: raw["T_cdi"].__iadd__(3.0 * k / 60 / 10), "temperature drifts"),
        (lambda raw, k: raw["flow_ch"].__imul__(0.2), "load too low"),
    ],
)
def test_what_is_not_steady_is_rejected_for_its_reason(disturb, reason: str) -> None:  # type: ignore[no-untyped-def]
    time, raw = steady()
    k = np.arange(len(time))
    limits = SteadyLimits(spread=1e9) if reason.endswith("drifts") else SteadyLimits()
    if reason == "temperature drifts":
        limits = SteadyLimits(spread=1e9, temperature_slope=0.2)
    disturb(raw, k)
    points, report = run(time, raw, limits=limits)
    assert len(points) == 0
    counts = report.counts()
    assert (
        max((v, r) for r, v in counts.items() if r != "no complete window left" and r != "starting or staging")[1]
        == reason
    )


def test_a_heat_balance_that_does_not_close_is_told_and_costs_no_point() -> None:
    time, raw = steady()
    raw["T_cdo"] = raw["T_cdi"] + 5.0
    raw["flow_cd"] = np.full(len(time), 1.15 * (419e3 + 80e3) / 4190 / 5)
    points, _ = run(time, raw)
    assert len(points) == 4
    assert not points.closing(0.08).any()
    raw["flow_cd"] /= 1.15
    points, _ = run(time, raw)
    assert len(points) == 4
    assert np.all(np.abs(points.balance) < 0.03)
    assert points.closing(0.08).all()


def test_a_second_machine_on_the_same_flow_is_rejected() -> None:
    time, raw = steady()
    others = np.zeros(240, dtype=bool)
    others[60:120] = True
    points, report = run(time, raw, others_running=others)
    assert report.counts()["several machines staged"] == 60
    inside = (points.time >= time[60]) & (points.time < time[150])
    assert not inside.any()


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 1000), holes=st.lists(st.integers(0, 239), max_size=12), off=st.integers(0, 200))
def test_windows_never_contain_missing_or_stopped_samples(seed: int, holes: list[int], off: int) -> None:
    time, raw = steady(seed=seed)
    raw["T_cdi"][holes] = np.nan
    raw["power"][off : off + 10] = 0.0
    points, report = run(time, raw)
    assert len(report.reason) == 240
    assert set(np.unique(report.reason)) <= set(range(len(REASONS)))
    for end in points.time:
        i = int(end // (60 * SECOND))
        window = slice(i - 44, i + 1)
        assert np.isfinite(raw["T_cdi"][window]).all()
        assert (raw["power"][window] > 0).all()


def test_bad_input_is_refused() -> None:
    time, raw = steady()
    with pytest.raises(ChillerError, match="increase"):
        run(time[::-1].copy(), raw)
    with pytest.raises(ChillerError, match="lack T_cho"):
        run(time, {k: v for k, v in raw.items() if k != "T_cho"})
    with pytest.raises(ChillerError, match="unknown"):
        run(time, {**raw, "T_room": raw["T_chi"]})


@pytest.mark.parametrize("seed", range(4))
def test_a_stream_cut_anywhere_gives_the_points_of_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time, raw = steady(900, 60, seed)
    raw["power"][rng.integers(0, 900, 3)] = 0.0
    raw["T_chi"][rng.integers(0, 900, 2)] = np.nan
    raw["others"] = np.where((np.arange(900) > 500) & (np.arange(900) < 540), 1.0, 0.0)
    whole, report = run(time, raw)
    assert report.counts()["several machines staged"] > 0
    table = np.column_stack([raw.get(k, np.full(900, np.nan)) for k in RAW_UNITS])
    stream = SteadyStream(INSTRUMENTS, 500e3, SteadyLimits(), 60.0, steady_quantities(raw, INSTRUMENTS))
    cuts = [0, *np.sort(rng.integers(0, 900, 15)).tolist(), 900]
    parts = [stream.take(time[a:b], table[a:b])[0] for a, b in pairwise(cuts) if b > a]
    np.testing.assert_array_equal(np.concatenate([p.time for p in parts]), whole.time)
    np.testing.assert_array_equal(np.concatenate([p.raw["T_chi"] for p in parts]), whole.raw["T_chi"])


def test_limits_fit_laboratory_data_of_ten_seconds() -> None:
    """States of half an hour, each after a quarter of an hour of transition, as in a laboratory's test sequence."""
    rng = np.random.default_rng(1)
    n, per = 27 * 270, 270
    state = np.arange(n) // per
    settled = 1 - np.exp(-(np.arange(n) % per) / 20.0)
    level = lambda low, high: (lambda v: v[state - (state > 0)] + (v[state] - v[state - (state > 0)]) * settled)(  # noqa: E731
        rng.uniform(low, high, 27)
    )
    T_cho, load = level(5.0, 9.0), level(150e3, 300e3)
    e = rng.standard_normal((5, n))
    raw = {
        "T_cdi": level(20.0, 29.0) + 0.05 * e[0],
        "T_chi": T_cho + load / 4190 / 13.6 + 0.05 * e[1],
        "T_cho": T_cho + 0.05 * e[2],
        "flow_ch": 13.6 * (1 + 0.005 * e[3]),
        "power": load / 5 * (1 + 0.01 * e[4]),
    }
    time = np.arange(n, dtype=np.int64) * 10 * SECOND
    usual = run(time, raw)[0]
    limits = propose_limits(time, raw, INSTRUMENTS, rated_load=316e3, limits=SteadyLimits())
    found = run(time, raw, limits=limits)[0]
    assert len(found) >= 24 > len(usual)
    assert limits.window < 2700
    kept = propose_limits(time, raw, INSTRUMENTS, rated_load=316e3, limits=SteadyLimits(), given=("window", "settling"))
    assert (kept.window, kept.settling) == (2700, 1800)
