"""Synthetic weather: outdoor temperature and sun on two facades, with cycles and restlessness like the real thing.

Sun: position by Cooper's declination and the hour angle, clear sky by Haurwitz (1945), diffuse share by Erbs (1982),
vertical facades by the isotropic sky (Duffie & Beckman 2013, Eq. 1.6.2, 2.10.1 and 2.15.1). Cloud cover and
temperature anomalies are Ornstein-Uhlenbeck processes; the temperature falls behind the sun by a few hours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from fdd.records import NANOSECONDS, FloatArray, IntArray

DAY = 86400.0
YEAR = 365.2425 * DAY


@dataclass(frozen=True, slots=True)
class Climate:
    """A place: Copenhagen by default.

    Attributes
    ----------
    latitude, longitude : degrees north and east
    mean, annual, daily : mean temperature [degC], amplitude of the year and of the summer day [K]
    anomaly, persistence : standard deviation [K] and time constant [s] of the weather systems
    ground : albedo [1]
    """

    latitude: float = 55.7
    longitude: float = 12.6
    mean: float = 8.5
    annual: float = 9.0
    daily: float = 3.5
    anomaly: float = 3.0
    persistence: float = 2.5 * DAY
    ground: float = 0.2


@dataclass(frozen=True, slots=True)
class Weather:
    """Series of shape (n,): outdoor temperature [degC], sun on the south and the north facade [W/m^2]."""

    T_out: FloatArray
    I_south: FloatArray
    I_north: FloatArray


def weather(time: IntArray, rng: np.random.Generator, climate: Climate | None = None) -> Weather:
    """Weather at the given event times.

    Parameters
    ----------
    time : shape (n,), equidistant [ns since epoch, UTC]
    rng : random numbers
    climate : the place
    """
    place = climate or Climate()
    seconds = time.astype(np.float64) / NANOSECONDS
    step = float(seconds[1] - seconds[0]) if len(seconds) > 1 else 300.0
    # 1970-01-01 is the first day of a year, so that seconds since then give day of year and hour of day.
    year, hour = seconds % YEAR / YEAR, (seconds / 3600.0 + place.longitude / 15.0) % 24.0
    cloud = _cloudiness(rng, len(time), step)
    elevation, south = _sun(place.latitude, year, hour)
    beam, diffuse, total = _radiation(elevation, cloud, year)
    reflected = 0.5 * place.ground * total
    systems = place.anomaly * _ornstein_uhlenbeck(rng, len(time), step / place.persistence)
    gusts = 0.3 * _ornstein_uhlenbeck(rng, len(time), step / 3600.0)
    summer = -np.cos(2.0 * np.pi * (year - 20.0 / 365.0))
    swing = place.daily * (0.6 + 0.4 * summer) * (1.2 - 0.9 * cloud)
    return Weather(
        T_out=place.mean + place.annual * summer - swing * np.cos(2.0 * np.pi * (hour - 3.0) / 24.0) + systems + gusts,
        I_south=beam * np.maximum(south, 0.0) + 0.5 * diffuse + reflected,
        I_north=beam * np.maximum(-south, 0.0) + 0.5 * diffuse + reflected,
    )


def _sun(latitude: float, year: FloatArray, hour: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sines of the sun's elevation and of its incidence on a south facade."""
    declination = np.radians(23.45) * np.sin(2.0 * np.pi * (284.0 / 365.0 + year))
    angle, phi = np.radians(15.0 * (hour - 12.0)), np.radians(latitude)
    up = np.sin(phi) * np.sin(declination) + np.cos(phi) * np.cos(declination) * np.cos(angle)
    south = np.sin(phi) * np.cos(declination) * np.cos(angle) - np.cos(phi) * np.sin(declination)
    return up, np.where(up > 0.0, south, 0.0)


def _radiation(up: FloatArray, cloud: FloatArray, year: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Beam (on a surface facing the sun), diffuse and global horizontal radiation [W/m^2]."""
    day = np.maximum(up, 0.0)
    clear = 1098.0 * day * np.exp(-0.057 / np.maximum(day, 1e-3))
    total = clear * (1.0 - 0.75 * cloud**3.4)  # Kasten & Czeplak (1980)
    outside = np.maximum(1367.0 * (1.0 + 0.033 * np.cos(2.0 * np.pi * year)) * day, 1.0)
    k = np.clip(total / outside, 0.0, 0.8)
    middle = 0.9511 - 0.1604 * k + 4.388 * k**2 - 16.638 * k**3 + 12.336 * k**4
    diffuse = total * np.where(k <= 0.22, 1.0 - 0.09 * k, middle)
    # Near the horizon a small sine would blow the beam up.
    return (total - diffuse) / np.maximum(day, 0.05), diffuse, total


def _cloudiness(rng: np.random.Generator, n: int, step: float) -> FloatArray:
    """Cloud cover in [0, 1]: weather systems of a day and single clouds of half an hour."""
    raw = _ornstein_uhlenbeck(rng, n, step / DAY) + 0.35 * _ornstein_uhlenbeck(rng, n, step / 1800.0)
    return 1.0 / (1.0 + np.exp(-(0.5 + 1.6 * raw)))


def _ornstein_uhlenbeck(rng: np.random.Generator, n: int, rate: float) -> FloatArray:
    """Stationary process of unit variance whose correlation falls by e in 1/rate steps."""
    keep = np.exp(-rate)
    noise = rng.standard_normal(n)
    noise[1:] *= np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], noise), dtype=np.float64)
