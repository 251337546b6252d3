"""What is silently wrong with a record is refused or said, with the row and the remedy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fdd.greybox.likelihood import Data, DataError, Likelihood
from fdd.models.functions import exp
from fdd.models.registry import get_model
from tests.greybox import problems
from tests.greybox.test_never_invents import TRUE, record

RADIATOR = get_model("radiator", sections=1, surroundings=False)


def radiator_record(n: int = 400) -> Data:
    """Supply, room, flow and a return between supply and room."""
    t, random = np.arange(n) * 300.0, np.random.default_rng(2)
    u = np.column_stack([60 + random.normal(size=n), 21 + 0.1 * random.normal(size=n), 0.05 + 0.01 * random.random(n)])
    return Data(t, u, (40 + random.normal(size=n))[:, None])


def test_a_sound_record_gives_no_warning() -> None:
    assert radiator_record().check(RADIATOR) == []
    assert record().check(problems.ou1d()) == []


def test_swapped_inputs_are_refused_and_the_other_column_named() -> None:
    d = radiator_record()
    with pytest.raises(DataError, match=r"m_flow is 2\d.*T_room would fit: are columns swapped"):
        dataclasses.replace(d, u=d.u[:, [0, 2, 1]]).check(RADIATOR)
    with pytest.raises(DataError, match=r"T_room.*are columns swapped"):
        dataclasses.replace(d, u=d.u[:, [1, 0, 2]]).check(RADIATOR)


def test_a_column_that_only_is_too_large_is_said_and_used() -> None:
    d = radiator_record()
    (said,) = dataclasses.replace(d, u=d.u * [1.0, 1.0, 1e3]).check(RADIATOR)
    assert "m_flow is 5" in said
    assert "see its unit" in said


def test_a_few_values_beyond_their_range_are_said() -> None:
    d = radiator_record()
    u = d.u.copy()
    u[:20, 2] = 30.0
    assert any("5% of m_flow lies outside 0 to 20" in w for w in dataclasses.replace(d, u=u).check(RADIATOR))


def test_a_frozen_half_is_said_with_its_rows() -> None:
    d = radiator_record()
    y = d.y.copy()
    y[200:] = y[200]
    (said,) = dataclasses.replace(d, y=y).check(RADIATOR)
    assert "from row 200 to 399 (50% of the record)" in said


def test_an_input_may_rest_at_its_end() -> None:
    d = radiator_record()
    u = d.u.copy()
    u[200:, 2] = 0.0
    assert dataclasses.replace(d, u=u).check(RADIATOR) == []


@pytest.mark.parametrize(("size", "unit"), [(1e9, "nanoseconds: divide by 1e"), (1e4, "milliseconds")])
def test_time_in_another_unit_is_refused(size: float, unit: str) -> None:
    d = radiator_record()
    with pytest.raises(DataError, match=unit):
        Data(d.t * size, d.u, d.y).check(RADIATOR)


def test_a_constant_output_is_refused() -> None:
    d = radiator_record()
    with pytest.raises(DataError, match=r"T_return is 40 in every one of 400 rows"):
        Likelihood(RADIATOR, dataclasses.replace(d, y=np.full((400, 1), 40.0)))
    # One run in which a rounded reading rests is no dead output.
    still = dataclasses.replace(d, t=d.t[:30], u=d.u[:30], y=np.full((30, 1), 40.0))
    assert len(Likelihood(RADIATOR, [d, still]).records) == 2


def test_a_missing_first_output_is_named_not_the_start() -> None:
    d = radiator_record()
    y = d.y.copy()
    y[:3] = np.nan
    with pytest.raises(DataError, match=r"T_return is missing in the first row.*begin the record at row 3"):
        Likelihood(RADIATOR, dataclasses.replace(d, y=y))
    # A model whose start is not made of outputs may begin anywhere.
    z = record().y.copy()
    z[0] = np.nan
    assert np.isfinite(Likelihood(problems.ou1d(), dataclasses.replace(record(), y=z)).value(TRUE))


def tame_at_first() -> tuple[object, Data, np.ndarray]:
    """A rate that an input raises two-hundredfold within every second interval."""
    m = problems.declared(
        "ramp",
        states=problems._states(x=0.1),
        inputs=problems._q("u"),
        outputs=problems._q("y"),
        parameters=(
            problems.log_parameter("k", 2.0),
            problems.log_parameter("s", 0.3),
            problems.log_parameter("r", 0.1),
        ),
        drift=lambda x, u, p: {"x": -p.k * (0.1 + u.u * u.u) * (x.x + 0.2 * x.x**3 - 1.0) + 0.1 * exp(-x.x)},
        diffusion=lambda x, u, p: {"x": p.s},
        observe=lambda x, u, p: {"y": x.x},
        noise=lambda x, u, p: {"y": p.r},
        start=problems.constant_start(x=0.5),
    )
    t, random = np.arange(120.0), np.random.default_rng(3)
    u = np.where(np.arange(120) % 2, 3.0 + random.random(120), 0.0)
    y = 0.8 + 0.1 * random.normal(size=120)
    return m, Data(t, u[:, None], y[:, None], hold="first"), np.array([2.0, 0.3, 0.1])


def test_stiffness_within_an_interval_is_stepped_through_to_the_stated_bound() -> None:
    m, d, values = tame_at_first()
    chosen = Likelihood(m, d, method=None)  # type: ignore[arg-type]
    exact = Likelihood(m, d, method="rk4", substeps=1000)  # type: ignore[arg-type]
    (a,), (b,) = chosen.paths(values), exact.paths(values)
    sd = np.sqrt(b.P[:, 0, 0])
    assert (np.abs(a.x - b.x)[:, 0] / sd).max() < 5e-5
    assert chosen.value(values) == pytest.approx(exact.value(values), abs=1e-3)


def test_a_pyranometer_that_reads_below_zero_at_night_is_no_swapped_column() -> None:
    zone = get_model("zone")
    t, random = np.arange(400) * 300.0, np.random.default_rng(3)
    sun = np.where(np.arange(400) % 288 > 100, -3.0, 300.0 + random.normal(size=400))
    u = np.column_stack([5 + random.normal(size=400), sun, 2000 + 100 * random.normal(size=400)])
    assert Data(t, u, (21 + 0.1 * random.normal(size=400))[:, None]).check(zone) == []
