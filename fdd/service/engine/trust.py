"""Doubt before accusing: a component that rings more often than its budget allows, on its own record, accuses nobody.

Alarms of the plant are counted since the component's baseline came in force, against what was promised for the days
that its charts have judged. An alarm that an operator closed as *found* was none of those; where nobody says what was
found, it counts. Where so many would come by chance once in a hundred records, the promise is void: the component
accuses nobody, and status and replay say so and ask for data. Readings that are frozen are told all the same.
"""

from __future__ import annotations

from scipy.stats import poisson

from fdd.evidence import AlarmKind, ChartKind
from fdd.records import JsonObject
from fdd.service.alarms.book import Ring

CHANCE = 0.01
# Fewer alarms than this are no record.
FEWEST = 3
YEAR = 365.25


class Trust:
    """How many alarms each component has raised that nobody has explained, since its baseline came in force."""

    def __init__(self) -> None:
        self._raised: dict[str, int] = {}

    def found(self, component: str) -> None:
        """An operator has found what an alarm told."""
        self._raised[component] = max(0, self._raised.get(component, 0) - 1)

    def forget(self, component: str) -> None:
        """A new baseline: its record begins."""
        self._raised.pop(component, None)

    def add(self, component: str) -> None:
        """One more."""
        self._raised[component] = self._raised.get(component, 0) + 1

    def void(self, component: str, days: int, promised: float, more: int = 0) -> str:
        """Why a component's alarms, and so many ``more``, are too many for its days judged; empty where they are not.

        ``promised`` is a year's.
        """
        count = self._raised.get(component, 0) + more
        expected = promised * days / YEAR
        if count < FEWEST or float(poisson.sf(count - 1, expected)) >= CHANCE:
            return ""
        return (
            f"it has rung {count} times where {expected:.1g} false alarms were promised, and nobody has found a fault; "
            "say so if one was found (clear with a comment that begins with 'found'), or give it data"
        )

    @staticmethod
    def may_be_doubted(ring: Ring) -> bool:
        """Whether it accuses the plant by what the model mispredicts."""
        return ring.kind is AlarmKind.PLANT and ring.evidence.kind is not ChartKind.FLATLINE

    def export_state(self) -> JsonObject:
        """Plain data."""
        return dict(self._raised)

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._raised = {str(k): int(v) for k, v in state.items()}
