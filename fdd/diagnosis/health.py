"""Alarms that no fault of the model's table explains: a model that no longer holds, and a reading that is frozen."""

from __future__ import annotations

from dataclasses import replace

from fdd.records import Alarm, JsonObject

FLATLINE = ":flatline"
# A reading that never changes leaves little room for another cause.
FROZEN = 0.95
TESTS = {
    "autocorrelation": "its errors of prediction have gained a memory",
    "periodogram": "its errors of prediction have gained a rhythm or a drift",
    "dispersion": "its errors of prediction no longer vary as they did",
}


def of_model(alarm: Alarm) -> Alarm:
    """The words of an alarm of the model's health."""
    charts = list(alarm.evidence["charts"].values())
    by_test = {test: [c["symbol"] for c in charts if c["test"] == test] for test in TESTS}
    said = [f"{TESTS[t]} ({', '.join(dict.fromkeys(s))})" for t, s in by_test.items() if s]
    cause: JsonObject = {
        "name": "model",
        "meaning": "the model no longer describes this component",
        "likelihood": 1.0,
        "for": said,
        "against": ["no chart of the plant has rung"],
        "checks": [],
    }
    return replace(
        alarm,
        summary=f"{alarm.component}: the model no longer describes this component ({'; '.join(said)}); re-identify it",
        severity="low",
        causes=(cause,),
        checks=(
            "ask what was changed since, of equipment, control settings or sensors: a change explains it",
            f"re-identify it (fdd reidentify SITE --only {alarm.component}): errors of prediction have no memory again",
        ),
    )


def undiagnosed(alarm: Alarm, error: Exception) -> Alarm:
    """The alarm where its diagnosis failed: what was known before stands, and why there is nothing new."""
    why = f"not diagnosed, because of {type(error).__name__}: {error}"
    known = alarm.summary.partition(" (not diagnosed, ")[0]
    said = known or f"{alarm.component}: {', '.join(alarm.evidence['charts'])} rang"
    return replace(
        alarm,
        summary=f"{said} ({why})",
        evidence={**alarm.evidence, "not_diagnosed": why},
    )


def without_frozen(alarm: Alarm) -> Alarm:
    """The alarm without charts of frozen readings, for a ranking by parameters and innovations."""
    charts = {name: c for name, c in alarm.evidence["charts"].items() if not name.endswith(FLATLINE)}
    return replace(alarm, evidence={**alarm.evidence, "charts": charts})


def with_frozen(alarm: Alarm) -> Alarm:
    """A frozen reading among the charts that rang comes before every other cause: what it upsets is its consequence."""
    frozen = [c for name, c in alarm.evidence["charts"].items() if name.endswith(FLATLINE)]
    if not frozen:
        return alarm
    points = ", ".join(str(c["point"]) for c in frozen)
    hours = max(float(c["unchanged_seconds"]) for c in frozen) / 3600
    checks = (
        f"look at {points} at the controller: a living signal changes by itself",
        "warm or load the sensor: it must follow within minutes",
        "if it follows at the controller, the gateway repeats old values: restart its polling",
    )
    cause: JsonObject = {
        "name": "frozen",
        "meaning": f"the sensor {points} is frozen",
        "likelihood": FROZEN,
        "for": [f"{c['point']} has not changed for {float(c['unchanged_seconds']) / 3600:.1f} h" for c in frozen],
        "against": [],
        "checks": list(checks),
    }
    others = tuple({**c, "likelihood": round(float(c["likelihood"]) * (1 - FROZEN), 3)} for c in alarm.causes)
    return replace(
        alarm,
        summary=f"{alarm.component}: the sensor {points} is frozen (no change for {hours:.1f} h)",
        severity="medium" if alarm.severity == "low" else alarm.severity,
        causes=(cause, *others),
        checks=(*checks, *alarm.checks),
    )
