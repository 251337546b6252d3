"""What a degraded chiller costs: extra energy a day against the baseline machine at the same load and weather."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.chiller_eiv.model import ChillerError
from fdd.records import FloatArray


@dataclass(frozen=True, slots=True)
class ExtraCost:
    """Extra consumption with its standard error.

    Attributes
    ----------
    power, power_se : mean extra power while running [W]
    share : of the expected power [1]
    energy_day, energy_day_se : [kWh/d]
    money_day : [currency/d], NaN without a tariff
    """

    power: float
    power_se: float
    share: float
    energy_day: float
    energy_day_se: float
    money_day: float


def extra_cost(
    power: FloatArray,
    expected: FloatArray,
    *,
    hours_a_day: float,
    price: float = float("nan"),
    model_sd: float = 0.0,
    independent: float | None = None,
) -> ExtraCost:
    """Extra power of recent points over the healthy machine's.

    Parameters
    ----------
    power, expected : measured, and of the healthy machine at today's load and weather [W], shape (n,)
    hours_a_day : running hours a day
    price : of electricity [currency/kWh]
    model_sd : standard deviation of the expectation's own bias [1], for the error of the mean
    independent : number of independent points they are worth; n if not given

    Raises
    ------
    ChillerError : no points, or hours outside 0 to 24
    """
    if not len(power):
        raise ChillerError("no steady points in the time asked for: no cost can be told")
    if not 0 <= hours_a_day <= 24:
        raise ChillerError(f"running hours a day must lie between 0 and 24; got {hours_a_day!r}")
    extra = power - expected
    n = float(independent or len(power))
    mean = float(extra.mean())
    se = float(np.hypot(extra.std(ddof=1) / np.sqrt(n) if len(power) > 1 else 0.0, model_sd * expected.mean()))
    energy = mean * hours_a_day / 1e3
    return ExtraCost(
        power=mean,
        power_se=se,
        share=mean / float(expected.mean()),
        energy_day=energy,
        energy_day_se=se * hours_a_day / 1e3,
        money_day=energy * price,
    )
