"""What may become of an alarm: which event leads from which state to which, after ISA-18.2 / IEC 62682.

The alarms latch: one whose evidence is gone waits to be cleared, whether it was acknowledged or not, for clearing also
starts its charts again. So acknowledging what has returned to normal is clearing it, and no action of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum

from fdd.evidence import Entry
from fdd.records import NANOSECONDS, AlarmState

HOUR = 3600 * NANOSECONDS
# An alarm explains others so long after its evidence has gone: what its fault left in windows of a day, and downstream.
GRACE = 24 * HOUR
# Flap protection: an alarm that came back after it had returned to normal within so long ...
FLAPPING = 7 * 24 * HOUR
# ... must be quiet for this time, doubled with every further return, before it returns again; ten days at most.
QUIET, QUIET_MOST = 6 * HOUR, 240 * HOUR


class Event(StrEnum):
    """What happens to an alarm; the last four are an operator's."""

    RING = "a chart rings"
    NORMAL = "the evidence is gone"
    EXPLAIN = "another alarm explains it"
    RELEASE = "nothing explains it any more"
    ACKNOWLEDGE = "acknowledge"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    CLEAR = "clear"


_R, _A, _H = AlarmState.RAISED, AlarmState.ACKNOWLEDGED, AlarmState.SHELVED
_S, _N, _C = AlarmState.SUPPRESSED, AlarmState.RETURNED, AlarmState.CLEARED

LIFE: Mapping[AlarmState, Mapping[Event, AlarmState]] = {
    _R: {Event.RING: _R, Event.NORMAL: _N, Event.EXPLAIN: _S, Event.ACKNOWLEDGE: _A, Event.SHELVE: _H, Event.CLEAR: _C},
    # Whoever has said that they saw it is not told that it is a consequence by its vanishing.
    _A: {Event.RING: _A, Event.NORMAL: _N, Event.SHELVE: _H, Event.CLEAR: _C},
    # The end of shelving, or of suppression, is followed by NORMAL or EXPLAIN where the evidence says so.
    _H: {Event.RING: _H, Event.SHELVE: _H, Event.UNSHELVE: _R, Event.CLEAR: _C},
    _S: {Event.RING: _S, Event.RELEASE: _R, Event.SHELVE: _H, Event.CLEAR: _C},
    _N: {Event.RING: _R, Event.SHELVE: _H, Event.CLEAR: _C},
    _C: {},
}
"""State and event to the next state; an event that is not there changes nothing, or is refused to an operator."""


def what_then(state: AlarmState, event: Event) -> AlarmState | None:
    """The next state; None where the event means nothing in this one."""
    return LIFE[state].get(event)


def quiet_wanted(history: Iterable[Entry], time: int) -> int:
    """How long the evidence must be gone before the alarm returns to normal [ns]: at once, longer if it flaps."""
    returns = sum(e.state == AlarmState.RETURNED and time - e.time < FLAPPING for e in history)
    return min(QUIET << (returns - 1), QUIET_MOST) if returns else 0
