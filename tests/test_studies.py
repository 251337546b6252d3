"""The study of a real building through the command line, as its page says; needs the shared data."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from fdd.greybox.validate import cumulated_periodogram, kolmogorov_band
from fdd.service.baselines.fitting import read_span
from fdd.service.baselines.identify import healthy_steps
from fdd.service.baselines.versions import in_force
from fdd.service.site.site_context import open_site

ROOT = Path(__file__).resolve().parents[1]
SPLIT = "2009-02-09"
# Strong sun, W/m2: where the page says that the model falls short.
STRONG_SUN = 100.0


class House:
    """The study's site with its store in a temporary folder, fitted on the first part."""

    def __init__(self, data: Path, folder: Path) -> None:
        self.data, self.folder = data, folder
        table = yaml.safe_load((ROOT / "docs" / "studies" / "real-building.yaml").read_text(encoding="utf-8"))
        table["store"]["path"] = "store.sqlite"
        self.site = folder / "site.yaml"
        self.site.write_text(yaml.safe_dump(table), encoding="utf-8")
        self.fitted = self.fdd("fit", self.data, "--until", SPLIT, "--starts", "1")

    def fdd(self, verb: str, data: Path, *options: str) -> dict[str, Any]:
        """One verb of the command, its JSON taken back."""
        done = subprocess.run(
            [sys.executable, "-m", "fdd", verb, str(self.site), str(data), "--json", *options],
            capture_output=True, text=True, cwd=ROOT, timeout=60, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    def frame(self) -> pd.DataFrame:
        """The measured data; times are local."""
        return pd.read_csv(self.data, parse_dates=["TimeDate"])

    def with_sensor(self, onset: str, stuck: bool, bias: float) -> Path:
        """A copy of the data with a faulty indoor sensor from ``onset`` on."""
        data = self.frame()
        on = data["TimeDate"] >= pd.Timestamp(onset)
        data.loc[on, "yTi"] = (data.loc[on, "yTi"].iloc[0] if stuck else data.loc[on, "yTi"]) + bias
        path = self.folder / "faulty.csv"
        data.to_csv(path, index=False)
        return path


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    data = Path(os.environ.get("FDD_SHARED", ROOT.parent / "shared")) / "data" / "flexhouse_prbs_5min.csv"
    if not data.is_file():
        pytest.skip("no measured data here; set FDD_SHARED to the folder that holds data/")
    return House(data, tmp_path_factory.mktemp("house"))


def _raised(alarm: dict[str, Any]) -> pd.Timestamp:
    return pd.Timestamp(alarm["raised"], unit="ns", tz="UTC").tz_convert("Europe/Copenhagen").tz_localize(None)


def test_fit_converges_near_what_other_programs_find(house: House) -> None:
    (baseline,) = house.fitted["baselines"]
    assert baseline["diagnostics"]["converged"]
    assert "C_h" in baseline["diagnostics"]["at_bound"]
    # Two independent programs over the whole record; ours sees 58 % of it, so the allowance is three standard errors.
    others = {"C_i": 1.0687 * 3.6e6, "C_e": 2.8959 * 3.6e6, "R_ie": 0.85629e-3, "R_ea": 4.6131e-3, "A_w": 6.1041}
    for symbol, value in others.items():
        assert baseline["parameters"][symbol] == pytest.approx(value, abs=3 * baseline["standard_errors"][symbol])


def test_innovations_are_white_at_lag_one_and_nearly_so_at_all_frequencies(house: House) -> None:
    context = open_site(house.site, house.data)
    store = context.store(read_only=True)
    baseline = in_force(store, ["house"])["house"]
    store.close()
    history = read_span(context, None, SPLIT)
    steps = healthy_steps(context.plan, context.plan.components[0], baseline, history)
    z = np.array([s.standardised[0, 0] for s in steps])
    z = z[np.isfinite(z)]
    assert len(z) > 800
    assert abs(np.corrcoef(z[1:], z[:-1])[0, 1]) < 1.96 / np.sqrt(len(z))
    frequency, power = cumulated_periodogram(z)
    assert np.abs(power - 2 * frequency).max() < kolmogorov_band(len(z), 0.01)


def test_healthy_alarms_come_in_strong_sun_only(house: House) -> None:
    """The page's shortfall, held to its size: one alarm in the 59 h not fitted, gone again, in strong sun."""
    alarms = house.fdd("replay", house.data, "--from", "2009-02-08T12:00")["alarms"]
    assert len(alarms) <= 1
    sun = house.frame().set_index("TimeDate")["Ps"] * 1e3
    for alarm in alarms:
        assert list(alarm["evidence"]["charts"]) == ["house/T_room:cusum"]
        assert alarm["state"] == "returned to normal"
        at = _raised(alarm)
        assert sun[at - pd.Timedelta("20min") : at].min() > STRONG_SUN


def test_no_alarm_after_the_bright_morning(house: House) -> None:
    assert house.fdd("replay", house.data, "--from", SPLIT)["alarms"] == []


@pytest.mark.parametrize(("stuck", "bias", "within"), [(True, 0.0, "2h"), (False, 0.5, "5min")])
def test_sensor_fault_is_alarmed(house: House, stuck: bool, bias: float, within: str) -> None:
    onset = pd.Timestamp("2009-02-09 18:00")
    faulty = house.with_sensor(onset.isoformat(), stuck, bias)
    (alarm,) = house.fdd("replay", faulty, "--from", SPLIT)["alarms"]
    assert onset <= _raised(alarm) <= onset + pd.Timedelta(within)
    first = alarm["evidence"]["charts"]["house/T_room:flatline" if stuck else "house/T_room:cusum"]
    assert first["raised"] == alarm["raised"]
    if not stuck:
        assert first["direction"] == np.sign(bias)
