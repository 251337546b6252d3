"""A notebook's way: tables in, fits, charts and alarms out, through the same engine as a site file."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import fdd
from fdd import Data
from fdd.greybox.likelihood import Data as Record
from fdd.greybox.record_faults import DataError
from fdd.greybox.simulate import realise
from fdd.models.registry import get_model

RADIATOR = get_model("radiator", sections=1, surroundings=False)
TRUE = {"C": 4e4, "H": 12.0, "sigma_T": 2e-3, "noise_return": 0.05}


def table(days: int = 20, lost: float = 0.0, fault_day: int = 12) -> pd.DataFrame:
    """A radiator in l/h and degF, local time; covered to seven tenths from a day on."""
    n, random = days * 144, np.random.default_rng(1)
    t = np.arange(n) * 600.0
    u = np.column_stack([
        55 + 8 * np.sin(2 * np.pi * t / 86400) + random.normal(size=n),
        21 + 0.5 * np.sin(2 * np.pi * t / 86400 - 1),
        0.03 + 0.01 * np.repeat(random.random(n // 12), 12),
    ])  # fmt: skip
    cut, y = min(fault_day * 144, n), []
    for part, factor in ((slice(0, cut), 1.0), (slice(cut, n), 0.7)):
        if part.start == part.stop:
            continue
        values = np.array([{**TRUE, "H": 12.0 * factor}[q.symbol] for q in RADIATOR.parameters])
        piece = realise(RADIATOR, values, Record(t[part], u[part], np.full((len(t[part]), 1), 40.0)), 2)
        y.append(piece.y[:, 0])
    index = pd.date_range("2026-01-05", periods=n, freq="10min", tz="Europe/Paris").tz_localize(None)
    columns = {"supply": u[:, 0] * 1.8 + 32, "T_room": u[:, 1], "flow": u[:, 2] * 3600, "T_return": np.concatenate(y)}
    df = pd.DataFrame(columns, index=index)
    return df.mask(random.random(df.shape) < lost) if lost else df


COLUMNS = {"T_supply": "supply", "m_flow": "flow"}
UNITS = {"T_supply": "degF", "m_flow": ("l/h", "1000 kg/m3")}


def test_a_table_becomes_a_record_in_the_models_units() -> None:
    df = table(2)
    d = Data.from_frame(df, RADIATOR, columns=COLUMNS, units=UNITS, zone="Europe/Paris")
    assert d.t[1] - d.t[0] == 600.0
    np.testing.assert_allclose(d.u[:, 0], (df["supply"] - 32) / 1.8)
    np.testing.assert_allclose(d.u[:, 2], df["flow"] / 3600, rtol=1e-12)


def test_local_times_keep_their_distance_when_clocks_change() -> None:
    index = pd.date_range("2026-03-28 12:00", periods=144, freq="10min", tz="Europe/Paris").tz_localize(None)
    df = table(1).set_index(index)
    d = Data.from_frame(df, RADIATOR, columns=COLUMNS, units=UNITS, zone="Europe/Paris")
    assert set(np.diff(d.t)) == {600.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"columns": {"T_supply": "suply", "m_flow": "flow"}}, "did you mean 'supply'"),
        ({"units": {"T_supply": "kW", "m_flow": ("l/h", "water")}}, "kW"),
        ({"columns": {"T": "supply"}}, "has T_supply, T_room, m_flow"),
    ],
)
def test_what_does_not_fit_is_named_with_what_would(change: dict[str, object], words: str) -> None:
    with pytest.raises(DataError, match=words):
        Data.from_frame(table(2), RADIATOR, **{"columns": COLUMNS, "units": UNITS, **change})  # type: ignore[arg-type]


def test_fit_takes_a_table_whose_columns_are_the_models() -> None:
    df = table(4)
    d = Data.from_frame(df, RADIATOR, columns=COLUMNS, units=UNITS)
    same = pd.DataFrame({**dict(zip(RADIATOR.symbols["inputs"], d.u.T, strict=True)), "T_return": d.y[:, 0]}, df.index)
    found = fdd.fit(RADIATOR, same)
    assert found.params["H"] == pytest.approx(12.0, rel=0.05)
    assert found.llf == pytest.approx(fdd.fit(RADIATOR, d).llf, rel=1e-9)


def test_monitoring_finds_what_a_site_file_would_find() -> None:
    found = fdd.monitor(
        table(), RADIATOR, until="2026-01-15", columns=COLUMNS, units=UNITS, zone="Europe/Paris", name="rad"
    )
    assert found.against == ()
    assert len(found.alarms) >= 1
    assert found.alarms["raised"].min() >= pd.Timestamp("2026-01-17", tz="Europe/Paris")
    assert "alarm(s)" in found.summary()
    assert set(found.charts.columns) == {"time", "chart", "statistic", "limit"}
    assert len(found.plot().axes) == found.charts["chart"].nunique()


def test_a_models_name_lets_the_variant_be_chosen() -> None:
    found = fdd.monitor(
        table(14, fault_day=13), "radiator", until="2026-01-15", columns=COLUMNS, units=UNITS, zone="Europe/Paris"
    )
    assert found.reasons[0].startswith("chosen: ")
    assert found.baseline.options["surroundings"] is False
