"""Self-check of the assumed sensor errors on a baseline: lambda_min estimates (true / assumed error variance).

Over-stated errors are dangerous: at twice the true ones, corrected least squares is further off than ordinary (R +19 %
against -6 % in the reference's example), so a guess is not better than nothing beyond a factor of about 1.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.chiller_eiv.estimators import lambda_min
from fdd.chiller_eiv.forms import DIVISION_FREE, Form
from fdd.chiller_eiv.moments import Moments, regression_terms, sum_moments
from fdd.records import FloatArray

LARGEST_SCALE = 16.0
"""Errors four times the declared ones (sixteen in variance) are no sensor noise but a model that does not fit."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What the data say about the declared sensor errors.

    Attributes
    ----------
    ratio : estimate of (true / declared error variance)
    low, high : its 95 % interval where the model is exact and points are independent
    scale : factor to apply to every error variance; 1 where the data give no reason or the ratio is not noise
    note : in words
    """

    ratio: float
    low: float
    high: float
    scale: float
    note: str


def calibrate_errors(x: FloatArray, cov: FloatArray, form: Form = DIVISION_FREE) -> Calibration:
    """Compare the declared sensor errors with the scatter of a baseline's points.

    Parameters
    ----------
    x, cov : measurements (n, m) and error covariance (n, m, m), as for :func:`fit.fit_gordon_ng`
    """
    return judge(sum_moments(regression_terms(form, x, cov)))


def judge(moments: Moments) -> Calibration:
    """The same from one machine's moments."""
    n = float(moments.n)
    freedom = max(n - (moments.M.shape[-1] - 1), 1.0)
    root = float(lambda_min(moments))
    if not np.isfinite(root):
        return Calibration(np.inf, np.inf, np.inf, 1.0, "no sensor errors are declared: nothing is corrected")
    ratio = root * n / freedom
    half = 1.96 * np.sqrt(2.0 / freedom)
    low, high = ratio * max(1 - half, 0.0), ratio * (1 + half)
    times = np.sqrt(ratio)
    if low <= 1.0 <= high:
        return Calibration(ratio, low, high, 1.0, f"sensor errors agree with the data (ratio {times:.2f})")
    if ratio > LARGEST_SCALE:
        note = (
            f"the points scatter {times:.1f} times as widely as the sensor errors explain: the model does not fit this "
            "machine exactly; the errors are left as declared"
        )
        return Calibration(ratio, low, high, 1.0, note)
    word = "too small" if ratio > 1 else "too large"
    return Calibration(
        ratio, low, high, ratio, f"sensor errors are declared {word}: multiplied by {times:.2f} to match the data"
    )
