"""A day of equipment against its rows of expectations: a predictive z for each, with no training or sharpened by it.

Of a row's residual the means of hours are taken; judged is the second most extreme (one hour alone is a transient),
of an inequality only what exceeds zero. With h the factors of the row's terms at that hour and b their errors,

.. math:: r = h'b + e, \\quad b \\sim N(0, diag(sd^2)), \\quad e \\sim N(0, s^2), \\quad z = r / \\sqrt{h'Ph + s^2}

is standard normal before anything was learned. Normal days update b and s^2 by conjugate regression (Gelman et al.
2013, 14.8), and z follows Student's t then; the statistic that is judged is the one that is learned. Fewer than five
days harm more than they help. Limits share the budget of false alarms over a day's tests (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from fdd.models.expectation import Day, EquipmentModel, Row
from fdd.records import FloatArray, JsonObject

ENOUGH = 5
"""Normal days from which a row is sharpened."""
KNOWN = 4.0
"""Degrees of freedom that the declared spread of an hour is worth."""
DAY_FACTOR = 365.25
BEYOND, NEAR = 0.1, 1.0
"""How far beyond the range of a driver what was learned in it still holds: a share of the range, and kelvins."""
REMAINS = 0.15
"""What a learned error may have moved since, as a share of its standard deviation before learning."""


@dataclass(frozen=True, slots=True)
class Statistic:
    """One side of a row on one day.

    Attributes
    ----------
    row, side : name; +1 for above what is expected, -1 for below
    value : residual to that side, in the row's unit; at least zero where the row is an inequality
    factors : of the row's terms, (n_terms,)
    count : how many stretches the row applied to
    at : event time at which the stretch judged began [s]
    drivers : what came from outside in that stretch, by role
    """

    row: str
    side: int
    value: float
    factors: tuple[float, ...]
    count: int
    at: float
    drivers: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Name of the test."""
        return f"{self.row} {'+' if self.side > 0 else '-'}"


@dataclass(frozen=True, slots=True)
class Belief:
    """A test's terms: mean and covariance; variance of a stretch and its degrees of freedom (inf: given).

    ``seen`` is the range of each driver on the days it was learned from, by role.
    """

    mean: FloatArray
    covariance: FloatArray
    variance: float
    freedom: float = np.inf
    days: int = 0
    seen: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def holds(self, drivers: Mapping[str, float]) -> bool:
        """Whether a stretch is like those that it was learned from."""
        return within(self.seen, drivers)

    def predict(self, factors: Sequence[float]) -> tuple[float, float]:
        """Expected value and its standard deviation for one more day."""
        h = np.array(factors)
        return float(h @ self.mean), float(np.sqrt(h @ self.covariance @ h + self.variance))


@dataclass(frozen=True, slots=True)
class Test:
    """A statistic judged: what was expected, how far off it is, the chance of that, and the largest chance forgiven."""

    statistic: Statistic
    expected: float
    sd: float
    z: float
    chance: float
    allowed: float
    learned_days: int

    @property
    def rings(self) -> bool:
        """Whether chance explains it less often than the budget forgives."""
        return self.chance < self.allowed

    @property
    def ratio(self) -> float:
        """z over its limit; 1 and more rings."""
        limit = float(stats.norm.isf(self.allowed))
        return float(stats.norm.isf(max(self.chance, 1e-300))) / limit


@dataclass(frozen=True)
class Beliefs:
    """What normal days have taught about one piece of equipment; empty before."""

    tests: Mapping[str, Belief] = field(default_factory=dict)

    def document(self) -> JsonObject:
        """Plain data."""
        return {
            key: {
                "mean": b.mean.tolist(),
                "covariance": b.covariance.tolist(),
                "variance": b.variance,
                "freedom": b.freedom,
                "days": b.days,
                "seen": {role: list(ends) for role, ends in b.seen.items()},
            }
            for key, b in self.tests.items()
        }

    @classmethod
    def of(cls, document: JsonObject) -> Beliefs:
        """What :meth:`document` wrote."""
        return cls(
            {
                key: Belief(
                    np.array(d["mean"]),
                    np.array(d["covariance"]).reshape(len(d["mean"]), len(d["mean"])),
                    d["variance"],
                    d["freedom"],
                    d["days"],
                    {role: (ends[0], ends[1]) for role, ends in d["seen"].items()},
                )
                for key, d in document.items()
            }
        )


def statistics(model: EquipmentModel, day: Day) -> list[Statistic]:
    """Every side of every row that the day's states and points allow to judge."""
    found: list[Statistic] = []
    for row in model.rows:
        if all(role in day for role in row.needs):
            found += _sides(row, day, [r for r in model.drivers if r in day])
    return found


def _sides(row: Row, day: Day, drivers: Sequence[str]) -> list[Statistic]:
    with np.errstate(all="ignore"):
        residual, terms = row.residual(day)
    symbols = term_symbols(row)
    good = np.isfinite(residual)
    if not good.any():
        return []
    block = np.floor(day.time / row.span).astype(np.int64)
    hours = np.unique(block[good])
    least = max(1.0, row.span / 3 / day.step)
    kept = [b for b in hours.tolist() if (good & (block == b)).sum() >= least]
    if not kept:
        return []
    inside = [good & (block == b) for b in kept]
    means = np.array([residual[i].mean() for i in inside])
    factors = np.array(
        [[_mean(terms.get(s, 0.0), i) for s in symbols] for i in inside]
    ).reshape(len(kept), len(symbols))  # fmt: skip
    found = []
    for side, words in ((1, row.high), (-1, row.low)):
        if not words:
            continue
        order = np.argsort(-side * means, kind="stable")
        pick = int(order[min(1, len(order) - 1)])
        value = float(side * means[pick])
        value = max(value, 0.0) if row.inequality else value
        found.append(
            Statistic(
                row.name,
                side,
                value,
                tuple((side * factors[pick]).tolist()),
                len(kept),
                float(kept[pick] * row.span),
                {role: float(np.nanmean(day[role][inside[pick]])) for role in drivers if _any(day[role][inside[pick]])},
            )
        )
    return found


def _any(x: FloatArray) -> bool:
    return bool(np.isfinite(x).any())


def seen_of(drivers: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float]]:
    """The range of each driver over several days."""
    roles = {role for d in drivers for role in d}
    ranges = {role: [d[role] for d in drivers if role in d] for role in sorted(roles)}
    return {role: (min(x), max(x)) for role, x in ranges.items()}


def within(seen: Mapping[str, tuple[float, float]], drivers: Mapping[str, float]) -> bool:
    """Whether drivers lie in the range seen, or a little beyond it."""
    return all(
        low - BEYOND * (high - low) - NEAR <= drivers[role] <= high + BEYOND * (high - low) + NEAR
        for role, (low, high) in seen.items()
        if role in drivers
    )


def _mean(term: FloatArray | float, inside: FloatArray) -> float:
    return float(np.mean(np.asarray(term)[inside])) if np.ndim(term) else float(term)


def term_symbols(row: Row) -> tuple[str, ...]:
    """The order of a row's terms: its sensors' roles, then what else it declares."""
    return tuple(dict.fromkeys((*_sensor_terms(row), *(t.symbol for t in row.terms))))


def _sensor_terms(row: Row) -> tuple[str, ...]:
    return tuple(r for r in row.needs if r.startswith("T_") and "_set" not in r)


def prior(model: EquipmentModel, row: Row, errors: Mapping[str, float] | None = None) -> Belief:
    """A row before anything was learned; ``errors`` are the site's own standard deviations by role."""
    own = {t.symbol: t.sd for t in row.terms}
    sd = np.array([own.get(s, (errors or {}).get(s, model.by_symbol[s].sd if s in model.by_symbol else 0.0))
                   for s in term_symbols(row)])  # fmt: skip
    return Belief(np.zeros(len(sd)), np.diag(sd**2), row.sd**2)


def judge(
    model: EquipmentModel,
    found: Iterable[Statistic],
    beliefs: Beliefs,
    allowed: float,
    errors: Mapping[str, float] | None = None,
) -> list[Test]:
    """Every statistic against what is expected.

    Parameters
    ----------
    allowed : chance of a false alarm on a day from one test
    """
    rows = {r.name: r for r in model.rows}
    tests = []
    for s in found:
        learned = beliefs.tests.get(s.key)
        # What was learned in one season says nothing of another: there the declared accuracies hold.
        belief = learned if learned and learned.holds(s.drivers) else prior(model, rows[s.row], errors)
        expected, sd = belief.predict(s.factors)
        z = (s.value - expected) / sd
        chance = float(stats.norm.sf(z) if np.isinf(belief.freedom) else stats.t.sf(z, belief.freedom))
        # What an inequality keeps within is never evidence, however little normal days have used of it.
        chance = 1.0 if rows[s.row].inequality and s.value <= 0 else chance
        tests.append(Test(s, expected, sd, z, chance, allowed, belief.days))
    return tests


def learn(
    model: EquipmentModel, days: Sequence[Sequence[Statistic]], errors: Mapping[str, float] | None = None
) -> Beliefs:
    """What normal days teach; tests that fewer than five of them could make are left as declared."""
    rows = {r.name: r for r in model.rows}
    by_key: dict[str, list[Statistic]] = {}
    for day in days:
        for s in day:
            by_key.setdefault(s.key, []).append(s)
    return Beliefs(
        {
            key: _posterior(prior(model, rows[seen[0].row], errors), seen)
            for key, seen in by_key.items()
            if len(seen) >= ENOUGH
        }
    )


def _posterior(before: Belief, seen: Sequence[Statistic]) -> Belief:
    """Bayesian regression; the spread of an hour is learned together with the errors."""
    h, r = np.array([s.factors for s in seen]).reshape(len(seen), -1), np.array([s.value for s in seen])
    variance = before.variance
    for _ in range(20):
        gain = before.covariance @ h.T @ np.linalg.inv(h @ before.covariance @ h.T + variance * np.eye(len(r)))
        mean, covariance = gain @ r, before.covariance - gain @ h @ before.covariance
        left = r - h @ mean
        spread = float(left @ left + np.trace(h @ covariance @ h.T))
        variance = (KNOWN * before.variance + spread) / (KNOWN + len(r))
    covariance = covariance + REMAINS**2 * before.covariance
    return Belief(mean, covariance, variance, KNOWN + len(r), len(r), seen_of([s.drivers for s in seen]))


def allowed_chance(false_alarms_per_year: float, tests: int) -> float:
    """Chance of a false alarm that one of a day's tests may have."""
    return false_alarms_per_year / DAY_FACTOR / max(tests, 1)
