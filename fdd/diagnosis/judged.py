"""What whoever closed an alarm said of it."""

from __future__ import annotations

from fdd.records import Alarm, AlarmState


def judged_false(alarm: Alarm) -> bool:
    """Whether the operator who closed the alarm called it false: the comment begins with that word."""
    if alarm.state is not AlarmState.CLEARED or not alarm.history:
        return False
    return alarm.history[-1].comment.strip().lower().startswith("false")


def judged_found(alarm: Alarm) -> bool:
    """Whether the operator who closed the alarm found what it told: the comment begins with ``found`` or ``true``."""
    if alarm.state is not AlarmState.CLEARED or not alarm.history:
        return False
    return alarm.history[-1].comment.strip().lower().startswith(("found", "true"))


def is_consequence(alarm: Alarm) -> bool:
    """Whether another alarm explains it, so that it is none of its own."""
    return alarm.state is AlarmState.SUPPRESSED or bool(alarm.evidence.caused_by)
