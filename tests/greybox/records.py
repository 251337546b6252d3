"""The records of the oracle problems, as shipped with the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fdd.greybox.likelihood import Data

ORACLE = Path(__file__).resolve().parents[1] / "oracle"


def table(name: str, header: int = 1, delimiter: str = ",") -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.genfromtxt(ORACLE / f"{name}.csv.gz", delimiter=delimiter, skip_header=header)


def kernel_record(name: str) -> Data:
    """A kernel problem; its times are written with ten digits, the problem says what they are exactly."""
    step = {"radiator": 1 / 60, "building": 1 / 6, "heat_exchanger": 1.0}[name]
    rows, outputs = table(f"kernel_{name}"), {"radiator": 1, "building": 2, "heat_exchanger": 2}[name]
    return Data(np.arange(len(rows)) * step, rows[:, 1:-outputs], rows[:, -outputs:], name=name)


def building_d() -> Data:
    rows = table("id_building")
    return Data(rows[:, 0], rows[:, 1:7], rows[:, 7:9], name="D")


def radiator_e() -> Data:
    rows = table("id_radiator")
    return Data(rows[:, 0], rows[:, 1:4], rows[:, 4:], name="E")


def ou1d(kind: str = "") -> Data:
    rows = table(f"id_ou1d{kind}")
    return Data(rows[:, 0], rows[:, 2:3], rows[:, 1:2], name=f"C{kind}")
