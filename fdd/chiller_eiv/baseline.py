"""A chiller's baseline: what it looks like when healthy, learned once from steady points and kept as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from fdd.chiller_eiv.clusters import Clusters, cluster
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.drift import WEEK, DriftBaseline, fit_baseline
from fdd.chiller_eiv.gate import GateDecision, Level, gate
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.steady_state import SteadyLimits, SteadyPoints, SteadyReport, steady_points, steady_quantities
from fdd.chiller_eiv.vector import VectorBaseline, learn_vector
from fdd.records import NANOSECONDS, FloatArray, IntArray, JsonObject

SCHEMA = 2
LEAST_CLOSING = 0.5
"""Share of points whose heat balance must close for parameters to be estimated from them."""


@dataclass(frozen=True)
class ChillerBaseline:
    """What one chiller is compared with.

    Attributes
    ----------
    start, end : span of the points it was learned from [ns]
    points : their number
    level, reasons : the gate's answer
    estimate, se : parameters that may be believed, by name, SI; those that were declined are not among them
    vector : expected steady states, power among them
    steady : limits of steady state
    period : sampling period [s]
    tested : quantities that must be steady
    drift : weekly parameter charts' baseline; None where the gate or the length forbids them
    drift_note : why there is none, or what self-calibration said
    balance : heat balance errors of the baseline's points
    """

    start: int
    end: int
    points: int
    level: str
    reasons: tuple[str, ...]
    estimate: Mapping[str, float]
    se: Mapping[str, float]
    vector: VectorBaseline
    steady: SteadyLimits
    period: float
    tested: tuple[str, ...]
    drift: DriftBaseline | None = None
    drift_note: str = ""
    balance: FloatArray = field(default_factory=lambda: np.zeros(0))

    def export_state(self) -> JsonObject:
        """Plain data: JSON scalars, lists and numpy arrays."""
        return {
            "schema": SCHEMA,
            **{k: getattr(self, k) for k in ("start", "end", "points", "level", "drift_note", "period")},
            "reasons": list(self.reasons),
            "tested": list(self.tested),
            "estimate": dict(self.estimate),
            "se": dict(self.se),
            "vector": self.vector.export_state(),
            "steady": {**asdict(self.steady), "noise": dict(self.steady.noise)},
            "drift": None if self.drift is None else self.drift.export_state(),
            "balance": self.balance,
        }

    @classmethod
    def of_state(cls, state: JsonObject, config: ChillerConfig) -> ChillerBaseline:
        """From what ``export_state`` gave.

        Raises
        ------
        ChillerError : it is another version's, or was learned with another rated load
        """
        if state.get("schema") != SCHEMA:
            raise ChillerError(
                f"chiller baseline has schema {state.get('schema')!r}, this version reads {SCHEMA}: learn it anew"
            )
        vector = VectorBaseline.of_state(state["vector"])
        if vector.layout.rated_load != config.rated_load:
            raise ChillerError(
                f"the baseline was learned with a rated load of {vector.layout.rated_load:g} W, the declaration says "
                f"{config.rated_load:g} W: learn it anew"
            )
        return cls(
            **{k: state[k] for k in ("start", "end", "points", "level", "drift_note", "period")},
            reasons=tuple(state["reasons"]),
            tested=tuple(state["tested"]),
            estimate=dict(state["estimate"]),
            se=dict(state["se"]),
            vector=vector,
            steady=SteadyLimits(**state["steady"]),
            drift=None if state["drift"] is None else DriftBaseline.of_state(state["drift"]),
            balance=np.asarray(state["balance"], dtype=float),
        )

    def expected_power(self, points: SteadyPoints, config: ChillerConfig) -> FloatArray:
        """Power that the healthy machine takes at the drivers of these points [W], shape (n,); NaN where not judged."""
        raw = with_load(points, config)
        layout = self.vector.layout
        own = {k: raw.get(k, np.full(len(points), np.nan)) for k in {*raw, *layout.readings, *layout.drivers}}
        extra = self.vector.residual(own)[:, layout.features.index("power")]
        power = points.raw["power"] - layout.auxiliary
        return np.asarray(np.where(self.vector.judged(own), power * np.exp(-extra), np.nan))


def with_load(points: SteadyPoints, config: ChillerConfig) -> dict[str, FloatArray]:
    """The points' readings and their load [W]."""
    x, _ = points.regressors(config.instruments)
    return {**points.raw, "load": x[:, 2]}


def clusters_of(points: SteadyPoints, config: ChillerConfig, length: int) -> Clusters:
    """Clusters of steady points whose windows have this length [ns]."""
    return cluster(points, with_load(points, config)["load"], length, config.rated_load)


def learn_baseline(
    points: SteadyPoints,
    config: ChillerConfig,
    *,
    steady: SteadyLimits | None = None,
    period: float = 300.0,
    tested: tuple[str, ...] | None = None,
) -> tuple[ChillerBaseline, GateDecision]:
    """Learn a chiller's baseline from the steady points of a healthy period.

    Parameters
    ----------
    steady, period, tested : how the points were made; by default as the declaration says

    Raises
    ------
    ChillerError : too few points or clusters
    """
    steady = steady or config.steady
    if not len(points):
        raise ChillerError(f"chiller {config.name!r}: no steady points; see the report of rejected samples")
    window = round(max(3, round(steady.window / period)) * period * NANOSECONDS)
    vector = learn_vector(clusters_of(points, config, window), config.instruments, config.rated_load)
    closing = points.closing(steady.balance)
    balanced = closing.mean() >= LEAST_CLOSING
    used = points.select(closing) if balanced else points
    x, cov = used.regressors(config.instruments, config.form().measured)
    decision = gate(
        x,
        cov,
        used.days(),
        options=config.fit_options(),
        limits=config.gate,
        leak=config.leak,
        scale=config.instruments.scales(),
    )
    if not balanced:
        off = float(np.nanmedian(points.balance))
        reason = (
            f"the heat balance does not close (condenser {100 * off:+.0f} % of load and power, at most "
            f"{100 * steady.balance:.0f} %): a meter is wrong"
        )
        decision = replace(decision, level=Level.RESIDUAL, reasons=(reason, *decision.reasons))
    drift, note = _drift(used.time // WEEK, x, cov, decision, config)
    believed = decision.level is not Level.RESIDUAL
    return (
        ChillerBaseline(
            start=int(points.time[0]),
            end=int(points.time[-1]),
            points=len(points),
            level=decision.level.value,
            reasons=decision.reasons,
            estimate=decision.fit.values() if believed else {},
            se=dict(zip(decision.fit.parameters, map(float, decision.se()), strict=True)) if believed else {},
            vector=vector,
            steady=steady,
            period=period,
            tested=tested or config.instruments.needed(),
            drift=drift,
            drift_note=note,
            balance=points.balance[np.isfinite(points.balance)],
        ),
        decision,
    )


def learn_from_samples(
    time: IntArray, raw: Mapping[str, FloatArray], config: ChillerConfig, end: int | None = None
) -> tuple[ChillerBaseline, GateDecision, SteadyPoints, SteadyReport]:
    """Learn a baseline from raw samples, with steady-state limits that fit them.

    Parameters
    ----------
    end : of the healthy period [ns]; by default all of it is healthy

    Returns
    -------
    The baseline and the gate's answer, and the steady points of all samples with the fate of every sample

    Raises
    ------
    ChillerError : no steady points, or too few; the text counts what was rejected
    """
    healthy = time <= (time[-1] if end is None else end)
    learned_from = {k: v[healthy] for k, v in raw.items()}
    steady = config.steady_for(time[healthy], learned_from)
    points, report = steady_points(time, raw, config.instruments, rated_load=config.rated_load, limits=steady)
    rejected = ", ".join(f"{k} {n}" for k, n in report.counts().items() if n)
    try:
        baseline, decision = learn_baseline(
            points.select(points.time <= time[healthy][-1]),
            config,
            steady=steady,
            period=report.period,
            tested=steady_quantities(learned_from, config.instruments),
        )
    except ChillerError as error:
        raise ChillerError(f"{error}; samples by reason: {rejected}") from None
    return baseline, decision, points, report


def _drift(
    week: IntArray, x: FloatArray, cov: FloatArray, decision: GateDecision, config: ChillerConfig
) -> tuple[DriftBaseline | None, str]:
    if decision.level is Level.RESIDUAL:
        return None, "parameters are not charted: " + decision.sentence()
    values = decision.fit.values()
    held = {k: v for k, v in values.items() if k not in ("dS", "R")}
    try:
        baseline = fit_baseline(x, cov, week, held, form=config.form(), options=config.drift)
    except ChillerError as e:
        return None, f"parameters are not charted weekly yet: {e}"
    return baseline, baseline.note
