"""Which fault explains a day: a bank of alternatives, each fitted to the same settled readings, with probabilities.

Every alternative is the steady form of the equipment with one transformation, of unknown size, of an input, a parameter
or a reading. Parameters have priors (name plate, or what normal days have taught); each alternative is fitted by its
largest posterior and weighed by Laplace's approximation of its evidence (MacKay 2003, ch. 28),

.. math:: \\log Z = -\\tfrac12 (r'r + u'u) - \\tfrac12 \\log |I + J'J|

with u the parameters in standard deviations of their prior and r the residuals in theirs. *Normal* has no
transformation; *none of these* is the normal form with errors several times as large. Faults may leave the form less
exact, so that their evidence is averaged over larger errors, too; normal operation has no such excuse. Blocks of half
an hour are correlated over some two hours, so that each counts a quarter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp, ndtr, ndtri

from fdd.models.expectation import Alternative, Day, EquipmentModel, SteadyForm, Values
from fdd.records import FloatArray, JsonObject

BLOCK = 1800.0
WORTH = 0.25
"""What a block counts of an independent one."""
FEWEST = 4
"""Blocks that a day must have."""
STEPS = 30
SETTLED = 1e-3
"""A step that gains less log-posterior than this ends the search."""
DELTA = 1e-4
LARGER = (1.0, 2.0, 4.0)
"""Factors on the form's errors that a fault's evidence is averaged over."""
NONE = (4.0, 8.0, 16.0)
"""The same for what no alternative explains."""
NORMAL, UNKNOWN = "normal", "none of these"
PRIOR = {NORMAL: 0.9, UNKNOWN: 0.005}
"""Odds on a day before it was seen; the faults share the rest."""
FINEST = 0.2
"""A form's errors are never learned smaller than this, in the outputs' unit."""
MOVES = 0.15
"""What a learned parameter may have moved since, as a share of its prior's standard deviation."""


@dataclass(frozen=True, slots=True)
class Belief:
    """Parameters on their scale: mean (p,) and a root of their covariance (p, p); errors of the outputs by role.

    ``seen`` is the range of each driver on the days it was learned from.
    """

    mean: FloatArray
    root: FloatArray
    errors: Mapping[str, float]
    days: int = 0
    seen: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def document(self) -> JsonObject:
        """Plain data."""
        return {
            "seen": {role: list(ends) for role, ends in self.seen.items()},
            "mean": self.mean.tolist(),
            "root": self.root.tolist(),
            "errors": dict(self.errors),
            "days": self.days,
        }

    @classmethod
    def of(cls, document: JsonObject) -> Belief:
        """What :meth:`document` wrote."""
        seen = {role: (ends[0], ends[1]) for role, ends in document["seen"].items()}
        return cls(np.array(document["mean"]), np.array(document["root"]), document["errors"], document["days"], seen)


@dataclass(frozen=True, slots=True)
class Fitted:
    """An alternative at its best: log-evidence, size in its unit, and root mean square of what is left by output."""

    name: str
    evidence: float
    size: float | None
    unit: str
    left: Mapping[str, float]


@dataclass(frozen=True)
class Weighed:
    """The bank's answer: log-evidence of *normal*, of *none of these* and of each fault at its best start."""

    normal: Fitted
    unknown: Fitted
    faults: tuple[Fitted, ...]
    blocks: int

    def odds_against_normal(self, share: Mapping[str, float]) -> float:
        """Log of the mean likelihood ratio of all faults against normal; ``share`` are their odds among each other.

        Under normal operation it exceeds log(1/a) with a chance of at most a (Markov's inequality).
        """
        logs = [f.evidence + np.log(share[f.name]) for f in self.faults]
        return float(logsumexp(logs)) - self.normal.evidence if logs else -np.inf


def prior(form: SteadyForm) -> Belief:
    """Before anything was learned; means on the scale of each parameter."""
    mean = [np.log(p.mean) if p.scale == "log" else p.mean for p in form.priors]
    return Belief(np.array(mean), np.diag([p.sd for p in form.priors]), dict(form.outputs))


def blocks(form: SteadyForm, day: Day) -> Values | None:
    """Means of half hours of settled operation by role; None where the day has too few."""
    if not all(role in day for role in form.needs):
        return None
    settled = form.settled(day)
    number = np.floor(day.time / BLOCK).astype(np.int64)
    least = max(1.0, BLOCK / 2 / day.step)
    kept = [b for b in np.unique(number[settled]).tolist() if (settled & (number == b)).sum() >= least]
    if len(kept) < FEWEST:
        return None
    inside = [settled & (number == b) for b in kept]
    table = {role: np.array([_mean(x[i]) for i in inside]) for role, x in day.values.items()}
    table = {r: x for r, x in table.items() if np.isfinite(x).mean() >= 0.5 or r in form.needs}
    whole = np.all([np.isfinite(x) for x in table.values()], axis=0)
    seen = {r: x[whole] for r, x in table.items()}
    told = _Problem(form, seen, prior(form), None).residuals(np.zeros((1, len(form.priors))))
    return seen if whole.sum() >= FEWEST and told else None


def _mean(x: FloatArray) -> float:
    good = x[np.isfinite(x)]
    return float(good.mean()) if len(good) else float("nan")


def weigh(model: EquipmentModel, seen: Values, belief: Belief) -> Weighed:
    """Every alternative fitted to the same blocks."""
    assert model.form is not None
    form = model.form
    plain = _Problem(form, seen, belief, None)
    u, jacobian = plain.search(np.zeros(plain.size))
    normal = plain.fitted(NORMAL, u, jacobian, (1.0,))
    unknown = plain.fitted(UNKNOWN, u, jacobian, NONE)
    best: dict[str, Fitted] = {}
    for alternative in (a for a in form.alternatives if set(a.needs) <= seen.keys()):
        problem = _Problem(form, seen, belief, alternative)
        for start in alternative.starts:
            got = problem.fitted(alternative.fault, *problem.search(problem.start(u, start)), LARGER)
            known = best.get(alternative.fault)
            if known is None or got.evidence > known.evidence:
                best[alternative.fault] = got
    return Weighed(normal, unknown, tuple(best.values()), len(next(iter(seen.values()))))


def misfit(form: SteadyForm, seen: Values, belief: Belief) -> float:
    """Half the sum of squares that normal operation leaves: what an alternative could gain at most, but for volume."""
    plain = _Problem(form, seen, belief, None)
    u, _ = plain.search(np.zeros(plain.size))
    r = plain.white(u[None, :])[0]
    return float(0.5 * (r @ r + u @ u))


def learn(form: SteadyForm, days: Sequence[Values]) -> Belief | None:
    """Parameters and errors from normal days; None where there are fewer than five."""
    if len(days) < 5:
        return None
    roles = set.intersection(*(set(d) for d in days))
    pooled = {r: np.concatenate([d[r] for d in days]) for r in roles}
    before = prior(form)
    belief = before
    for _ in range(3):
        problem = _Problem(form, pooled, belief, None)
        start = np.zeros(problem.size)
        u, jacobian = problem.search(start)
        left = problem.left(u)
        worth = WORTH * len(next(iter(pooled.values())))
        errors = {
            role: max(FINEST, float(np.sqrt((4.0 * form.outputs[role] ** 2 + worth * left[role] ** 2) / (4.0 + worth))))
            for role in left
        }
        belief = replace(before, errors={**form.outputs, **errors})
    covariance = np.linalg.inv(np.eye(len(u)) + jacobian.T @ jacobian)
    spread = before.root @ (covariance + MOVES**2 * np.eye(len(u))) @ before.root.T
    root = np.asarray(np.linalg.cholesky(spread), dtype=np.float64)
    return Belief(before.mean + before.root @ u, root, belief.errors, len(days))


class _Problem:
    """One alternative as a least-squares problem in whitened unknowns."""

    def __init__(self, form: SteadyForm, seen: Values, belief: Belief, alternative: Alternative | None) -> None:
        self.form, self.seen, self.belief, self.alternative = form, seen, belief, alternative
        self.size = len(form.priors) + (alternative is not None)
        # What a parameter is multiplied by once, not with every evaluation.
        self._logs = np.array([p.scale == "log" for p in form.priors])

    def start(self, u: FloatArray, size: float) -> FloatArray:
        """Normal parameters with a size to start from."""
        a = self.alternative
        assert a is not None
        low, high = _ends(a)
        at = np.log(size) if a.scale == "log" else size
        share = np.clip((at - low) / (high - low), 0.02, 0.98)
        return np.append(u, float(ndtri(share)))

    def natural(self, u: FloatArray) -> tuple[Values, FloatArray | None]:
        """Parameters, each (k, 1), and the size, (k, 1), of whitened unknowns (k, size)."""
        p = len(self.form.priors)
        scaled = self.belief.mean + u[:, :p] @ self.belief.root.T
        values = np.where(self._logs, np.exp(np.clip(scaled, -20.0, 20.0)), scaled)
        table = {q.symbol: values[:, i : i + 1] for i, q in enumerate(self.form.priors)}
        return table, None if self.alternative is None else self.extent(u[:, p:])

    def extent(self, w: FloatArray) -> FloatArray:
        """The fault's size from its whitened unknown."""
        a = self.alternative
        assert a is not None
        low, high = _ends(a)
        at = low + (high - low) * ndtr(w)
        return np.asarray(np.exp(at) if a.scale == "log" else at)

    def residuals(self, u: FloatArray) -> dict[str, FloatArray]:
        """By output, measured less predicted, (k, n)."""
        p, size = self.natural(u)
        v = self.seen
        if self.alternative is not None and size is not None:
            v, p = self.alternative.change(dict(v), p, size)
        expected = self.form.predict(v, p)
        return {
            role: self.seen[role] - expected[role]
            for role in self.form.outputs
            if role in expected and role in self.seen
        }

    def white(self, u: FloatArray) -> FloatArray:
        """Residuals in standard deviations, (k, m)."""
        parts = self.residuals(u)
        return np.concatenate([np.sqrt(WORTH) * r / self.belief.errors[role] for role, r in parts.items()], axis=1)

    def search(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Levenberg and Marquardt from a start; the unknowns and the Jacobian of the residuals there."""
        damping, steps = 1e-2, np.vstack([np.zeros(self.size), DELTA * np.eye(self.size)])
        jacobian = np.zeros((1, self.size))
        here = np.inf
        for _ in range(STEPS):
            r = self.white(u + steps)
            jacobian = (r[1:] - r[0]).T / DELTA
            here = float(r[0] @ r[0] + u @ u)
            gradient, curvature = jacobian.T @ r[0] + u, jacobian.T @ jacobian + np.eye(self.size)
            moved = False
            for _ in range(6):
                step = np.linalg.solve(curvature + damping * np.diag(np.diagonal(curvature)), -gradient)
                there = u + np.clip(step, -3.0, 3.0)
                r2 = self.white(there[None, :])[0]
                value = float(r2 @ r2 + there @ there)
                if value < here:
                    moved, damping = True, damping / 5
                    break
                damping *= 5
            if not moved:
                break
            u = there
            if here - value < SETTLED:
                break
        r = self.white(u + steps)
        return u, (r[1:] - r[0]).T / DELTA

    def left(self, u: FloatArray) -> dict[str, float]:
        """Root mean square of what is left, by output, in its unit."""
        return {role: float(np.sqrt(np.mean(r**2))) for role, r in self.residuals(u[None, :]).items()}

    def fitted(self, name: str, u: FloatArray, jacobian: FloatArray, larger: Sequence[float]) -> Fitted:
        """The evidence at the optimum, averaged over factors on the errors."""
        r = self.white(u[None, :])[0]
        worth = WORTH * len(r)
        logs = []
        for s in larger:
            _, volume = np.linalg.slogdet(np.eye(self.size) + jacobian.T @ jacobian / s**2)
            logs.append(-0.5 * (r @ r / s**2 + u @ u) - worth * np.log(s) - 0.5 * volume)
        a = self.alternative
        size = None if a is None else float(self.extent(u[None, -1:])[0, 0])
        evidence = float(logsumexp(logs) - np.log(len(logs)))
        return Fitted(name, evidence, size, a.unit if a else "", self.left(u))


def _ends(a: Alternative) -> tuple[float, float]:
    return (float(np.log(a.low)), float(np.log(a.high))) if a.scale == "log" else (a.low, a.high)
