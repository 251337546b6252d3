"""A chiller's baseline from a healthy history, as the store keeps it; and its history as the study wants it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.chiller_eiv.baseline import ChillerBaseline, learn_from_samples
from fdd.chiller_eiv.gate import GateDecision, Level
from fdd.chiller_eiv.model import ChillerError
from fdd.chiller_eiv.steady_state import SteadyReport
from fdd.chiller_eiv.study import ChillerData
from fdd.chiller_eiv.study_report import SHOWN
from fdd.config.schema import CHILLER
from fdd.records import NANOSECONDS, Baseline, JsonObject
from fdd.service.baselines.history import History, held
from fdd.service.baselines.identify import IdentifyError
from fdd.service.site.plan import Chiller, Plan

DAY = 86400 * NANOSECONDS
# Baselines shorter than this know one season only.
SHORT = 84.0


@dataclass(frozen=True)
class FittedChiller:
    """One chiller's new baseline and how far it can be believed."""

    baseline: Baseline
    learned: ChillerBaseline
    decision: GateDecision
    report: SteadyReport
    warnings: tuple[str, ...]

    def summary(self) -> str:
        """What a reader must know of it."""
        b = self.baseline
        lines = [f"{b.component}: {b.samples} steady points; parameters are {self.decision.sentence()}"]
        for symbol, value in b.parameters.items():
            factor, unit = SHOWN[symbol]
            half = 1.96 * b.standard_errors.get(symbol, float("nan"))
            span = f"{(value - half) * factor:.4g} to {(value + half) * factor:.4g}" if np.isfinite(half) else "held"
            lines.append(f"  {symbol} = {value * factor:.4g} {unit} ({span})")
        v = self.learned.vector
        lines.append(
            f"  watched in {v.clusters} clusters of like states: {', '.join(v.layout.features)}; power within "
            f"{100 * v.power_cv:.1f} % of states left out (CV(RMSE))"
        )
        ton = 3.51685  # kW of cooling in a ton of refrigeration
        table = ", ".join(f"{100 * share:.0f} % {ton * each:.3f}" for share, each in v.part_load().items())
        lines.append(f"  expected kW per ton at the mean temperatures, by load: {table or 'no such load was seen'}")
        steady = self.learned.steady
        lines.append(f"  steady: {steady.window / 60:g} min, {steady.settling / 60:g} min after a start")
        lines.append("  samples by reason: " + ", ".join(f"{k} {n}" for k, n in self.report.counts().items() if n))
        calibration = self.learned.drift_note
        if calibration not in self.warnings and self.decision.level is not Level.RESIDUAL:
            lines.append(f"  self-calibration: {calibration}")
        lines += [f"  warning: {w}" for w in self.warnings]
        lines.append(f"  baseline version {b.version} of {b.component} is in force")
        return "\n".join(lines)


def chiller_data(plan: Plan, chiller: Chiller, history: History) -> ChillerData:
    """A chiller's raw data out of a history, values held and the gate closed as the engine does it."""
    values = held(history.time, history.of(tuple(chiller.inputs.values())), plan.hold)
    raw = {quantity: values[:, i].copy() for i, quantity in enumerate(chiller.inputs)}
    if chiller.when:
        closed = ~(history.of((chiller.when,))[:, 0] > 0.5)
        raw["power"][closed] = 0.0
    present = {k: v for k, v in raw.items() if k in chiller.config.quantities() or np.isfinite(v).any()}
    return ChillerData(history.time, present)


def learn_chiller(plan: Plan, chiller: Chiller, history: History, reason: str = "fitted") -> FittedChiller:
    """Learn a chiller's baseline from a healthy history.

    Raises
    ------
    IdentifyError : too few steady points to predict even its power; the text counts what was rejected
    """
    data = chiller_data(plan, chiller, history)
    try:
        learned, decision, _, report = learn_from_samples(data.time, data.raw, chiller.config)
    except ChillerError as error:
        raise IdentifyError(f"{chiller.name}: {error}") from None
    return FittedChiller(_document(chiller, learned, reason), learned, decision, report, _warnings(learned))


def _document(chiller: Chiller, learned: ChillerBaseline, reason: str) -> Baseline:
    """The baseline as every component's: version 0 until it is accepted."""
    return Baseline(
        component=chiller.name,
        version=0,
        model=CHILLER,
        model_version="1",
        options={},
        parameters=dict(learned.estimate),
        standard_errors=dict(learned.se),
        covariance=[],
        start=learned.start,
        end=learned.end,
        samples=learned.points,
        log_likelihood=0.0,
        innovation={},
        diagnostics={
            "chiller": _plain(learned.export_state()),
            "level": learned.level,
            "reasons": list(learned.reasons),
            "unidentifiable": [],
        },
        reason=reason,
    )


def _plain(value: object) -> JsonObject:
    """Arrays as lists, so that the document is JSON in any store."""
    found: JsonObject = _plain_value(value)  # type: ignore[assignment]
    return found


def _plain_value(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {k: _plain_value(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_value(v) for v in value]
    return value


def _warnings(learned: ChillerBaseline) -> tuple[str, ...]:
    found = []
    days = (learned.end - learned.start) / DAY
    if days < SHORT:
        found.append(f"{days:.0f} days of baseline; {SHORT:.0f} or more, over seasons, make its charts trustworthy")
    if learned.level == Level.RESIDUAL.value:
        found.append("its parameters cannot be told from these data; its steady states are watched all the same")
    elif learned.drift is None:
        found.append(learned.drift_note)
    return (*found, *learned.vector.notes)
