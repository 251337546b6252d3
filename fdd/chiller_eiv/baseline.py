"""A chiller's baseline: what it looks like when healthy, learned once from steady points and kept as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from fdd.chiller_eiv.checks import SERIES, ApproachModel, available_series, fit_approach
from fdd.chiller_eiv.config import ChillerConfig
from fdd.chiller_eiv.drift import WEEK, DriftBaseline, fit_baseline
from fdd.chiller_eiv.forms import Form
from fdd.chiller_eiv.gate import GateDecision, Level, gate
from fdd.chiller_eiv.model import ChillerError, GordonNg
from fdd.chiller_eiv.power_residual import (
    DAY,
    PowerModel,
    Reference,
    choose_power_model,
    daily_medians,
    learn_reference,
)
from fdd.chiller_eiv.steady_state import SteadyPoints
from fdd.records import FloatArray, JsonObject

POWER = "power residual"
"""Name of the power residual's series, beside those of ``checks.SERIES``."""

_FLOOR = {POWER: 0.003, **dict.fromkeys(SERIES, 0.03)}
"""Least day-to-day standard deviation believed: 0.3 % of power, 0.03 K."""


@dataclass(frozen=True)
class ChillerBaseline:
    """What one chiller is compared with.

    Attributes
    ----------
    start, end : span of the points it was learned from [ns]
    points : their number
    level, reasons : the gate's answer
    estimate, se : parameters by name, SI; for information
    power : expected power
    references : daily reference by series
    approaches : approach lines by series
    drift : weekly parameter charts' baseline; None where the gate or the length forbids them
    drift_note : why there is none, or what self-calibration said
    balance : heat balance errors of the baseline's points
    availability : share of days with points
    """

    start: int
    end: int
    points: int
    level: str
    reasons: tuple[str, ...]
    estimate: Mapping[str, float]
    se: Mapping[str, float]
    power: PowerModel
    references: Mapping[str, Reference]
    approaches: Mapping[str, ApproachModel] = field(default_factory=dict)
    drift: DriftBaseline | None = None
    drift_note: str = ""
    balance: FloatArray = field(default_factory=lambda: np.zeros(0))
    availability: float = 1.0

    def export_state(self) -> JsonObject:
        """Plain data: JSON scalars, lists and numpy arrays."""
        return {
            "schema": 1,
            **{k: getattr(self, k) for k in ("start", "end", "points", "level", "drift_note", "availability")},
            "reasons": list(self.reasons),
            "estimate": dict(self.estimate),
            "se": dict(self.se),
            "power": {"form": self.power.form.name, "machine": asdict(self.power.machine), "spread": self.power.spread},
            "references": {k: asdict(v) for k, v in self.references.items()},
            "approaches": {k: asdict(v) for k, v in self.approaches.items()},
            "drift": None if self.drift is None else self.drift.export_state(),
            "balance": self.balance,
        }

    @classmethod
    def of_state(cls, state: JsonObject, config: ChillerConfig) -> ChillerBaseline:
        """From what ``export_state`` gave; the forms come from the configuration.

        Raises
        ------
        ChillerError : the saved form is not among the configuration's
        """
        if state.get("schema") != 1:
            raise ChillerError(
                f"chiller baseline has schema {state.get('schema')!r}, this version reads 1: learn it anew"
            )
        forms: dict[str, Form] = {f.name: f for f in config.prediction_forms()}
        name = state["power"]["form"]
        if name not in forms:
            raise ChillerError(f"the saved baseline uses form {name!r}, the configuration allows {', '.join(forms)}")
        machine = GordonNg(**state["power"]["machine"])
        plain = {k: state[k] for k in ("start", "end", "points", "level", "drift_note", "availability")}
        return cls(
            **plain,
            reasons=tuple(state["reasons"]),
            estimate=dict(state["estimate"]),
            se=dict(state["se"]),
            power=PowerModel(forms[name], machine, float(state["power"]["spread"]), int(state["points"])),
            references={k: Reference(**v) for k, v in state["references"].items()},
            approaches={k: ApproachModel(**v) for k, v in state["approaches"].items()},
            drift=None if state["drift"] is None else DriftBaseline.of_state(state["drift"]),
            balance=np.asarray(state["balance"], dtype=float),
        )

    def series(self, points: SteadyPoints, config: ChillerConfig) -> dict[str, FloatArray]:
        """The watched series of these points: relative power residual and approach residuals [K], shape (n,) each."""
        x, _ = points.regressors(config.instruments, self.power.form.measured)
        out = {POWER: self.power.residual(x)}
        for name, model in self.approaches.items():
            if available(name, points):
                out[name] = model.residual(points.raw, x[:, 2])
        return out


def available(series: str, points: SteadyPoints) -> bool:
    """Whether a series' two quantities are among the points'."""
    warm, cold, _ = SERIES[series]
    return warm in points.raw and cold in points.raw


def learn_baseline(points: SteadyPoints, config: ChillerConfig) -> tuple[ChillerBaseline, GateDecision]:
    """Learn a chiller's baseline from the steady points of a healthy period.

    Raises
    ------
    ChillerError : too few points or days to predict even the power
    """
    if not len(points):
        raise ChillerError(f"chiller {config.name!r}: no steady points; see the report of rejected samples")
    x, cov = points.regressors(config.instruments, config.form().measured)
    days = points.days()
    decision = gate(x, cov, days, options=config.fit_options(), limits=config.gate, leak=config.leak)
    drift, note = _drift(points, x, cov, decision, config)
    forms = [(f, points.regressors(config.instruments, f.measured)[0]) for f in config.prediction_forms()]
    power = choose_power_model(forms, days)
    load = x[:, 2]
    approaches = {k: fit_approach(k, points.raw, load) for k in available_series(points.raw)}
    span = max((int(points.time[-1]) - int(points.time[0])) / DAY, 1.0)
    draft = ChillerBaseline(
        start=int(points.time[0]),
        end=int(points.time[-1]),
        points=len(points),
        level=decision.level.value,
        reasons=decision.reasons,
        estimate=decision.fit.values(),
        se=dict(zip(decision.fit.parameters, map(float, decision.fit.se), strict=True)),
        power=power,
        references={},
        approaches=approaches,
        drift=drift,
        drift_note=note,
        balance=points.balance[np.isfinite(points.balance)],
        availability=float(np.clip((days.max() + 1) / (span + 1), 0.05, 1.0)),
    )
    references = {
        k: learn_reference(daily_medians(points.time, v)[1], _FLOOR[k]) for k, v in draft.series(points, config).items()
    }
    return _with(draft, references), decision


def _with(draft: ChillerBaseline, references: Mapping[str, Reference]) -> ChillerBaseline:
    return ChillerBaseline(**{**{k: getattr(draft, k) for k in draft.__dataclass_fields__}, "references": references})


def _drift(
    points: SteadyPoints, x: FloatArray, cov: FloatArray, decision: GateDecision, config: ChillerConfig
) -> tuple[DriftBaseline | None, str]:
    if decision.level is Level.RESIDUAL:
        return None, "parameters are not charted: " + decision.sentence()
    values = decision.fit.values()
    held = {k: v for k, v in values.items() if k not in ("dS", "R")}
    try:
        baseline = fit_baseline(x, cov, points.time // WEEK, held, form=config.form(), options=config.drift)
    except ChillerError as e:
        return None, f"parameters are not charted weekly yet: {e}"
    return baseline, baseline.note
