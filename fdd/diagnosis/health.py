"""Alarms that no fault of the model's table explains: a model that no longer holds, and a reading that is frozen."""

from __future__ import annotations

from dataclasses import replace

from fdd.evidence import Cause, ChartEvidence, ChartKind, Message
from fdd.records import Alarm

# A reading that never changes leaves little room for another cause.
FROZEN = 0.95
TESTS = {
    ChartKind.AUTOCORRELATION: "model_memory",
    ChartKind.PERIODOGRAM: "model_rhythm",
    ChartKind.DISPERSION: "model_spread",
}


def of_model(alarm: Alarm) -> Alarm:
    """What an alarm of the model's health says."""
    charts = alarm.evidence.charts.values()
    by_test = {code: [c.symbol for c in charts if c.kind is kind] for kind, code in TESTS.items()}
    cause = Cause(
        name="model",
        meaning=Message.of("model_stale"),
        likelihood=1.0,
        speaks_for=tuple(Message.of(code, symbols=tuple(dict.fromkeys(s))) for code, s in by_test.items() if s),
        speaks_against=(Message.of("no_plant_chart"),),
    )
    return replace(
        alarm,
        severity="low",
        causes=(cause,),
        checks=(Message.of("model_ask"), Message.of("model_reidentify", name=alarm.component)),
    )


def undiagnosed(alarm: Alarm, error: Exception) -> Alarm:
    """The alarm where its diagnosis failed: what was known before stands, and why there is nothing new."""
    why = Message.of("not_diagnosed", error=type(error).__name__, text=str(error))
    return replace(alarm, evidence=replace(alarm.evidence, not_diagnosed=why))


def without_frozen(alarm: Alarm) -> Alarm:
    """The alarm without charts of frozen readings, for a ranking by parameters and innovations."""
    charts = {name: c for name, c in alarm.evidence.charts.items() if c.kind is not ChartKind.FLATLINE}
    return replace(alarm, evidence=replace(alarm.evidence, charts=charts))


def with_frozen(alarm: Alarm) -> Alarm:
    """A frozen reading among the charts that rang comes before every other cause: what it upsets is its consequence."""
    frozen = [c for c in alarm.evidence.charts.values() if c.kind is ChartKind.FLATLINE]
    if not frozen:
        return alarm
    points = tuple(c.point or c.symbol for c in frozen)
    checks = (Message.of("frozen_look", points=points), Message.of("frozen_warm"), Message.of("frozen_gateway"))
    cause = Cause(
        name="frozen",
        meaning=Message.of("frozen", points=points),
        likelihood=FROZEN,
        speaks_for=tuple(_unchanged(c) for c in frozen),
        checks=checks,
    )
    others = tuple(replace(c, likelihood=round((c.likelihood or 0.0) * (1 - FROZEN), 3)) for c in alarm.causes)
    return replace(
        alarm,
        severity="medium" if alarm.severity == "low" else alarm.severity,
        causes=(cause, *others),
        checks=(*checks, *alarm.checks),
    )


def _unchanged(chart: ChartEvidence) -> Message:
    return Message.of("unchanged", point=chart.point or chart.symbol, hours=(chart.unchanged_seconds or 0.0) / 3600)
