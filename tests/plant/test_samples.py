from pathlib import Path

import numpy as np
import pandas as pd

from fdd.config.load import load_site
from fdd.plant.samples import FOULING
from fdd.plant.scenario import simulate

FOLDER = Path(__file__).resolve().parents[2] / "data"


def test_shipped_sample_is_what_the_plant_still_gives():
    shipped = pd.read_csv(FOLDER / "house_fouling.csv.gz", index_col=0)
    made = simulate(FOULING)
    assert list(shipped.columns) == list(made.columns)
    assert np.abs(shipped.to_numpy() - made.to_numpy()).max() < 2e-3
    assert list(pd.to_datetime(shipped.index)) == list(made.index)


def test_shipped_site_names_the_samples_columns():
    site = load_site(FOLDER / "site.yaml")
    assert set(site.points) == set(pd.read_csv(FOLDER / "house_fouling.csv.gz", nrows=0).columns[1:])
